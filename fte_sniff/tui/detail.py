"""The page about the cursor's row: each byte explained, and the bytes around it.

12,340  AA 01 01 03 E8 00 00 00 00 EE<55 01 01 03 E8 00
12,356  00 00 0F EE>AA 01 02 03 ...
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import ClassVar, Final

import numpy as np
from rich.cells import cell_len
from rich.style import Style
from rich.text import Text

from fte_sniff.analysis.line_setup import LineSetup
from fte_sniff.analysis.relations import AnswerState
from fte_sniff.errors import listed, printable
from fte_sniff.formats.cell_text import padded, wrap
from fte_sniff.formats.looks import LOOKS, ORDER_MARK
from fte_sniff.i18n import _, later
from fte_sniff.protocol import iso_time, spaced_hex, status_of
from fte_sniff.protocol.dissect import ExplainedBit, ExplainedField, dissect, explain
from fte_sniff.protocol.rows import Row, Rows
from fte_sniff.protocol.spec import NAME_OF_ROLE, Role
from fte_sniff.tui.cells import span_text, turns_text
from fte_sniff.tui.pages import Context, Page
from fte_sniff.tui.painter import BOLD, Palette, Sign
from fte_sniff.tui.view import Answered

INLINE_BYTES: Final = 4
"""A field of at most this many bytes shows them before its name; others below it."""

MIN_TEXT_CELLS: Final = 30
"""Cells that a text needs at least to start after the value; else it is below."""

UNCERTAIN_ORDER: Final = later(
    "the order with rows of the other port is uncertain: the times are too close"
)

NO_ANSWER: Final = {
    AnswerState.UNANSWERED: later(
        "unanswered: the motor's next command, or the deadline, came first"
    ),
    AnswerState.UNKNOWN: later("whether it was answered is unknown"),
    AnswerState.HIDDEN: later("whether it was answered is unknown: a filter hid the feedback"),
    AnswerState.UNCOVERED: later("whether it was answered is unknown: no feedback came before it"),
}
"""What is known of a command that has no answer."""

_HEX_WIDTH: Final = 3 * INLINE_BYTES
_NAME_WIDTH: Final = 10
_VALUE_WIDTH: Final = 18
_INDENT: Final = " " * (2 + _HEX_WIDTH)

AROUND_BYTES: Final = 32
"""Bytes before the row, and after it, that are shown."""


@dataclass(frozen=True, slots=True)
class _Layout:
    palette: Palette
    width: int
    field: int | None


class DetailPage(Page):
    """The explanation of the cursor's row."""

    NAME = "detail"
    SHORT: ClassVar[bool] = True
    EXPLAINS_ROW: ClassVar[bool] = True

    def titles(self, context: Context) -> Sequence[str]:
        """The title."""
        return [_("the row, byte by byte")]

    def text(self, context: Context) -> Text:
        """Heading, what it belongs to, its fields, and the bytes around it."""
        row, index = context.row, context.index
        if row is None or index is None:
            return Text(_("no row"))
        layout = _Layout(context.palette, context.size.width, context.field)
        lines = _heading(row, context, layout)
        style = context.palette.statuses[row.status]
        marked = [(LOOKS[row.status].mark, text, style) for text in explain(row)]
        if row.unordered:
            marked.append((ORDER_MARK, UNCERTAIN_ORDER, Style.null()))
        marked += [
            (Sign.PAIRED.value, text, context.palette.signs) for text in relations(context, index)
        ]
        for sign, text, own in marked:
            parts = wrap(_(text), layout.width - 2)
            lines += [Text(f"{' ' if n else sign} {part}", own) for n, part in enumerate(parts)]
        fields = [_with_turns(field, context.view.setup) for field in dissect(row)]
        value_width = _VALUE_WIDTH if any(field.value for field in fields) else 0
        for number, field in enumerate(fields):
            lines += _field_lines(field, layout, value_width, number == layout.field)
        lines += [Text(), *bytes_around(context, row, index)]
        for line in lines:
            line.truncate(layout.width, overflow="ellipsis")
        return Text("\n").join(lines)


def relations(context: Context, index: int) -> list[str]:
    """How the row and other rows belong together: a command and its answers."""
    near = context.view.around(index)
    answers, command = near.answers_of(index), near.command_of(index)
    if command is not None:
        row, t_ns = context.row_text(command), near.rows.t_ns
        delay_ns = int(t_ns[index - near.first] - t_ns[command - near.first])
        return [
            _("answers the command in {row}, {delay} later", row=row, delay=span_text(delay_ns))
        ]
    texts = [_answer_text(one, context) for one in answers]
    if len(set(texts)) == 1:
        return texts[:1]
    pairs = zip(answers, texts, strict=True)
    return [_("motor {motor}: {text}", motor=one.motor, text=text) for one, text in pairs]


def _answer_text(one: Answered, context: Context) -> str:
    if one.answer is None:
        return _(NO_ANSWER[one.state])
    form = _("answered by {row}") if one.delay_ns is None else _("answered after {delay} by {row}")
    return _(form, row=context.row_text(one.answer), delay=span_text(one.delay_ns))


def _heading(row: Row, context: Context, layout: _Layout) -> list[Text]:
    name = row.kind.name if row.kind else _("unknown frame") if row.framed else _("damage")
    time = _("no time") if row.t_ns is None else iso_time(row.t_ns, context.zone)
    position = _(
        "offset {offset:,}  {length} bytes  {port}",
        offset=row.offset,
        length=len(row.raw),
        port=printable(row.port),
    )
    lines = [Text(name, context.palette.statuses[row.status] + BOLD)]
    for text in (time, position):
        if lines[-1].cell_len + 2 + cell_len(text) <= layout.width:
            lines[-1].append(f"  {text}", Style(bold=False))
        else:
            lines.append(Text(f"  {text}"))
    return lines


