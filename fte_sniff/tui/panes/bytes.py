"""Bytes pane: the bytes of the stream around a row.

12,340  AA 01 01 03 E8 00 00 00 00 EE<55 01 01 03 E8 00 .......... U.....
12,356  00 00 0F EE>AA 01 02 03 ...
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import takewhile
from typing import Final

from rich.style import Style
from rich.text import Text

from fte_sniff.analysis.row_store import RowStore
from fte_sniff.protocol import Row
from fte_sniff.protocol.dissect import dissect
from fte_sniff.tui.i18n import _, later
from fte_sniff.tui.panes.pane import FIELD, Pane, PaneContext
from fte_sniff.tui.table.theme import Palette

CONTEXT_LINES: Final = 6
"""Least lines before the row's first one, and after its last one."""

MAX_ROWS_SEARCHED: Final = 20_000
"""Rows of other ports among which the port's neighbours are searched for."""

BYTES_PER_LINE: Final = (32, 16, 8)
"""The first that fits is used, or else the last."""


_OFFSET_WIDTH: Final = 12
_STEP_ROWS: Final = 256


def neighbours(store: RowStore, index: int, reach: int) -> list[Row]:
    """The row at an index, with the rows of its port up to `reach` bytes away, in order.

    Raises IndexError if there is no such row.
    """
    row = store.row(index)
    start, end = row.offset - reach, row.offset + len(row.raw) + reach
    before = (other for other in _backwards(store, index) if other.port == row.port)
    after = (other for other in _forwards(store, index) if other.port == row.port)
    near_before = takewhile(lambda other: other.offset + len(other.raw) > start, before)
    near_after = takewhile(lambda other: other.offset < end, after)
    return [*reversed(list(near_before)), row, *near_after]


def _backwards(store: RowStore, index: int) -> Iterator[Row]:
    last = max(store.first, index - MAX_ROWS_SEARCHED)
    while index > last:
        start = max(last, index - _STEP_ROWS)
        yield from reversed(store.rows(start, index))
        index = start


def _forwards(store: RowStore, index: int) -> Iterator[Row]:
    end = min(store.next, index + 1 + MAX_ROWS_SEARCHED)
    for start in range(index + 1, end, _STEP_ROWS):
        yield from store.rows(start, min(end, start + _STEP_ROWS))


def dump(
    row: Row,
    rows: Sequence[Row],
    width: int,
    palette: Palette,
    field: int | None = None,
    around: int = CONTEXT_LINES,
) -> Text:
    """Hex dump of the row among its neighbours, in `width` cells; one field is highlighted.

    There are `around` lines before the row's first one, and after its last one.
    """
    per_line = next((n for n in BYTES_PER_LINE if _cells(n) + n < width), BYTES_PER_LINE[-1])
    stream = _Stream(row, rows, palette, field)
    first = max(0, row.offset // per_line - around)
    last = (row.offset + max(1, len(row.raw)) - 1) // per_line + around
    with_text = _cells(per_line) + per_line < width
    lines = [
        stream.line(number * per_line, per_line, with_text) for number in range(first, last + 1)
    ]
    return Text("\n").join(line for line in lines if line is not None)


def _cells(per_line: int) -> int:
    """Width of an offset and the bytes of a line, with the signs between them."""
    return _OFFSET_WIDTH + 1 + 3 * per_line + 1


class _Stream:
    def __init__(
        self, row: Row, rows: Sequence[Row], palette: Palette, looked_at: int | None
    ) -> None:
        self._row = range(row.offset, row.offset + len(row.raw))
        self._palette = palette
        self._starts = {other.offset for other in rows}
        self._bytes: dict[int, int] = {}
        self._styles: dict[int, Style] = {}
        for other in rows:
            styles = palette.of_bytes(other)
            for offset, (byte, style) in enumerate(
                zip(other.raw, styles, strict=True), other.offset
            ):
                self._bytes[offset], self._styles[offset] = byte, style
        for number, field in enumerate(dissect(row)):
            look = palette.field if number == looked_at else palette.cursor_row
            for offset in field.offsets:
                style = self._styles[row.offset + offset] + look + Style(meta={FIELD: number})
                self._styles[row.offset + offset] = style

    def line(self, start: int, per_line: int, with_text: bool) -> Text | None:
        """One line; None where none of its bytes is known."""
        offsets = range(start, start + per_line)
        if not any(offset in self._bytes for offset in offsets):
            return None
        line = Text(f"{start:>{_OFFSET_WIDTH},} ", style=self._palette.muted)
        for offset in offsets:
            begins_line = offset == start
            separator = self._separator(offset, begins_line)
            line.append(separator, self._separator_style(offset, begins_line))
            byte = self._bytes.get(offset)
            line.append("··" if byte is None else f"{byte:02X}", self._style(offset))
        end = offsets.stop
        line.append(">" if end == self._row.stop else " ", self._separator_style(end, False))
        if with_text:
            line.append(" ")
            for offset in offsets:
                line.append(_character(self._bytes.get(offset)), self._style(offset))
        return line

    def _separator(self, offset: int, begins_line: bool) -> str:
        """The sign before a byte; that after the row is not repeated on the next line."""
        if self._row and offset == self._row.start:
            return "<"
        if self._row and offset == self._row.stop and not begins_line:
            return ">"
        return "|" if offset in self._starts else " "

    def _style(self, offset: int) -> Style:
        return self._styles.get(offset, self._palette.muted)

    def _separator_style(self, offset: int, begins_line: bool) -> Style:
        if offset in self._row or (offset == self._row.stop and not begins_line):
            return self._palette.signs + self._palette.cursor_row
        return self._palette.muted


def _character(byte: int | None) -> str:
    if byte is None:
        return " "
    return chr(byte) if 0x20 <= byte < 0x7F else "."


class BytesPane(Pane):
    """The bytes of the stream around the cursor's row."""

    NAME = "bytes"
    EXPLAINS_ROW = True
    HINT = later("<this row>  [ ]: field  J K: scroll  esc: close")

    def draw(self, context: PaneContext) -> None:
        """Dump the bytes around the cursor's row, where they are not shown already."""
        if context.row is None or context.index is None:
            self.set_page_of(Text, _("no row"))
            return
        around = CONTEXT_LINES
        if not (self.styles.height is None or self.styles.height.is_auto):
            around = max(around, (self.page_size.height - 1) // 2)
        rows = neighbours(context.store, context.index, around * BYTES_PER_LINE[0])
        self.set_title(_("bytes around offset {offset:,}", offset=context.row.offset))
        width, palette = self.page_size.width, context.palette
        self.set_page_of(dump, context.row, rows, width, palette, context.field, around)
