"""Reads tables and runs by pyarrow, a reader of others, and holds them against the same as CSV and JSON.

Usage: read_parquet.py FOLDER, which has table.{parquet,csv,json} and runs.{parquet,csv,json} of one sweep.
"""

from __future__ import annotations

import csv
import json
import sys
from pathlib import Path
from typing import Any

import pyarrow.parquet

Row = dict[str, Any]


def parquet_rows(file: Path) -> list[Row]:
    """Every row; no file without rows is a success."""
    rows: list[Row] = pyarrow.parquet.read_table(file).to_pylist()
    assert rows, f"{file} has no rows"
    return rows


def agree_with_csv(rows: list[Row], file: Path) -> None:
    """Every value: texts letter by letter, numbers to the last bit, and what is missing."""
    with file.open(newline="") as lines:
        expected = list(csv.DictReader(lines))
    assert len(rows) == len(expected), (len(rows), len(expected))
    for row, words in zip(rows, expected):
        assert list(row) == list(words), f"the columns are {list(row)}, not {list(words)}"
        for name, value in row.items():
            read = None if words[name] == "" else type(value)(words[name])
            assert value == read, f"{name}: {value!r}, not {words[name]!r}"


def agree_with_runs(rows: list[Row], file: Path) -> None:
    """Every key of a run, with its labels and metrics."""
    expected = [json.loads(line) for line in file.read_text().splitlines()]
    assert len(rows) == len(expected), (len(rows), len(expected))
    for row, run in zip(rows, expected):
        flat = {key: value for key, value in run.items() if key not in ("factors", "metrics")}
        assert row == {**flat, **run["factors"], **run["metrics"]}


def agree_with_cells(rows: list[Row], file: Path) -> None:
    """Mean and interval of every metric in every cell."""
    cells = json.loads(file.read_text())["cells"]
    assert len(rows) == len(cells), (len(rows), len(cells))
    for row, cell in zip(rows, cells):
        assert {name: row[name] for name in cell["factors"]} == cell["factors"] and row["n"] == cell["n"]
        for metric, told in cell["metrics"].items():
            stem = "success_ratio" if metric == "success" else metric
            mean = row[stem if metric == "success" else f"{metric}_mean"]
            ends = [row[f"{stem}_ci95_low"], row[f"{stem}_ci95_high"]]
            assert (mean, ends) == (told["mean"], told["ci95"] or [None, None]), (metric, mean, ends, told)


def main() -> None:
    """Checks both kinds of file."""
    folder = Path(sys.argv[1])
    for name, agree_with_json in (("table", agree_with_cells), ("runs", agree_with_runs)):
        rows = parquet_rows(folder / f"{name}.parquet")
        agree_with_csv(rows, folder / f"{name}.csv")
        agree_with_json(rows, folder / f"{name}.json")
        print(f"{name}.parquet: {len(rows)} rows of {len(rows[0])} columns, the same as in CSV and JSON")


if __name__ == "__main__":
    main()
