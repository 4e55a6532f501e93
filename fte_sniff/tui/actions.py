"""Navigation, filter, search and mark actions."""

from __future__ import annotations

import asyncio
from abc import abstractmethod
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from datetime import UTC
from functools import partial
from time import monotonic

from textual import on
from textual.app import App
from textual.worker import WorkType

from fte_sniff.analysis.filter.cell_filter import CellFilter, both, cell_filters
from fte_sniff.analysis.search import Search, find_raised, find_step
from fte_sniff.errors import FteSniffError, printable
from fte_sniff.session.save import SaveJob
from fte_sniff.tui.goto import GotoField, ToOffset, parse_goal
from fte_sniff.tui.help import HelpPage
from fte_sniff.tui.i18n import _, theme_after, worded
from fte_sniff.tui.keys import COMMANDS, key_names
from fte_sniff.tui.notices import NoticeLine
from fte_sniff.tui.options import StartOptions
from fte_sniff.tui.panes.switcher import Panes
from fte_sniff.tui.pickers import Chosen, ColumnChooser, Entry, Picker
from fte_sniff.tui.prompt import FilterField, SaveField, SearchField, parsed, prepare
from fte_sniff.tui.table.columns import TimeStyle, column_of
from fte_sniff.tui.table.widget import AbstractMeta, RowTable, TableHeader
from fte_sniff.tui.text import clock_text
from fte_sniff.tui.view_model import ViewModel


class Parts(App[None], metaclass=AbstractMeta):
    """A screen whose parts have been made."""

    _opening: StartOptions
    _watched: ViewModel
    _table: RowTable
    _panes: Panes
    _notice: NoticeLine
    _filter_field: FilterField
    _goto_field: GotoField
    _search_field: SearchField
    _save_field: SaveField
    _filters_before: list[str]
    """Filters that stood before, the latest last; an empty one shows all."""
    _saving: SaveJob | None
    """The file that is being written, if there is one."""

    def _tell(self, words: str) -> None:
        """Tell for a while what a key did, or why it did nothing."""
        self._notice.tell(words)

    def _work(self, group: str, work: WorkType[None]) -> None:
        """Do something beside the screen; what was done in its group before ends."""
        self.run_worker(work, group=group, exclusive=True)

    @abstractmethod
    def _show_state(self) -> None:
        """Draw the lines around the table, where they changed."""

    @abstractmethod
    def _unselect(self) -> bool:
        """End the selection; whether there was one."""


class NavigationActions(Parts):
    """Ways to look."""

    def action_pause(self) -> None:
        """Freeze the view, or let it go on."""
        self._table.pause()

    def action_times(self, by: int) -> None:
        """Let times count from something else, as far as there is a mark or another zone."""
        if self._watched.start_ns is None and len(self._watched.store):
            self._tell(_("no row here has a time to go by"))
            return
        look, styles = self._table.look, list(TimeStyle)
        if self._table.marks.latest is None:
            styles.remove(TimeStyle.MARK)
        if look.zone == UTC:
            styles.remove(TimeStyle.LOCAL)
        now = look.times
        at = styles.index(now) if now in styles else 0
        style = styles[(at + by) % len(styles)]
        self._table.set_look(times=style)
        self._panes.look()
        self._tell(_(style.meaning))

    def action_columns(self) -> None:
        """Choose columns, their order and widths."""
        look = self._table.look
        shown = self._table.columns
        chooser = ColumnChooser(shown, lambda name: column_of(name, look).width)
        self.push_screen(chooser, self._choose_columns)

    def _choose_columns(self, chosen: Chosen | None) -> None:
        if chosen is not None:
            self._table.set_look(choice=chosen.choice)

    @on(TableHeader.Clicked)
    def _choose_by_mouse(self) -> None:
        self.action_columns()

    def action_theme(self) -> None:
        """Switch to the next theme."""
        self.theme = theme_after(self.theme)
        self._table.sync()
        self._tell(_("theme {name}").format(name=self.theme))

    def action_pane(self, name: str) -> None:
        """Show the pane of that name, or close it; to explain one row is to stay on it."""
        self._panes.toggle(name)
        if self._panes.holds_row:
            self._table.stay()
        self._show_state()

    def action_zoom(self, by: int) -> None:
        """Look at more time, or less."""
        self._panes.zoom(by)

    def action_scroll_pane(self, by: int) -> None:
        """Move the page of the pane."""
        self._panes.scroll(by)

    @on(RowTable.Opened)
    def _open_by_mouse(self) -> None:
        if not self._panes.holds_row:
            self.action_pane("detail")

    def action_help(self) -> None:
        """Show the page of help."""
        self.push_screen(HelpPage())

    def action_palette(self) -> None:
        """Pick what to do from a list of all that can be done."""
        entries = [Entry(_(key.tooltip), key.action, key_names(key)) for key in COMMANDS]
        self.push_screen(Picker(_("do"), entries), self._do)

    async def _do(self, action: str | None) -> None:
        if action is not None and not await self.run_action(action, self):
            await self.run_action(action, self._table)


