"""Panes about the cursor's row: the detail explains it, the bytes pane dumps those around it.

12,340  AA 01 01 03 E8 00 00 00 00 EE<55 01 01 03 E8 00 .......... U.....
12,356  00 00 0F EE>AA 01 02 03 ...
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, tzinfo
from itertools import groupby, takewhile

from rich.cells import cell_len
from rich.style import Style
from rich.text import Text

from fte_sniff.analysis.relations import CommandAnswer
from fte_sniff.analysis.row_store import RowStore
from fte_sniff.analysis.statistics import DEFAULT_SETUP, LineSetup
from fte_sniff.errors import listed, printable
from fte_sniff.formats.cell_text import padded, wrap
from fte_sniff.protocol import Row, iso_time, spaced_hex, status_of
from fte_sniff.protocol.columns import LOOKS, ORDER_MARK
from fte_sniff.protocol.dissect import (
    ExplainedBit,
    ExplainedField,
    dissect,
    explain,
)
from fte_sniff.protocol.spec import NAME_OF_ROLE, Role
from fte_sniff.tui.cells import span_text, turns_text
from fte_sniff.tui.i18n import _, later
from fte_sniff.tui.painter import NO_ANSWER, Palette, Sign
from fte_sniff.tui.panes.pane import FIELD, Pane, PaneContext

INLINE_BYTES = 4
"""A field of at most this many bytes shows them before its name; others below it."""

DETAIL_BYTES = 8
"""Bytes in a line below a field's name."""

MIN_TEXT_CELLS = 30
"""Cells that a text needs at least to start after the value; else it is below."""

UNCERTAIN_ORDER = later(
    "the order with rows of the other port is uncertain: the times are too close"
)

_HEX_WIDTH = 3 * INLINE_BYTES
_NAME_WIDTH = 10
_VALUE_WIDTH = 18
_INDENT = " " * (2 + _HEX_WIDTH)


def relation_lines(context: PaneContext) -> list[str]:
    """How the row and other rows belong together: a command and its answers."""
    command, answers = context.command, context.answers
    if command is not None:
        row, delay = context.row_text(command.command), span_text(command.delay_ns)
        if command.delay_ns is None:
            return [_("answers the command in {row}", row=row)]
        return [_("answers the command in {row}, {delay} later", row=row, delay=delay)]
    texts = [_answer_text(one, context) for one in answers]
    if len(set(texts)) == 1:
        return texts[:1]
    pairs = zip(answers, texts, strict=True)
    return [_("motor {motor}: {text}", motor=one.motor, text=text) for one, text in pairs]


def _answer_text(one: CommandAnswer, context: PaneContext) -> str:
    if one.answer is None:
        return _(NO_ANSWER[one.state])
    form = _("answered by {row}") if one.delay_ns is None else _("answered after {delay} by {row}")
    return _(form, row=context.row_text(one.answer), delay=span_text(one.delay_ns))


@dataclass(frozen=True, slots=True)
class DetailLayout:
    """Space for the text."""

    width: int
    """Cells; meanings and faults are wrapped to them."""
    bit_lines: bool
    field: int | None = None
    relations: tuple[str, ...] = ()


def detail_text(
    row: Row,
    palette: Palette,
    layout: DetailLayout,
    line_setup: LineSetup = DEFAULT_SETUP,
    zone: tzinfo = UTC,
) -> Text:
    """The explanation of a row; positions in turns too, where the set-up gives pulses per turn."""
    lines = _heading(row, palette, layout, zone)
    style = palette.statuses[row.status]
    mark = LOOKS[row.status].mark
    marked = [(mark, text, style) for text in explain(row)]
    if row.unordered:
        marked.append((ORDER_MARK, UNCERTAIN_ORDER, Style.null()))
    marked += [(Sign.PAIRED.value, text, palette.signs) for text in layout.relations]
    for sign, text, own in marked:
        lines += _marked_lines(sign, text, own, layout)
    fields = [_with_turns(field, line_setup) for field in dissect(row)]
    value_width = _VALUE_WIDTH if any(field.value for field in fields) else 0
    for number, field in enumerate(fields):
        meta = Style(meta={FIELD: number})
        for line in _field_lines(field, palette, layout, value_width, number == layout.field):
            line.stylize(meta)
            lines.append(line)
    for line in lines:
        line.truncate(layout.width, overflow="ellipsis")
    return Text("\n").join(lines)


