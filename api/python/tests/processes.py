"""``furrow`` processes, ended with their tests."""

from __future__ import annotations

import os
import subprocess
import threading
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import Any

import httpx
import pytest

READY_WITHIN_S = 20.0
ENDS_WITHIN_S = 20.0


def program() -> str:
    """The program under test."""
    path = os.environ.get("FURROW_BIN")
    if not path or not Path(path).is_file():
        pytest.fail(f"FURROW_BIN must name the program furrow, and is {path!r}: build it with `cargo build`", False)
    return path


def environment() -> dict[str, str]:
    return {name: value for name, value in os.environ.items() if not name.startswith("FURROW_")}


def run(*args: str) -> str:
    """What ``furrow`` with these arguments prints."""
    done = subprocess.run([program(), *args], env=environment(), capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    return done.stdout


class Process:
    """A process that goes on until it is told to end. What it logged must be free of panics."""

    def __init__(self, folder: Path, name: str, *args: str) -> None:
        self._log = folder / f"{name}.log"
        with self._log.open("a") as log:
            command = [program(), *args]
            self.process = subprocess.Popen(command, env=environment(), stdout=subprocess.PIPE, stderr=log, text=True)

    def lines(self, until: str) -> list[str]:
        """What it prints up to the line that begins with ``until``."""
        assert self.process.stdout is not None
        # A process that says nothing is killed, and what it did not say is missed below.
        overdue = threading.Timer(READY_WITHIN_S, self.process.kill)
        overdue.start()
        said: list[str] = []
        for line in self.process.stdout:
            said.append(line.strip())
            if line.startswith(until):
                overdue.cancel()
                return said
        overdue.cancel()
        pytest.fail(f"furrow said {said}, not {until!r}: {self._log.read_text()}")

    def kill(self) -> None:
        self.process.kill()
        self.process.wait(ENDS_WITHIN_S)

    def end(self) -> None:
        self.process.terminate()
        try:
            self.process.wait(ENDS_WITHIN_S)
        finally:
            self.kill()
            if self.process.stdout is not None:
                self.process.stdout.close()
        assert "panicked at" not in self._log.read_text()


class Server(Process):
    """A coordinator. ``address`` is where users connect; port 0 is a free one."""

    def __init__(self, folder: Path, *more: str, address: str = "127.0.0.1:0") -> None:
        self.folder = folder
        self.db = folder / "served.db"
        serve = ["serve", "--db", str(self.db), "--http", address, "--zenoh", "tcp/127.0.0.1:0", "--verify", "0"]
        super().__init__(folder, "server", *serve, *more)
        self.said = self.lines(until="workers connect to ")
        self.url = self.said[0].split()[-1]
        self.endpoint = self.said[-1].split()[-1]

    def __enter__(self) -> Server:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.end()

    def worker(self) -> Process:
        """A worker with one thread."""
        place = ["--connect", self.endpoint, "--spool", str(self.folder / "spool")]
        return Process(self.folder, "worker", "work", *place, "--threads", "1")

    def json(self, path: str, query: Mapping[str, str] | None = None) -> Any:
        """What the server itself says, past the client under test."""
        return httpx.get(self.url + path, params=query, trust_env=False).raise_for_status().json()
