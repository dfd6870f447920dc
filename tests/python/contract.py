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


def main(options: list[str]) -> int:
    with tempfile.TemporaryDirectory() as folder, Server(Path(folder), "--http-rate", "100000") as server:
        with furrow.Client(server.url) as client:
            key, worker = fill(server, client)
        names = {"FURROW_JOB_KEY": key, "FURROW_WORKER": worker, "PYTHONPATH": str(HERE)}
        program = [str(Path(sys.executable).parent / "schemathesis"), "--config-file", str(HERE / "schemathesis.toml")]
        asked = [*program, "run", f"{server.url}/openapi.json", "--no-color", *options]
        # A folder of its own: nothing of it stays.
        return subprocess.run(asked, env={**os.environ, **names}, cwd=folder).returncode


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
