"""The page about the cursor's row: each byte explained, and the bytes around it.

12,340  AA 01 01 03 E8 00 00 00 00 EE<55 01 01 03 E8 00
12,356  00 00 0F EE>AA 01 02 03 ...
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import groupby
from typing import ClassVar, Final

import numpy as np
from rich.table import Table
from rich.text import Text

from fte_sniff.analysis.relations import AnswerState
from fte_sniff.errors import listed, printable
from fte_sniff.formats.looks import LOOKS, ORDER_MARK
from fte_sniff.i18n import _, later
from fte_sniff.protocol.columns import iso_time, spaced_hex
from fte_sniff.protocol.dissect import ExplainedBit, ExplainedField, dissect, explain
from fte_sniff.protocol.rows import Row
from fte_sniff.protocol.spec import NAME_OF_ROLE, Role, Status, status_of
from fte_sniff.tui.cells import span_text, turns_text
from fte_sniff.tui.pages import Context, Page, text_of
from fte_sniff.tui.painter import BOLD, REVERSED, UNDERLINED, Palette, Sign
from fte_sniff.tui.view import Answered

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

_HEX_WIDTH: Final = len("00 00 00 00")
"""Cells of the bytes of a field; more are below."""

AROUND_BYTES: Final = 32
"""Bytes before the row, and after it, that are shown."""


class DetailPage(Page):
    """The explanation of the cursor's row."""

    NAME = "detail"
    SHORT: ClassVar[bool] = True
    EXPLAINS_ROW: ClassVar[bool] = True

    def title(self, context: Context) -> str:
        """The title."""
        return _("the row, byte by byte")

    def text(self, context: Context) -> Text:
        """Heading, what it belongs to, its fields, and the bytes around it."""
        table = context.table
        row, index, palette = table.cursor_row, table.cursor_index, table.palette
        if row is None or index is None:
            return Text(_("no row"))
        signs, style = Table.grid(padding=(0, 1)), palette.statuses[row.status]
        for text in explain(row):
            signs.add_row(LOOKS[row.status].mark, _(text), style=style)
        if row.unordered:
            signs.add_row(ORDER_MARK, _(UNCERTAIN_ORDER))
        for text in relations(context, index):
            signs.add_row(Sign.PAIRED.value, text, style=palette.signs)
        return text_of(
            *(_heading(row, context), signs, _fields(row, context), ""),
            *bytes_around(context, row, index),
            width=context.size.width,
        )


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


def _heading(row: Row, context: Context) -> Text:
    name = row.kind.name if row.kind else _("unknown frame") if row.framed else _("damage")
    time = _("no time") if row.t_ns is None else iso_time(row.t_ns, context.table.look.shown_zone)
    position = _(
        "offset {offset:,}  {length} bytes  {port}",
        offset=row.offset,
        length=len(row.raw),
        port=printable(row.port),
    )
    return Text.assemble(
        (name, context.table.palette.statuses[row.status] + BOLD), f"  {time}  {position}"
    )


def _with_turns(field: ExplainedField, pulses_per_turn: float | None) -> ExplainedField:
    """The field; with turns, where it is a decoded position, and a turn is known."""
    if field.name != NAME_OF_ROLE[Role.POSITION] or not field.value or not pulses_per_turn:
        return field
    turns = turns_text(int.from_bytes(field.raw, "big", signed=True), pulses_per_turn)
    return field._replace(value=f"{field.value}, {turns}")


def _fields(row: Row, context: Context) -> Table:
    """Sign, bytes, name, value and meaning of each field; with the meaning, its fault and bits."""
    palette, table = context.table.palette, Table.grid(padding=(0, 1, 0, 0))
    table.add_column(no_wrap=True)
    table.add_column(max_width=_HEX_WIDTH)
    for number, field in enumerate(dissect(row)):
        field = _with_turns(field, context.view.pulses_per_turn)
        status = status_of((field.fault,)) if field.fault else Status.OK
        style = palette.statuses[status]
        own = style + REVERSED + UNDERLINED if number == context.table.field else style
        value = f"{field.value}  {''.join('01'[bit.is_set] for bit in reversed(field.bits))}"
        texts = (
            Text(_(field.meaning), palette.muted),
            Text(_(field.note), style),
            Text(_bits_in_a_line(field.bits), palette.muted),
        )
        table.add_row(
            Text(LOOKS[status].mark, style),
            Text(spaced_hex(field.raw), own),
            Text(field.name, own + BOLD),
            value.strip(),
            Text("\n").join(filter(None, texts)),
        )
    return table


def _bits_in_a_line(bits: Sequence[ExplainedBit]) -> str:
    """All bits from the highest; those with the same label together."""
    runs = [
        f"{_(label)} {''.join('01'[bit.is_set] for bit in run)}"
        for label, run in groupby(reversed(bits), key=lambda bit: bit.label)
    ]
    return _("bits 7-0: {bits}", bits=listed(runs)) if runs else ""


# The bytes around the row


def bytes_around(context: Context, row: Row, index: int) -> Iterator[Text]:
    """The bytes of the row's port before and after it, as a hex dump; rows are divided by `|`."""
    near = context.view.around(index)
    rows = near.rows.select(near.rows.port == near.rows.ports.index(row.port))
    start, stop = row.offset - AROUND_BYTES, row.offset + len(row.raw) + AROUND_BYTES
    beside = (rows.offset + rows.length.astype(np.int64) > start) & (rows.offset < stop)
    found, starts = dict[int, int](), set[int]()
    for other in rows.select(np.flatnonzero(beside)):
        found |= dict(enumerate(other.raw, other.offset))
        starts.add(other.offset)
    per_line = 16 if context.size.width >= 16 * 4 + 14 else 8
    yield Text(_("bytes around offset {offset:,}", offset=row.offset), "bold")
    own = range(row.offset, row.offset + len(row.raw))
    for first in range(max(0, start) // per_line * per_line, stop, per_line):
        offsets = range(first, first + per_line)
        if any(one in found for one in offsets):
            yield _dump_line(offsets, found, starts, own, context.table.palette)


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
