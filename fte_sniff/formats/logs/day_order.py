"""Owns whether the dates of a log, such as 2/8/2024, begin with the day or with the month.

It must not know which moment a time is. A date with a number above 12 shows the order of all; so
lines wait for one. `--date` tells it as well: the day of the first. Where nothing does, the month
is first, as in America, whose machines write so; that is told.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from datetime import date
from typing import Protocol, TypeVar

from fte_sniff.errors import InputTextError
from fte_sniff.formats.logs.line_time import Stamp

_MOST_HELD = 1000
_MONTHS = 12


class _Logged(Protocol):
    @property
    def stamp(self) -> Stamp | None: ...
    @property
    def line(self) -> int: ...


_L = TypeVar("_L", bound=_Logged)


class DayOrder:
    """The order of day and month in one log."""

    def __init__(self, first: date | None = None) -> None:
        """Nothing is known of it, but perhaps which day the first date is."""
        self._first = first
        self._day_first: bool | None = None
        self._doubtful: tuple[int, int, int] | None = None
        """The first date that can be read both ways, if one was met before the order was known."""
        self._proven = False

    def settled(self, lines: Iterable[_L]) -> Iterator[_L]:
        """The same lines, those with doubtful dates once their order is known.

        Raises:
            InputTextError: a date contradicts how those before it were read.
        """
        held = deque[_L]()
        for line in lines:
            if line.stamp is not None and line.stamp.day_or_month is not None:
                self._see(line.stamp.day_or_month, line.line)
            if self._day_first is None and self._doubtful is not None:
                held.append(line)
                if len(held) <= _MOST_HELD:
                    continue
                self._day_first = False
            while held:
                yield held.popleft()
            yield line
        if self._doubtful is not None and self._day_first is None:
            self._day_first = False
        yield from held

    def date_of(self, written: tuple[int, int, int]) -> tuple[int, int, int]:
        """Year, month and day of a date in the log's order."""
        one, other, year = written
        return (year, other, one) if self._day_first else (year, one, other)

    @property
    def doubt(self) -> str | None:
        """How doubtful dates were read, where nothing shows that it is right."""
        if self._doubtful is None or self._proven:
            return None
        one, other, year = self._doubtful
        return (
            f"{one}/{other}/{year} is taken for {self._first_day(day_first=False)}, month first;"
            f" --date {self._first_day(day_first=True)} says day first"
        )

    def _first_day(self, *, day_first: bool) -> str:
        """The first doubtful date, read in one order."""
        one, other, year = self._doubtful or (0, 0, 0)
        month, day = (other, one) if day_first else (one, other)
        return f"{year:04}-{month:02}-{day:02}"

    def _see(self, written: tuple[int, int, int], line: int) -> None:
        one, other, year = written
        if one > _MONTHS < other or one == other:
            return
        if one <= _MONTHS and other <= _MONTHS:
            if self._day_first is None and self._doubtful is None:
                self._doubtful = written
                self._ask()
            return
        day_first = one > _MONTHS
        if self._day_first not in (None, day_first):
            way_out = "split the log there"
            if not self._proven:
                way_out = f"add --date {self._first_day(day_first=day_first)}, the day of the first"
            raise InputTextError(
                f"line {line}: {one}/{other}/{year} has its {'day' if day_first else 'month'}"
                f" first, but dates before it were read the other way; {way_out}"
            )
        self._day_first, self._proven = day_first, True

    def _ask(self) -> None:
        """Take the order from the day that the user says the first date is."""
        for day_first in (False, True):
            if str(self._first) == self._first_day(day_first=day_first):
                self._day_first, self._proven = day_first, True
