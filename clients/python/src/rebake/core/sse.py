"""Server-sent events, as far as the service uses them."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Event:
    """One event: its id, its name, and its data, which is JSON."""

    id: str
    name: str
    data: Any


class EventReader:
    """Bytes as they arrive to events. Comments, which keep the connection alive, are left out."""

    def __init__(self) -> None:
        self._rest = b""
        self._fields: dict[str, str] = {}

    def feed(self, data: bytes) -> list[Event]:
        """The events that are complete with these bytes."""
        *lines, self._rest = (self._rest + data).split(b"\n")
        events = []
        for line in lines:
            text = line.decode("utf-8").rstrip("\r")
            if text:
                name, _, value = text.partition(":")
                self._fields[name] = value.removeprefix(" ")
            elif "data" in self._fields:
                found = self._fields
                events.append(Event(found.get("id", ""), found.get("event", "message"), json.loads(found["data"])))
                self._fields = {}
            else:
                self._fields = {}
        return events
