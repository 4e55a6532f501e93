"""Actions that find rows: go to a row, a time, a fault or a mark; filter; search."""

from __future__ import annotations

import asyncio
import re
from bisect import bisect_left
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from datetime import UTC, tzinfo
from functools import partial
from time import monotonic

from fte_sniff.analysis.feed import Feed
from fte_sniff.analysis.filter.terms import CellFilter, both, cell_filters
from fte_sniff.analysis.row_store import BlockSource, RowStore
from fte_sniff.analysis.search import Search, find_byte, find_fault, find_raised, find_step
from fte_sniff.analysis.time_text import ClockTime, clock_time, duration_ns, time_ns
from fte_sniff.errors import FteSniffError, InputTextError, printable
from fte_sniff.formats.cell_text import clock_text
from fte_sniff.protocol import Row
from fte_sniff.protocol.rows import Rows
from fte_sniff.session.notes import Note, located
from fte_sniff.tui.actions import ScreenActions
from fte_sniff.tui.i18n import _, error_text
from fte_sniff.tui.modals import Entry, Picker
from fte_sniff.tui.options import StartOptions
from fte_sniff.tui.prompt import (
    FILTER_NAME,
    GOTO,
    NOTE,
    SEARCH,
    FilterField,
    PromptField,
    parse_filter,
    preload_filter,
)


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


NO_TIME = -(2**63)

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
    return None if t_ns is None else min(_first_from(store, t_ns), last)


def _row_with_byte(store: RowStore, cursor: int, offset: int) -> int | None:
    if cursor >= store.view.count:
        return None
    index = find_byte(store, store.view.row(cursor).port, offset)
    return None if index is None else store.view.position_of(index)


def _first_from(store: RowStore, t_ns: int) -> int:
    """First shown row at or after a time, as if times never fell."""

    def time(position: int) -> int:
        found = time_at(store, position)
        return NO_TIME if found is None else found

    return bisect_left(range(store.view.count), t_ns, key=time)


def time_at(store: RowStore, position: int) -> int | None:
    """Time of a shown row; None where there is no such row, or it has no time."""
    return store.view.row(position).t_ns if position < store.view.count else None


SEARCH_GROUP = "search"

SEARCH_BLOCK_S = 0.05
"""How long a search may block the screen before it continues in a worker."""


