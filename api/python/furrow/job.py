"""One run."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from .transport import Transport, segment


class Job:
    """A job: a scenario with a seed, and its result if there is one.

    What a list tells of it is as it was then; the rest is asked for when it is first used, and kept until ``refresh``.
    """

    def __init__(self, transport: Transport, told: Mapping[str, Any]) -> None:
        self._transport = transport
        self._told = told
        self._detail = told if "scenario" in told else None

    @classmethod
    def named(cls, transport: Transport, name: int | str) -> Job:
        """The job of that number, key, or beginning of a key (8 digits or more)."""
        return cls(transport, transport.json(f"/v1/jobs/{segment(name)}"))

    def __repr__(self) -> str:
        return f"<furrow.Job {self.id} {self.factors} seed {self.seed}: {self.outcome or self.state}>"

    @property
    def id(self) -> int:
        """Its number in this database."""
        return int(self._told["id"])

    @property
    def key(self) -> str:
        """What is run, as 64 hexadecimal digits: the same key is not run twice."""
        return str(self._told["key"])

    @property
    def state(self) -> str:
        """``queued``, ``leased``, ``done``, ``failed`` or ``cancelled``."""
        return str(self._told["state"])

    @property
    def seed(self) -> int:
        """Its seed."""
        return int(self._told["seed"])

    @property
    def factors(self) -> dict[str, str]:
        """Its labels by factor, in the sweep through which it was listed, else in the oldest that wants it."""
        if "factors" in self._told:
            return dict(self._told["factors"])
        return dict(self._told["cells"][0]["factors"]) if self._told["cells"] else {}

    @property
    def outcome(self) -> str | None:
        """How its run ended: ``success``, or why not; None without a result."""
        outcome: str | None = self._told["outcome"]
        return outcome

    @property
    def digest(self) -> str | None:
        """The digest of its path, outcome and metrics: the same on every machine."""
        digest: str | None = self._told["digest"]
        return digest

    @property
    def detail(self) -> Mapping[str, Any]:
        """All that the server tells of it, keys as in ``GET /v1/jobs/{job}``."""
        if self._detail is None:
            self._detail = self._ask()
        return self._detail

    @property
    def metrics(self) -> dict[str, float]:
        """What was measured, by metric; units stand in the names. Empty without a result."""
        return dict(self.detail["metrics"])

    @property
    def scenario(self) -> dict[str, Any]:
        """What was run, with all defaults filled in."""
        return dict(self.detail["scenario"])

    @property
    def reason(self) -> str | None:
        """What the last attempt said for itself: of a failed job the panic's message, or how its worker died."""
        reasons: list[str | None] = [attempt["reason"] for attempt in self.detail["attempts"]]
        return reasons[-1] if reasons else None

    def refresh(self) -> Job:
        """Asks the server again; returns itself."""
        self._told = self._detail = self._ask()
        return self

    def trajectory(self) -> npt.NDArray[np.void]:
        """The true poses, 20 a simulated second, as n records ``time_s`` [s], ``x_m``, ``y_m`` [m], ``heading_rad`` [rad].

        The heading is counter-clockwise from the x axis. What was not recorded is run again by the server, to the same
        bits. A job without a result is a ``ProblemError`` with status 409.
        """
        told = self._transport.json(f"/v1/jobs/{self.id}/trajectory")
        path = np.empty(len(told["poses"]), dtype=[(name, np.float64) for name in ("time_s", *told["columns"])])
        path["time_s"] = np.arange(len(path)) * told["step_s"]
        for name, values in zip(told["columns"], np.array(told["poses"]).reshape(-1, len(told["columns"])).T):
            path[name] = values
        return path

    def svg(self) -> str:
        """A drawing of the run as SVG: field, weeds, damaged plants and the path. Status 409 without a result."""
        return self._transport.text(f"/v1/jobs/{self.id}/trajectory.svg")

    def _ask(self) -> Mapping[str, Any]:
        answer: Mapping[str, Any] = self._transport.json(f"/v1/jobs/{self.id}")
        return answer
