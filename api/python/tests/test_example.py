"""The example that comes with the client."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from processes import Server

EXAMPLE = Path(__file__).parents[1] / "examples/sweep_to_figure.py"


def test_a_sweep_becomes_a_figure(served: Server, tmp_path: Path) -> None:
    picture = tmp_path / "bounds.png"
    levels = ["--field", "crop-1", "--algorithm", "oracle", "heading-hold", "--seeds", "2"]
    command = [sys.executable, str(EXAMPLE), "--url", served.url, *levels, "--output", str(picture)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    assert picture.read_bytes().startswith(b"\x89PNG\r\n")
