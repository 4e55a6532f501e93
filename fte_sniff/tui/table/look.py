"""Owns how the table is to look, as the user chose: columns, widths, and what times count from.

It must not know rows or the window.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class TimeStyle(StrEnum):
    """What the times of rows are told from; the text stands over the column."""

    CLOCK = "time UTC"
    START = "+ start"
    BEFORE = "+ before"
    MARK = "+ mark"

    @property
    def meaning(self) -> str:
        """In words."""
        return _MEANINGS[self]


_MEANINGS = {
    TimeStyle.CLOCK: "times are the time of day, UTC",
    TimeStyle.START: "times count from the first row",
    TimeStyle.BEFORE: "times count from the row before",
    TimeStyle.MARK: "times count from the last mark that was set",
}


@dataclass(frozen=True, slots=True)
class ColumnChoice:
    """The columns that the user wants, and how wide."""

    names: tuple[str, ...]
    """Shown from left to right; at least one."""
    widths: tuple[tuple[str, int], ...] = ()
    """Cells of the columns that have another width than their own."""


@dataclass(frozen=True, slots=True)
class Look:
    """All of it."""

    ports: tuple[str, ...] = ()
    """Ports seen so far; from two on, each row says its own."""
    times: TimeStyle = TimeStyle.CLOCK
    choice: ColumnChoice | None = None
    """None where the width of the window decides."""