def _marked_lines(mark: str, text: str, style: Style, layout: DetailLayout) -> list[Text]:
    parts = wrap(_(text), layout.width - 2)
    return [Text(f"{' ' if n else mark} {part}", style=style) for n, part in enumerate(parts)]


def _heading(row: Row, palette: Palette, layout: DetailLayout, zone: tzinfo) -> list[Text]:
    kind = row.kind
    name = kind.name if kind else _("unknown frame") if row.framed else _("damage")
    time = _("no time") if row.t_ns is None else iso_time(row.t_ns, zone)
    position = _(
        "offset {offset:,}  {length} bytes  {port}",
        offset=row.offset,
        length=len(row.raw),
        port=printable(row.port),
    )
    style = palette.of_kind(row) if kind else palette.statuses[row.status]
    lines = [Text(name, style=style + Style(bold=True))]
    for text in (time, position):
        line = Text.assemble(lines[-1], f"  {text}")
        if line.cell_len <= layout.width:
            lines[-1] = line
        else:
            lines.append(Text(f"  {text}"))
    return lines


def _with_turns(field: ExplainedField, line_setup: LineSetup) -> ExplainedField:
    """The field; with turns, where it is a decoded position."""
    if field.name != NAME_OF_ROLE[Role.POSITION] or not field.value:
        return field
    turns = turns_text(int.from_bytes(field.raw, "big", signed=True), line_setup)
    return field._replace(value=f"{field.value}, {turns}") if turns else field


def _field_lines(
    field: ExplainedField,
    palette: Palette,
    layout: DetailLayout,
    value_width: int,
    is_looked_at: bool,
) -> Iterator[Text]:
    """Bytes, name, value and meaning; then more bytes, the fault, and the bits."""
    style = palette.statuses[status_of((field.fault,))] if field.fault else Style.null()
    own = style if field.fault else palette.fields.get(field.name, Style.null())
    own += palette.field if is_looked_at else Style.null()
    mark = LOOKS[status_of((field.fault,))].mark if field.fault else " "
    inline = len(field.raw) <= INLINE_BYTES
    value = field.value
    if field.bits:
        value += "  " + "".join("01"[bit.is_set] for bit in reversed(field.bits))
    digits = spaced_hex(field.raw) if inline else ""
    line = Text.assemble(
        (mark, style),
        " ",
        (digits, own),
        " " * (_HEX_WIDTH - len(digits)),
        (field.name, own + Style(bold=True)),
        " " * max(1, _NAME_WIDTH + 1 - len(field.name)),
        f"{padded(value, value_width)} " if value_width else "",
    )
    first, *more = _wrapped_after(_(field.meaning), line.cell_len, layout)
    line.append(first, palette.muted)
    line.rstrip()
    note = _(field.note)
    if note and inline and not more and line.cell_len + 2 + cell_len(note) <= layout.width:
        line.append(f"  {note}", style)
        note = ""
    yield line
    for text in more:
        yield Text(text, style=palette.muted)
    for digits in [] if inline else _hex_lines(field.raw):
        yield Text.assemble((mark, style), " ", (digits, own))
    yield from _indented(note, style, layout)
    if not layout.bit_lines:
        yield from _indented(_bits_in_a_line(field.bits), palette.muted, layout)
        return
    for bit in field.bits:
        value, meaning = "01"[bit.is_set], _(bit.meaning)
        text = _(
            "bit {number} is {value}: {meaning}", number=bit.number, value=value, meaning=meaning
        )
        yield from _indented(text, Style.null() if bit.is_set else palette.muted, layout)


def _bits_in_a_line(bits: Sequence[ExplainedBit]) -> str:
    """All bits from the highest; those with the same label together."""
    runs = [
        f"{_(label)} {''.join('01'[bit.is_set] for bit in run)}"
        for label, run in groupby(reversed(bits), key=lambda bit: bit.label)
    ]
    return _("bits 7-0: {bits}", bits=listed(runs)) if runs else ""


