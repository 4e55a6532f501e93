"""Copy and save actions: rows to the clipboard and to files, and pictures of the screen."""

from __future__ import annotations

import asyncio
import re
from contextlib import suppress
from dataclasses import replace
from functools import partial
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING, Final

from platformdirs import user_cache_path
from rich.console import Console
from rich.terminal_theme import SVG_EXPORT_THEME
from textual.widgets import Input

from fte_sniff.analysis.search import select_rows
from fte_sniff.errors import FteSniffError, printable, unwritable
from fte_sniff.formats.writers import OutputFormat, row_writer
from fte_sniff.protocol import Row, spaced_hex
from fte_sniff.recording.metadata import Selection
from fte_sniff.session.save import (
    PICTURE_SUFFIXES,
    ExportSource,
    SaveJob,
    SaveTarget,
    replace_text,
)
from fte_sniff.tui.actions import ScreenActions
from fte_sniff.tui.i18n import _, error_text

if TYPE_CHECKING:
    from fte_sniff.analysis.filter.row_filter import RowFilter


COPY_NAME: Final = "copied.txt"
"""File in the user's cache folder that holds the latest copy."""

MAX_COPIED_ROWS = 10_000
"""A terminal accepts about a megabyte."""

SAVE_GROUP = "save"
"""Group of the save's worker, and topic of its notice."""

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
        self._inform(
            form.format(what=printable(first), file=printable(_short_path(file)) if file else "")
        )

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
            self._inform(text.format(file=printable(str(self._save_job.path))))
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
        await self._wait_until_drawn()
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
            self._notice.report(text.format(count=job.rows, file=printable(str(job.path))))
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
            self._inform(_("saved the screen to {file}", file=printable(str(path))))

    def _show_progress(self, job: SaveJob, share: float) -> None:
        text = _("saving to {file}: {share:.0%}, esc ends it")
        text = text.format(file=printable(str(job.path)), share=share)
        self._notice.pin(SAVE_GROUP, text, warning=False)

    async def _wait_until_drawn(self) -> None:
        """Wait until the notice is on the screen, since the first rows may take long."""
        drawn = asyncio.Event()
        self.call_after_refresh(drawn.set)
        await drawn.wait()

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
        self._inform(_("{file} was not saved", file=printable(str(job.path))))
        return True
