"""Marks and notes on rows."""

from __future__ import annotations

from fte_sniff.errors import FileError, printable
from fte_sniff.i18n import _, later
from fte_sniff.protocol.rows import Row, Rows
from fte_sniff.session.notes import RowKey, located
from fte_sniff.tui.line import Question
from fte_sniff.tui.parts import Parts


class NotesControl:
    """Marks rows, asks for notes on them, and writes these to the file of the notes.

    The marks that are shown are an attribute of the table.
    """

    def __init__(self, parts: Parts) -> None:
        self._parts, self._view, self._table = parts, parts.view, parts.table
        self._status, self._notes = parts.status, parts.options.notes
        self._missing = {} if self._notes is None else dict(self._notes.notes)
        """Notes whose rows have not come yet."""

    def mark(self) -> None:
        """Mark the row under the cursor, or remove its mark."""
        row = self._table.cursor_row
        if row is None:
            return
        self._table.stop_following()
        index = self._table.last_index
        if self._table.marks.get(index):
            self._status.inform(_("the row has a note; # changes it, an empty one removes it"))
        else:
            self._keep(index, row, "" if index not in self._table.marks else None)

    def ask(self) -> None:
        """Ask for a note on the row under the cursor."""
        row = self._table.cursor_row
        if row is None:
            return
        self._table.stop_following()
        index = self._table.last_index

        def accept(line: str) -> None:
            self._keep(index, row, line or None)

        question = Question(later("note"), later("the wheel was blocked by hand"), str, accept)
        self._parts.line.ask(question, self._table.marks.get(index, ""))

    def _keep(self, index: int, row: Row, text: str | None) -> None:
        """Mark a row with a text, or remove its mark (None), and write that to the file."""
        if text is None:
            self._table.marks.pop(index, None)
        else:
            self._table.marks[index] = text
        self._table.draw()
        if self._notes is None:
            return
        try:
            path = self._notes.set(RowKey(row.port, row.offset, row.t_ns), text)
        except FileError as error:
            self._status.warn(_(error.message))
        else:
            if path is not None:
                news = _("marks and notes are saved in {path}", path=printable(str(path)))
                self._status.inform(news)

    def find_noted(self, rows: Rows, first: int) -> None:
        """Mark those of the new rows that have a note."""
        for number, key in located(rows, [*self._missing]):
            text = self._missing.pop(key, None)
            if text is not None:
                self._table.marks[first + number] = text

    def show(self) -> None:
        """Show the note on the row under the cursor."""
        index = self._table.cursor_index
        text = "" if index is None else self._table.marks.get(index, "")
        if text:
            self._status.pin("note", _("note: {text}", text=text))
        else:
            self._status.forget("note")

    def to_mark(self, by: int) -> None:
        """Go to the next shown mark, or to the previous one."""
        last, shown = self._table.last_index, self._view.shown
        beyond = [one for one in self._table.marks if (one - last) * by > 0 and shown.has(one)]
        if not self._table.jump_to_index(min(beyond, key=lambda one: one * by, default=None)):
            below, above = _("no marked row is shown below"), _("no marked row is shown above")
            none = "" if self._table.marks else _("no row is marked; m marks one")
            self._status.inform(none or (below if by > 0 else above))
