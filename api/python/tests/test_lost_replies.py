"""Lost replies, busy servers and servers that come back."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path

import httpx
import pytest

import furrow
from conftest import BOUNDS, SHORT
from processes import Server
from relay import losing

SEATS = 64


def test_a_submission_whose_reply_is_lost_is_taken_once(idle: Server) -> None:
    with losing(idle.url, b"POST /v1/sweeps", lose=2) as relay, furrow.Client(relay.url) as client:
        sweep = client.submit(BOUNDS, only=SHORT, seeds=1)
        assert relay.lost == 2 and sweep.status.total == 2
        assert [sweep["id"] for sweep in idle.json("/v1/sweeps")["items"]] == [sweep.id]


def test_two_calls_are_two_submissions(idle: Server) -> None:
    with furrow.Client(idle.url) as client:
        first, second = (client.submit(BOUNDS, only=SHORT, seeds=1) for _ in range(2))
        assert first.id != second.id


def test_steering_again_after_a_lost_reply_changes_nothing_more(idle: Server, waiting: furrow.Sweep) -> None:
    with losing(idle.url, b"DELETE /v1/sweeps", lose=1) as relay, furrow.Client(relay.url) as client:
        assert client.sweep(waiting.id).cancel().state == "cancelled" and relay.lost == 1


def test_events_that_break_off_are_asked_for_again(served: Server, done: furrow.Sweep) -> None:
    with losing(served.url, b"/events", lose=1) as relay, furrow.Client(relay.url) as client:
        assert client.sweep(done.id).wait(progress=False).state == "done" and relay.lost == 1


def test_who_asks_too_often_waits(tmp_path: Path) -> None:
    with Server(tmp_path, "--http-rate", "1") as server:
        with furrow.Client(server.url) as client:
            assert all(client.workers() == [] for _ in range(7)), "five at once, then one a second"
        with furrow.Client(server.url, retry_for=0.0) as client, pytest.raises(furrow.ProblemError) as refusal:
            for _ in range(7):
                client.workers()
        assert refusal.value.status == 429


def test_without_a_seat_for_events_the_sweep_is_looked_at(served: Server, done: furrow.Sweep) -> None:
    limits = httpx.Limits(max_connections=SEATS, max_keepalive_connections=0)
    with httpx.Client(limits=limits, trust_env=False) as listener, ExitStack() as seats:
        for _ in range(SEATS):
            response = seats.enter_context(listener.stream("GET", f"{served.url}/v1/events"))
            assert response.status_code == 200
        assert httpx.get(f"{served.url}/v1/sweeps/1/events", trust_env=False).status_code == 503
        assert done.wait(progress=False, timeout=10).state == "done"


def test_a_sweep_is_waited_for_over_a_restart(tmp_path: Path) -> None:
    with ExitStack() as servers:
        first = servers.enter_context(Server(tmp_path))
        address = first.url.removeprefix("http://")
        restarted: list[Server] = []

        def restart(_: furrow.SweepStatus) -> None:
            if not restarted:
                first.kill()
                restarted.append(servers.enter_context(Server(tmp_path, "--threads", "2", address=address)))

        with furrow.Client(first.url) as client:
            sweep = client.submit(BOUNDS, only=SHORT, seeds=1)
            assert sweep.wait(restart, timeout=60).status.done == 2 and restarted
