"""Filters made from the cells of a row; needs no polars."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass

from fte_sniff.protocol import VALUE_FIELDS, Row, Value, iso_time, record

_ORDER = (
    "kind",
    *(field.name for field in VALUE_FIELDS),
    "status",
    "faults",
    "direction",
    "port",
    "cmd",
    "length",
    "time",
    "raw",
)
_LOOSE = re.compile(r"\bOR\b|\|\|", re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class CellFilter:
    """The filters of one cell."""

    column: str
    """Name of its column."""
    only: str
    """Keeps the rows with the same value."""
    without: str
    """Keeps all other rows, also those without a value."""


def cell_filters(row: Row) -> list[CellFilter]:
    """The filters of all cells of a row, the most useful first."""
    values = record(row)
    return [found for name in _ORDER for found in _of_cell(name, values[name])]


def _of_cell(name: str, value: Value) -> Iterator[CellFilter]:
    if isinstance(value, list):
        words = [f"'{word}'" for word in value]
        if not words:
            yield CellFilter(name, f"{name} IS NULL", f"{name} IS NOT NULL")
        for word in words:
            yield CellFilter(name, f"{name} = {word}", f"{name} != {word}")
    elif value is None:
        if name == "kind":
            yield CellFilter(name, f"{name} IS NULL", f"{name} IS NOT NULL")
    elif name == "time" and isinstance(value, int):
        time = iso_time(value)
        yield CellFilter(name, f"{name} >= '{time}'", f"{name} < '{time}'")
    elif isinstance(value, int) or value.isprintable():
        # A device's name may have undecodable bytes, which no filter can contain.
        literal = f"{value}" if isinstance(value, int) else _quoted(value)
        yield CellFilter(name, f"{name} = {literal}", f"{name} IS DISTINCT FROM {literal}")


def _quoted(text: str) -> str:
    doubled = text.replace("'", "''")
    return f"'{doubled}'"


def both(current: str, added: str) -> str:
    """The conjunction of two filters; the current one may be empty."""
    if not current or current == added:
        return added
    if _LOOSE.search(current):
        return f"({current}) AND {added}"
    return current if added in current.split(" AND ") else f"{current} AND {added}"