class FilterActions(Parts):
    """Filters: typed into the field at the bottom, or picked from the cells of a row."""

    def _set_filter(self, line: str) -> None:
        """Put a filter in force that passed the check; an empty one shows all."""
        before = self._filter_field.standing
        if line != before:
            self._filters_before.append(before)
        self._hold_filter(line)

    def _hold_filter(self, line: str) -> None:
        self._filter_field.hold(line)
        self._watched.set_filter(parsed(line) if line else None, self._table.near)
        self._table.sync()

    def action_filter(self) -> None:
        """Ask for a filter."""
        self._filter_field.ask()

    def action_unfilter(self) -> None:
        """Show all rows again."""
        self._set_filter("")

    def action_filter_before(self) -> None:
        """Go back to the filter that stood before this one."""
        if self._filters_before:
            self._hold_filter(self._filters_before.pop())
        else:
            self._tell(_("no other filter stood before"))

    def action_only(self) -> None:
        """Show only rows that are like the cursor's in one cell."""
        self._pick_cell(_("only rows with"), lambda cell: cell.only)

    def action_without(self) -> None:
        """Hide rows that are like the cursor's in one cell."""
        self._pick_cell(_("hide rows with"), lambda cell: cell.without)

    def _pick_cell(self, title: str, said: Callable[[CellFilter], str]) -> None:
        row = self._table.cursor_row
        if row is None:
            return
        prepare()
        cells = cell_filters(row)
        names = [cell.column for cell in cells]
        at = names.index(self._table.column) if self._table.column in names else 0
        entries = [Entry(printable(cell.only), said(cell)) for cell in cells]
        self.push_screen(Picker(title, entries, at), self._add_filter)

    def _add_filter(self, condition: str | None) -> None:
        if condition is not None:
            self._set_filter(both(self._filter_field.standing, condition))


class GotoActions(Parts):
    """Ways to a row."""

    def _go(self, line: str) -> None:
        if not line:
            return
        zone, cursor = self._table.look.shown_zone, self._table.viewport.cursor
        goal = parse_goal(line, zone)
        row = self._watched.row_of(goal, cursor, zone)
        if row is None and isinstance(goal, ToOffset):
            words = _("no row that is shown has byte {offset:,} of its stream")
            self._tell(words.format(offset=goal.offset))
        elif row is None:
            self._tell(_("no row here has a time to go by"))
        if row is None:
            return
        last = self._table.viewport.count - 1
        moment = self._watched.moment_of(goal, cursor, zone)
        self._table.jump(row)
        if row > last >= 0:
            words = _("there is no row {number:,}; this is the last")
            self._tell(words.format(number=row + 1))
        elif moment is not None:
            self._tell_outside(line, moment)

    def _tell_outside(self, line: str, moment: int) -> None:
        """Say that no row is of that time, where it lies before or after all that are shown."""
        first, last = self._watched.shown_ends
        zone = self._table.look.shown_zone
        if last is not None and moment > last:
            words, end = _("{time} lies after the last row ({end})"), last
        elif first is not None and moment < first:
            words, end = _("{time} lies before the first row ({end})"), first
        else:
            return
        self._tell(words.format(time=printable(line.strip()), end=clock_text(end, 3, zone)))

    def action_goto(self) -> None:
        """Ask where to go."""
        self._goto_field.ask()

    def action_fault(self, by: int) -> None:
        """Go to the next row with a fault, or to the one before."""
        if self._table.jump_to_fault(by):
            return
        words = _("no row with a fault below this one")
        if by < 0:
            words = _("no row with a fault above this one")
        if find_raised(self._watched.store, self._table.index_here, by) is not None:
            hint = _("{key} goes to one whose ERROR or ONLINE is not in order")
            words += "; " + hint.format(key="a" if by > 0 else "A")
        self._tell(words)

    def action_raised(self, by: int) -> None:
        """Go to the next row with a flag byte that is not in order, or to the one before."""
        if self._table.jump_to_raised(by):
            return
        if by > 0:
            self._tell(_("no row below this one whose ERROR or ONLINE is not in order"))
        else:
            self._tell(_("no row above this one whose ERROR or ONLINE is not in order"))


