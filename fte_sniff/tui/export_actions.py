"""Save and copy."""

from __future__ import annotations

import asyncio
import os
import re
from contextlib import suppress
from dataclasses import replace
from functools import partial
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING, Final

from platformdirs import user_cache_path
from textual.widgets import Input

from fte_sniff.analysis.search import select_rows
from fte_sniff.errors import FteSniffError, printable
from fte_sniff.formats.writers import OutputFormat, row_writer
from fte_sniff.protocol import Row, spaced_hex
from fte_sniff.recording.metadata import Selection
from fte_sniff.session.save import ExportSource, SaveJob, SaveTarget
from fte_sniff.tui.actions import Parts
from fte_sniff.tui.i18n import _, worded

if TYPE_CHECKING:
    from fte_sniff.analysis.filter.row_filter import RowFilter


NAME: Final = "copied.txt"
"""The file's name; each copy replaces the one before."""


def keep_copy(text: str) -> Path | None:
    """Keep the text in the user's cache folder, for the user alone; None where it cannot be."""
    path = user_cache_path("fte-sniff", appauthor=False) / NAME
    part = path.with_name(f"{NAME}.{os.getpid()}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with os.fdopen(os.open(part, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600), "w") as file:
            file.write(text)
        part.replace(path)
    except (OSError, UnicodeError):
        with suppress(OSError):
            part.unlink(missing_ok=True)
        return None
    return path


def short_path(path: Path) -> str:
    """The path with `~` for the home folder."""
    with suppress(ValueError, RuntimeError):
        return f"~/{path.relative_to(Path.home())}"
    return str(path)


MOST_COPIED = 10_000
"""Rows that can be copied at once: a terminal takes about a megabyte."""

_GAPS = re.compile(" {2,}")

GROUP = "save"
"""What the work beside the screen is called."""


class ExportActions(Parts):
    """Rows, and typed text, to the clipboard and to files."""

    def action_copy_text(self) -> None:
        """Copy the selected rows, or the cursor's, as the lines that `decode` prints."""
        rows = self._taken()
        if rows is not None:
            stream = StringIO()
            row_writer(OutputFormat.TABLE, stream, ports=len(self._watched.ports) > 1).write(rows)
            text = stream.getvalue()
            if len(rows) == 1:
                # Alone it needs no columns, and no names above them.
                text = _GAPS.sub("  ", text.splitlines()[-1])
            self._copy(text, len(rows))

    def action_copy(self) -> None:
        """Copy the bytes of the selected rows, or of the cursor's, as hex."""
        rows = self._taken()
        if rows is not None:
            self._copy("\n".join(spaced_hex(row.raw) for row in rows), len(rows))

    def _taken(self) -> list[Row] | None:
        """The rows to copy; None where there are none, or too many."""
        store, selected = self._watched.store, self._table.selected
        if not selected:
            row = self._table.cursor_row
            return None if row is None else [row]
        start, end = store.shown.position_of(selected.start), store.shown.position_of(selected.stop)
        if end - start > MOST_COPIED:
            words = _("{count:,} rows are too many to copy (at most {most:,}); w saves them")
            self._tell(words.format(count=end - start, most=MOST_COPIED))
            return None
        return [row for _, row in store.shown.slice(start, end)]

    def _copy(self, text: str, rows: int) -> None:
        text = text.rstrip("\n").encode("utf-8", "backslashreplace").decode()
        self.copy_to_clipboard(text)
        kept = keep_copy(text)
        first = text.partition("\n")[0] if rows == 1 else _("{count:,} rows").format(count=rows)
        form = _("copied {what}") if kept is None else _("copied {what}  (also in {file})")
        self._tell(
            form.format(what=printable(first), file=printable(short_path(kept)) if kept else "")
        )

    def action_interrupt(self) -> None:
        """Copy the selection of a field; where nothing is selected, end."""
        field = self.focused
        if isinstance(field, Input) and field.selected_text:
            self.copy_to_clipboard(field.selected_text)
        else:
            self.exit()

    def action_save(self) -> None:
        """Ask for the file that the selected rows, or all that are shown, are saved to."""
        if self._saving is not None:
            words = _("{file} is still being saved; esc ends that")
            self._tell(words.format(file=printable(str(self._saving.path))))
        elif not self._watched.store.shown.count:
            self._tell(_("no row is shown that could be saved"))
        else:
            self._tell_what_is_saved()
            self._save_field.ask()

    def _tell_what_is_saved(self) -> None:
        store, selected = self._watched.store, self._table.selected
        if selected:
            count = store.shown.position_of(selected.stop) - store.shown.position_of(selected.start)
            self._tell(_("{count:,} selected rows would be saved").format(count=count))
        else:
            count = store.shown.count
            self._tell(_("{count:,} shown rows would be saved").format(count=count))

    def _target(self, line: str) -> SaveTarget:
        return SaveTarget.parse(line, self._watched.state.files)

    def _save(self, line: str) -> None:
        if not line:
            return
        store, selected = self._watched.store, self._table.selected
        wanted = selected or range(store.first, store.next)
        try:
            self._saving = SaveJob(self._target(line), self._origin(selected))
        except FteSniffError as error:
            self._notice.warn(worded(error))
            return
        saving, row_filter = self._saving, store.shown.filter
        self._tell_share(saving, 0)
        self._work(GROUP, partial(self._write, saving, wanted, row_filter))

    def _origin(self, selected: range) -> ExportSource:
        """What is known of the rows that are saved: those shown, or those of them selected."""
        store = self._watched.store
        origin = replace(self._opening.origin, ports=self._watched.ports)
        if selected:
            first, last = store.row(selected.start), store.row(selected.stop - 1)
            origin = origin.within(first.t_ns, last.t_ns)
        if store.shown.filter is not None:
            own = Selection(
                store.shown.filter.text, len(selected or range(store.first, store.next))
            )
            origin = replace(origin, selections=[*origin.selections, own])
        return origin

    async def _write(self, saving: SaveJob, wanted: range, row_filter: RowFilter | None) -> None:
        """Save the rows of these indices that the filter wants, while the screen goes on."""
        store, at = self._watched.store, wanted.start
        await self._drawn()
        try:
            while at < wanted.stop:
                if at < store.first:
                    at = min(store.first, wanted.stop)
                rows, at = select_rows(store, at, wanted.stop, row_filter)
                saving.write(rows)
                self._tell_share(saving, (at - wanted.start) / len(wanted))
                await asyncio.sleep(0)
            saving.finish()
        except FteSniffError as error:
            self._end_of_saving()
            self._notice.warn(worded(error))
        else:
            self._end_of_saving()
            words = _("saved {count:,} rows to {file}")
            self._tell(words.format(count=saving.rows, file=printable(str(saving.path))))
            self._unselect()

    def _tell_share(self, saving: SaveJob, share: float) -> None:
        words = _("saving to {file}: {share:.0%}, esc ends it")
        words = words.format(file=printable(str(saving.path)), share=share)
        self._notice.hold(GROUP, words, worry=False)

    async def _drawn(self) -> None:
        """Wait until what was told is on the screen: the first rows may take long."""
        drawn = asyncio.Event()
        self.call_after_refresh(drawn.set)
        await drawn.wait()

    def _end_of_saving(self) -> None:
        self._saving = None
        self._notice.release(GROUP)

    def _end_saving(self) -> bool:
        """End the saving that runs, with nothing left of it; whether there was one."""
        if self._saving is None:
            return False
        saving = self._saving
        self._end_of_saving()
        self.workers.cancel_group(self, GROUP)
        # The work may not have begun, and then does not hear that it is to end.
        saving.abandon()
        self._tell(_("{file} was not saved").format(file=printable(str(saving.path))))
        return True
