"""Actions of the keys: view, navigation, filter and search."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from datetime import UTC
from functools import partial
from time import monotonic, monotonic_ns

from textual import on
from textual.app import App
from textual.worker import WorkType

from fte_sniff.analysis.filter.cell_filter import CellFilter, both, cell_filters
from fte_sniff.analysis.search import Search, find_fault, find_raised, find_step
from fte_sniff.errors import FteSniffError, printable
from fte_sniff.formats.cell_text import clock_text
from fte_sniff.protocol import Row
from fte_sniff.protocol.dissect import dissect
from fte_sniff.row_batch import RowBatch
from fte_sniff.session.notes import Note, Notes, RowKey, located
from fte_sniff.session.save import SaveJob
from fte_sniff.tui.goto import GotoField, parse_goal, row_of, time_at, time_of
from fte_sniff.tui.i18n import LANGUAGES, _, error_text, switch_language, theme_after
from fte_sniff.tui.keys import COMMANDS, SEARCH_WORDS, key_names, translate_keys
from fte_sniff.tui.modals import ChosenColumns, ColumnChooser, Entry, HelpPage, Picker
from fte_sniff.tui.notices import NoticeLine
from fte_sniff.tui.options import StartOptions
from fte_sniff.tui.panes.pane import BESIDE_CELLS, Body, Pane
from fte_sniff.tui.panes.switcher import PaneSwitcher
from fte_sniff.tui.panes.top import TopView
from fte_sniff.tui.prompt import (
    FilterField,
    NameField,
    NoteField,
    PictureField,
    PromptField,
    PromptLine,
    SaveField,
    SearchField,
    parse_filter,
    preload_filter,
)
from fte_sniff.tui.table.columns import TimeStyle
from fte_sniff.tui.table.widget import RowTable, TableHeader
from fte_sniff.tui.view_model import ViewModel, ViewUpdate


class ScreenActions(App[None]):
    """Base of the actions: the widgets and the state that they work on."""

    _options: StartOptions
    _model: ViewModel
    _table: RowTable
    _header: TableHeader
    _panes: PaneSwitcher
    _body: Body
    _notice: NoticeLine
    _filter_field: FilterField
    _saved_filters: dict[str, str]
    """Saved filters by name."""
    _name_field: NameField
    _goto_field: GotoField
    _search_field: SearchField
    _save_field: SaveField
    _picture_field: PictureField
    language: str
    """A key of `i18n.LANGUAGES`."""
    _note_field: NoteField
    _missing: dict[RowKey, Note]
    """Notes whose rows have not come yet."""
    _left_at: RowKey | None
    """The row where the view was left, until it has come."""
    _noted_row: Row | None = None
    _noted_index: int = 0
    """The row whose note is written, and its index."""
    _earlier_filters: list[str]
    """Filters before the current one, the latest last; an empty one shows all rows."""
    _speed: float
    """Speed of the next playback."""
    _notes: Notes | None
    """Where marks are kept; None to keep none."""
    _save_job: SaveJob | None
    """The file that is being written, if any."""

    def _inform(self, text: str) -> None:
        self._notice.inform(text)

    def _start_worker(self, group: str, work: WorkType[None]) -> None:
        self.run_worker(work, group=group, exclusive=True)

    def _end_selection(self) -> bool:
        """End the selection; returns whether there was one."""
        if self._table.selection_start is None:
            return False
        self._table.selection_start = None
        self._table.sync()
        return True

    def action_top(self) -> None:
        """Show one line for each kind and motor in place of the table, or the table again."""
        top = self._panes.top
        top.display = not top.display
        self._header.display = self._table.display = not top.display
        (top if top.display else self._table).focus()
        if top.display and self._panes.explains_row:
            self._panes.close()
        self.call_after_refresh(self._panes.redraw)


class ViewActions(ScreenActions):
    """Pause, times, columns, theme, language, panes, help and the list of commands."""

    def action_pause(self) -> None:
        """Freeze the view of a capture, or resume it; play a file, or pause playback."""
        model, viewport = self._model, self._table.viewport
        if model.state.live:
            self._table.toggle_pause()
        elif model.start_ns is None:
            self._inform(_("no row here has a time"))
        elif model.playback is not None and viewport.following:
            model.playback.paused = not model.playback.paused
        else:
            self._play()

    def _play(self) -> None:
        """Play from the row under the cursor; from the first if that is the last."""
        model, index = self._model, self._table.last_index
        speed = self._speed if model.playback is None else model.playback.speed
        model.stop_playback()
        if index >= model.store.next - 1:
            index = model.store.first
        self._panes.restart(model.play(index, speed, monotonic_ns()))
        self._table.action_follow()
        self._inform(_("playing; < and > change the speed, space pauses, esc shows the whole file"))

    def _stop_playback(self) -> None:
        """Show the whole file again."""
        if self._model.playback is None:
            return
        self._speed = self._model.playback.speed
        self._table.stop_following()
        events = self._model.stop_playback()
        self._panes.on_update(ViewUpdate(True, events, False, None))
        self._table.sync()
        self._notice.report(_("the whole file is shown"))

    def action_speed(self, by: int) -> None:
        """Play faster or more slowly."""
        if self._model.playback is None:
            self._inform(_("nothing is played; space plays a file from the cursor's row"))
        else:
            self._model.playback.change_speed(by)

    def action_times(self) -> None:
        """Switch to the next time style; without a mark or another zone, two are skipped."""
        if self._model.start_ns is None and len(self._model.store):
            self._inform(_("no row here has a time"))
            return
        view, styles = self._table.view, list(TimeStyle)
        if self._table.marks.latest is None:
            styles.remove(TimeStyle.MARK)
        if view.zone == UTC:
            styles.remove(TimeStyle.LOCAL)
        current = styles.index(view.times) if view.times in styles else 0
        style = styles[(current + 1) % len(styles)]
        self._table.set_view(times=style)
        self._panes.redraw()
        self._inform(_(style.meaning))

    def action_changes(self) -> None:
        """Highlight the bytes that changed, or no longer."""
        changes = not self._table.view.changes
        self._table.set_view(changes=changes)
        on = _("bytes that differ from the frame before of the same kind and motor are highlighted")
        self._inform(on if changes else _("changed bytes are not highlighted"))

    def action_events(self) -> None:
        """Show the lines of port events and gaps, or hide them."""
        events = not self._table.view.events
        self._table.set_view(events=events)
        self._inform(_("port events are shown") if events else _("port events are hidden"))

    @on(TableHeader.Clicked)
    def action_columns(self) -> None:
        """Choose columns, their order and widths."""

        def choose(chosen: ChosenColumns | None) -> None:
            if chosen is not None:
                self._table.set_view(choice=chosen.choice, delta=chosen.delta)

        chooser = ColumnChooser(self._table.view, self._table.scrollable_size.width)
        self.push_screen(chooser, choose)

    def action_theme(self) -> None:
        """Switch to the next theme."""
        self.theme = theme_after(self.theme)
        self._table.sync()
        self._inform(_("theme {name}", name=self.theme))

    def action_language(self) -> None:
        """Switch to the next language."""
        words = list(LANGUAGES)
        self.language = words[(words.index(self.language) + 1) % len(words)]
        switch_language(self.language)
        for node in (self, *self.query(RowTable), *self.query(PromptLine)):
            translate_keys(node)
        for field in self.query(PromptField):
            field.translate()
        self._panes.forget_texts()
        self._table.refresh()
        self._inform(_("the language is English"))

    def action_pane(self, name: str) -> None:
        """Show or close a pane; one that explains a row stops following the end."""
        self._panes.toggle(name)
        if self._panes.explains_row:
            self._table.stop_following()

    @on(TopView.AboutRow)
    def _on_row_pane(self, event: TopView.AboutRow) -> None:
        self.action_top()
        self.action_pane(event.pane)

    def action_grow_pane(self, by: int) -> None:
        """Move the divider between the table and the pane."""
        self._body.grow(by)

    def action_pane_side(self) -> None:
        """Move the panes beside the table, or below it."""
        if not self._body.can_be_beside:
            text = _("a pane is beside the table from {cells} columns on")
            self._inform(text.format(cells=BESIDE_CELLS))
            return
        layout = self._body.pane_layout
        self._body.set_pane_layout(replace(layout, beside=not layout.beside))

    def action_zoom(self, by: int) -> None:
        """Show more time, or less."""
        self._panes.zoom(by)

    def action_plot_range(self) -> None:
        """Show outliers in the plots, or leave them out."""
        self._panes.switch_range()

    def action_scroll_pane(self, by: int) -> None:
        """Scroll the pane by lines."""
        self._panes.scroll(by)

    def action_field(self, by: int) -> None:
        """Look at the next field of the cursor's row, or at the previous one."""
        row = self._table.cursor_row
        if row is None:
            return
        if not self._panes.explains_row:
            self.action_pane("detail")
        current, count = self._table.field, len(dissect(row))
        start = (-1 if by > 0 else count) if current is None else current
        self._table.look_at((start + by) % count)

    @on(Pane.Pointed)
    def _on_pointed(self, event: Pane.Pointed) -> None:
        self._table.look_at(event.field)

    @on(RowTable.Opened)
    def _on_double_click(self) -> None:
        if not self._panes.explains_row:
            self.action_pane("detail")

    def action_help(self) -> None:
        """Show the help page."""
        self.push_screen(HelpPage(self._table.palette))

    def action_palette(self) -> None:
        """Pick a command from a list."""
        entries = [
            Entry(
                _(key.tooltip),
                key.action,
                key_names(key),
                f"{SEARCH_WORDS.get(key.action, '')} {key.key_display} {key.tooltip}",
            )
            for key in COMMANDS
        ]
        self.push_screen(Picker(_("commands"), entries), self._run_command)

    async def _run_command(self, action: str | None) -> None:
        if action is not None and not await self.run_action(action, self):
            await self.run_action(action, self._table)


