"""One sweep: waiting for it, steering it, and reading its results."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Literal

import pandas as pd

from . import frames
from .errors import SweepCancelled, SweepFailed
from .job import Job
from .records import FailedJob, SweepStatus, read
from .transport import Query, Transport
from .waiting import Bar, Told, until_ended

JOBS_A_PAGE = 1_000
REASONS = 10

Names = str | Sequence[str] | None
TextFormat = Literal["text", "md", "csv", "json", "latex"]


class Sweep:
    """A sweep on a server. ``status`` is where it stood when the server was last asked."""

    def __init__(
        self, transport: Transport, status: SweepStatus, not_applied: Sequence[Mapping[str, Any]] = ()
    ) -> None:
        self._transport = transport
        self.status = status
        self.not_applied = tuple(not_applied)
        """Paths of ``set`` and ``vary`` that some scenarios do not have; known to who submitted it only."""

    @classmethod
    def numbered(cls, transport: Transport, id: int, not_applied: Sequence[Mapping[str, Any]] = ()) -> Sweep:
        """The sweep of that number."""
        return cls(transport, read(SweepStatus, transport.json(f"/v1/sweeps/{int(id)}")), not_applied)

    def __repr__(self) -> str:
        status = self.status
        return f"<furrow.Sweep {self.id} {status.name}: {status.state}, {status.done} of {status.total} jobs done>"

    @property
    def id(self) -> int:
        """Its number."""
        return self.status.id

    @property
    def name(self) -> str:
        """The name it was given, or its plan's."""
        return self.status.name

    @property
    def state(self) -> str:
        """``active``, ``paused``, ``done`` or ``cancelled``, when the server was last asked."""
        return self.status.state

    @property
    def factors(self) -> list[str]:
        """Names of its factors, in the plan's order."""
        return list(self.status.factors)

    def refresh(self) -> Sweep:
        """Asks where it stands; returns itself."""
        return self._now(self._transport.json(self._path()))

    def wait(self, progress: bool | Told = True, timeout: float | None = None) -> Sweep:
        """Waits until every job has ended, with a progress bar; returns itself.

        ``progress`` may also be a function that is told of each new ``SweepStatus``; ``timeout`` is in seconds. A sweep
        that is paused is waited for, too. Raises ``SweepFailed`` if jobs failed, ``SweepCancelled`` if the sweep was
        cancelled or removed, ``TimeoutError``, and ``Unreachable`` when the server has not answered for long.
        """
        if callable(progress):
            self.status = until_ended(self._transport, self.status, progress, timeout)
        elif progress:
            with Bar(self.status) as bar:
                self.status = until_ended(self._transport, self.status, bar, timeout)
        else:
            self.status = until_ended(self._transport, self.status, lambda _: None, timeout)
        if self.status.state == "cancelled":
            raise SweepCancelled(self.status)
        if self.status.failed:
            raise SweepFailed(self.status, self._failures())
        return self

    def pause(self) -> Sweep:
        """Hands out no more of its jobs; those that run may end. Returns itself, as all that steers it."""
        return self._change(paused=True)

    def resume(self) -> Sweep:
        """Lets it go on."""
        return self._change(paused=False)

    def prioritize(self, priority: int) -> Sweep:
        """Gives it another priority: higher goes first, 0 is the usual."""
        return self._change(priority=priority)

    def cancel(self) -> Sweep:
        """Gives up the jobs that no other sweep wants, and stops their runs. A sweep that is done stays so."""
        return self._now(self._transport.ask("DELETE", self._path()).json())

    def retry(self) -> Sweep:
        """Queues its failed and cancelled jobs again."""
        return self._now(self._transport.ask("POST", self._path("/retry")).json())

    def table(
        self, group_by: Names = None, metrics: Names = None, columns: str | None = None, statistics: Names = None
    ) -> pd.DataFrame:
        """Statistics of the results so far, a row per cell.

        Columns: the factors in ``group_by`` (all of them, if None; ``[]`` puts all runs together), ``n`` runs with a
        result, ``missing`` runs without, then per metric and statistic ``METRIC_mean``, ``_std``, ``_median``, ``_min``,
        ``_max``, ``_ci95_low``, ``_ci95_high`` (the 95 % interval of the mean) and ``_n``; the unit stands in the
        metric's name. ``success_ratio`` is the mean of ``success``, and stands beside every metric. ``statistics``
        chooses among these, and ``sum``, ``p5``, ``p25``, ``p75`` and ``p95`` (percentiles). With ``columns``, the
        labels of that factor stand before the columns' names: ``rgop.n``.
        """
        query = _table_query(group_by, metrics, columns, statistics)
        return frames.of_table(self._transport.text(self._path("/table"), {**query, "format": "csv"}), self.factors)

    def table_text(
        self,
        format: TextFormat = "text",
        group_by: Names = None,
        metrics: Names = None,
        columns: str | None = None,
        statistics: Names = None,
    ) -> str:
        """The same table written out, for instance as LaTeX with the rules of booktabs."""
        query = _table_query(group_by, metrics, columns, statistics)
        return self._transport.text(self._path("/table"), {**query, "format": format})

    def results(self) -> pd.DataFrame:
        """All runs, a row each: ``job``, ``key``, the factors, ``seed``, ``state``, ``attempts``, ``outcome``,
        ``digest``, then every metric, with the unit in its name. Failed and waiting runs are rows, too.

        Through Parquet where pyarrow is installed, else through CSV, with equal results.
        """
        if frames.has_parquet():
            answer = self._transport.ask("GET", self._path("/results"), {"format": "parquet"})
            return frames.of_runs_in_parquet(answer.content, self.factors)
        return frames.of_runs(self._transport.text(self._path("/results"), {"format": "csv"}), self.factors)

    def compare(
        self,
        factor: str | None = None,
        a: str | None = None,
        b: str | None = None,
        metric: Names = None,
        group_by: Names = None,
        other: int | Sweep | None = None,
    ) -> pd.DataFrame:
        """Two levels of a factor in pairs of runs that differ in nothing else; with ``other`` side b is of that sweep.

        A row per metric (``success`` if None) over all pairs, whose labels are missing, then for each level of the
        factors in ``group_by``: ``pairs``, the means ``a`` and ``b``, their ``difference`` with ``ci95_low`` and
        ``ci95_high``, ``p`` and ``p_holm`` of the ``test``, effects, and about how many ``more_seeds`` would decide.
        """
        query = {"factor": factor, "a": a, "b": b, "metric": _listed(metric), "group_by": _listed(group_by)}
        side = None if other is None else str(other.id if isinstance(other, Sweep) else int(other))
        csv = self._transport.text(self._path("/compare"), {**query, "other": side, "format": "csv"})
        return frames.of_comparison(csv, [] if group_by is None else _names(group_by))

    def jobs(self, state: str | None = None, factors: Mapping[str, str] | None = None) -> Iterator[Job]:
        """Its jobs by cell and number, page by page as they are needed: those in ``state``, with labels ``factors``."""
        query: dict[str, str | None] = {"sweep": str(self.id), "state": state, "limit": str(JOBS_A_PAGE)}
        query.update({f"factor.{name}": label for name, label in (factors or {}).items()})
        while True:
            page = self._transport.json("/v1/jobs", query)
            for line in page["items"]:
                yield Job(self._transport, line)
            if page["next"] is None:
                return
            query["after"] = page["next"]

    def _path(self, rest: str = "") -> str:
        return f"/v1/sweeps/{self.id}{rest}"

    def _change(self, **what: object) -> Sweep:
        return self._now(self._transport.ask("PATCH", self._path(), body=what).json())

    def _now(self, told: Mapping[str, Any]) -> Sweep:
        self.status = read(SweepStatus, told)
        return self

    def _failures(self) -> list[FailedJob]:
        failed = (job for job, _ in zip(self.jobs(state="failed"), range(REASONS)))
        return [FailedJob(job.id, job.key, job.factors, job.seed, job.reason) for job in failed]


def _table_query(group_by: Names, metrics: Names, columns: str | None, statistics: Names) -> Query:
    lists = {"group_by": _listed(group_by), "metric": _listed(metrics), "statistic": _listed(statistics)}
    return {**lists, "columns": columns}


def _names(names: str | Sequence[str]) -> list[str]:
    return [names] if isinstance(names, str) else list(names)


def _listed(names: Names) -> str | None:
    return None if names is None else ",".join(_names(names))
