"""Owns the pane that explains the row under the cursor, byte by byte.

It must not know what the bytes mean: `protocol.dissect` does.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from textwrap import wrap

from rich.style import Style
from rich.text import Text
from textual.app import ComposeResult
from textual.containers import VerticalScroll
from textual.widgets import Static

from fte_sniff.errors import shown
from fte_sniff.protocol import FRAME_LENGTH, Frame, Row, iso_time, spaced_hex, status_of
from fte_sniff.protocol.dissect import Part, dissect, explain
from fte_sniff.tui.table.layout import MARKS
from fte_sniff.tui.table.palette import Palette

BYTES_BESIDE = 4
"""Bytes of a field that stand side by side, before its name."""

BYTES_BELOW = 16
"""Bytes that stand side by side where a part is longer than any field of a frame."""

ROOMY_LINES = 40
"""Lines of the terminal from which on flag bytes are explained bit by bit."""

_HEX_WIDTH = 3 * BYTES_BESIDE
_NAME_WIDTH = 10
_VALUE_WIDTH = 18
_INDENT = " " * (2 + _HEX_WIDTH)


@dataclass(frozen=True, slots=True)
class Room:
    """What there is room for."""

    width: int
    """Cells; what a part is may be cut to it, what is wrong is wrapped."""
    bits: bool
    """Whether flag bytes are explained bit by bit."""


def detail_text(row: Row, palette: Palette, room: Room) -> Text:
    """The row explained."""
    lines = [_heading(row, palette)]
    wrong = palette.statuses[row.status]
    lines += [Text(f"{MARKS[row.status]} {line}", style=wrong) for line in explain(row)]
    for part in dissect(row):
        lines += _part_lines(part, palette, room)
    for line in lines:
        line.truncate(room.width, overflow="ellipsis")
    return Text("\n").join(lines)


def _heading(row: Row, palette: Palette) -> Text:
    kind = row.kind if isinstance(row, Frame) else None
    name = kind.name if kind else "unknown frame" if isinstance(row, Frame) else "damage"
    time = "no time" if row.t_ns is None else iso_time(row.t_ns)
    where = f"offset {row.offset:,}  {len(row.raw)} bytes  {shown(row.port)}"
    style = palette.of_kind(row) if kind else palette.statuses[row.status]
    return Text.assemble((name, style + Style(bold=True)), f"  {time}  {where}")


def _part_lines(part: Part, palette: Palette, room: Room) -> Iterator[Text]:
    """The bytes, the name, the value and what it is; then what is wrong, and the bits."""
    wrong = palette.statuses[status_of((part.fault,))] if part.fault else Style.null()
    mark = MARKS[status_of((part.fault,))] if part.fault else " "
    long = len(part.raw) > FRAME_LENGTH - 4
    first, *more = [""] if long else _hex_lines(part.raw, BYTES_BESIDE)
    below = _hex_lines(part.raw, BYTES_BELOW) if long else more
    value = part.value
    if part.bits:
        value += "  " + "".join("01"[bit.is_set] for bit in reversed(part.bits))
    yield Text.assemble(
        (mark, wrong),
        f" {first:<{_HEX_WIDTH}}",
        (f"{part.name:<{_NAME_WIDTH}} ", wrong + Style(bold=True)),
        f"{value:<{_VALUE_WIDTH}} ",
        (part.meaning, palette.muted),
    )
    for line in below:
        yield Text(f"  {line}")
    for line in wrap(part.note, max(1, room.width - len(_INDENT))):
        yield Text(_INDENT + line, style=wrong)
    for bit in part.bits if room.bits else ():
        said = f"bit {bit.number} is {'01'[bit.is_set]}: {bit.meaning}"
        yield Text(_INDENT + said, style=Style.null() if bit.is_set else palette.muted)


def _hex_lines(raw: bytes, width: int) -> list[str]:
    return [spaced_hex(raw[at : at + width]) for at in range(0, len(raw), width)] or [""]


class DetailPane(VerticalScroll, can_focus=False):
    """The explanation of one row."""

    def __init__(self) -> None:
        super().__init__()
        self._page = Static()
        self._shown: tuple[Row, Palette, Room] | None = None
        self.display = False

    def compose(self) -> ComposeResult:
        """One page that can be moved with the mouse wheel."""
        yield self._page

    def show(self, row: Row | None, palette: Palette) -> None:
        """Explain this row, if it is not the one explained."""
        if row is None:
            self._shown = None
            self._page.update(Text("no row"))
            return
        roomy = self.app.size.height >= ROOMY_LINES
        now = (row, palette, Room(self.app.size.width - 1, roomy))
        if self._shown != now:
            self._shown = now
            self.set_class(roomy, "-roomy")
            self._page.update(detail_text(*now))
