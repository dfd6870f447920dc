"""What is refused, and how that is told."""

from __future__ import annotations

import socket
import threading
from pathlib import Path

import pytest

import furrow
from conftest import BOUNDS
from furrow.address import Address, is_this_machine


def test_a_refusal_names_the_key_and_what_is_allowed(client: furrow.Client) -> None:
    with pytest.raises(furrow.ProblemError) as refusal:
        client.submit(BOUNDS, only={"field": ["crop-9"]})
    problem = refusal.value
    assert (problem.status, problem.title) == (422, "Unprocessable Entity")
    assert problem.allowed == ("crop-1", "crop-2", "crop-3", "crop-4")
    assert "crop-9" in problem.detail and problem.document["status"] == 422 and "crop-9" in str(problem)


def test_a_bad_question_is_refused_by_its_key(client: furrow.Client, done: furrow.Sweep) -> None:
    with pytest.raises(furrow.ProblemError) as refusal:
        done.table(metrics="beauty")
    assert (refusal.value.status, refusal.value.key) == (422, "metric") and "success" in refusal.value.allowed
    with pytest.raises(furrow.ProblemError) as refusal:
        list(done.jobs(state="asleep"))
    assert (refusal.value.status, refusal.value.key) == (400, "state")


def test_what_is_not_there_is_not_found(client: furrow.Client) -> None:
    for asked in (
        lambda: client.sweep(999),
        lambda: client.job("../sweeps/1"),
        lambda: client.publication("guyonneau2022", "table-99"),
    ):
        with pytest.raises(furrow.ProblemError) as refusal:
            asked()
        assert refusal.value.status == 404


def test_a_server_that_is_away_is_named() -> None:
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    with furrow.Client(f"http://127.0.0.1:{port}", retry_for=0.2) as client:
        with pytest.raises(furrow.Unreachable, match=f"127.0.0.1:{port}") as error:
            client.plans()
    assert isinstance(error.value, ConnectionError)


def test_an_answer_of_something_else_is_a_problem_too() -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        def answer() -> None:
            connection, _ = listener.accept()
            with connection:
                connection.recv(65536)
                connection.sendall(b"HTTP/1.1 502 Bad Gateway\r\nContent-Length: 5\r\nConnection: close\r\n\r\n<oops")

        thread = threading.Thread(target=answer)
        thread.start()
        with furrow.Client(f"http://127.0.0.1:{listener.getsockname()[1]}") as client:
            with pytest.raises(furrow.ProblemError, match="502 Bad Gateway"):
                client.plans()
        thread.join()


@pytest.mark.parametrize("url", ["nonsense", "ftp://host", "http://", "https://", "http://me:secret@host"])
def test_an_address_that_is_none_is_refused(url: str) -> None:
    with pytest.raises(ValueError, match="expected http") as error:
        furrow.Client(url)
    assert "secret" not in str(error.value)


@pytest.mark.parametrize("url", ["http://furrow.example", "http://192.0.2.1:8080", "http://localhost.example"])
def test_a_token_leaves_this_machine_encrypted_only(url: str, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(ValueError, match="in the clear"):
        furrow.Client(url, token="furrow_x")
    monkeypatch.setenv("FURROW_TOKEN", "furrow_x")
    monkeypatch.setenv("FURROW_URL", url)
    with pytest.raises(ValueError, match="in the clear"):
        furrow.Client()
    furrow.Client(url.replace("http:", "https:")).close()


def test_loopback_addresses_are_this_machine() -> None:
    for host in ("localhost", "127.0.0.1", "127.1.2.3", "::1", "::ffff:127.0.0.1"):
        assert is_this_machine(host), host
    for host in ("localhost.example", "10.0.0.1", "::ffff:10.0.0.1", "barn"):
        assert not is_this_machine(host), host


def test_the_environment_says_what_is_not_given(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    assert str(Address.of(None, None, None).url) == "http://127.0.0.1:8080"
    for name, value in (("URL", "https://barn.example:1"), ("TOKEN", "furrow_env\n"), ("CA", str(tmp_path))):
        monkeypatch.setenv(f"FURROW_{name}", value)
    taken = Address.of(None, None, None)
    assert (str(taken.url), taken.token, taken.ca) == ("https://barn.example:1", "furrow_env", tmp_path)
    given = Address.of("https://field.example", "furrow_arg", "/other")
    assert (given.url.host, given.token, given.ca) == ("field.example", "furrow_arg", Path("/other"))


def test_certificates_that_are_not_there_are_named(tmp_path: Path) -> None:
    missing = tmp_path / "none.pem"
    with pytest.raises(ValueError, match="none.pem"):
        furrow.Client("https://127.0.0.1:1", ca=missing)
