"""Holds a running server against its own description, by schemathesis.

Usage: contract.py [OPTION OF schemathesis run ..]; FURROW_BIN names the program.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parents[1] / "api/python/tests"))

import furrow  # noqa: E402
from processes import Server  # noqa: E402

BOUNDS = "guyonneau2022/bounds"
SHORT = {"algorithm": ["oracle", "heading-hold"], "field": ["crop-1"]}
# Some of them are removed on the way.
SWEEPS = 40


def fill(server: Server, client: furrow.Client) -> tuple[str, str]:
    """Gives the server finished sweeps; a job's key and the worker that ran it, which then leaves.

    A server that works itself would end when its worker is revoked, which the description allows.
    """
    worker = server.worker()
    for _ in range(SWEEPS):
        sweep = client.submit(BOUNDS, only=SHORT, seeds=2)
        sweep.wait(progress=False, timeout=120)
    worker.end()
    return next(sweep.jobs()).key, client.workers()[0].id


def settings(folder: Path, key: str, worker: str) -> Path:
    """The settings with the names of what is there."""
    text = (HERE / "schemathesis.toml").read_text().replace("JOB_KEY", key).replace("WORKER", worker)
    (folder / "schemathesis.toml").write_text(text)
    return folder / "schemathesis.toml"


def main(options: list[str]) -> int:
    """Starts a server, fills it, and asks it all sorts of things; the exit code is that of schemathesis."""
    with tempfile.TemporaryDirectory() as name, Server(Path(name), "--http-rate", "100000") as server:
        folder = Path(name)
        with furrow.Client(server.url) as client:
            file = settings(folder, *fill(server, client))
        program = [str(Path(sys.executable).parent / "schemathesis"), "--config-file", str(file)]
        asked = [*program, "run", f"{server.url}/openapi.json", "--no-color", *options]
        # Whatever it leaves is left in the folder that goes.
        return subprocess.run(asked, env={**os.environ, "PYTHONPATH": str(HERE)}, cwd=folder).returncode


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
