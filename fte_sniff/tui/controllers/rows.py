"""Go to rows: by a number, a time, a byte, a fault, a gap, an answer; select them."""

from __future__ import annotations

import re
from dataclasses import dataclass
from datetime import UTC, tzinfo

from fte_sniff.analysis.row_store import RowStore
from fte_sniff.analysis.search import find_byte, find_fault, find_raised, find_unanswered
from fte_sniff.analysis.time_text import ClockTime, clock_time, duration_ns, time_ns
from fte_sniff.errors import InputTextError
from fte_sniff.formats.cell_text import clock_text
from fte_sniff.tui.controllers.controller import Parts, ScreenController
from fte_sniff.tui.i18n import _
from fte_sniff.tui.panes.row import STATES
from fte_sniff.tui.prompt import GOTO, PromptField


@dataclass(frozen=True, slots=True)
class Goal:
    """Where to go; one of the fields is set."""

    row: int | None = None
    """The shown row of this number, from 1."""
    percent: float | None = None
    """The row at a percentage (0 to 100) of the shown rows."""
    offset: int | None = None
    """The row that holds a byte of the stream of the cursor's row, from 0."""
    t_ns: int | None = None
    """The first row at or after a time, nanoseconds since 1970 UTC."""
    clock: ClockTime | None = None
    """The first row at or after a time of day, on the day of the cursor's row."""
    distance_ns: int | None = None
    """The first row at or after a distance from the cursor's row; negative is earlier."""


_ROW = re.compile(r"[0-9][0-9_,]*")
_NO_UNIT = re.compile(r"[+-][0-9]+(?:\.[0-9]*)?", re.ASCII)
_SHARE = re.compile(r"([0-9]{1,3}(?:\.[0-9]*)?) ?%", re.ASCII)
_OFFSET = re.compile(r"@ ?(0[xX][0-9a-fA-F]{1,16}|[0-9][0-9_,]{0,20})", re.ASCII)


def parse_goal(text: str, zone: tzinfo = UTC) -> Goal:
    """Parse a goal; a date and time without a zone are in `zone`.

    Raises InputTextError; it shows a goal of each kind, or asks for the unit of a distance.
    """
    text = text.strip()
    if _ROW.fullmatch(text):
        return Goal(row=int(text.replace(",", "").replace("_", "")))
    if match := _SHARE.fullmatch(text):
        return Goal(percent=min(100.0, float(match[1])))
    if match := _OFFSET.fullmatch(text):
        return Goal(offset=int(match[1].replace(",", "").replace("_", ""), 0))
    if (t_ns := time_ns(text, zone)) is not None:
        return Goal(t_ns=t_ns)
    if (clock := clock_time(text)) is not None:
        return Goal(clock=clock)
    if text[:1] in ("+", "-") and (ns := duration_ns(text[1:])) is not None:
        return Goal(distance_ns=-ns if text[0] == "-" else ns)
    if _NO_UNIT.fullmatch(text):
        raise InputTextError(_("{text} has no unit; write {text}s, {text}ms, {text}us", text=text))
    raise InputTextError(
        _(
            "a row (1200), 50%, a time (12:00:03.5, 20:00+08:00), a distance (+2s, -50ms)"
            " or a byte (@8190)"
        )
    )


def time_of(goal: Goal, store: RowStore, cursor: int, zone: tzinfo) -> int | None:
    """Time that a goal names, nanoseconds since 1970 UTC; `zone` is the default.

    `cursor` is the position of the cursor's row among those shown. Returns None for goals that
    name no time, and where the cursor's row has none.
    """
    cursor_ns = time_at(store, cursor)
    if cursor_ns is None:
        return None
    if goal.distance_ns is not None:
        return cursor_ns + goal.distance_ns
    return goal.t_ns if goal.clock is None else goal.clock.on_day_of(cursor_ns, zone)


def row_of(goal: Goal, store: RowStore, cursor: int, zone: tzinfo) -> int | None:
    """Position of the row that a goal names among those shown; the arguments are `time_of`'s.

    Returns None where no shown row has the byte, or a time is needed and there are none. A position
    may be past the last row.
    """
    last = max(0, store.view.count - 1)
    if goal.row is not None:
        return goal.row - 1
    if goal.percent is not None:
        return round(goal.percent / 100 * last)
    if goal.offset is not None:
        return _row_with_byte(store, cursor, goal.offset)
    t_ns = time_of(goal, store, cursor, zone)
    return None if t_ns is None else _first_from(store, t_ns)


def _row_with_byte(store: RowStore, cursor: int, offset: int) -> int | None:
    if cursor >= store.view.count:
        return None
    index = find_byte(store, store.view.row(cursor).port, offset)
    return None if index is None else store.view.position_of(index)


def _first_from(store: RowStore, t_ns: int) -> int:
    """The first shown row at or after a time, as if times never fell; at most the last one."""
    position = store.view.position_of(store.index_from(t_ns))
    return min(position, max(0, store.view.count - 1))


def time_at(store: RowStore, position: int) -> int | None:
    """Time of a shown row; None without such a row or its time."""
    return store.view.row(position).t_ns if position < store.view.count else None