def _with_turns(field: ExplainedField, setup: LineSetup) -> ExplainedField:
    """The field; with turns, where it is a decoded position."""
    if field.name != NAME_OF_ROLE[Role.POSITION] or not field.value:
        return field
    turns = turns_text(int.from_bytes(field.raw, "big", signed=True), setup)
    return field._replace(value=f"{field.value}, {turns}") if turns else field


def _field_lines(
    field: ExplainedField, layout: _Layout, value_width: int, is_looked_at: bool
) -> Iterator[Text]:
    """Bytes, name, value and meaning; then more bytes, the fault, and the bits."""
    palette = layout.palette
    style = palette.statuses[status_of((field.fault,))] if field.fault else Style.null()
    own = style + palette.field if is_looked_at else style
    mark = LOOKS[status_of((field.fault,))].mark if field.fault else " "
    inline = len(field.raw) <= INLINE_BYTES
    value = field.value
    if field.bits:
        value += "  " + "".join("01"[bit.is_set] for bit in reversed(field.bits))
    digits = spaced_hex(field.raw) if inline else ""
    line = Text.assemble(
        *((mark, style), " ", (digits, own), " " * (_HEX_WIDTH - len(digits))),
        *((field.name, own + BOLD), " " * max(1, _NAME_WIDTH + 1 - len(field.name))),
        f"{padded(value, value_width)} " if value_width else "",
    )
    first, *more = _wrapped_after(_(field.meaning), line.cell_len, layout.width)
    line.append(first, palette.muted)
    line.rstrip()
    note = _(field.note)
    if note and inline and not more and line.cell_len + 2 + cell_len(note) <= layout.width:
        line.append(f"  {note}", style)
        note = ""
    yield line
    for text in more:
        yield Text(text, palette.muted)
    if not inline:
        yield Text.assemble((mark, style), " ", (spaced_hex(field.raw), own))
    yield from _indented(note, style, layout.width)
    yield from _indented(_bits_in_a_line(field.bits), palette.muted, layout.width)


def _bits_in_a_line(bits: Sequence[ExplainedBit]) -> str:
    """All bits from the highest; those with the same label together."""
    runs = [
        f"{_(label)} {''.join('01'[bit.is_set] for bit in run)}"
        for label, run in groupby(reversed(bits), key=lambda bit: bit.label)
    ]
    return _("bits 7-0: {bits}", bits=listed(runs)) if runs else ""


def _wrapped_after(text: str, start: int, width: int) -> list[str]:
    """The text from cell `start` on, later lines indented; all below where that is too narrow."""
    if not text:
        return [""]
    left = width - start
    if left >= MIN_TEXT_CELLS or left >= cell_len(text):
        first, *more = wrap(text, left)
        return [first, *(" " * start + line for line in more)]
    return ["", *(_INDENT + line for line in wrap(text, width - len(_INDENT)))]


def _indented(text: str, style: Style, width: int) -> list[Text]:
    return [Text(_INDENT + line, style) for line in wrap(text, width - len(_INDENT))]


# The bytes around the row


def bytes_around(context: Context, row: Row, index: int) -> Iterator[Text]:
    """The bytes of the row's port before and after it, as a hex dump; rows are divided by `|`."""
    near = context.view.around(index)
    rows = near.rows.select(near.rows.port == near.rows.ports.index(row.port))
    start, stop = row.offset - AROUND_BYTES, row.offset + len(row.raw) + AROUND_BYTES
    beside = (rows.offset + rows.length.astype(np.int64) > start) & (rows.offset < stop)
    found, starts = dict[int, int](), set[int]()
    for other in _in_order(rows, np.flatnonzero(beside)):
        found |= dict(enumerate(other.raw, other.offset))
        starts.add(other.offset)
    per_line = 16 if context.size.width >= 16 * 4 + 14 else 8
    yield Text(_("bytes around offset {offset:,}", offset=row.offset), "bold")
    own = range(row.offset, row.offset + len(row.raw))
    for first in range(max(0, start) // per_line * per_line, stop, per_line):
        offsets = range(first, first + per_line)
        if any(one in found for one in offsets):
            yield _dump_line(offsets, found, starts, own, context.palette)


def _in_order(rows: Rows, at: np.ndarray[tuple[int], np.dtype[np.int64]]) -> Iterator[Row]:
    return iter(rows.select(at))


def _dump_line(
    offsets: range, found: dict[int, int], starts: set[int], own: range, palette: Palette
) -> Text:
    """Offset, bytes with the signs between them, and characters."""
    line, characters = Text(f"{offsets.start:>12,} ", palette.muted), ""
    for offset in offsets:
        sign = "|" if offset in starts else " "
        sign = "<" if offset == own.start else ">" if offset == own.stop else sign
        byte = found.get(offset)
        line.append(sign, palette.signs if sign in "<>" else palette.muted)
        style = BOLD if offset in own else palette.muted
        line.append("··" if byte is None else f"{byte:02X}", style)
        characters += (
            " " if byte is None else chr(byte) if chr(byte).isprintable() and byte < 127 else "."
        )
    return line.append(f"  {characters}", palette.muted)
