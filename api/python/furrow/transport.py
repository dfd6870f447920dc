"""Requests over HTTP that are asked again until there is an answer.

Everything a client of Furrow asks may be asked twice without harm: reading changes nothing, a submission carries an
Idempotency-Key, and pausing, cancelling or retrying again changes nothing more.
"""

from __future__ import annotations

import random
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any
from urllib.parse import quote

import httpx

from .address import Address
from .errors import ProblemError, Unreachable

CONNECT_WITHIN_S = 5.0
BUSY = (429, 503)
FIRST_PAUSE_S, LONGEST_PAUSE_S = 0.1, 5.0
# A stream of events says something every 10 s.
STREAM_SILENT_FOR_S = 30.0

Query = Mapping[str, str | None]


class Transport:
    """Asks one server. ``timeout_s`` is for an answer's next bytes, ``retry_for_s`` for all attempts together [s]."""

    def __init__(self, address: Address, timeout_s: float, retry_for_s: float) -> None:
        self.url = str(address.url)
        self._retry_for_s = retry_for_s
        # No proxy of the environment and no redirect: a token goes to the server itself, or nowhere.
        self._http = httpx.Client(
            base_url=address.url,
            headers=address.headers(),
            verify=address.trust(),
            timeout=httpx.Timeout(timeout_s, connect=min(CONNECT_WITHIN_S, timeout_s)),
            trust_env=False,
            follow_redirects=False,
        )

    def close(self) -> None:
        self._http.close()

    def ask(
        self,
        method: str,
        path: str,
        query: Query | None = None,
        body: object = None,
        headers: Mapping[str, str] | None = None,
    ) -> httpx.Response:
        """A good answer to ``method`` on ``path``; ``query`` without what is None, ``body`` as JSON.

        Raises ``ProblemError`` when the server refuses, ``Unreachable`` when it does not answer.
        """
        request = self._http.build_request(method, path, params=given(query), json=body, headers=headers)
        for pause_s in self.pauses():
            try:
                response = self._http.send(request)
            except httpx.TransportError as error:
                failure: Exception = Unreachable(f"{self.url} does not answer: {error or type(error).__name__}")
                failure.__cause__ = error
                wait_s = pause_s
            else:
                if response.status_code not in BUSY:
                    return good(response)
                failure = problem(response)
                wait_s = asked_to_wait_s(response, pause_s)
            if pause_s is None or wait_s is None:
                raise failure
            time.sleep(wait_s)
        raise AssertionError("the last pause is None")

    def json(self, path: str, query: Query | None = None) -> Any:
        """The JSON at ``path``."""
        return self.ask("GET", path, query).json()

    def text(self, path: str, query: Query | None = None) -> str:
        """The text at ``path``."""
        return self.ask("GET", path, query).text

    @contextmanager
    def lines(self, path: str, within_s: float) -> Iterator[Iterator[str]]:
        """The lines of a stream of events, asked for once; ``within_s`` is how long to wait for the next [s].

        Raises ``ProblemError`` or ``Unreachable``, the latter also when the stream breaks off.
        """
        timeout = httpx.Timeout(min(STREAM_SILENT_FOR_S, within_s), connect=CONNECT_WITHIN_S)
        try:
            with self._http.stream("GET", path, timeout=timeout) as response:
                if response.status_code != 200:
                    response.read()
                    raise problem(response)
                yield response.iter_lines()
        except httpx.TransportError as error:
            raise Unreachable(f"{self.url}: the events broke off: {error or type(error).__name__}") from error

    def pauses(self) -> Iterator[float | None]:
        """Pauses between attempts [s], each with its own chance; None when the time is up."""
        until, pause_s = time.monotonic() + self._retry_for_s, FIRST_PAUSE_S
        while (left_s := until - time.monotonic()) > 0:
            yield min(left_s, pause_s * random.uniform(0.5, 1.0))
            pause_s = min(2 * pause_s, LONGEST_PAUSE_S)
        yield None


def asked_to_wait_s(response: httpx.Response, pause_s: float | None) -> float | None:
    """What the server asks for, or the pause if that is longer [s]; None when the time is up."""
    after = response.headers.get("Retry-After", "")
    return pause_s if pause_s is None or not after.isdigit() else max(pause_s, float(after))


def given(query: Query | None) -> dict[str, str]:
    return {key: value for key, value in (query or {}).items() if value is not None}


def good(response: httpx.Response) -> httpx.Response:
    """The answer, unless the server refuses."""
    if response.is_success:
        return response
    raise problem(response)


def problem(response: httpx.Response) -> ProblemError:
    """A refusal; one that is no problem document comes from something in between."""
    if response.headers.get("Content-Type", "").startswith("application/problem+json"):
        document = response.json()
        if isinstance(document, dict):
            return ProblemError(response.status_code, document)
    detail = f"the server answered {response.status_code}"
    return ProblemError(response.status_code, {"title": response.reason_phrase, "detail": detail})


def segment(name: object) -> str:
    """A name as one segment of a path."""
    return quote(str(name), safe="")
