"""What the server tells, as plain data. Keys that this version does not know are left out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any, TypeVar

T = TypeVar("T")


def read(kind: type[T], told: Mapping[str, Any]) -> T:
    """``told`` as a ``kind``; a key without a default that is not there is a ``TypeError``."""
    known = {field.name for field in fields(kind)}  # type: ignore[arg-type]
    return kind(**{key: value for key, value in told.items() if key in known})


@dataclass(frozen=True)
class SweepStatus:
    """Where a sweep stands. ``state`` is ``active``, ``paused``, ``done`` or ``cancelled``.

    Counts are jobs: ``total`` = ``done`` + ``failed`` + ``queued`` + ``leased`` (at a worker) + ``cancelled``; of those
    done ``cached`` were known at submission and ``disputed`` are in doubt. ``rate_per_s`` is results per second [1/s],
    ``eta_s`` the time left at that rate [s], with its 95 % interval ``eta_ci95_s``; None while nothing is known. Times
    are milliseconds since 1970.
    """

    id: int
    name: str
    plan: str
    state: str
    priority: int
    total: int
    done: int
    failed: int
    queued: int
    leased: int
    cancelled: int
    cached: int
    disputed: int
    engine: str
    seeds: int
    factors: list[str]
    record: bool
    timing: bool
    created_ms: int
    finished_ms: int | None = None
    rate_per_s: float | None = None
    eta_s: float | None = None
    eta_ci95_s: list[float] | None = None

    @property
    def ended(self) -> bool:
        """Whether nothing more comes by itself."""
        return self.state in ("done", "cancelled")


@dataclass(frozen=True)
class Plan:
    """A plan that comes with the server. ``factors`` are the labels of the levels by factor."""

    name: str
    title: str
    source: str
    seeds: int
    factors: dict[str, list[str]]


@dataclass(frozen=True)
class PublishedTable:
    """A published table: ``client.publication(source, table)`` holds results against it."""

    source: str
    table: str


@dataclass(frozen=True)
class FailedJob:
    """A job that was given up on, and the reason of its last attempt."""

    id: int
    key: str
    factors: dict[str, str]
    seed: int
    reason: str | None


@dataclass(frozen=True)
class Worker:
    """A worker. ``state`` is ``live``, ``away``, ``expired``, ``revoked`` or ``barred``.

    ``threads`` is runs at a time, ``leased`` jobs that it holds, ``results`` those recorded of it, ``rate_per_s``
    results per second over the last 30 s [1/s]. Times are milliseconds since 1970; None where there is no limit.
    ``barred`` says since when and why it gets no more jobs, if a result of it turned out wrong.
    """

    id: str
    name: str
    state: str
    engine: str
    threads: int
    enrolled_by: str
    leased: int
    results: int
    first_seen_ms: int
    last_seen_ms: int
    rate_per_s: float | None = None
    certificate_until_ms: int | None = None
    until_ms: int | None = None
    revoked_ms: int | None = None
    barred: dict[str, Any] | None = None
