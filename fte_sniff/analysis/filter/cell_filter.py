"""Filter made from a table cell; needs no polars."""

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
    """What a cell of a row can say in a filter."""

    column: str
    """Its name in the row contract."""
    only: str
    """Wants the rows that are alike here."""
    without: str
    """Wants the other rows, those included that have no such value."""


def cell_filters(row: Row) -> list[CellFilter]:
    """For every cell of a row by which one could filter, in the order of their use."""
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
    elif _can_be_written(value):
        said = f"{value}" if isinstance(value, int) else _quoted(value)
        yield CellFilter(name, f"{name} = {said}", f"{name} IS DISTINCT FROM {said}")


def _can_be_written(value: int | str) -> bool:
    """Whether a filter can hold it; a device's name may hold bytes that are no text."""
    return isinstance(value, int) or value.isprintable()


def _quoted(text: str) -> str:
    doubled = text.replace("'", "''")
    return f"'{doubled}'"


def both(standing: str, added: str) -> str:
    """A filter that wants what both want; the one that stands may be empty."""
    if not standing or standing == added:
        return added
    first = f"({standing})" if _LOOSE.search(standing) else standing
    return standing if _holds(standing, added) else f"{first} AND {added}"


def _holds(standing: str, added: str) -> bool:
    """Whether the filter is already among those that were added."""
    return not _LOOSE.search(standing) and added in standing.split(" AND ")