class RowController(ScreenController):
    """Moves the cursor to rows, and selects rows from the cursor on."""

    def __init__(self, parts: Parts) -> None:
        super().__init__(parts)
        self.field = PromptField(self._focus, GOTO, parse_goal, self._go)

    def action_goto(self) -> None:
        """Ask where to go."""
        self.field.open()

    def _go(self, line: str) -> None:
        if not line:
            return
        store, cursor = self._store, self._table.viewport.cursor
        zone = self._table.view.shown_zone
        goal = parse_goal(line, zone)
        row = row_of(goal, store, cursor, zone)
        if row is None:
            text = _("no row here has a time")
            if goal.offset is not None:
                text = _("no row that is shown has byte {offset:,} of its stream")
            self._notice.inform(text.format(offset=goal.offset))
            return
        last = self._table.viewport.count - 1
        t_ns = time_of(goal, store, cursor, zone)
        self._table.jump(row)
        if row > last >= 0:
            text = _("row {number:,} does not exist; this is the last")
            self._notice.inform(text.format(number=row + 1))
        elif t_ns is not None:
            self._warn_outside(line, t_ns)

    def _warn_outside(self, line: str, t_ns: int) -> None:
        """Report a time before the first or after the last shown row."""
        store, zone = self._store, self._table.view.shown_zone
        first, last = time_at(store, 0), time_at(store, max(0, store.view.count - 1))
        if last is not None and t_ns > last:
            text, end = _("{time} is after the last row ({end})"), last
        elif first is not None and t_ns < first:
            text, end = _("{time} is before the first row ({end})"), first
        else:
            return
        self._notice.inform(text.format(time=line.strip(), end=clock_text(end, 3, zone)))

    def go_to_fault_between(self, start_ns: int, end_ns: int) -> None:
        """Go to the first shown row with a fault in a span of time, else to its first row."""
        store = self._store
        self._table.stop_following()
        self._table.jump(_first_from(store, start_ns))
        row = self._table.cursor_row
        if row is None or not row.faults:
            index = find_fault(store, self._table.last_index, 1)
            t_ns = None if index is None else store.row(index).t_ns
            if t_ns is not None and t_ns < end_ns:
                self._table.jump_to_index(index)

    def action_fault(self, by: int) -> None:
        """Go to the next fault, or to the previous one."""
        store, start = self._store, self._table.last_index
        if self._table.jump_to_index(find_fault(store, start, by)):
            return
        text, other = _("no row with a fault below this one"), _("{key} goes to the previous one")
        if by < 0:
            text, other = _("no row with a fault above this one"), _("{key} goes to the next one")
        if find_fault(store, start, -by) is not None:
            text += "; " + other.format(key="E" if by > 0 else "e")
        if find_raised(store, start, by) is not None:
            hint = _("{key} goes to a row whose ERROR or ONLINE is not in order")
            text += "; " + hint.format(key="a" if by > 0 else "A")
        self._notice.inform(text)

    def action_raised(self, by: int) -> None:
        """Go to the next row with a raised flag byte, or to the previous one."""
        below = _("no row below this one whose ERROR or ONLINE is not in order")
        above = _("no row above this one whose ERROR or ONLINE is not in order")
        index = find_raised(self._store, self._table.last_index, by)
        self._jump(index, below if by > 0 else above)

    def action_unanswered(self, by: int) -> None:
        """Go to the next command without an answer, or to the previous one."""
        below = _("no command without an answer below this row")
        above = _("no command without an answer above this row")
        index = find_unanswered(self._store, self._table.last_index, by)
        self._jump(index, below if by > 0 else above)

    def _jump(self, index: int | None, otherwise: str) -> None:
        if not self._table.jump_to_index(index):
            self._notice.inform(otherwise)

    def action_landmark(self, by: int) -> None:
        """Go to the next lost port or gap, or to the previous one."""
        store, last = self._store, self._table.last_index
        beyond = self._table.landmarks.beyond(last, by)
        index = next((one.index for one in beyond if store.first <= one.index), None)
        if index is None:
            below = _("no port was lost and no rows are missing below this row")
            above = _("no port was lost and no rows are missing above this row")
            self._notice.inform(below if by > 0 else above)
            return
        position = store.view.position_of(index)
        self._table.jump(min(position, max(0, store.view.count - 1)))

    def action_related(self) -> None:
        """Go from a command to its answer, or from an answer to its command."""
        if not self._table.viewport.count:
            return
        index = self._table.last_index
        related = self._table.relations.related(index)
        text = _("this row is neither a command that awaits an answer nor an answer")
        states = {one.state for one in self._table.relations.answers(index)}
        text = next((_(STATES[one]) for one in STATES if one in states), text)
        if related:
            text = _("the filter hides row {number:,}, to which this one belongs; F shows all")
            text = text.format(number=related[0] + 1)
        shown = (one for one in related if self._store.view.has(one))
        self._table.stop_following()
        self._jump(next(shown, None), text)

    def action_select(self) -> None:
        """Begin a selection at the cursor's row, or end it."""
        if not self._table.end_selection() and self._table.viewport.count:
            self._table.stop_following()
            self._table.selection_start = self._table.last_index
            self._table.sync()
            self._notice.inform(_("selecting: move, then y or Y copies, w saves, esc ends it"))
