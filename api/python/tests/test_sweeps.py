"""From a plan to results."""

from __future__ import annotations

import json

import httpx
import numpy as np
import pandas as pd
import pytest

import furrow
from conftest import BOUNDS, SHORT
from processes import Server

METRICS = ["success", "mean_squared_error_mm2"]


def test_a_sweep_is_waited_for_and_tells_where_it_stands(client: furrow.Client) -> None:
    told: list[furrow.SweepStatus] = []
    only = {"algorithm": ["heading-hold"], "field": ["crop-1"]}
    sweep = client.submit(BOUNDS, only=only, seeds=3, name="floor", priority=2, record=True)
    assert (sweep.name, sweep.factors, sweep.status.priority) == ("floor", ["algorithm", "field"], 2)
    assert sweep.wait(told.append, timeout=60) is sweep
    assert (sweep.state, told[-1].state, told[-1].done, told[-1].eta_s) == ("done", "done", 3, 0.0)
    assert sweep.status.cached == 2, "the runs of the sweep that is done were not repeated"
    assert repr(sweep).endswith("floor: done, 3 of 3 jobs done>")


def test_a_progress_bar_ends_full(done: furrow.Sweep, capsys: pytest.CaptureFixture[str]) -> None:
    done.wait()
    assert "sweep 1: 100 %" in (shown := capsys.readouterr().err) and "4/4 runs" in shown


def test_settings_reach_the_scenario(client: furrow.Client, done: furrow.Sweep) -> None:
    job = next(done.jobs())
    base = {part: values for part, values in job.scenario.items() if part != "field"}
    field = {
        "name": "two rows",
        "row_spacing_m": 1.5,
        "rows": [{"points_m": [[0, -0.75], [4, -0.75]]}, {"points_m": [[0, 0.75], [4, 0.75]]}],
        "plants": [{"x_m": 1.0, "y_m": y, "radius_m": 0.02, "height_m": 1.0, "kind": "crop", "row": row}
                   for row, y in enumerate((-0.75, 0.75))],
        "start": {"x_m": 0, "y_m": 0, "heading_rad": 0},
        "inter_rows": 1,
    }
    plan = {"name": "mine", "title": "t", "source": "s", "base": {**base, "field": job.scenario["field"]},
            "factors": [{"name": "algorithm", "levels": [{"label": "oracle", "patch": {}}]}], "seeds": 1}
    limits = {"limits.max_time_s": 20.0}
    sweep = client.submit(plan, set=limits, vary={"limits.stuck_after_s": [5.0, 6.0]}, field=field, timing=True)
    sweep.wait(progress=False, timeout=60)
    assert sweep.status.timing and sweep.factors == ["algorithm", "field", "stuck_after_s"]
    scenarios = [job.scenario for job in sweep.jobs()]
    assert {scenario["limits"]["stuck_after_s"] for scenario in scenarios} == {5.0, 6.0}
    assert {scenario["limits"]["max_time_s"] for scenario in scenarios} == {20.0}
    assert "line_finding_time_ms_mean" in sweep.table()


def test_settings_that_some_scenarios_do_not_have_are_told(idle: Server) -> None:
    with furrow.Client(idle.url) as client:
        sweep = client.submit(BOUNDS, set={"perception.iterations": 3}, only={"field": ["crop-1"]})
        assert [told["path"] for told in sweep.not_applied] == ["perception.iterations"]


def test_a_table_has_what_the_server_says_to_the_last_bit(served: Server, done: furrow.Sweep) -> None:
    table = done.table(metrics=METRICS)
    cells = served.json("/v1/sweeps/1/table", {"metric": ",".join(METRICS)})["cells"]
    assert len(table) == len(cells) == 2
    for row, cell in zip(table.to_dict("records"), cells):
        error, success = cell["metrics"]["mean_squared_error_mm2"], cell["metrics"]["success"]
        assert (row["algorithm"], row["field"], row["n"], row["missing"]) == (*cell["factors"].values(), 2, 0)
        for statistic in ("mean", "std", "median", "min", "max", "n"):
            assert row[f"mean_squared_error_mm2_{statistic}"] == error[statistic]
        ends = [row["mean_squared_error_mm2_ci95_low"], row["mean_squared_error_mm2_ci95_high"]]
        assert ends == error["ci95"] and row["success_ratio"] == success["mean"]
    kinds = table.dtypes.astype(str)
    assert (kinds["algorithm"], kinds["n"], kinds["success_ratio"]) == ("string", "int64", "float64")


def test_a_table_can_be_grouped_and_turned(done: furrow.Sweep) -> None:
    together = done.table(group_by=[], metrics="simulated_s", statistics=["mean", "n"])
    assert list(together.columns) == ["n", "missing", "success_ratio", "simulated_s_mean", "simulated_s_n"]
    assert together["n"].tolist() == [4]
    turned = done.table(metrics="success", columns="algorithm", statistics="mean")
    assert list(turned["field"]) == ["crop-1"]
    assert turned["oracle.success_ratio"].tolist() == [1.0] and turned["heading-hold.n"].dtype == np.int64


def test_a_table_is_written_as_text(done: furrow.Sweep) -> None:
    latex = done.table_text("latex", metrics="success")
    assert latex.startswith("\\begin{tabular}") and "\\toprule" in latex
    assert "oracle,crop-1,2,0,1" in done.table_text("csv", metrics=METRICS)
    assert json.loads(done.table_text("json"))["sweep"] == 1
    assert "success ratio" in done.table_text()


