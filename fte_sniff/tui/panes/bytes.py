"""Bytes pane.

12,340  AA 01 01 03 E8 00 00 00 00 EE[55 01 01 03 E8 00|.......... U.....
12,356  00 00 0F EE]AA 01 02 03 ...
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Final

from rich.style import Style
from rich.text import Text

from fte_sniff.analysis.row_store import RowStore
from fte_sniff.protocol import Row, Status
from fte_sniff.tui.i18n import _, later
from fte_sniff.tui.panes.pane import Pane, PaneContext
from fte_sniff.tui.table.theme import Palette

TITLE: Final = later("bytes around offset {offset:,}")
HINT: Final = later("[ ] row   | next row   J K: scroll   esc: close")
NO_ROW: Final = later("no row")

LINES_AROUND: Final = 6
"""Lines before the row's first one, and behind its last one."""

MOST_ROWS_AWAY: Final = 20_000
"""Rows of other ports that neighbours are looked for behind."""

ABREAST: Final = (32, 16, 8)
"""How many bytes may stand in a line: as many as there is room for, the last in any case."""

UNKNOWN: Final = "··"

_OFFSET_WIDTH: Final = 12
_AT_ONCE: Final = 256
_OWN: Final = Style(bold=True, reverse=True)


def neighbours(store: RowStore, index: int, reach: int) -> list[Row]:
    """The row of that index with those of its port that stand up to `reach` bytes away, in order.

    Raises:
        IndexError: there is no such row.
    """
    row = store.row(index)
    start, end = row.offset - reach, row.offset + len(row.raw) + reach
    before: list[Row] = []
    for other in _of_port(_backwards(store, index), row.port):
        if other.offset + len(other.raw) <= start:
            break
        before.append(other)
    behind: list[Row] = []
    for other in _of_port(_forwards(store, index), row.port):
        if other.offset >= end:
            break
        behind.append(other)
    return [*reversed(before), row, *behind]


def _of_port(rows: Iterator[Row], port: str) -> Iterator[Row]:
    return (row for row in rows if row.port == port)


def _backwards(store: RowStore, index: int) -> Iterator[Row]:
    last = max(store.first, index - MOST_ROWS_AWAY)
    while index > last:
        at = max(last, index - _AT_ONCE)
        yield from reversed(store.rows(at, index))
        index = at


def _forwards(store: RowStore, index: int) -> Iterator[Row]:
    end = min(store.next, index + 1 + MOST_ROWS_AWAY)
    for at in range(index + 1, end, _AT_ONCE):
        yield from store.rows(at, min(end, at + _AT_ONCE))


def dump(row: Row, rows: Sequence[Row], width: int, palette: Palette) -> Text:
    """The row among its neighbours, for so many cells."""
    abreast = next((n for n in ABREAST if _cells(n) + n < width), ABREAST[-1])
    stream = _Stream(row, rows, palette)
    first = max(0, row.offset // abreast - LINES_AROUND)
    last = (row.offset + max(1, len(row.raw)) - 1) // abreast + LINES_AROUND
    lines = [
        stream.line(number * abreast, abreast, _cells(abreast) + abreast < width)
        for number in range(first, last + 1)
    ]
    return Text("\n").join(line for line in lines if line is not None)


def _cells(abreast: int) -> int:
    """What the offset and so many bytes take, with the signs between them."""
    return _OFFSET_WIDTH + 1 + 3 * abreast + 1


class _Stream:
    """The bytes of some rows by their offsets."""

    def __init__(self, row: Row, rows: Sequence[Row], palette: Palette) -> None:
        self._own = range(row.offset, row.offset + len(row.raw))
        self._muted = palette.muted
        self._bytes: dict[int, int] = {}
        self._starts = {other.offset for other in rows}
        self._styles: dict[int, Style] = {}
        for other in rows:
            faulty = other.status is not Status.OK
            style = palette.statuses[other.status] if faulty else Style.null()
            for place, byte in enumerate(other.raw, other.offset):
                self._bytes[place] = byte
                self._styles[place] = style

    def line(self, start: int, abreast: int, with_text: bool) -> Text | None:
        """One line; None where none of its bytes is known."""
        places = range(start, start + abreast)
        if not any(place in self._bytes for place in places):
            return None
        line = Text(f"{start:>{_OFFSET_WIDTH},} ", style=self._muted)
        for place in places:
            line.append(self._sign(place, place == start), self._style_between(place))
            byte = self._bytes.get(place)
            line.append(UNKNOWN if byte is None else f"{byte:02X}", self._style(place))
        line.append("]" if places.stop == self._own.stop else " ", self._style_between(places.stop))
        if with_text:
            line.append(" ")
            for place in places:
                line.append(_character(self._bytes.get(place)), self._style(place))
        return line

    def _sign(self, place: int, begins_line: bool) -> str:
        """What stands before a byte; the bracket behind the line before is not said again."""
        if self._own and place == self._own.start:
            return "["
        if self._own and place == self._own.stop and not begins_line:
            return "]"
        return "|" if place in self._starts else " "

    def _style(self, place: int) -> Style:
        return _OWN if place in self._own else self._styles.get(place, self._muted)

    def _style_between(self, place: int) -> Style:
        inner = place in self._own or place == self._own.stop
        return _OWN if inner else self._muted


def _character(byte: int | None) -> str:
    if byte is None:
        return " "
    return chr(byte) if 0x20 <= byte < 0x7F else "."


class BytesPane(Pane):
    """The stream around the row under the cursor."""

    def __init__(self) -> None:
        super().__init__(HINT)
        self._shown: tuple[object, ...] | None = None

    def see(self, sight: PaneContext) -> None:
        """Dump what stands around the cursor's row, unless that is what stands there."""
        if sight.row is None or sight.index is None:
            self._shown = None
            self.draw(Text(_(NO_ROW)))
            return
        width = self.room.width
        reach = LINES_AROUND * ABREAST[0]
        rows = neighbours(sight.store, sight.index, reach)
        now = (sight.row, rows[0].offset, len(rows), width, sight.palette)
        if now == self._shown:
            return
        self._shown = now
        self.entitle(_(TITLE).format(offset=sight.row.offset))
        self.draw(dump(sight.row, rows, width, sight.palette))
