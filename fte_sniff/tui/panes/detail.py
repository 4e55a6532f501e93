"""Detail pane."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, tzinfo
from itertools import groupby

from rich.cells import cell_len
from rich.style import Style
from rich.text import Text

from fte_sniff.analysis.statistics import DEFAULT_SETUP, LineSetup
from fte_sniff.errors import printable
from fte_sniff.formats.text_layout import ORDER_MARK
from fte_sniff.protocol import Frame, Row, spaced_hex, status_of
from fte_sniff.protocol.dissect import ExplainedBit, ExplainedField, dissect, explain
from fte_sniff.tui.i18n import _, later
from fte_sniff.tui.panes.pane import Pane, PaneContext
from fte_sniff.tui.table.columns import MARKS
from fte_sniff.tui.table.theme import Palette
from fte_sniff.tui.text import moment_text, padded, turns_text, wrap

TITLE = later("the row, byte by byte")
HINT = later("J K: scroll   esc: close")
NO_ROW = later("no row")
TURNS = "{pulses}, {turns}"
BIT = later("bit {number} is {value}: {meaning}")
BITS = later("bits 7-0: {bits}")
BIT_RUN = "{label} {digits}"

BYTES_BESIDE = 4
"""Bytes of a field that stand side by side, before its name."""

BYTES_BELOW = 8
"""Bytes that stand side by side below the name, where a part has more than stand before it."""

BESIDE_CELLS = 30
"""Cells that words need at least to stand beside a value; else they stand below it."""

ROOMY_LINES = 40
"""Lines of the terminal from which on each bit of a flag byte has a line of its own."""

UNCERTAIN_ORDER = later(
    "a row of the other port may have come first: their times are too close to tell"
)
"""What the sign of an uncertain order means."""

_HEX_WIDTH = 3 * BYTES_BESIDE
_NAME_WIDTH = 10
_VALUE_WIDTH = 18
_INDENT = " " * (2 + _HEX_WIDTH)


@dataclass(frozen=True, slots=True)
class Width:
    """What there is room for."""

    width: int
    """Cells; what a part is may be cut to it, what is wrong is wrapped."""
    bits: bool
    """Whether each bit of a flag byte has a line of its own."""


def detail_text(
    row: Row, palette: Palette, room: Width, bench: LineSetup = DEFAULT_SETUP, zone: tzinfo = UTC
) -> Text:
    """The row explained; positions in turns too, where the bench tells how long a turn is."""
    lines = _heading(row, palette, room, zone)
    wrong = palette.statuses[row.status]
    for said in explain(row):
        first, *more = wrap(_(said), room.width - 2)
        lines.append(Text(f"{MARKS[row.status]} {first}", style=wrong))
        lines += [Text(f"  {line}", style=wrong) for line in more]
    if row.order_uncertain:
        words = wrap(_(UNCERTAIN_ORDER), room.width - 2)
        marks = (ORDER_MARK, *(" " * (len(words) - 1)))
        lines += [Text(f"{mark} {line}") for mark, line in zip(marks, words, strict=True)]
    parts = [_with_turns(part, bench) for part in dissect(row)]
    values = _VALUE_WIDTH if any(part.value for part in parts) else 0
    for part in parts:
        lines += _part_lines(part, palette, room, values)
    for line in lines:
        line.truncate(room.width, overflow="ellipsis")
    return Text("\n").join(lines)


def _heading(row: Row, palette: Palette, room: Width, zone: tzinfo) -> list[Text]:
    kind = row.kind if isinstance(row, Frame) else None
    name = kind.name if kind else _("unknown frame") if isinstance(row, Frame) else _("damage")
    time = _("no time") if row.t_ns is None else moment_text(row.t_ns, zone)
    where = _("offset {offset:,}  {length} bytes  {port}").format(
        offset=row.offset, length=len(row.raw), port=printable(row.port)
    )
    style = palette.of_kind(row) if kind else palette.statuses[row.status]
    lines = [Text(name, style=style + Style(bold=True))]
    for words in (time, where):
        line = Text.assemble(lines[-1], f"  {words}")
        if line.cell_len <= room.width:
            lines[-1] = line
        else:
            lines.append(Text(f"  {words}"))
    return lines


def _with_turns(part: ExplainedField, bench: LineSetup) -> ExplainedField:
    """A decoded position also tells its turns."""
    if part.name != "pulses" or not part.value:
        return part
    pulses = int.from_bytes(part.raw, "big", signed=True)
    turns = turns_text(pulses, bench)
    return replace(part, value=TURNS.format(pulses=part.value, turns=turns)) if turns else part


def _part_lines(part: ExplainedField, palette: Palette, room: Width, values: int) -> Iterator[Text]:
    """The bytes, the name, the value in its cells and what it is; then what is wrong, and the bits.

    More bytes than stand before a name follow in lines of their own, each with the part's mark.
    """
    wrong = palette.statuses[status_of((part.fault,))] if part.fault else Style.null()
    mark = MARKS[status_of((part.fault,))] if part.fault else " "
    beside = len(part.raw) <= BYTES_BESIDE
    value = part.value
    if part.bits:
        value += "  " + "".join("01"[bit.is_set] for bit in reversed(part.bits))
    line = Text.assemble(
        (mark, wrong),
        f" {spaced_hex(part.raw) if beside else '':<{_HEX_WIDTH}}",
        (f"{part.name:<{_NAME_WIDTH}} ", wrong + Style(bold=True)),
        f"{padded(value, values)} " if values else "",
    )
    here, *more = _wrapped_beside(_(part.meaning), line.cell_len, room)
    line.append(here, palette.muted)
    line.rstrip()
    yield line
    for below in more:
        yield Text(below, style=palette.muted)
    for digits in [] if beside else _hex_lines(part.raw, BYTES_BELOW):
        yield Text.assemble((mark, wrong), f" {digits}")
    yield from _indented(_(part.note), wrong, room)
    if not room.bits:
        yield from _indented(_bits_in_a_line(part.bits), palette.muted, room)
        return
    for bit in part.bits:
        said = _(BIT).format(number=bit.number, value="01"[bit.is_set], meaning=_(bit.meaning))
        yield from _indented(said, Style.null() if bit.is_set else palette.muted, room)


def _bits_in_a_line(bits: Sequence[ExplainedBit]) -> str:
    """Every bit from the highest down; those of one name together."""
    runs = groupby(reversed(bits), key=lambda bit: bit.label)
    told = [
        BIT_RUN.format(label=_(label), digits="".join("01"[bit.is_set] for bit in run))
        for label, run in runs
    ]
    return _(BITS).format(bits=", ".join(told)) if told else ""


def _wrapped_beside(words: str, start: int, room: Width) -> list[str]:
    """The words from cell `start` on, its other lines indented; all below where that is narrow."""
    if not words:
        return [""]
    if room.width - start >= BESIDE_CELLS or room.width - start >= cell_len(words):
        first, *more = wrap(words, room.width - start)
        return [first, *(" " * start + line for line in more)]
    return ["", *(_INDENT + line for line in wrap(words, room.width - len(_INDENT)))]


def _indented(words: str, style: Style, room: Width) -> list[Text]:
    lines = wrap(words, room.width - len(_INDENT))
    return [Text(_INDENT + line, style=style) for line in lines]


def _hex_lines(raw: bytes, width: int) -> list[str]:
    return [spaced_hex(raw[at : at + width]) for at in range(0, len(raw), width)] or [""]


class DetailPane(Pane):
    """The explanation of one row."""

    def __init__(self) -> None:
        super().__init__(HINT)
        self._shown: tuple[Row, Palette, Width, LineSetup, tzinfo] | None = None

    def see(self, sight: PaneContext) -> None:
        """Explain the cursor's row, if it is not the one explained."""
        self.entitle(_(TITLE))
        if sight.row is None:
            self._shown = None
            self.draw(Text(_(NO_ROW)))
            return
        roomy = self.app.size.height >= ROOMY_LINES
        room = Width(self.room.width, roomy)
        now = (sight.row, sight.palette, room, sight.bench, sight.zone)
        if self._shown != now:
            self._shown = now
            self.draw(detail_text(*now))
            self.scroll_home(animate=False)
