"""Rows and port events as columns."""

from __future__ import annotations

from collections.abc import Iterable

from fte_sniff.protocol import PortEvent, Row
from fte_sniff.protocol.rows import Rows


def in_columns(*entries: Row | PortEvent | Iterable[Row | PortEvent]) -> Rows:
    """Rows and events, one by one or in lists, as `Rows`."""
    found: list[Row | PortEvent] = []
    for entry in entries:
        found += [entry] if hasattr(entry, "port") else entry  # type: ignore[list-item,arg-type]
    events = [entry for entry in found if isinstance(entry, PortEvent)]
    return Rows.from_rows([one for one in found if not isinstance(one, PortEvent)], events=events)
