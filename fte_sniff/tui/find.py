"""Keys that lead to a row: a place or a time, a match, a fault, an answer, an event."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from datetime import UTC, tzinfo
from functools import partial
from typing import Final, TypeAlias

from fte_sniff.analysis.store import Matches
from fte_sniff.analysis.time_text import clock_time, duration_ns, time_ns
from fte_sniff.errors import InputTextError, shortened
from fte_sniff.formats.cell_text import clock_text
from fte_sniff.i18n import _, later
from fte_sniff.protocol.rows import Bools, Row, Rows
from fte_sniff.tui.detail import NO_ANSWER
from fte_sniff.tui.line import Question
from fte_sniff.tui.parts import Parts
from fte_sniff.tui.search import parse_search
from fte_sniff.tui.view import View

Goal: TypeAlias = "Callable[[View, Row, tzinfo], int | str]"
"""The position of a shown row, or why there is none; by the cursor's row and the zone of times."""

_NUMBER: Final = re.compile(r"[0-9][0-9_,]*")
_SHARE: Final = re.compile(r"([0-9]{1,3}(?:\.[0-9]*)?) ?%", re.ASCII)


def parse_goal(text: str, zone: tzinfo = UTC) -> Goal:
    """Parse a goal; a date and time without a zone are in `zone`.

    Raises InputTextError; it shows a goal of each kind.
    """
    text = text.strip()
    if _NUMBER.fullmatch(text):
        return lambda _view, _row, _zone: int(text.replace(",", "").replace("_", "")) - 1
    if match := _SHARE.fullmatch(text):
        share = min(1.0, float(match[1]) / 100)
        return lambda view, _row, _zone: round(share * (view.shown.count - 1))
    if (t_ns := time_ns(text, zone)) is not None:
        return partial(_of_time, text, lambda _row_ns, _zone: t_ns)
    if (clock := clock_time(text)) is not None:
        return partial(_of_time, text, clock.on_day_of)
    if text[:1] in ("+", "-") and (ns := duration_ns(text[1:])) is not None:
        return partial(
            _of_time, text, lambda row_ns, _zone: row_ns + (-ns if text[0] == "-" else ns)
        )
    raise InputTextError(
        _(
            "{text} is not a row (1200), a share (50%), a time (12:00:03.5, 20:00+08:00)"
            " or a distance (+2s, -50ms)",
            text=shortened(text),
        )
    )


def _of_time(
    text: str, time: Callable[[int, tzinfo], int], view: View, row: Row, zone: tzinfo
) -> int | str:
    """The first row at or after a time, which may depend on that of the cursor's row."""
    if row.t_ns is None or view.first_ns is None or view.last_ns is None:
        return _("no row here has a time")
    t_ns = time(row.t_ns, zone)
    if t_ns > view.last_ns:
        end = clock_text(view.last_ns, 3, zone)
        return _("{time} is after the last row ({end})", time=text, end=end)
    if t_ns < view.first_ns:
        end = clock_text(view.first_ns, 3, zone)
        return _("{time} is before the first row ({end})", time=text, end=end)
    return view.shown.position_of(view.store.index_at(t_ns))


class Goto:
    """Goes to a row, a share, a time or a distance."""

    def __init__(self, parts: Parts) -> None:
        self._parts, self._view, self._table = parts, parts.view, parts.table

    def ask(self) -> None:
        """Ask where to go."""
        example = "1200, 50%, 12:00:03.5, +2s, -50ms"
        self._parts.line.ask(Question(later("go to"), example, parse_goal, self.accept))

    def accept(self, line: str) -> None:
        """Go to a goal, or report why there is no such row."""
        row, zone = self._table.cursor_row, self._table.look.shown_zone
        if not line or row is None:
            return
        found = parse_goal(line, zone)(self._view, row, zone)
        if isinstance(found, str):
            self._parts.status.inform(found)
            return
        self._table.jump(found)
        if found >= self._view.shown.count:
            text = _("row {number:,} does not exist; this is the last", number=found + 1)
            self._parts.status.inform(text)


