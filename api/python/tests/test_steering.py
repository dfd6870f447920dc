"""Pausing, cancelling, retrying, and sweeps that end otherwise than wished."""

from __future__ import annotations

from pathlib import Path

import httpx
import pytest

import furrow
from conftest import BOUNDS
from furrow.waiting import postfix
from processes import Server


def test_a_sweep_is_paused_resumed_and_put_first(waiting: furrow.Sweep) -> None:
    assert waiting.pause().state == "paused" and waiting.pause().state == "paused"
    assert postfix(waiting.status) == "paused"
    assert waiting.resume().state == "active"
    assert waiting.prioritize(7).status.priority == 7
    assert waiting.refresh().status.priority == 7


def test_a_cancelled_sweep_says_so_and_can_be_retried(waiting: furrow.Sweep) -> None:
    assert waiting.cancel().state == "cancelled"
    with pytest.raises(furrow.SweepCancelled, match="was cancelled with 0 of 2 jobs done") as cancelled:
        waiting.wait(progress=False)
    assert not cancelled.value.removed and cancelled.value.status.cancelled == 2
    with pytest.raises(furrow.ProblemError) as refusal:
        waiting.resume()
    assert refusal.value.status == 409
    assert waiting.retry().state == "active" and waiting.status.queued == 2


def test_a_sweep_that_is_removed_meanwhile_says_so(idle: Server, waiting: furrow.Sweep) -> None:
    def remove(_: furrow.SweepStatus) -> None:
        httpx.delete(f"{idle.url}/v1/sweeps/{waiting.id}", params={"purge": "true"}, trust_env=False)

    with pytest.raises(furrow.SweepCancelled) as removed:
        waiting.wait(remove)
    assert removed.value.removed and "was removed" in str(removed.value)


def test_patience_ends(waiting: furrow.Sweep) -> None:
    with pytest.raises(TimeoutError, match="0 of 2 jobs done after 0.2 s"):
        waiting.wait(progress=False, timeout=0.2)


def test_failed_jobs_are_told_with_their_reasons(tmp_path: Path) -> None:
    with Server(tmp_path, "--max-attempts", "1") as server, furrow.Client(server.url) as client:
        # A search so long that the worker is killed before it ends.
        long = {"perception.iterations": 1_000}
        only = {"algorithm": ["rgop"], "field": ["crop-1"]}
        sweep = client.submit(BOUNDS, only=only, set=long, seeds=1)
        worker = server.worker()

        def kill(status: furrow.SweepStatus) -> None:
            if status.leased:
                worker.kill()

        with pytest.raises(furrow.SweepFailed) as failed:
            sweep.wait(kill, timeout=40)
        worker.end()
        (job,) = failed.value.failed
        assert job.factors == {"algorithm": "rgop", "field": "crop-1"} and job.seed == 1
        assert job.reason and job.reason in str(failed.value)
        assert client.job(job.key).state == "failed"
        assert sweep.retry().state == "active"
