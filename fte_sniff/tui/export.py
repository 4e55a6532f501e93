"""Copy rows to the clipboard; save rows and pictures of the screen to files."""

from __future__ import annotations

import asyncio
import os
import re
from collections.abc import Iterator
from dataclasses import replace
from io import StringIO
from pathlib import Path
from typing import Final

from platformdirs import user_cache_path

from fte_sniff.errors import FileError, FteSniffError, reason_of
from fte_sniff.formats.text_table import TableWriter
from fte_sniff.i18n import _, error_text, later
from fte_sniff.protocol.columns import spaced_hex
from fte_sniff.protocol.rows import Item, Rows
from fte_sniff.recording.metadata import Selection
from fte_sniff.recording.output_file import Existing
from fte_sniff.session.save import (
    DEFAULT_NAME,
    ExportSource,
    exported,
    format_of,
    free_path,
    replace_text,
    typed_path,
)
from fte_sniff.tui.cells import WITH_DETAIL
from fte_sniff.tui.line import Question
from fte_sniff.tui.parts import Parts

COPY_NAME: Final = "copied.txt"
"""File in the user's cache folder that holds the latest copy."""

PICTURE_NAME: Final = "fte-sniff-screen.svg"

MAX_COPIED_ROWS: Final = 10_000
"""A terminal accepts about a megabyte."""

SAVED_ROWS: Final = 4_096
"""Rows that are saved at once, in a few hundredths of a second."""

_GAPS: Final = re.compile(" {2,}")


def write_copy(text: str) -> Path | None:
    """Write the text to `COPY_NAME`, readable by the user only; None where that fails."""
    path = user_cache_path("fte-sniff", appauthor=False) / COPY_NAME
    try:
        replace_text(path, text)
    except (OSError, FileError):
        return None
    return path


