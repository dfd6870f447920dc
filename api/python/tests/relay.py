"""A relay before a server that loses replies."""

from __future__ import annotations

import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from urllib.parse import urlsplit


class Relay:
    """Passes connections on, and cuts the first ``lose`` of those that send ``word`` once the reply has begun."""

    def __init__(self, url: str, word: bytes, lose: int) -> None:
        self._server = (urlsplit(url).hostname or "", urlsplit(url).port or 0)
        self._word, self._left, self.lost = word, lose, 0
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.url = f"http://127.0.0.1:{self._listener.getsockname()[1]}"
        self._threads: list[threading.Thread] = []
        self._open: list[socket.socket] = []

    def accept(self) -> None:
        """Takes connections until it is closed."""
        while True:
            try:
                client, _ = self._listener.accept()
            except OSError:
                return
            thread = threading.Thread(target=self._pass_on, args=(client,))
            thread.start()
            self._threads.append(thread)

    def _pass_on(self, client: socket.socket) -> None:
        with client, socket.create_connection(self._server) as server:
            self._open += [client, server]
            while question := _received(client):
                server.sendall(question)
                reply = _received(server)
                if self._word in question and self._left:
                    self._left -= 1
                    self.lost += 1
                    return
                client.sendall(reply)

    def close(self) -> None:
        # A thread that waits for a connection hears of it by the shutdown only.
        self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()
        for end in self._open:
            _shut(end)
        for thread in self._threads:
            thread.join()


def _received(end: socket.socket) -> bytes:
    try:
        return end.recv(1 << 20)
    except OSError:
        return b""


def _shut(end: socket.socket) -> None:
    try:
        end.shutdown(socket.SHUT_RDWR)
    except OSError:
        pass


@contextmanager
def losing(url: str, word: bytes, lose: int) -> Iterator[Relay]:
    """A relay to ``url`` that works beside the test."""
    relay = Relay(url, word, lose)
    thread = threading.Thread(target=relay.accept)
    thread.start()
    try:
        yield relay
    finally:
        relay.close()
        thread.join()
