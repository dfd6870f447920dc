"""Waiting for a sweep: its events, or where there are none a look a second."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from types import TracebackType

from tqdm.auto import tqdm

from .errors import ProblemError, SweepCancelled, Unreachable
from .events import events
from .records import SweepStatus, read
from .transport import BUSY, Transport

LOOK_EVERY_S = 1.0

Told = Callable[[SweepStatus], object]


def until_ended(transport: Transport, known: SweepStatus, told: Told, timeout_s: float | None) -> SweepStatus:
    """Waits until the sweep has ended; ``told`` hears where it stands whenever that changes.

    Raises ``TimeoutError`` after ``timeout_s``, ``SweepCancelled`` when the sweep is removed meanwhile.
    """
    until = math.inf if timeout_s is None else time.monotonic() + timeout_s
    path = f"/v1/sweeps/{known.id}"
    while True:
        for status in _heard(transport, path, known, until):
            known = status
            told(known)
        now = _looked(transport, path, known)
        if now != known:
            known = now
            told(known)
        if known.ended:
            return known
        left_s = until - time.monotonic()
        if left_s <= 0:
            raise TimeoutError(f"sweep {known.id} has {known.done} of {known.total} jobs done after {timeout_s} s")
        time.sleep(min(LOOK_EVERY_S, left_s))


def _heard(transport: Transport, path: str, known: SweepStatus, until: float) -> Iterator[SweepStatus]:
    """What the events tell, until the sweep has ended, the time is up, or the stream breaks off."""
    left_s = until - time.monotonic()
    if left_s <= 0:
        return
    try:
        with transport.lines(f"{path}/events", left_s) as lines:
            for event in events(lines):
                if event.name == "progress":
                    known = read(SweepStatus, event.data)
                    yield known
                if event.name == "end" and event.data["state"] is None:
                    raise SweepCancelled(known, removed=True)
                if time.monotonic() >= until:
                    return
    except Unreachable:
        return
    except ProblemError as refusal:
        if refusal.status not in (*BUSY, 404):
            raise


def _looked(transport: Transport, path: str, known: SweepStatus) -> SweepStatus:
    try:
        return read(SweepStatus, transport.json(path))
    except ProblemError as refusal:
        if refusal.status == 404:
            raise SweepCancelled(known, removed=True) from refusal
        raise


class Bar:
    """A progress bar with the time left and its 95 % interval."""

    def __init__(self, status: SweepStatus) -> None:
        form = "{desc}: {percentage:3.0f} %|{bar}| {n_fmt}/{total_fmt} runs, {elapsed}{postfix}"
        self._bar = tqdm(total=status.total, desc=f"sweep {status.id}", bar_format=form)
        self(status)

    def __enter__(self) -> Bar:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._bar.close()

    def __call__(self, status: SweepStatus) -> None:
        self._bar.total = status.total
        self._bar.n = status.done + status.failed + status.cancelled
        self._bar.set_postfix_str(postfix(status), refresh=True)


def postfix(status: SweepStatus) -> str:
    """What else there is to say: ``3 failed, 2 min 5 s left [1 min 40 s, 2 min 37 s]``."""
    parts = [f"{status.failed} failed"] if status.failed else []
    if status.state == "paused":
        parts.append("paused")
    elif status.eta_s and not status.ended:
        left = f"{duration(status.eta_s)} left"
        if status.eta_ci95_s is not None:
            left += " [{}, {}]".format(*map(duration, status.eta_ci95_s))
        parts.append(left)
    return ", ".join(parts)


def duration(seconds: float) -> str:
    """``45 s``, ``2 min 5 s`` or ``3 h 20 min``."""
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60} min {whole % 60} s"
    return f"{whole // 3600} h {whole % 3600 // 60} min"