class NavigationActions(ScreenActions):
    """Go to a row, a fault or a mark; select rows."""

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
        self._inform(text.format(time=printable(line.strip()), end=clock_text(end, 3, zone)))

    def action_fault(self, by: int) -> None:
        """Go to the next fault, or to the previous one."""
        store, start = self._model.store, self._table.last_index
        if self._table.jump_to_index(find_fault(store, start, by)):
            return
        text = _("no row with a fault below this one")
        if by < 0:
            text = _("no row with a fault above this one")
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
        """Go to a row by its index, or inform why not."""
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
            if self._table.marks.text(index):
                self._inform(_("the row has a note; # changes it, an empty one removes it"))
            elif row is not None:
                self._keep_note(index, row, "" if index not in self._table.marks else None)

    def action_note(self) -> None:
        """Ask for a note on the row under the cursor."""
        self._table.stop_following()
        self._noted_row = self._table.cursor_row
        self._noted_index = self._table.last_index
        if self._noted_row is not None:
            self._note_field.open_with(self._table.marks.text(self._noted_index))

    def _write_note(self, text: str) -> None:
        if self._noted_row is not None:
            self._keep_note(self._noted_index, self._noted_row, text or None)

    def _keep_note(self, index: int, row: Row, text: str | None) -> None:
        """Mark a row with a text, or remove its mark (None), and write that to the file."""
        note = Note.on(row, text or "")
        if text is None:
            self._table.marks.remove(index)
        else:
            self._table.marks.set(index, note.text)
        self._table.sync()
        if self._notes is not None:
            if text is None:
                self._notes.remove(note, self._capture_at(index))
            else:
                self._notes.set(note, self._capture_at(index))
            self._start_worker("notes", self._save_notes)

    def _capture_at(self, index: int) -> int:
        """The number of a row's capture among those of the view."""
        return 0 if self._notes is None else self._notes.origins.at(index)

    async def _save_notes(self) -> None:
        """Write the notes in a thread, since a disk may be slow."""
        if self._notes is not None and (trouble := await asyncio.to_thread(self._notes.save)):
            self._notice.warn(printable(_(trouble)))

    def action_notes(self) -> None:
        """Pick a marked row and go to it."""
        store, marks, entries = self._model.store, self._table.marks, []
        for index in sorted(marks):
            if store.first <= index < store.next:
                row = store.row(index)
                time = "" if row.t_ns is None else clock_text(row.t_ns, 3, self._table.view.zone)
                text = printable(marks.text(index)) or _("mark")
                entries.append(Entry(f"{time}  {text}", str(index), f"{row.offset:,}"))
        if entries:
            self.push_screen(Picker(_("marks and notes"), entries), self._go_to_note)
        else:
            self._inform(_("no row is marked; m marks one"))

    def _go_to_note(self, index: str | None) -> None:
        if index is not None and not self._table.jump_to_index(int(index)):
            self._inform(_("the filter hides this row; F shows all rows"))

    def _find_noted(self, rows: Sequence[Row], first: int) -> None:
        """Mark those of the new rows that have a note, and find the row where the view was left."""
        wanted = set(self._missing)
        if self._left_at is not None:
            wanted.add(self._left_at)
        if not (wanted and len(rows)):
            return
        for number, key in located(RowBatch.from_rows(rows), wanted):
            if self._capture_at(first + number) != key.capture:
                continue
            note = self._missing.pop(key, None)
            if note is not None:
                self._table.marks.set(first + number, note.text)
            if key == self._left_at:
                self._left_at = None
                self._table.sync()
                self._table.jump_to_index(first + number)

    def _show_note(self) -> None:
        """Show the note on the row under the cursor."""
        index = self._table.cursor_index
        text = "" if index is None else self._table.marks.text(index)
        if text:
            self._notice.pin("note", _("note: {text}", text=printable(text)), warning=False)
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


