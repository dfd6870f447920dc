"""Where the server is, and what may be sent there."""

from __future__ import annotations

import ipaddress
import os
import ssl
from dataclasses import dataclass, field
from pathlib import Path

import httpx

DEFAULT_URL = "http://127.0.0.1:8080"


@dataclass(frozen=True)
class Address:
    """A server's address, with the token that is sent to it and the certificates by which it is trusted."""

    url: httpx.URL
    token: str | None = field(default=None, repr=False)
    ca: Path | None = None

    @classmethod
    def of(cls, url: str | None, token: str | None, ca: str | os.PathLike[str] | None) -> Address:
        """What is given, else what FURROW_URL, FURROW_TOKEN and FURROW_CA say, as the command line does.

        A ``ValueError`` where the address is none, or the token would cross the network in the clear.
        """
        text = url or os.environ.get("FURROW_URL") or DEFAULT_URL
        token = (token or os.environ.get("FURROW_TOKEN") or "").strip() or None
        authority = ca or os.environ.get("FURROW_CA") or None
        address = cls(parsed(text), token, None if authority is None else Path(authority))
        if token is not None and address.url.scheme == "http" and not is_this_machine(address.url.host):
            raise ValueError(f"{text}: a token must not cross the network in the clear: expected https://HOST:PORT")
        return address

    def headers(self) -> dict[str, str]:
        """What goes with every request."""
        return {} if self.token is None else {"Authorization": f"Bearer {self.token}"}

    def trust(self) -> ssl.SSLContext:
        """The certificates by which the server is trusted: those in ``ca``, else the system's."""
        try:
            context = ssl.create_default_context(cafile=self.ca)
        except OSError as error:
            raise ValueError(f"ca {self.ca}: {error.strerror or error}") from error
        # A server's own certificate, which no authority signed, may be trusted by itself.
        context.verify_flags |= ssl.VERIFY_X509_PARTIAL_CHAIN
        return context


def parsed(text: str) -> httpx.URL:
    """The address in ``text``; a ``ValueError`` says what is expected."""
    try:
        url = httpx.URL(text)
    except httpx.InvalidURL as error:
        raise ValueError(f"{text}: {error}") from None
    if url.scheme not in ("http", "https") or not url.host or url.userinfo:
        shown = url.copy_with(username="", password="") if url.userinfo else text
        raise ValueError(f"{shown}: expected http://HOST:PORT or https://HOST:PORT")
    return url


def is_this_machine(host: str) -> bool:
    """Whether ``host`` is a loopback address, or localhost."""
    if host == "localhost":
        return True
    try:
        address = ipaddress.ip_address(host)
    except ValueError:
        return False
    mapped = address.ipv4_mapped if isinstance(address, ipaddress.IPv6Address) else None
    return (mapped or address).is_loopback
