"""Rows and port events as columns, and rows without the columns that other rows decide."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from fte_sniff.protocol import PortEvent, Row
from fte_sniff.protocol.columns import DERIVED
from fte_sniff.protocol.rows import Rows


def in_columns(*entries: Row | PortEvent | Iterable[Row | PortEvent]) -> Rows:
    """Rows and events, one by one or in lists, as `Rows`."""
    found: list[Row | PortEvent] = []
    for entry in entries:
        found += [entry] if hasattr(entry, "port") else entry  # type: ignore[list-item,arg-type]
    events = [entry for entry in found if isinstance(entry, PortEvent)]
    return Rows.from_rows([one for one in found if not isinstance(one, PortEvent)], events=events)


def without_facts(records: Iterable[dict[str, Any]]) -> list[dict[str, Any]]:
    """The rows without the columns that later rows decide."""
    return [{name: one[name] for name in one if name not in DERIVED} for one in records]