def test_runs_are_the_same_through_parquet_csv_and_json(
    served: Server, done: furrow.Sweep, monkeypatch: pytest.MonkeyPatch
) -> None:
    parquet = done.results()
    monkeypatch.setattr("furrow.frames.has_parquet", lambda: False)
    csv = done.results()
    pd.testing.assert_frame_equal(parquet, csv, check_exact=True)
    lines = httpx.get(f"{served.url}/v1/sweeps/1/results", params={"format": "json"}).text.splitlines()
    assert len(lines) == len(csv) == 4
    for line, row in zip(map(json.loads, lines), csv.to_dict("records")):
        measured = {name: value for name, value in line["metrics"].items() if value is not None}
        told = {**line["factors"], **measured, **{key: line[key] for key in ("job", "seed", "digest")}}
        assert {key: row[key] for key in told} == told
        assert all(np.isnan(row[name]) for name in line["metrics"].keys() - measured.keys())


def test_runs_without_a_result_are_rows_too(waiting: furrow.Sweep, monkeypatch: pytest.MonkeyPatch) -> None:
    parquet = waiting.results()
    monkeypatch.setattr("furrow.frames.has_parquet", lambda: False)
    pd.testing.assert_frame_equal(parquet, waiting.results(), check_exact=True)
    assert parquet["state"].tolist() == ["queued", "queued"] and parquet["outcome"].isna().all()
    table = waiting.table(metrics="success")
    assert table["n"].tolist() == [0, 0] and table["success_ratio"].isna().all()


def test_a_factor_may_be_called_like_another_column(
    idle: Server, done: furrow.Sweep, monkeypatch: pytest.MonkeyPatch
) -> None:
    level = {"label": "1", "patch": {}}
    plan = {"name": "mine", "title": "t", "source": "s", "base": next(done.jobs()).scenario,
            "factors": [{"name": "seed", "levels": [level]}, {"name": "state", "levels": [level]}], "seeds": 1}
    with furrow.Client(idle.url) as client:
        sweep = client.submit(plan)
        parquet = sweep.results()
        monkeypatch.setattr("furrow.frames.has_parquet", lambda: False)
        pd.testing.assert_frame_equal(parquet, sweep.results(), check_exact=True)
        assert parquet[["factor.seed", "seed", "factor.state", "state"]].values.tolist() == [["1", 1, "1", "queued"]]
        assert sweep.table()["seed"].tolist() == ["1"]


def test_two_levels_are_compared_in_pairs(client: furrow.Client, done: furrow.Sweep) -> None:
    compared = done.compare("algorithm", "oracle", "heading-hold", metric=METRICS, group_by="field")
    assert compared["field"].isna().tolist() == [True, True, False, False]
    over_all = compared[compared["field"].isna() & (compared["metric"] == "success")].iloc[0]
    assert (over_all["pairs"], over_all["difference"], over_all["test"]) == (2, 1.0, "mcnemar-exact")
    assert over_all["ci95_low"] < over_all["difference"] <= over_all["ci95_high"]
    kinds = compared.dtypes.astype(str)
    assert (kinds["pairs"], kinds["p"], kinds["zeros"]) == ("int64", "float64", "Int64")
    again = client.submit(BOUNDS, only=SHORT, seeds=2).wait(progress=False, timeout=60)
    across = done.compare("algorithm", "oracle", "heading-hold", other=again)
    assert across["difference"].tolist() == [1.0]


def test_a_publication_stands_beside_a_sweep(client: furrow.Client, done: furrow.Sweep) -> None:
    assert furrow.PublishedTable("guyonneau2022", "table-2") in client.publications()
    table = client.publication("guyonneau2022", "table-2", sweep=done)
    assert list(table.columns[:3]) == ["algorithm", "field", "published"]
    assert table.dtypes.astype(str)["published"] == "float64" and (table["verdict"] == "not-run").any()
    for published in client.publications():
        assert len(client.publication(published.source, published.table, sweep=1)) > 0


def test_lists_go_on_over_pages(client: furrow.Client, done: furrow.Sweep, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("furrow.sweep.JOBS_A_PAGE", 3)
    monkeypatch.setattr("furrow.client.SWEEPS_A_PAGE", 1)
    client.submit(BOUNDS, only=SHORT, seeds=2)
    jobs = list(done.jobs())
    assert [(job.factors["algorithm"], job.seed) for job in jobs] == [
        ("oracle", 1), ("oracle", 2), ("heading-hold", 1), ("heading-hold", 2)
    ]
    assert [job.seed for job in done.jobs(state="done", factors={"algorithm": "oracle"})] == [1, 2]
    assert list(done.jobs(state="failed")) == []
    numbers = [sweep.id for sweep in client.sweeps()]
    assert len(numbers) > 1 and numbers == sorted(numbers, reverse=True)


def test_plans_and_workers_are_listed(client: furrow.Client) -> None:
    plan = next(plan for plan in client.plans() if plan.name == BOUNDS)
    assert plan.seeds == 5 and plan.factors["algorithm"] == ["oracle", "rgop", "heading-hold"]
    (worker,) = client.workers()
    assert (worker.state, worker.threads, worker.barred) == ("live", 2, None) and worker.results >= 4
