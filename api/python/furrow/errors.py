"""What can go wrong, and what to do about it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from .records import FailedJob, SweepStatus


class FurrowError(Exception):
    """The root of this package's errors."""


class Unreachable(FurrowError, ConnectionError):
    """The server gave no answer, however often it was asked. Whatever was asked may be asked again."""


class ProblemError(FurrowError):
    """The server refused: a problem document after RFC 9457.

    ``status`` is the HTTP status, ``title`` that in words, ``detail`` what is wrong. ``key`` names the key at fault (a
    dotted path in what was sent, or a parameter) and ``allowed`` what it may be, where the server says so. ``document``
    is all that it said.
    """

    def __init__(self, status: int, document: Mapping[str, Any]) -> None:
        self.status = status
        self.title = str(document.get("title", ""))
        self.detail = str(document.get("detail", ""))
        key = document.get("key")
        self.key = key if isinstance(key, str) else None
        self.allowed: tuple[str, ...] = tuple(document.get("allowed", ()))
        self.document = dict(document)
        super().__init__(f"{status} {self.title}: {self.detail}")


class SweepFailed(FurrowError):
    """The sweep is done, but some of its jobs could not be run. ``failed`` says which and why.

    A run that went badly is no failure: its ``success`` is 0. The other jobs' results are there; ``Sweep.retry`` queues
    the failed ones again.
    """

    def __init__(self, status: SweepStatus, failed: Sequence[FailedJob]) -> None:
        self.status = status
        self.failed = tuple(failed)
        reasons = "; ".join(f"job {job.id}: {job.reason or 'no reason is known'}" for job in failed)
        more = f"; and {status.failed - len(failed)} more" if status.failed > len(failed) else ""
        super().__init__(f"{status.failed} of {status.total} jobs of sweep {status.id} failed: {reasons}{more}")


class SweepCancelled(FurrowError):
    """Somebody cancelled the sweep, or removed it; ``status`` is where it stood. ``Sweep.retry`` queues its jobs again."""

    def __init__(self, status: SweepStatus, removed: bool = False) -> None:
        self.status = status
        self.removed = removed
        what = "removed" if removed else "cancelled"
        super().__init__(f"sweep {status.id} was {what} with {status.done} of {status.total} jobs done")