class Searching:
    """Finds the rows with bytes, a word, or what a filter tests, one match after the other."""

    def __init__(self, parts: Parts) -> None:
        self._parts, self._view, self._table = parts, parts.view, parts.table
        self.matches: Matches | None = None
        self._typed = ""
        self._due: tuple[int, int] | None = None
        """Where the next match is looked for, and in which direction, until all are known."""

    def ask(self) -> None:
        """Ask what to look for."""
        example = "rpm = 1000, AA 01, hex:AA ?? 03"
        self._parts.line.ask(Question(later("search"), example, parse_search, self.accept))

    def accept(self, line: str) -> None:
        """Go to the next match of a search; an empty line ends the last one."""
        self.end()
        if line:
            self._typed = line
            self.matches = Matches(self._view.store, parse_search(line))
            # While the end is followed, all rows are above.
            self._due = self._table.last_index, -1 if self._table.viewport.following else 1
            self.step()

    def again(self, by: int) -> None:
        """Go to the next match, or to the previous one."""
        self._due = self._table.last_index + by, by
        self.step()

    def step(self) -> None:
        """Test more rows; go to the match that is looked for, once all are tested."""
        matches = self.matches
        if matches is None or matches.extend() or self._due is None:
            return
        (start, by), self._due = self._due, None
        found = self._nearest(matches, start, by)
        around = found is None
        if found is None:
            found = self._nearest(matches, -by * 2**62, by)
        inform = self._parts.status.inform
        if not self._table.jump_to_index(found):
            inform(_("no row that is shown has {text}", text=self._typed))
        elif around:
            inform(_("the search continued from the other end"))

    def _nearest(self, matches: Matches, start: int, by: int) -> int | None:
        """The first shown match at or after an index (`by` 1), or at or before it (-1)."""
        found, shown = matches.indices, self._view.shown
        at = int(found.searchsorted(start, "left" if by > 0 else "right"))
        own = found[at:] if by > 0 else found[:at][::-1]
        return next((int(index) for index in own if shown.has(int(index))), None)

    @property
    def text(self) -> str:
        """`match 2 of 16` on a match, else `16 matches`; empty without a search."""
        index = self._table.cursor_index
        if self.matches is None:
            return ""
        found = self.matches.indices
        at = int(found.searchsorted(-1 if index is None else index))
        if at == len(found) or found[at] != index:
            return _("{all:,} matches", all=len(found))
        return _("match {number:,} of {all:,}", number=at + 1, all=len(found))

    def end(self) -> bool:
        """End the search; returns whether there was one."""
        was_there = self.matches is not None
        self.matches = self._due = None
        return was_there


_WORTH: Final[Mapping[str, tuple[Callable[[Rows], Bools], str]]] = {
    "fault": (lambda rows: rows.faults != 0, later("row with a fault")),
    "raised": (Rows.raised, later("row whose ERROR or ONLINE is not in order")),
    "unanswered": (lambda rows: rows.unanswered > 0, later("command without an answer")),
}
"""What is worth a look: the test of its rows, and what it is."""


class Find:
    """Goes to the next row that is worth a look."""

    def __init__(self, parts: Parts) -> None:
        self._view, self._table, self._status = parts.view, parts.table, parts.status

    def row(self, what: str, by: int) -> None:
        """Go to the next row of `_WORTH` (`by` 1), or to the previous one (-1)."""
        test, name = _WORTH[what]
        index = self._view.shown.find(test, self._table.last_index, by)
        self._go(index, by, _(name))

    def landmark(self, by: int) -> None:
        """Go to the next lost port or gap, or to the previous one."""
        index = self._view.shown.next_landmark(self._table.last_index, by)
        if index is not None:
            self._table.stay_at(index)
        else:
            self._go(None, by, _("lost port or gap"))

    def _go(self, index: int | None, by: int, name: str) -> None:
        if not self._table.jump_to_index(index):
            text = _("no {name} below") if by > 0 else _("no {name} above")
            self._status.inform(text.format(name=name))

    def related(self) -> None:
        """Go from a command to its answer, or from an answer to its command."""
        index, shown = self._table.last_index, self._view.shown
        related = self._view.related(index)
        text = _("this row is neither a command that awaits an answer nor an answer")
        states = {one.state for one in self._view.around(index).answers_of(index)}
        text = next((_(NO_ANSWER[one]) for one in NO_ANSWER if one in states), text)
        if related:
            text = _("the filter hides row {number:,}; F shows all", number=related[0] + 1)
        self._table.stop_following()
        if not self._table.jump_to_index(next(filter(shown.has, related), None)):
            self._status.inform(text)
