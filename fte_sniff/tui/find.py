"""Fields that lead to a row: go to a row or a time, and search for a text or bytes."""

from __future__ import annotations

import asyncio
import re
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, tzinfo
from functools import partial
from time import monotonic

from textual.worker import WorkType

from fte_sniff.analysis.row_store import RowStore
from fte_sniff.analysis.search import Search, find_byte, find_step
from fte_sniff.analysis.time_text import ClockTime, clock_time, duration_ns, time_ns
from fte_sniff.errors import FteSniffError, InputTextError
from fte_sniff.formats.cell_text import clock_text
from fte_sniff.tui.i18n import _, error_text, later
from fte_sniff.tui.prompt import Prompt, PromptField, preload_filter


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


class GotoField(PromptField):
    """Asks for a row, a share, a byte, a time or a distance, and goes there."""

    PROMPT = Prompt(
        later("go to"),
        "1200, 50%, 12:00:03.5, +2s, -50ms, @8190",
        later("enter goes there, esc stays here"),
    )

    def parse(self, line: str) -> Goal:
        """Parse a goal; raises InputTextError."""
        return parse_goal(line)

    def accept(self, line: str) -> None:
        """Go to a goal, and report where it is not."""
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


GROUP = "search"
"""The worker that searches, and its notice."""

SEARCH_BLOCK_S = 0.05
"""How long a search may block the screen before it continues in a worker."""


class SearchField(PromptField):
    """Finds the rows with a text or bytes, one hit after the other, in a worker if it takes long.

    The search in effect is an attribute of the table, which marks its hits.
    """

    PROMPT = Prompt(
        later("search"),
        "rpm=1000, AA 01, hex:AA ?? 03",
        later("enter finds the next row from here on, then n and N; up: earlier ones"),
    )

    def open(self, line: str | None = None) -> None:
        """Let the user type."""
        super().open(line)
        self.call_after_refresh(preload_filter)

    def parse(self, line: str) -> Search:
        """Parse a search; raises InputTextError."""
        return Search.parse(line)

    def action_again(self, by: int) -> None:
        """Go to the next hit, or to the previous one."""
        search = self._table.search
        if search is None:
            self._notice.inform(_("no search yet; / starts one"))
        else:
            self._find(search, self._table.last_index + by, by)

    def accept(self, line: str) -> None:
        """Go to the next hit of a search; an empty line ends the last one."""
        self._cancel()
        self._table.set_search(Search.parse(line) if line else None)
        if self._table.search is not None:
            # While the end is followed, all rows are above.
            by = -1 if self._table.viewport.following else 1
            self._find(self._table.search, self._table.last_index, by)

    def _find(self, search: Search, start: int, by: int) -> None:
        self._cancel()
        steps = self._search_steps(search, start, by)
        until = monotonic() + SEARCH_BLOCK_S
        while monotonic() < until:
            if next(steps, None) is None:
                return
        work: WorkType[None] = partial(self._continue_search, search, steps)
        self.run_worker(work, group=GROUP, exclusive=True)

    async def _continue_search(self, search: Search, steps: Iterator[int]) -> None:
        form = _("looking for {text}: {share:.0%} seen, esc ends it")
        for seen in steps:
            share = min(seen / max(1, len(self._store)), 1.0)
            text = form.format(text=search.typed, share=share)
            self._notice.pin(GROUP, text, warning=False)
            await asyncio.sleep(0)

    def _search_steps(self, search: Search, start: int, by: int) -> Iterator[int]:
        """Search to the end of the rows, then from the other end to the start.

        Yields the number of rows that were seen; shows the result at the end.
        """
        store = self._store
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
                    self._notice.unpin(GROUP)
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
        self._notice.unpin(GROUP)
        if not self._table.jump_to_index(found):
            self._notice.inform(_("the next match arrived after the pause; space continues"))
        elif wrapped:
            self._notice.inform(_("the search continued from the other end"))

    def _report_no_hit(self, search: Search) -> None:
        self._notice.unpin(GROUP)
        text = _("no row that the filter shows has {text}")
        if self._store.view.pending:
            text = _("no row has {text} so far; the filter is still running")
        elif self._store.view.filter is None:
            text = _("no row has {text}")
        self._notice.inform(text.format(text=search.typed))

    @property
    def is_searching(self) -> bool:
        """Whether a search continues in its worker."""
        return any(worker.group == GROUP and worker.is_running for worker in self.workers)

    def end(self) -> bool:
        """Cancel a running search, or clear the last one; returns whether there was one."""
        if self.is_searching:
            self._cancel()
            self._notice.unpin(GROUP)
            return True
        if self._table.search is not None:
            self._table.set_search(None)
            return True
        return False

    def _cancel(self) -> None:
        self.workers.cancel_group(self, GROUP)
