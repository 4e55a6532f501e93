"""Owns what people are told of the filter's language.

It must not know how a filter is read: a screen tells of it long before one is wanted.
"""

from __future__ import annotations

from collections.abc import Iterator
from textwrap import wrap
from typing import Final

from fte_sniff.protocol import COLUMNS


def _help() -> Iterator[str]:
    yield "A filter says which rows are wanted, in SQL's words: motor = 1 AND rpm > 500"
    yield ""
    yield "Fields"
    for column in COLUMNS:
        yield from _beside(f"  {column.name:<10} ", column.meaning)
        yield from _beside(" " * 13, ", ".join(column.words))
    yield ""
    yield "Examples"
    for example, meaning in EXAMPLES:
        yield f"  {example:<34} {meaning}"


def _beside(start: str, text: str) -> list[str]:
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
)
"""Filters that work, and what each shows."""

FILTER_HELP: Final = "\n".join(_help())
"""The language on one screen, for `--help` and the filter field."""
