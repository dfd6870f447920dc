"""A real server for the tests: the program that FURROW_BIN names, on a database of its own."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

import furrow
from processes import Server

# Short runs: the true lines in place of found ones, and no lines at all.
BOUNDS = "guyonneau2022/bounds"
SHORT = {"algorithm": ["oracle", "heading-hold"], "field": ["crop-1"]}


@pytest.fixture(autouse=True)
def environment(monkeypatch: pytest.MonkeyPatch) -> None:
    """The user's own server is left alone."""
    for name in ("FURROW_URL", "FURROW_TOKEN", "FURROW_CA"):
        monkeypatch.delenv(name, raising=False)


@pytest.fixture(scope="session")
def served(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    """A server that works, and holds a sweep that is done: sweep 1, of four runs."""
    with Server(tmp_path_factory.mktemp("served"), "--threads", "2") as server:
        with furrow.Client(server.url) as client:
            client.submit(BOUNDS, only=SHORT, seeds=2).wait(progress=False, timeout=60)
        yield server


@pytest.fixture
def client(served: Server) -> Iterator[furrow.Client]:
    """A client of the server that works."""
    with furrow.Client(served.url) as client:
        yield client


@pytest.fixture
def done(client: furrow.Client) -> furrow.Sweep:
    """The sweep that is done."""
    return client.sweep(1)


@pytest.fixture
def idle(tmp_path: Path) -> Iterator[Server]:
    """A server without workers: nothing it is given is ever run."""
    with Server(tmp_path) as server:
        yield server


@pytest.fixture
def waiting(idle: Server) -> Iterator[furrow.Sweep]:
    """A sweep whose jobs wait for good."""
    with furrow.Client(idle.url) as client:
        yield client.submit(BOUNDS, only=SHORT, seeds=1)