class MarkActions(Parts):
    """Marks and the selection."""

    def action_mark(self) -> None:
        """Mark the row under the cursor, or take its mark away."""
        if self._table.viewport.count:
            self._table.stay()
            self._table.marks.toggle(self._table.index_here)
            self._table.sync()

    def action_to_mark(self, by: int) -> None:
        """Go to the next marked row, or to the one before."""
        if self._table.jump_to_mark(by):
            return
        if not self._table.marks:
            self._tell(_("no row is marked; m marks one"))
        elif by > 0:
            self._tell(_("no marked row is shown below this one"))
        else:
            self._tell(_("no marked row is shown above this one"))

    def action_select(self) -> None:
        """Begin a selection at the cursor's row, or end it."""
        if self._table.selecting_from is not None:
            self._unselect()
        elif self._table.viewport.count:
            self._table.stay()
            self._table.selecting_from = self._table.index_here
            self._table.sync()
            self._tell(_("selecting: move, then y or Y copies, w saves, esc ends it"))

    def _unselect(self) -> bool:
        """End the selection; whether there was one."""
        if self._table.selecting_from is None:
            return False
        self._table.selecting_from = None
        self._table.sync()
        return True


AT_ONCE_S = 0.05
"""How long the search may hold up the screen before it goes on beside it."""

GROUP = "search"
"""What the work beside the screen is called."""


@dataclass(frozen=True, slots=True)
class TableLook:
    """How far a search is."""

    found: int | None
    """Index of the row that has it."""
    seen: int
    """Rows that it has passed."""
    around: bool
    """Whether it began anew from the other end."""


class SearchActions(Parts):
    """Looking for a text or bytes."""

    def action_search(self) -> None:
        """Ask what to look for."""
        self._search_field.ask()

    def action_again(self, by: int) -> None:
        """Go to the next row that has it, or to the one before."""
        search = self._table.search
        if search is None:
            self._tell(_("nothing was looked for yet; / begins"))
        else:
            self._seek(search, self._table.index_here + by, by)

    def _search(self, line: str) -> None:
        """Look for a line that passed the check; an empty one ends the search."""
        self.workers.cancel_group(self, GROUP)
        self._table.set_search(Search.parse(line) if line else None)
        if self._table.search is not None:
            # Whoever follows the end looks back from there.
            by = -1 if self._table.viewport.following else 1
            self._table.stay()
            self._seek(self._table.search, self._table.index_here, by)

    def _seek(self, search: Search, start: int, by: int) -> None:
        self.workers.cancel_group(self, GROUP)
        steps = self._steps(search, start, by)
        until = monotonic() + AT_ONCE_S
        while monotonic() < until:
            if self._step(search, steps) is None:
                return
        self._work(GROUP, partial(self._go_on, search, steps))

    async def _go_on(self, search: Search, steps: Iterator[TableLook]) -> None:
        while (look := self._step(search, steps)) is not None:
            share = look.seen / max(1, len(self._watched.store))
            words = _("looking for {text}: {share:.0%} seen, esc ends it")
            words = words.format(text=printable(search.typed), share=min(share, 1.0))
            self._notice.hold(GROUP, words, worry=False)
            await asyncio.sleep(0)

    def _step(self, search: Search, steps: Iterator[TableLook]) -> TableLook | None:
        """How far the search is now; None where it has come to its end, and has said so."""
        try:
            look = next(steps, None)
        except FteSniffError as error:
            self._notice.release(GROUP)
            self._notice.warn(worded(error))
            return None
        if look is None:
            self._notice.release(GROUP)
            self._tell_none(search)
        elif look.found is not None:
            self._notice.release(GROUP)
            self._show_found(look)
        else:
            return look
        return None

    def _steps(self, search: Search, start: int, by: int) -> Iterator[TableLook]:
        """To the end of the rows, and then from the other end to where it began."""
        store = self._watched.store
        begun = len(store)
        mask = partial(search.mask, columns={column.name for column in self._table.columns})
        index: int | None = start
        for around in (False, True):
            if around:
                index = store.first if by > 0 else store.next - 1
            while index is not None:
                step = find_step(store, mask, index, by)
                here = step.found if step.found is not None else index
                if around and (here - start) * by >= 0:
                    return
                seen = abs(index - start) if not around else begun - abs(start - index)
                yield TableLook(step.found, seen, around)
                index = step.onward

    def _show_found(self, look: TableLook) -> None:
        if look.found is None or not self._table.jump_to_index(look.found):
            self._tell(_("the next row that has it came after the pause; space goes on"))
        elif look.around:
            self._tell(_("there was no further one: it went on from the other end"))

    def _tell_none(self, search: Search) -> None:
        if self._watched.store.shown.pending:
            words = _("no row so far has {text}; the filter is still at work")
        elif self._watched.store.shown.filter is None:
            words = _("no row has {text}")
        else:
            words = _("no row that the filter shows has {text}")
        self._tell(words.format(text=printable(search.typed)))

    @property
    def _searching(self) -> bool:
        return any(worker.group == GROUP and worker.is_running for worker in self.workers)

    def _end_search(self) -> bool:
        """End a search that runs, or forget what was looked for; whether there was one."""
        if self._searching:
            self.workers.cancel_group(self, GROUP)
            self._notice.release(GROUP)
            return True
        if self._table.search is not None:
            self._table.set_search(None)
            return True
        return False
