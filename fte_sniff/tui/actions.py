"""Actions on the view and on rows: pause, times, columns, panes, copy and save."""

from __future__ import annotations

import asyncio
import re
from contextlib import suppress
from dataclasses import replace
from datetime import UTC
from functools import partial
from io import StringIO
from pathlib import Path
from time import monotonic_ns
from typing import TYPE_CHECKING, Final

from platformdirs import user_cache_path
from rich.console import Console
from rich.terminal_theme import SVG_EXPORT_THEME
from textual import on
from textual.app import App
from textual.containers import Vertical
from textual.widgets import Input
from textual.worker import WorkType

from fte_sniff.analysis.feed import Feed
from fte_sniff.analysis.row_store import BlockSource
from fte_sniff.analysis.search import select_rows
from fte_sniff.errors import FteSniffError, unwritable
from fte_sniff.formats.writers import FORMAT_BY_SUFFIX, OutputFormat, row_writer
from fte_sniff.protocol import Row, spaced_hex
from fte_sniff.protocol.dissect import dissect
from fte_sniff.recording.metadata import Selection
from fte_sniff.session.save import PICTURE_SUFFIXES, ExportSource, SaveJob, SaveTarget, replace_text
from fte_sniff.tui.focus import Focus
from fte_sniff.tui.i18n import LANGUAGES, _, error_text, set_language, switch_language, theme_after
from fte_sniff.tui.keys import COMMANDS, SEARCH_WORDS, key_names, translate_keys
from fte_sniff.tui.modals import ChosenColumns, ColumnChooser, Entry, HelpPage, Picker
from fte_sniff.tui.options import StartOptions
from fte_sniff.tui.panes.pane import BESIDE_CELLS, Body, Pane
from fte_sniff.tui.panes.switcher import PaneSwitcher
from fte_sniff.tui.prompt import PICTURE_FILE, ROWS_FILE, PromptField, SaveField
from fte_sniff.tui.status_bar import NoticeLine
from fte_sniff.tui.table.columns import TimeStyle
from fte_sniff.tui.table.widget import RowTable, TableHeader
from fte_sniff.tui.view_model import ViewModel

if TYPE_CHECKING:
    from fte_sniff.analysis.filter.row_filter import RowFilter


class ScreenActions(App[None]):
    """Base of the actions: the widgets and the state that they work on."""

    def __init__(self, feed: Feed, options: StartOptions, source: BlockSource | None) -> None:
        """Build the widgets; with a `source`, which reads rows again, not all stay in memory."""
        super().__init__()
        set_language(options.language)
        self.language = options.language
        translate_keys(self)
        self._options = options
        self._model = ViewModel(feed, options.row_filter, options.store(source), options.alert)
        store = self._model.store
        self._header = TableHeader()
        self._table = RowTable(store, self._header, options.choices.view)
        captures = 1 if options.notes is None else options.notes.origins.captures
        self._panes = PaneSwitcher(store, self._table, options.line_setup, captures)
        self._focus = Focus(self, self._table, self._header, self._panes.top)
        main = Vertical(self._header, self._table, self._panes.top, id="main")
        self._body = Body(main, self._panes, options.choices.panes)
        self._notice = NoticeLine()

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
        self._focus.show_top(not self._panes.top.display)
        if self._panes.top.display and self._panes.explains_row:
            self._panes.close()
        self.call_after_refresh(self._panes.redraw)


class ViewActions(ScreenActions):
    """Pause, times, columns, theme, language, panes, help and the list of commands."""

    _speed = 1.0
    """Speed of the next playback."""

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
        self._panes.restart(*model.play(index, speed, monotonic_ns()))
        self._table.action_follow()
        self._inform(_("playing; < and > change the speed, space pauses, esc shows the whole file"))

    def _stop_playback(self) -> None:
        if self._model.playback is None:
            return
        self._speed = self._model.playback.speed
        self._table.stop_following()
        events = self._model.stop_playback()
        self._panes.observe(events)
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
        for node in (self, self._table, self._panes.top):
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
        self._panes.change(lambda pane: pane.zoom(by))

    def action_plot_range(self) -> None:
        """Show outliers in the plots, or leave them out."""
        self._panes.change(lambda pane: pane.switch_range())

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


