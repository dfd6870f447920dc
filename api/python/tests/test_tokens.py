"""A server beyond its own machine: encrypted, for those with a token."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

import furrow
from conftest import BOUNDS, SHORT
from processes import Server, run


@pytest.fixture
def exposed(tmp_path: Path) -> Iterator[Server]:
    """Listens on all addresses; is reached over the loopback interface, which makes no difference to it."""
    with Server(tmp_path, address="0.0.0.0:0") as server:
        server.url = server.url.replace("0.0.0.0", "127.0.0.1")
        yield server


def token(server: Server, scopes: str) -> str:
    made = run("token", "create", "--name", scopes.replace(",", "-"), "--scope", scopes, "--expires", "1d", "--db", str(server.db))
    return made.strip()


def test_a_token_opens_what_its_scope_is_for(exposed: Server, monkeypatch: pytest.MonkeyPatch) -> None:
    certificate = f"{exposed.db}.http-cert.pem"
    with furrow.Client(exposed.url, token=token(exposed, "read,submit"), ca=certificate) as client:
        assert client.submit(BOUNDS, only=SHORT, seeds=1).pause().state == "paused"
    monkeypatch.setenv("FURROW_URL", exposed.url)
    monkeypatch.setenv("FURROW_TOKEN", token(exposed, "read"))
    monkeypatch.setenv("FURROW_CA", certificate)
    with furrow.Client() as reader:
        assert reader.sweep(1).state == "paused"
        with pytest.raises(furrow.ProblemError) as refusal:
            reader.sweep(1).resume()
        assert refusal.value.status == 403


def test_no_token_and_a_wrong_one_are_refused(exposed: Server) -> None:
    certificate = f"{exposed.db}.http-cert.pem"
    for wrong in (None, "furrow_" + "x" * 43):
        with furrow.Client(exposed.url, token=wrong, ca=certificate) as client:
            with pytest.raises(furrow.ProblemError) as refusal:
                client.plans()
            assert refusal.value.status == 401


def test_a_server_that_nobody_vouches_for_hears_no_token(exposed: Server) -> None:
    with furrow.Client(exposed.url, token="furrow_x", retry_for=0.0) as client:
        with pytest.raises(furrow.Unreachable, match="(?i)certificate"):
            client.plans()


def test_a_token_is_shown_nowhere() -> None:
    secret = "furrow_" + "s" * 43
    with furrow.Client("https://barn.example", token=secret) as client:
        shown = [repr(client), repr(client._transport), repr(vars(client._transport)), repr(vars(client))]
        assert not any(secret in text for text in shown)
        assert repr(client) == "furrow.Client('https://barn.example')"
