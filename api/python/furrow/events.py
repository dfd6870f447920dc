"""Server-sent events: what changes about a sweep."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from typing import Any, NamedTuple


class Event(NamedTuple):
    """An event's name and its data."""

    name: str
    data: Any


def events(lines: Iterable[str]) -> Iterator[Event]:
    """The events in a stream's ``lines``. Comments, which begin with a colon, are left out."""
    name = "message"
    data: list[str] = []
    for line in lines:
        field, _, value = line.partition(":")
        value = value.removeprefix(" ")
        if not line and data:
            yield Event(name, json.loads("\n".join(data)))
        if not line:
            name, data = "message", []
        elif field == "event":
            name = value
        elif field == "data":
            data.append(value)