COPY_NAME: Final = "copied.txt"
"""File in the user's cache folder that holds the latest copy."""

MAX_COPIED_ROWS = 10_000
"""A terminal accepts about a megabyte."""

SAVE_GROUP = "save"

_GAPS = re.compile(" {2,}")


def write_copy(text: str) -> Path | None:
    """Write the text to `COPY_NAME`, readable by the user only; None where that fails."""
    path = user_cache_path("fte-sniff", appauthor=False) / COPY_NAME
    try:
        replace_text(path, text)
    except OSError:
        return None
    return path


def _short_path(path: Path) -> str:
    """The path with `~` for the home folder."""
    with suppress(ValueError, RuntimeError):
        return f"~/{path.relative_to(Path.home())}"
    return str(path)


class ExportActions(ScreenActions):
    """Copy rows and typed text to the clipboard; save rows and pictures to files."""

    def __init__(self, feed: Feed, options: StartOptions, source: BlockSource | None) -> None:
        super().__init__(feed, options, source)
        self._save_job: SaveJob | None = None
        self._save_field = SaveField(
            self._focus, ROWS_FILE, FORMAT_BY_SUFFIX, self._target, self._save
        )
        self._picture_field = SaveField(
            self._focus, PICTURE_FILE, PICTURE_SUFFIXES, self._picture_target, self._save_picture
        )

    def action_copy_text(self) -> None:
        """Copy the selected rows, or the cursor's, in the table format of `decode`."""
        rows = self._rows_to_copy()
        if rows is not None:
            stream = StringIO()
            row_writer(OutputFormat.TABLE, stream, ports=len(self._model.ports) > 1).write(rows)
            text = stream.getvalue()
            if len(rows) == 1:
                # A single row needs neither columns nor their names.
                text = _GAPS.sub("  ", text.splitlines()[-1])
            self._copy(text, len(rows))

    def action_copy(self) -> None:
        """Copy the bytes of the selected rows, or of the cursor's, as hex."""
        rows = self._rows_to_copy()
        if rows is not None:
            self._copy("\n".join(spaced_hex(row.raw) for row in rows), len(rows))

    def _rows_to_copy(self) -> list[Row] | None:
        """The rows to copy; None where there are none, or too many."""
        positions, row = self._selected_positions(), self._table.cursor_row
        if not self._table.selected:
            return None if row is None else [row]
        if len(positions) > MAX_COPIED_ROWS:
            text = _("{count:,} rows are too many to copy (at most {most:,}); w saves them")
            self._inform(text.format(count=len(positions), most=MAX_COPIED_ROWS))
            return None
        rows = self._model.store.view.slice(positions.start, positions.stop)
        return [row for _, row in rows]

    def _copy(self, text: str, rows: int) -> None:
        text = text.rstrip("\n").encode("utf-8", "backslashreplace").decode()
        self.copy_to_clipboard(text)
        file = write_copy(text)
        first = text.partition("\n")[0] if rows == 1 else _("{count:,} rows", count=rows)
        form = _("copied {what}") if file is None else _("copied {what}  (also in {file})")
        self._inform(form.format(what=first, file=_short_path(file) if file else ""))

    def action_interrupt(self) -> None:
        """Copy the selected text of a field; without one, quit."""
        field = self.focused
        if isinstance(field, Input) and field.selected_text:
            self.copy_to_clipboard(field.selected_text)
        else:
            self.exit()

    def action_save(self) -> None:
        """Ask for the file to which the selected rows, or all shown rows, are saved."""
        if self._save_job is not None:
            text = _("{file} is still being saved; esc ends that")
            self._inform(text.format(file=self._save_job.path))
        elif not self._model.store.view.count:
            self._inform(_("no row is shown that could be saved"))
        else:
            self._report_row_count()
            self._save_field.open()

    def _report_row_count(self) -> None:
        selected = self._selected_positions()
        count, text = self._model.store.view.count, _("{count:,} shown rows would be saved")
        if selected:
            count, text = len(selected), _("{count:,} selected rows would be saved")
        self._inform(text.format(count=count))

    def _selected_positions(self) -> range:
        """Positions of the selected rows among those shown."""
        selected, position_of = self._table.selected, self._model.store.view.position_of
        return range(position_of(selected.start), position_of(selected.stop))

    def _target(self, line: str) -> SaveTarget:
        return SaveTarget.parse(line, self._model.state.files)

    def _save(self, line: str) -> None:
        if not line:
            return
        store, selected = self._model.store, self._table.selected
        indices = selected or range(store.first, store.next)
        try:
            job = self._save_job = SaveJob(self._target(line), self._export_source(selected))
        except FteSniffError as error:
            self._notice.warn(error_text(error))
            return
        self._show_progress(job, 0)
        self._start_worker(SAVE_GROUP, partial(self._write, job, indices, store.view.filter))

    def _export_source(self, selected: range) -> ExportSource:
        """Facts about the rows that are saved: those shown, or the selected ones among them."""
        store = self._model.store
        source = replace(self._options.export_source, ports=self._model.ports)
        if selected:
            first, last = store.row(selected.start), store.row(selected.stop - 1)
            source = source.within(first.t_ns, last.t_ns)
        if store.view.filter is not None:
            rows = len(selected or range(store.first, store.next))
            selection = Selection(store.view.filter.text, rows)
            source = replace(source, selections=[*source.selections, selection])
        return source

    async def _write(self, job: SaveJob, indices: range, row_filter: RowFilter | None) -> None:
        """Save the rows of these indices that pass the filter, while the screen continues."""
        store, index = self._model.store, indices.start
        # The first rows may take long, so the notice comes before them.
        await self.screen.wait_for_refresh()
        try:
            while index < indices.stop:
                if index < store.first:
                    index = min(store.first, indices.stop)
                rows, index = select_rows(store, index, indices.stop, row_filter)
                job.write(rows)
                self._show_progress(job, (index - indices.start) / len(indices))
                await asyncio.sleep(0)
            job.close()
        except FteSniffError as error:
            self._forget_job()
            self._notice.warn(error_text(error))
        else:
            self._forget_job()
            text = _("saved {count:,} rows to {file}")
            self._notice.report(text.format(count=job.rows, file=job.path))
            self._end_selection()

    def action_picture(self) -> None:
        """Keep the screen as it is now, and ask for the file to which it is saved."""
        self._picture = self._record_screen()
        self._picture_field.open()

    def _record_screen(self) -> Console:
        """The screen, as a console that can export it."""
        width, height = self.size
        console = Console(
            width=width,
            height=height,
            file=StringIO(),
            force_terminal=True,
            color_system="truecolor",
            record=True,
            safe_box=False,
        )
        console.print(self.screen._compositor.render_update(full=True))
        return console

    def _picture_target(self, line: str) -> SaveTarget:
        return SaveTarget.parse(line, self._model.state.files, PICTURE_SUFFIXES)

    def _save_picture(self, line: str) -> None:
        if not line:
            return
        path = self._picture_target(line).path
        if path.suffix.lower() == ".svg":
            text = self._picture.export_svg(title=self.title)
        else:
            text = self._picture.export_html(theme=SVG_EXPORT_THEME)
        try:
            path.write_text(text, "utf-8")
        except OSError as error:
            self._notice.warn(error_text(unwritable(path, error)))
        else:
            self._inform(_("saved the screen to {file}", file=path))

    def _show_progress(self, job: SaveJob, share: float) -> None:
        text = _("saving to {file}: {share:.0%}, esc ends it")
        text = text.format(file=job.path, share=share)
        self._notice.pin(SAVE_GROUP, text, warning=False)

    def _forget_job(self) -> None:
        self._save_job = None
        self._notice.unpin(SAVE_GROUP)

    def _abandon_save(self) -> bool:
        """Cancel a running save and remove its file; returns whether there was one."""
        job = self._save_job
        if job is None:
            return False
        self._forget_job()
        self.workers.cancel_group(self, SAVE_GROUP)
        # A worker that has not started yet does not notice that it is cancelled.
        job.abandon()
        self._inform(_("{file} was not saved", file=job.path))
        return True