def _wrapped_after(text: str, start: int, layout: DetailLayout) -> list[str]:
    """The text from cell `start` on, later lines indented; all below where that is too narrow."""
    if not text:
        return [""]
    width = layout.width - start
    if width >= MIN_TEXT_CELLS or width >= cell_len(text):
        first, *more = wrap(text, width)
        return [first, *(" " * start + line for line in more)]
    return ["", *(_INDENT + line for line in wrap(text, layout.width - len(_INDENT)))]


def _indented(text: str, style: Style, layout: DetailLayout) -> list[Text]:
    lines = wrap(text, layout.width - len(_INDENT))
    return [Text(_INDENT + line, style=style) for line in lines]


def _hex_lines(raw: bytes) -> list[str]:
    starts = range(0, len(raw), DETAIL_BYTES)
    return [spaced_hex(raw[start : start + DETAIL_BYTES]) for start in starts] or [""]


class DetailPane(Pane):
    """The explanation of the cursor's row."""

    NAME = "detail"
    EXPLAINS_ROW = True
    HINT = later("[ ]: field   J K: scroll   esc: close")
    _index: int | None = None

    def draw(self, context: PaneContext) -> None:
        """Explain the cursor's row, where it is not explained already."""
        self.set_title(_("the row, byte by byte"))
        layout = DetailLayout(
            self.page_size.width,
            self.screen.has_class("-tall"),
            context.field,
            tuple(relation_lines(context)),
        )
        setup, zone, row = context.line_setup, context.zone, context.row
        if row is None:
            self.set_page_of(Text, _("no row"))
        elif (
            self.set_page_of(detail_text, row, context.palette, layout, setup, zone)
            and context.index != self._index
        ):
            self._index = context.index
            self.scroll_home(animate=False)


CONTEXT_LINES = 6
"""Least lines before the row's first one, and after its last one."""

MAX_ROWS_SEARCHED = 20_000
"""Rows of other ports among which the port's neighbours are searched for."""

DUMP_BYTES = (32, 16, 8)
"""The first that fits is used, or else the last."""


_OFFSET_WIDTH = 12
_STEP_ROWS = 32


def neighbours(store: RowStore, index: int, before: int, after: int) -> list[Row]:
    """The row at an index, with the rows of its port that have the bytes before and after it.

    `before` and `after` are numbers of bytes. Raises IndexError for an unknown row.
    """
    row = store.row(index)
    start, end = row.offset - before, row.offset + len(row.raw) + after
    backwards = (other for other in _backwards(store, index) if other.port == row.port)
    forwards = (other for other in _forwards(store, index) if other.port == row.port)
    near_before = takewhile(lambda other: other.offset + len(other.raw) > start, backwards)
    near_after = takewhile(lambda other: other.offset < end, forwards)
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
    per_line = next((n for n in DUMP_BYTES if _cells(n) + n < width), DUMP_BYTES[-1])
    stream = _ByteDump(row, rows, palette, field)
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


class _ByteDump:
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
            self._bytes |= dict(enumerate(other.raw, other.offset))
            self._styles |= dict(enumerate(styles, other.offset))
        for number, field in enumerate(dissect(row)):
            for offset in field.offsets:
                own = self._styles[row.offset + offset]
                # The background of a fault is over that of the row.
                look = own + palette.field if number == looked_at else palette.cursor_row + own
                self._styles[row.offset + offset] = look + Style(meta={FIELD: number})

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
    HINT = later("<this row>   [ ]: field   J K: scroll   esc: close")

    def draw(self, context: PaneContext) -> None:
        """Dump the bytes around the cursor's row, where they are not shown already."""
        if context.row is None or context.index is None:
            self.set_page_of(Text, _("no row"))
            return
        around = CONTEXT_LINES
        if not (self.styles.height is None or self.styles.height.is_auto):
            around = max(around, (self.page_size.height - 1) // 2)
        reach = around * DUMP_BYTES[0]
        rows = neighbours(context.store, context.index, reach, reach)
        self.set_title(_("bytes around offset {offset:,}", offset=context.row.offset))
        width, palette = self.page_size.width, context.palette
        self.set_page_of(dump, context.row, rows, width, palette, context.field, around)