SEARCH_GROUP = "search"
"""Group of the search's workers, and topic of its notice."""

SEARCH_BLOCK_S = 0.05
"""How long a search may block the screen before it continues in a worker."""


@dataclass(frozen=True, slots=True)
class SearchProgress:
    """How far a search has come."""

    found: int | None
    """Index of the hit."""
    seen: int
    """Rows that were searched."""
    wrapped: bool
    """Whether the search went on from the other end."""


class FindActions(ScreenActions):
    """Filters, typed or made from a cell, and the search for a text or bytes."""

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

    @on(TopView.Chosen)
    def _on_line_chosen(self, event: TopView.Chosen) -> None:
        self._add_condition(event.condition)
        self.action_top()

    def _ask_filter_name(self, _line: str) -> None:
        self._name_field.open()

    def _name_filter(self, name: str) -> None:
        """Save the filter in effect by name."""
        if name:
            self._saved_filters[name] = self._filter_field.current
            self._inform(_("saved; f lists the filter as {name}", name=printable(name)))

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
            self._table.stop_following()
            self._find(self._table.search, self._table.last_index, by)

    def _find(self, search: Search, start: int, by: int) -> None:
        self.workers.cancel_group(self, SEARCH_GROUP)
        steps = self._search_steps(search, start, by)
        until = monotonic() + SEARCH_BLOCK_S
        while monotonic() < until:
            if self._next_step(search, steps) is None:
                return
        self._start_worker(SEARCH_GROUP, partial(self._continue_search, search, steps))

    async def _continue_search(self, search: Search, steps: Iterator[SearchProgress]) -> None:
        while (progress := self._next_step(search, steps)) is not None:
            share = progress.seen / max(1, len(self._model.store))
            text = _("looking for {text}: {share:.0%} seen, esc ends it")
            text = text.format(text=printable(search.typed), share=min(share, 1.0))
            self._notice.pin(SEARCH_GROUP, text, warning=False)
            await asyncio.sleep(0)

    def _next_step(self, search: Search, steps: Iterator[SearchProgress]) -> SearchProgress | None:
        """Search some rows; None at the end, which has then been reported."""
        try:
            progress = next(steps, None)
        except FteSniffError as error:
            self._notice.unpin(SEARCH_GROUP)
            self._notice.warn(error_text(error))
            return None
        if progress is not None and progress.found is None:
            return progress
        self._notice.unpin(SEARCH_GROUP)
        if progress is None:
            self._report_no_hit(search)
        else:
            self._show_hit(progress)
        return None

    def _search_steps(self, search: Search, start: int, by: int) -> Iterator[SearchProgress]:
        """Search to the end of the rows, then from the other end to the start."""
        store = self._model.store
        rows_at_start = len(store)
        mask = partial(search.matches, columns={column.name for column in self._table.columns})
        index: int | None = start
        for wrapped in (False, True):
            if wrapped:
                index = store.first if by > 0 else store.next - 1
            while index is not None:
                step = find_step(store, mask, index, by)
                reached = step.found if step.found is not None else index
                if wrapped and (reached - start) * by >= 0:
                    return
                distance = abs(index - start)
                seen = rows_at_start - distance if wrapped else distance
                yield SearchProgress(step.found, seen, wrapped)
                index = step.next_index

    def _show_hit(self, progress: SearchProgress) -> None:
        if not self._table.jump_to_index(progress.found):
            self._inform(_("the next match arrived after the pause; space continues"))
        elif progress.wrapped:
            self._inform(_("the search continued from the other end"))

    def _report_no_hit(self, search: Search) -> None:
        if self._model.store.view.pending:
            text = _("no row has {text} so far; the filter is still running")
        elif self._model.store.view.filter is None:
            text = _("no row has {text}")
        else:
            text = _("no row that the filter shows has {text}")
        self._inform(text.format(text=printable(search.typed)))

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
