"""Rows and port events as columns, and rows without the columns that other rows decide."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from fte_sniff.protocol.columns import DERIVED
from fte_sniff.protocol.framer import Framer
from fte_sniff.protocol.items import Chunk, PortEvent
from fte_sniff.protocol.rows import ARRAYS, MOST_BYTES, Row, Rows, fault_bits
from fte_sniff.recording.reader import Recording


def rows_from(rows: Iterable[Row]) -> Rows:
    """The columns of single rows."""
    rows = list(rows)
    ports = tuple(dict.fromkeys(row.port for row in rows))
    raw = b"".join(row.raw.ljust(MOST_BYTES, b"\0") for row in rows)
    columns: dict[str, Any] = {
        "port": [ports.index(row.port) for row in rows],
        "length": [len(row.raw) for row in rows],
        "faults": [fault_bits(row.faults) for row in rows],
        "raw": np.frombuffer(raw, np.uint8).reshape(-1, MOST_BYTES),
    }
    for name in ARRAYS.keys() - columns.keys():
        values = [getattr(row, name) for row in rows]
        columns[name] = [ARRAYS[name][1] if one is None else one for one in values]
    return Rows.blank(len(rows), ports, **columns)


def entries(*given: Row | PortEvent | Iterable[Row | PortEvent]) -> list[Rows | PortEvent]:
    """Rows and events, one by one or in lists, as a recording takes them."""
    found: list[Row | PortEvent] = []
    for entry in given:
        found += [entry] if hasattr(entry, "port") else entry  # type: ignore[list-item,arg-type]
    rows = rows_from([entry for entry in found if isinstance(entry, Row)])
    return [rows, *(entry for entry in found if isinstance(entry, PortEvent))]


def fed(framer: Framer, chunk: Chunk) -> list[Row]:
    """The rows that a framer decides with a chunk."""
    framer.push(chunk)
    return list(framer.drain())


def read_rows(path: Path, *, is_growing: bool = False) -> list[Row]:
    """The rows of a recording, in file order."""
    items = Recording(path, is_growing=is_growing).items()
    return [row for item in items if isinstance(item, Rows) for row in item]


def without_facts(records: Iterable[dict[str, Any]]) -> list[dict[str, Any]]:
    """The rows without the columns that later rows decide."""
    return [{name: one[name] for name in one if name not in DERIVED} for one in records]
