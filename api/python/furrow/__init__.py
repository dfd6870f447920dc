"""A client for Furrow: submit sweeps, wait for them, and read tables, runs and paths as data frames and arrays.

    import furrow

    with furrow.Client() as client:
        sweep = client.submit("guyonneau2022/bounds", only={"field": ["crop-1"]}, seeds=3)
        print(sweep.wait().table(group_by=["algorithm"], metrics=["success", "mean_squared_error_mm2"]))

Read in this order: ``client`` (the server), ``sweep`` and ``job`` (what it holds), ``records`` (plain data), ``frames``
(CSV and Parquet to pandas), ``waiting`` and ``events`` (progress), ``transport`` and ``address`` (HTTP), ``errors``.
Units stand in names (``x_m``, ``eta_s``); lengths are metres, angles radians, counter-clockwise from the x axis.
"""

from .client import Client
from .errors import FurrowError, ProblemError, SweepCancelled, SweepFailed, Unreachable
from .job import Job
from .records import FailedJob, Plan, PublishedTable, SweepStatus, Worker
from .sweep import Sweep

__all__ = [
    "Client",
    "FailedJob",
    "FurrowError",
    "Job",
    "Plan",
    "ProblemError",
    "PublishedTable",
    "Sweep",
    "SweepCancelled",
    "SweepFailed",
    "SweepStatus",
    "Unreachable",
    "Worker",
]
