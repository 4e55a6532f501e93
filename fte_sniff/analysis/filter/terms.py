"""Help text of the filter language, and the filters of a cell on the screen."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from textwrap import wrap
from typing import Final

from fte_sniff.analysis.filter.row_filter import FUNCTIONS
from fte_sniff.protocol import COLUMNS, Value, iso_time, record
from fte_sniff.protocol.rows import Row


def quoted(text: str) -> str:
    """The text as a literal of a filter."""
    return "'" + text.replace("'", "''") + "'"


def _help() -> Iterator[str]:
    yield "A filter selects rows with an SQL expression: motor = 1 AND rpm > 500"
    yield ""
    yield "Fields"
    for column in COLUMNS:
        yield from _wrapped(f"  {column.name:<10} ", column.meaning)
        yield from _wrapped(" " * 13, ", ".join(column.words))
    yield ""
    yield "Examples"
    for example, meaning in EXAMPLES:
        yield f"  {example:<34} {meaning}"


def _wrapped(start: str, text: str) -> list[str]:
    return wrap(text, 79, initial_indent=start, subsequent_indent=" " * len(start))


EXAMPLES: Final = (
    ("motor = 1 AND rpm > 500", "AND OR NOT, also && || !"),
    ("kind IN ('speed', 'position')", "one of these words"),
    ("malformed OR noise", "a word alone: a kind, status or fault"),
    ("faults = 'noise'", "among the row's faults; IN: any of them"),
    ("faults IS NULL", "no fault at all"),
    ("error = 0x0F OR online & 0x01 = 0", "hex and single bits"),
    ("raw LIKE 'AA 01%'", "% any bytes, _ any digit; spaces are free"),
    ("time >= '2026-01-31T12:00:00Z'", "UTC, or with a zone as +08:00"),
    ("time > '12:00:05'", "a time of day, UTC, on any day"),
    ("rpm BETWEEN -10 AND 10", "both ends included; never rows without rpm"),
    ("kind IS DISTINCT FROM 'speed'", "any other, also rows that have no kind"),
    *((function.example, function.meaning) for function in FUNCTIONS.values()),
)
"""Working filters, each with its meaning."""

FILTER_HELP: Final = "\n".join(_help())
"""The language on one screen, for `--help` and the filter prompt."""


_LOOSE = re.compile(r"\bOR\b|\|\|", re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class CellFilter:
    """The filters of one cell."""

    column: str
    only: str
    """Keeps the rows with the same value."""
    without: str
    """Keeps all other rows, also those without a value."""


def cell_filters(row: Row) -> list[CellFilter]:
    """The filters of all cells of a row, in the order of the screen's columns."""
    values = record(row)
    return [found for column in COLUMNS for found in _of_cell(column.name, values[column.name])]


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
    elif not isinstance(value, str) or value.isprintable():
        # A device's name may have undecodable bytes, which no filter can contain.
        literal = quoted(value) if isinstance(value, str) else f"{value}".upper()
        yield CellFilter(name, f"{name} = {literal}", f"{name} IS DISTINCT FROM {literal}")


def both(current: str, added: str) -> str:
    """The conjunction of two filters; the current one may be empty."""
    if not current or current == added:
        return added
    if _LOOSE.search(current):
        return f"({current}) AND {added}"
    return current if added in current.split(" AND ") else f"{current} AND {added}"