class Export:
    """Copies and saves rows, one file at a time, and pictures of the screen."""

    def __init__(self, parts: Parts) -> None:
        self._parts, self._view, self._table = parts, parts.view, parts.table
        self._status = parts.status
        self._path: Path | None = None
        """The file to which rows are being saved."""
        self._task: asyncio.Task[None] | None = None

    @property
    def _indices(self) -> range:
        """The rows to save or copy, as far as they are shown."""
        return self._table.selected or range(self._view.store.next)

    def copy_text(self) -> None:
        """Copy the selected rows, or the cursor's, in the table format of `decode`."""
        rows = self._rows_to_copy()
        if rows is not None:
            stream, zone = StringIO(), self._table.look.shown_zone
            several = len(self._view.store.ports) > 1
            TableWriter(stream, ports=several, zone=zone)(rows)
            text = stream.getvalue()
            if len(rows) == 1:
                # A single row needs neither columns nor their names.
                text = _GAPS.sub("  ", text.splitlines()[-1])
            self._copy(text, len(rows))

    def copy_hex(self) -> None:
        """Copy the bytes of the selected rows, or of the cursor's, as hex."""
        rows = self._rows_to_copy()
        if rows is not None:
            self._copy("\n".join(spaced_hex(row.raw) for row in rows), len(rows))

    def _rows_to_copy(self) -> Rows | None:
        """The rows to copy; None where there are none, or too many."""
        index, selected = self._table.cursor_index, self._table.selected
        if index is None:
            return None
        own = selected or range(index, index + 1)
        indices = self._view.shown.between(own.start, own.stop)
        if len(indices) > MAX_COPIED_ROWS:
            text = _("{count:,} rows are too many to copy (at most {most:,}); w saves them")
            self._status.inform(text.format(count=len(indices), most=MAX_COPIED_ROWS))
            return None
        return self._view.store.rows_at(indices)

    def _copy(self, text: str, rows: int) -> None:
        text = text.rstrip("\n").encode("utf-8", "backslashreplace").decode()
        self._table.app.copy_to_clipboard(text)
        file = write_copy(text)
        first = text.partition("\n")[0] if rows == 1 else _("{count:,} rows", count=rows)
        form = _("copied {what}") if file is None else _("copied to {file}: {what}")
        if file is not None and os.environ.get("TMUX"):
            form = _("copied to {file}; tmux passes it on with `set -g set-clipboard on`: {what}")
        self._status.inform(form.format(what=first, file=file))

    def ask(self) -> None:
        """Ask for the file to which the selected rows, or all shown rows, are saved."""
        if self._path is not None:
            text = _("{file} is still being saved; esc ends that")
            self._status.inform(text.format(file=self._path))
            return
        own = self._indices
        count = len(self._view.shown.between(own.start, own.stop))
        self._status.inform(_("{count:,} rows would be saved", count=count))
        name = str(free_path(DEFAULT_NAME))
        self._parts.line.ask(Question(later("save to"), name, self.parse, self.accept), name)

    def parse(self, line: str) -> tuple[Path, Existing]:
        """Parse the path and format of a file; raises FteSniffError."""
        return typed_path(line, self._view.state.files)

    def accept(self, line: str) -> None:
        """Save the rows to a file."""
        self._status.inform("")
        if not line:
            return
        try:
            self._path, existing = self.parse(line)
        except FteSniffError as error:
            self._status.warn(error_text(error))
            return
        self._task = asyncio.create_task(self._save(self._path, existing))

    def _source(self) -> ExportSource:
        """Facts about the rows that are saved: those shown, or the selected ones among them."""
        view, own = self._view, self._parts.options.export_source
        source = replace(own, ports=view.store.ports, zone=self._table.look.shown_zone)
        if view.filter is not None:
            selection = Selection(view.filter.text, len(self._indices))
            source = replace(source, selections=[*source.selections, selection])
        return source

    async def _save(self, path: Path, existing: Existing) -> None:
        """Save the rows while the screen continues."""
        indices, rows = self._indices, 0
        try:
            with exported(path, format_of(path), self._source(), existing) as write:
                for index, item in self._items(indices):
                    self._show_progress(path, (index - indices.start) / len(indices))
                    await asyncio.sleep(0)
                    write(item)
                    rows += len(item) if isinstance(item, Rows) else 0
        except FteSniffError as error:
            self._forget_job()
            self._status.warn(error_text(error))
        else:
            self._forget_job()
            self._status.inform(_("saved {count:,} rows to {file}", count=rows, file=path))
            self._table.selection_start = None
            self._table.draw()

    def _items(self, indices: range) -> Iterator[tuple[int, Item]]:
        """The shown rows of these indices and what is between them, each with an index."""
        view, at = self._view, indices.start
        marks = [one for one in view.store.marks if indices.start < one.index < indices.stop]
        for stop in (*(one.index for one in marks), indices.stop):
            while at < stop:
                end = min(at + SAVED_ROWS, stop)
                yield at, view.store.rows_at(view.shown.between(at, end))
                at = end
            if marks:
                yield at, marks.pop(0).what

    def picture(self) -> None:
        """Save the screen as it is now to a new file in the working folder."""
        path = free_path(PICTURE_NAME)
        try:
            self._table.app.save_screenshot(f"{path}")
        except OSError as error:
            failed = _("{file} was not saved", file=path)
            self._status.warn(_(WITH_DETAIL, event=failed, detail=_(reason_of(error))))
        else:
            self._status.inform(_("saved the screen to {file}", file=path))

    def _show_progress(self, path: Path, share: float) -> None:
        text = _("saving to {file}: {share:.0%}, esc ends it")
        self._status.pin("save", text.format(file=path, share=share))

    def _forget_job(self) -> None:
        self._path = None
        self._status.forget("save")

    def abandon(self) -> bool:
        """Cancel a running save and remove its file; returns whether there was one."""
        path = self._path
        if path is None or self._task is None:
            return False
        self._task.cancel()
        self._forget_job()
        self._status.inform(_("{file} was not saved", file=path))
        return True
