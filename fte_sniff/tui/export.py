"""Copy rows to the clipboard; save rows and pictures of the screen to files."""

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
from textual.worker import WorkType

from fte_sniff.analysis.search import select_rows
from fte_sniff.errors import FileError, FteSniffError, TranslatableText, reason_of
from fte_sniff.formats.writers import FORMAT_BY_SUFFIX, OutputFormat, row_writer
from fte_sniff.protocol import Row, spaced_hex
from fte_sniff.recording.metadata import Selection
from fte_sniff.session.save import (
    DEFAULT_NAME,
    ExportSource,
    SaveJob,
    SaveTarget,
    free_path,
    replace_text,
)
from fte_sniff.tui.cells import WITH_DETAIL
from fte_sniff.tui.i18n import _, error_text, later
from fte_sniff.tui.prompt import Parts, Prompt, PromptField

if TYPE_CHECKING:
    from fte_sniff.analysis.filter.row_filter import RowFilter


COPY_NAME: Final = "copied.txt"
"""File in the user's cache folder that holds the latest copy."""

PICTURE_NAME: Final = "fte-sniff-screen.svg"

MAX_COPIED_ROWS = 10_000
"""A terminal accepts about a megabyte."""

GROUP = "save"
"""The worker that saves, and its notice."""

_GAPS = re.compile(" {2,}")


def write_copy(text: str) -> Path | None:
    """Write the text to `COPY_NAME`, readable by the user only; None where that fails."""
    path = user_cache_path("fte-sniff", appauthor=False) / COPY_NAME
    try:
        replace_text(path, text)
    except (OSError, FileError):
        return None
    return path


def _short_path(path: Path) -> str:
    """The path with `~` for the home folder."""
    with suppress(ValueError, RuntimeError):
        return f"~/{path.relative_to(Path.home())}"
    return str(path)


class ExportField(PromptField):
    """Copies and saves rows, one file at a time, and pictures of the screen."""

    PROMPT = Prompt(
        later("save to"),
        DEFAULT_NAME,
        TranslatableText(
            "enter saves, esc goes back; the extension selects the format: {forms}",
            forms=" ".join(FORMAT_BY_SUFFIX),
        ),
    )

    def __init__(self, parts: Parts) -> None:
        super().__init__(parts)
        self.job: SaveJob | None = None
        """The rows that are being saved."""

    def action_copy_text(self) -> None:
        """Copy the selected rows, or the cursor's, in the table format of `decode`."""
        rows = self._rows_to_copy()
        if rows is not None:
            stream = StringIO()
            zone = self._table.view.shown_zone
            ports = len(self._model.ports) > 1
            row_writer(OutputFormat.TABLE, stream, ports=ports, zone=zone).write(rows)
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
            self._notice.inform(text.format(count=len(positions), most=MAX_COPIED_ROWS))
            return None
        rows = self._store.view.slice(positions.start, positions.stop)
        return [row for _, row in rows]

    def _copy(self, text: str, rows: int) -> None:
        text = text.rstrip("\n").encode("utf-8", "backslashreplace").decode()
        self.app.copy_to_clipboard(text)
        file = write_copy(text)
        first = text.partition("\n")[0] if rows == 1 else _("{count:,} rows", count=rows)
        form = _("copied {what}") if file is None else _("copied {what}  (also in {file})")
        self._notice.inform(form.format(what=first, file=_short_path(file) if file else ""))

    def action_ask(self) -> None:
        """Ask for the file to which the selected rows, or all shown rows, are saved."""
        if self.job is not None:
            text = _("{file} is still being saved; esc ends that")
            self._notice.inform(text.format(file=self.job.path))
        elif not self._store.view.count:
            self._notice.inform(_("no row is shown that could be saved"))
        else:
            self._report_row_count()
            self.default = str(free_path(DEFAULT_NAME))
            self.open()

    def _report_row_count(self) -> None:
        selected = self._selected_positions()
        count, text = self._store.view.count, _("{count:,} shown rows would be saved")
        if selected:
            count, text = len(selected), _("{count:,} selected rows would be saved")
        self._notice.inform(text.format(count=count))

    def _selected_positions(self) -> range:
        """Positions of the selected rows among those shown."""
        selected, position_of = self._table.selected, self._store.view.position_of
        return range(position_of(selected.start), position_of(selected.stop))

    def parse(self, line: str) -> SaveTarget:
        """Parse the path and format of a file; raises FteSniffError."""
        return SaveTarget.parse(line, self._model.state.files)

    def accept(self, line: str) -> None:
        """Save the rows to a file."""
        if not line:
            return
        store, selected = self._store, self._table.selected
        indices = selected or range(store.first, store.next)
        try:
            job = self.job = SaveJob(self.parse(line), self._export_source(selected))
        except FteSniffError as error:
            self._notice.warn(error_text(error))
            return
        self._show_progress(job, 0)
        work: WorkType[None] = partial(self._write, job, indices, store.view.filter)
        self.run_worker(work, group=GROUP, exclusive=True)

    def _export_source(self, selected: range) -> ExportSource:
        """Facts about the rows that are saved: those shown, or the selected ones among them."""
        store = self._store
        zone = self._table.view.shown_zone
        source = replace(self._options.export_source, ports=self._model.ports, zone=zone)
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
        store, index = self._store, indices.start
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
            text = _("saved {count:,} rows to {file}", count=job.rows, file=job.path)
            self._notice.report(text)
            self._table.end_selection()

    def action_picture(self) -> None:
        """Save the screen as it is now to a new file in the working folder."""
        path = free_path(PICTURE_NAME)
        try:
            with path.open("x", encoding="utf-8") as file:
                file.write(self.app.export_screenshot())
        except OSError as error:
            failed = _("{file} was not saved", file=path)
            self._notice.warn(_(WITH_DETAIL, event=failed, detail=_(reason_of(error))))
        else:
            self._notice.inform(_("saved the screen to {file}", file=path))

    def _show_progress(self, job: SaveJob, share: float) -> None:
        text = _("saving to {file}: {share:.0%}, esc ends it")
        text = text.format(file=job.path, share=share)
        self._notice.pin(GROUP, text, warning=False)

    def _forget_job(self) -> None:
        self.job = None
        self._notice.unpin(GROUP)

    def abandon(self) -> bool:
        """Cancel a running save and remove its file; returns whether there was one."""
        job = self.job
        if job is None:
            return False
        self._forget_job()
        self.workers.cancel_group(self, GROUP)
        # A worker that has not started yet does not notice that it is cancelled.
        job.abandon()
        self._notice.inform(_("{file} was not saved", file=job.path))
        return True
