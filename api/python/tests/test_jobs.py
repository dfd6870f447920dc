"""Single runs."""

from __future__ import annotations

import numpy as np
import pytest

import furrow
from processes import Server


@pytest.fixture
def job(done: furrow.Sweep) -> furrow.Job:
    return next(done.jobs(factors={"algorithm": "heading-hold"}))


def test_a_job_goes_by_number_key_and_first_digits(client: furrow.Client, job: furrow.Job) -> None:
    for name in (job.id, str(job.id), job.key, job.key[:12]):
        found = client.job(name)
        assert (found.id, found.key, found.digest) == (job.id, job.key, job.digest)
    assert client.job(job.key).factors == {"algorithm": "heading-hold", "field": "crop-1"}


def test_what_a_list_leaves_out_is_asked_for(job: furrow.Job) -> None:
    assert (job.state, job.seed, job.reason) == ("done", 1, None)
    assert job.outcome is not None and job.outcome != "success" and job.metrics["success"] == 0.0
    assert job.scenario["perception"]["kind"] == "heading-hold" or job.scenario["mission"]["kind"] == "heading-hold"
    assert job.refresh() is job and job.detail["attempts"][0]["end"] == "done"
    assert repr(job).startswith(f"<furrow.Job {job.id} ")


def test_a_path_has_named_columns_and_the_poses_of_the_server(served: Server, job: furrow.Job) -> None:
    path, told = job.trajectory(), served.json(f"/v1/jobs/{job.id}/trajectory")
    assert path.dtype.names == ("time_s", "x_m", "y_m", "heading_rad")
    np.testing.assert_array_equal(np.column_stack([path[name] for name in path.dtype.names[1:]]), told["poses"])
    assert path["time_s"][0] == 0.0 and np.allclose(np.diff(path["time_s"]), 0.05)
    assert path["time_s"][-1] == pytest.approx(job.metrics["simulated_s"], abs=0.06)


def test_a_run_is_drawn(job: furrow.Job) -> None:
    assert "<svg" in (svg := job.svg()) and svg.rstrip().endswith("</svg>")


def test_a_job_without_a_result_has_no_path(waiting: furrow.Sweep) -> None:
    job = next(waiting.jobs())
    assert (job.state, job.outcome, job.digest, job.metrics) == ("queued", None, None, {})
    with pytest.raises(furrow.ProblemError) as refusal:
        job.trajectory()
    assert refusal.value.status == 409