class FindActions(ScreenActions):
    """Go to rows, mark and select them, filter them, and search for a text or bytes."""

    def __init__(self, feed: Feed, options: StartOptions, source: BlockSource | None) -> None:
        super().__init__(feed, options, source)
        self._saved_filters = dict(options.choices.filters)
        self._filter_field = FilterField(
            self._focus,
            self._model.store,
            options.row_filter.text if options.row_filter else "",
            self._saved_filters,
            self._cursor_ns,
            self._set_filter,
            self._ask_filter_name,
        )
        self._name_field = PromptField(self._focus, FILTER_NAME, str, self._name_filter)
        self._note_field = PromptField(self._focus, NOTE, str, self._write_note)
        self._search_field = PromptField(self._focus, SEARCH, Search.parse, self._search)
        self._goto_field = PromptField(self._focus, GOTO, parse_goal, self._go)
        self._earlier_filters: list[str] = []
        """Filters before the current one, the latest last; an empty one shows all rows."""
        self._notes = options.notes
        self._missing = {} if options.notes is None else dict(options.notes.notes)
        """Notes whose rows have not come yet."""
        self._left_at = options.place.cursor
        """The row where the view was left, until it has come."""
        self._noted: tuple[int, Row] | None = None
        """The row whose note is written, after its index."""

    def _cursor_ns(self) -> int | None:
        row = self._table.cursor_row
        return None if row is None else row.t_ns

    def action_goto(self) -> None:
        """Ask where to go."""
        self._goto_field.open()

    def _go(self, line: str) -> None:
        if not line:
            return
        store, cursor = self._model.store, self._table.viewport.cursor
        zone = self._table.view.shown_zone
        goal = parse_goal(line, zone)
        row = row_of(goal, store, cursor, zone)
        if row is None:
            text = _("no row here has a time")
            if goal.offset is not None:
                text = _("no row that is shown has byte {offset:,} of its stream")
            self._inform(text.format(offset=goal.offset))
            return
        last = self._table.viewport.count - 1
        t_ns = time_of(goal, store, cursor, zone)
        self._table.jump(row)
        if row > last >= 0:
            text = _("there is no row {number:,}; this is the last")
            self._inform(text.format(number=row + 1))
        elif t_ns is not None:
            self._warn_outside(line, t_ns)

    def _warn_outside(self, line: str, t_ns: int) -> None:
        """Report a time before the first or after the last shown row."""
        store, zone = self._model.store, self._table.view.shown_zone
        first, last = time_at(store, 0), time_at(store, max(0, store.view.count - 1))
        if last is not None and t_ns > last:
            text, end = _("{time} is after the last row ({end})"), last
        elif first is not None and t_ns < first:
            text, end = _("{time} is before the first row ({end})"), first
        else:
            return
        self._inform(text.format(time=line.strip(), end=clock_text(end, 3, zone)))

    def action_fault(self, by: int) -> None:
        """Go to the next fault, or to the previous one."""
        store, start = self._model.store, self._table.last_index
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
        self._inform(text)

    def action_raised(self, by: int) -> None:
        """Go to the next row with a raised flag byte, or to the previous one."""
        below = _("no row below this one whose ERROR or ONLINE is not in order")
        above = _("no row above this one whose ERROR or ONLINE is not in order")
        index = find_raised(self._model.store, self._table.last_index, by)
        self._jump(index, below if by > 0 else above)

    def _jump(self, index: int | None, otherwise: str) -> None:
        if not self._table.jump_to_index(index):
            self._inform(otherwise)

    def action_landmark(self, by: int) -> None:
        """Go to the next lost port or gap, or to the previous one."""
        store, last = self._model.store, self._table.last_index
        beyond = self._table.landmarks.beyond(last, by)
        index = next((one.index for one in beyond if store.first <= one.index), None)
        if index is None:
            below = _("no port was lost and no rows are missing below this row")
            above = _("no port was lost and no rows are missing above this row")
            self._inform(below if by > 0 else above)
            return
        position = store.view.position_of(index)
        self._table.jump(min(position, max(0, store.view.count - 1)))

    def action_related(self) -> None:
        """Go from a command to its answer, or from an answer to its command."""
        if not self._table.viewport.count:
            return
        index = self._table.last_index
        related = self._table.relations.related(index)
        text = _("this row is neither a command with an answer nor an answer")
        if related:
            text = _("the filter hides row {number:,}, to which this one belongs; F shows all")
            text = text.format(number=related[0] + 1)
        shown = (one for one in related if self._model.store.view.has(one))
        self._table.stop_following()
        self._jump(next(shown, None), text)

    def action_overview(self, cell: int) -> None:
        """Go to the most important row of a cell of the overview."""
        self._table.jump_to_cell(cell)

    def action_mark(self) -> None:
        """Mark the row under the cursor, or remove its mark."""
        if self._table.viewport.count:
            self._table.stop_following()
            index, row = self._table.last_index, self._table.cursor_row
            if self._table.marks.get(index):
                self._inform(_("the row has a note; # changes it, an empty one removes it"))
            elif row is not None:
                self._keep_note(index, row, "" if index not in self._table.marks else None)

    def action_note(self) -> None:
        """Ask for a note on the row under the cursor."""
        self._table.stop_following()
        index, row = self._table.last_index, self._table.cursor_row
        if row is not None:
            self._noted = index, row
            self._note_field.open(self._table.marks.get(index, ""))

    def _write_note(self, text: str) -> None:
        if self._noted is not None:
            self._keep_note(*self._noted, text or None)

    def _keep_note(self, index: int, row: Row, text: str | None) -> None:
        """Mark a row with a text, or remove its mark (None), and write that to the file."""
        note = Note.on(row, text or "")
        if text is None:
            self._table.marks.pop(index, None)
        else:
            self._table.marks[index] = note.text
        self._table.sync()
        if self._notes is not None:
            if text is None:
                self._notes.remove(note, self._capture_at(index))
            else:
                self._notes.set(note, self._capture_at(index))
                if path := self._notes.news(self._capture_at(index)):
                    text = _("marks and notes are saved in {path}", path=printable(str(path)))
                    self._inform(text)
            self._start_worker("notes", self._save_notes)

    def _capture_at(self, index: int) -> int:
        """The number of a row's capture among those of the view."""
        return 0 if self._notes is None else self._notes.origins.at(index)

    async def _save_notes(self) -> None:
        """Write the notes in a thread, since a disk may be slow."""
        if self._notes is not None and (trouble := await asyncio.to_thread(self._notes.save)):
            self._notice.warn(_(trouble))

    def action_notes(self) -> None:
        """Pick a marked row and go to it."""
        store, marks, entries = self._model.store, self._table.marks, []
        for index in sorted(marks):
            if store.first <= index < store.next:
                row = store.row(index)
                time = "" if row.t_ns is None else clock_text(row.t_ns, 3, self._table.view.zone)
                text = printable(marks[index]) or _("mark")
                entries.append(Entry(f"{time}  {text}", str(index), f"{row.offset:,}"))
        if entries:
            self.push_screen(Picker(_("marks and notes"), entries), self._go_to_note)
        else:
            self._inform(_("no row is marked; m marks one"))

    def _go_to_note(self, index: str | None) -> None:
        if index is not None and not self._table.jump_to_index(int(index)):
            self._inform(_("the filter hides this row; F shows all rows"))

    def _find_noted(self, rows: Rows, first: int) -> None:
        """Mark those of the new rows that have a note, and find the row where the view was left."""
        wanted = set(self._missing)
        if self._left_at is not None:
            wanted.add(self._left_at)
        if not (wanted and len(rows)):
            return
        for number, key in located(rows, wanted):
            if self._capture_at(first + number) != key.capture:
                continue
            note = self._missing.pop(key, None)
            if note is not None:
                self._table.marks[first + number] = note.text
            if key == self._left_at:
                self._left_at = None
                self._table.sync()
                self._table.jump_to_index(first + number)

    def _show_note(self) -> None:
        index = self._table.cursor_index
        text = "" if index is None else self._table.marks.get(index, "")
        if text:
            self._notice.pin("note", _("note: {text}", text=text), warning=False)
        else:
            self._notice.unpin("note")

    def action_to_mark(self, by: int) -> None:
        """Go to the next mark, or to the previous one."""
        below = _("no marked row is shown below this one")
        above = _("no marked row is shown above this one")
        none = "" if self._table.marks else _("no row is marked; m marks one")
        self._jump(self._table.next_mark(by), none or (below if by > 0 else above))

    def action_select(self) -> None:
        """Begin a selection at the cursor's row, or end it."""
        if not self._end_selection() and self._table.viewport.count:
            self._table.stop_following()
            self._table.selection_start = self._table.last_index
            self._table.sync()
            self._inform(_("selecting: move, then y or Y copies, w saves, esc ends it"))

    def action_filter(self) -> None:
        """Ask for a filter."""
        self._filter_field.open()

    def action_unfilter(self) -> None:
        """Show all rows."""
        self._set_filter("")

    def action_filter_before(self) -> None:
        """Go back to the previous filter."""
        if self._earlier_filters:
            self._apply_filter(self._earlier_filters.pop())
        else:
            self._inform(_("there was no other filter before"))

    def _set_filter(self, line: str) -> None:
        """Apply a valid filter, and remember the current one; an empty one shows all rows."""
        current = self._filter_field.current
        if line != current:
            self._earlier_filters.append(current)
        self._apply_filter(line)

    def _apply_filter(self, line: str) -> None:
        self._filter_field.set_current(line)
        self._model.set_filter(parse_filter(line) if line else None, self._table.near)
        self._table.sync()

    def action_choose(self) -> None:
        """Show the rows of the line under the cursor of the top view, by a filter."""
        condition = self._panes.top.condition
        if condition is not None:
            self._add_condition(condition)
            self._focus.show_top(False)

    def _ask_filter_name(self, _line: str) -> None:
        self._name_field.open()

    def _name_filter(self, name: str) -> None:
        """Save the filter in effect by name."""
        if name:
            self._saved_filters[name] = self._filter_field.current
            self._inform(_("saved; f lists the filter as {name}", name=name))

    def action_only(self) -> None:
        """Show only rows with the same value in a cell."""
        self._pick_cell(_("only rows with"), lambda cell: cell.only)

    def action_without(self) -> None:
        """Hide rows with the same value in a cell."""
        self._pick_cell(_("hide rows with"), lambda cell: cell.without)

    def _pick_cell(self, title: str, condition: Callable[[CellFilter], str]) -> None:
        row = self._table.cursor_row
        if row is None:
            return
        preload_filter()
        cells = cell_filters(row)
        names = [cell.column for cell in cells]
        cursor = names.index(self._table.column) if self._table.column in names else 0
        entries = [Entry(printable(cell.only), condition(cell)) for cell in cells]
        self.push_screen(Picker(title, entries, cursor), self._add_condition)

    def _add_condition(self, condition: str | None) -> None:
        if condition is not None:
            self._set_filter(both(self._filter_field.current, condition))

    def action_search(self) -> None:
        """Ask for a text or bytes."""
        preload_filter()
        self._search_field.open()

    def action_again(self, by: int) -> None:
        """Go to the next hit, or to the previous one."""
        search = self._table.search
        if search is None:
            self._inform(_("no search yet; / starts one"))
        else:
            self._find(search, self._table.last_index + by, by)

    def _search(self, line: str) -> None:
        self.workers.cancel_group(self, SEARCH_GROUP)
        self._table.set_search(Search.parse(line) if line else None)
        if self._table.search is not None:
            # While the end is followed, all rows are above.
            by = -1 if self._table.viewport.following else 1
            self._find(self._table.search, self._table.last_index, by)

    def _find(self, search: Search, start: int, by: int) -> None:
        self.workers.cancel_group(self, SEARCH_GROUP)
        steps = self._search_steps(search, start, by)
        until = monotonic() + SEARCH_BLOCK_S
        while monotonic() < until:
            if next(steps, None) is None:
                return
        self._start_worker(SEARCH_GROUP, partial(self._continue_search, search, steps))

    async def _continue_search(self, search: Search, steps: Iterator[int]) -> None:
        form = _("looking for {text}: {share:.0%} seen, esc ends it")
        for seen in steps:
            share = min(seen / max(1, len(self._model.store)), 1.0)
            text = form.format(text=search.typed, share=share)
            self._notice.pin(SEARCH_GROUP, text, warning=False)
            await asyncio.sleep(0)

    def _search_steps(self, search: Search, start: int, by: int) -> Iterator[int]:
        """Search to the end of the rows, then from the other end to the start.

        Yields the number of rows that were seen; shows the result at the end.
        """
        store = self._model.store
        rows_at_start = len(store)
        mask = partial(search.matches, columns={column.name for column in self._table.columns})
        index: int | None = start
        for wrapped in (False, True):
            if wrapped:
                index = store.first if by > 0 else store.next - 1
            while index is not None:
                try:
                    step = find_step(store, mask, index, by)
                except FteSniffError as error:
                    self._notice.unpin(SEARCH_GROUP)
                    self._notice.warn(error_text(error))
                    return
                reached = index if step.found is None else step.found
                if wrapped and (reached - start) * by >= 0:
                    break
                if step.found is not None:
                    self._show_hit(step.found, wrapped)
                    return
                distance = abs(index - start)
                yield rows_at_start - distance if wrapped else distance
                index = step.next_index
        self._report_no_hit(search)

    def _show_hit(self, found: int, wrapped: bool) -> None:
        self._notice.unpin(SEARCH_GROUP)
        if not self._table.jump_to_index(found):
            self._inform(_("the next match arrived after the pause; space continues"))
        elif wrapped:
            self._inform(_("the search continued from the other end"))

    def _report_no_hit(self, search: Search) -> None:
        self._notice.unpin(SEARCH_GROUP)
        text = _("no row that the filter shows has {text}")
        if self._model.store.view.pending:
            text = _("no row has {text} so far; the filter is still running")
        elif self._model.store.view.filter is None:
            text = _("no row has {text}")
        self._inform(text.format(text=search.typed))

    @property
    def _searching(self) -> bool:
        return any(worker.group == SEARCH_GROUP and worker.is_running for worker in self.workers)

    def _end_search(self) -> bool:
        """Cancel a running search, or clear the last one; returns whether there was one."""
        if self._searching:
            self.workers.cancel_group(self, SEARCH_GROUP)
            self._notice.unpin(SEARCH_GROUP)
            return True
        if self._table.search is not None:
            self._table.set_search(None)
            return True
        return False
