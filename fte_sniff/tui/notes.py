"""Marks and notes on rows."""

from __future__ import annotations

import asyncio

from textual.worker import WorkType

from fte_sniff.errors import printable
from fte_sniff.formats.cell_text import clock_text
from fte_sniff.protocol import Row
from fte_sniff.protocol.rows import Rows
from fte_sniff.session.notes import Note, located
from fte_sniff.tui.i18n import _, later
from fte_sniff.tui.modals import Entry, Picker
from fte_sniff.tui.prompt import Parts, Prompt, PromptField


class NotesField(PromptField):
    """Marks rows, asks for notes on them, and writes these to the file of the notes.

    The marks that are shown are an attribute of the table.
    """

    PROMPT = Prompt(
        later("note"),
        later("the wheel was blocked by hand"),
        later("enter keeps it beside the recording, an empty one removes it, esc goes back"),
    )

    def __init__(self, parts: Parts) -> None:
        super().__init__(parts)
        self._notes = self._options.notes
        self._missing = {} if self._notes is None else dict(self._notes.notes)
        """Notes whose rows have not come yet."""
        self.left_at = self._options.place.cursor
        """The row where the view was left, until it has come."""
        self._noted: tuple[int, Row] | None = None
        """The row whose note is written, after its index."""

    def action_mark(self) -> None:
        """Mark the row under the cursor, or remove its mark."""
        if self._table.viewport.count:
            self._table.stop_following()
            index, row = self._table.last_index, self._table.cursor_row
            if self._table.marks.get(index):
                self._notice.inform(_("the row has a note; # changes it, an empty one removes it"))
            elif row is not None:
                self._keep_note(index, row, "" if index not in self._table.marks else None)

    def action_ask(self) -> None:
        """Ask for a note on the row under the cursor."""
        self._table.stop_following()
        index, row = self._table.last_index, self._table.cursor_row
        if row is not None:
            self._noted = index, row
            self.open(self._table.marks.get(index, ""))

    def accept(self, line: str) -> None:
        """Write the note; an empty one removes the mark."""
        if self._noted is not None:
            self._keep_note(*self._noted, line or None)

    def _keep_note(self, index: int, row: Row, text: str | None) -> None:
        """Mark a row with a text, or remove its mark (None), and write that to the file."""
        note = Note.on(row, text)
        if note.text is None:
            self._table.marks.pop(index, None)
        else:
            self._table.marks[index] = note.text
        self._table.sync()
        if self._notes is not None:
            self._notes.set(note)
            if text is not None and (path := self._notes.news(note.key)):
                text = _("marks and notes are saved in {path}", path=printable(str(path)))
                self._notice.inform(text)
            work: WorkType[None] = self._save_notes
            self.run_worker(work, group="notes", exclusive=True)

    async def _save_notes(self) -> None:
        """Write the notes in a thread, since a disk may be slow."""
        if self._notes is not None and (trouble := await asyncio.to_thread(self._notes.save)):
            self._notice.warn(_(trouble))

    def action_notes(self) -> None:
        """Pick a marked row and go to it."""
        store, marks, entries = self._store, self._table.marks, []
        for index in sorted(marks):
            if store.first <= index < store.next:
                row = store.row(index)
                time = "" if row.t_ns is None else clock_text(row.t_ns, 3, self._table.view.zone)
                text = printable(marks[index]) or _("mark")
                entries.append(Entry(f"{time}  {text}", str(index), f"{row.offset:,}"))
        if entries:
            self.app.push_screen(Picker(_("marks and notes"), entries), self._go_to_note)
        else:
            self._notice.inform(_("no row is marked; m marks one"))

    def _go_to_note(self, index: str | None) -> None:
        if index is not None and not self._table.jump_to_index(int(index)):
            self._notice.inform(_("the filter hides this row; F shows all rows"))

    def find_noted(self, rows: Rows, first: int) -> None:
        """Mark those of the new rows that have a note, and find the row where the view was left."""
        wanted = set(self._missing)
        if self.left_at is not None:
            wanted.add(self.left_at)
        if not (wanted and len(rows)):
            return
        for number, key in located(rows, wanted):
            note = self._missing.pop(key, None)
            if note is not None and note.text is not None:
                self._table.marks[first + number] = note.text
            if key == self.left_at:
                self.left_at = None
                self._table.sync()
                self._table.jump_to_index(first + number)

    def show_note(self) -> None:
        """Show the note on the row under the cursor."""
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
        if not self._table.jump_to_index(self._table.next_mark(by)):
            self._notice.inform(none or (below if by > 0 else above))

    def save(self) -> None:
        """Write the notes at the end, if the worker has not."""
        if self._notes is not None:
            self._notes.save()
