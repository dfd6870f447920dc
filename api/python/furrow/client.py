"""The way to a server."""

from __future__ import annotations

import os
import uuid
from collections.abc import Iterator, Mapping, Sequence
from types import TracebackType
from typing import Any

import pandas as pd

from . import frames
from .address import Address
from .job import Job
from .records import Plan, PublishedTable, SweepStatus, Worker, read
from .sweep import Sweep
from .transport import Transport, segment

SWEEPS_A_PAGE = 200


class Client:
    """A Furrow server.

    ``url``, ``token`` and ``ca`` (a file of certificates by which to trust the server) are taken from FURROW_URL,
    FURROW_TOKEN and FURROW_CA where they are not given, as the command line does; the address is
    http://127.0.0.1:8080 if nobody says. A token is sent encrypted or to this machine only. ``timeout`` is how long an
    answer may stand still [s]; a server that does not answer or is busy (429, 503) is asked again for ``retry_for``
    seconds, with growing pauses.

    ``ValueError`` where address, token or certificates cannot be used.
    """

    def __init__(
        self,
        url: str | None = None,
        token: str | None = None,
        ca: str | os.PathLike[str] | None = None,
        timeout: float = 75.0,
        retry_for: float = 60.0,
    ) -> None:
        self._transport = Transport(Address.of(url, token, ca), timeout, retry_for)

    def __repr__(self) -> str:
        return f"furrow.Client({self.url!r})"

    def __enter__(self) -> Client:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Closes the connections. Sweeps and jobs that came from this client can ask no more."""
        self._transport.close()

    @property
    def url(self) -> str:
        """The server's address."""
        return self._transport.url

    def submit(
        self,
        plan: str | Mapping[str, Any],
        *,
        seeds: int | None = None,
        only: Mapping[str, Sequence[str]] | None = None,
        set: Mapping[str, Any] | None = None,
        vary: Mapping[str, Sequence[Any]] | None = None,
        field: Mapping[str, Any] | None = None,
        name: str | None = None,
        priority: int | None = None,
        record: bool = False,
        timing: bool = False,
    ) -> Sweep:
        """Submits a plan, by its name or as an object; jobs whose result is known are not run again.

        ``seeds``: 1 to this many, in place of the plan's number. ``only``: levels to keep, by factor. ``set``: values
        by dotted path in the scenario; ``vary``: values that a path takes, as a further factor. ``field``: a field of
        yours in place of the plan's. ``priority``: higher goes first. ``record`` stores paths, ``timing`` measures
        computing times. A call is one submission, however often it has to be sent. A plan or value that cannot be is a
        ``ProblemError`` with status 400 or 422 that names the key and what is allowed.
        """
        wishes = {"seeds": seeds, "only": only, "set": set, "vary": vary, "field": field, "name": name}
        flags = {"priority": priority, "record": record or None, "timing": timing or None}
        body = {"plan": plan, **{key: value for key, value in {**wishes, **flags}.items() if value is not None}}
        once = {"Idempotency-Key": uuid.uuid4().hex}
        created = self._transport.ask("POST", "/v1/sweeps", body=body, headers=once).json()
        return Sweep.numbered(self._transport, created["id"], created["not_applied"])

    def sweep(self, id: int) -> Sweep:
        """The sweep of that number; a ``ProblemError`` with status 404 if there is none."""
        return Sweep.numbered(self._transport, id)

    def sweeps(self) -> Iterator[Sweep]:
        """All sweeps, the newest first, page by page as they are needed."""
        query: dict[str, str | None] = {"limit": str(SWEEPS_A_PAGE)}
        while True:
            page = self._transport.json("/v1/sweeps", query)
            for told in page["items"]:
                yield Sweep(self._transport, read(SweepStatus, told))
            if page["next"] is None:
                return
            query["after"] = str(page["next"])

    def job(self, id_or_key: int | str) -> Job:
        """The job of that number, key, or first 8 or more digits of a key."""
        return Job.named(self._transport, id_or_key)

    def plans(self) -> list[Plan]:
        """The plans that can be submitted by name."""
        items = self._transport.json("/v1/plans")["items"]
        labels = ({factor["name"]: factor["labels"] for factor in item["factors"]} for item in items)
        return [read(Plan, {**item, "factors": factors}) for item, factors in zip(items, labels)]

    def workers(self) -> list[Worker]:
        """All workers, live and past, the latest seen first."""
        return [read(Worker, item) for item in self._transport.json("/v1/workers")["items"]]

    def publications(self) -> list[PublishedTable]:
        """The published tables that results can be held against."""
        return [read(PublishedTable, item) for item in self._transport.json("/v1/publications")["items"]]

    def publication(self, source: str, table: str, sweep: int | Sweep | None = None) -> pd.DataFrame:
        """A published table beside the results of ``sweep``, or of the newest that fits, a row per cell.

        Columns: the factors, ``published`` (the paper's value), ``program`` and ``program_median`` (what its authors'
        own program gave), ``ours_mean``, ``ours_median``, ``ours_ci95_low``, ``ours_ci95_high``, ``ours_n``, the
        ``verdict`` and a ``note``.
        """
        of = None if sweep is None else str(sweep.id if isinstance(sweep, Sweep) else int(sweep))
        path = f"/v1/publications/{segment(source)}/{segment(table)}"
        return frames.of_publication(self._transport.text(path, {"sweep": of, "format": "csv"}))
