"""Detail pane: a row explained byte by byte."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, tzinfo
from itertools import groupby

from rich.cells import cell_len
from rich.style import Style
from rich.text import Text

from fte_sniff.analysis.relations import AnswerState, CommandAnswer
from fte_sniff.analysis.statistics import DEFAULT_SETUP, LineSetup
from fte_sniff.errors import listed, printable
from fte_sniff.formats.cell_text import moment_text, padded, wrap
from fte_sniff.formats.text_layout import ORDER_MARK
from fte_sniff.protocol import Frame, Row, spaced_hex, status_of
from fte_sniff.protocol.dissect import ExplainedBit, ExplainedField, dissect, explain
from fte_sniff.tui.i18n import _, later
from fte_sniff.tui.panes.pane import FIELD, Pane, PaneContext
from fte_sniff.tui.table.columns import MARKS
from fte_sniff.tui.table.painter import Sign
from fte_sniff.tui.table.theme import Palette
from fte_sniff.tui.text import span_text, turns_text

INLINE_BYTES = 4
"""A field of at most this many bytes shows them before its name; others below it."""

BYTES_PER_LINE = 8
"""Bytes in a line below a field's name."""

MIN_TEXT_CELLS = 30
"""Cells that a text needs at least to start after the value; else it is below."""

TALL = 40
"""Lines of the terminal from which on each bit of a flag byte has a line of its own."""

UNCERTAIN_ORDER = later(
    "the order with rows of the other port is uncertain: the times are too close"
)

_HEX_WIDTH = 3 * INLINE_BYTES
_NAME_WIDTH = 10
_VALUE_WIDTH = 18
_INDENT = " " * (2 + _HEX_WIDTH)


STATES = {
    AnswerState.UNANSWERED: later("unanswered: the next command to the motor came first"),
    AnswerState.WAITING: later("unanswered so far"),
    AnswerState.UNKNOWN: later("whether it was answered is unknown"),
}


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
        return _(STATES[one.state])
    form = _("answered by {row}") if one.delay_ns is None else _("answered after {delay} by {row}")
    return _(form, row=context.row_text(one.answer), delay=span_text(one.delay_ns))


@dataclass(frozen=True, slots=True)
class DetailLayout:
    """Space for the text."""

    width: int
    """Cells; meanings and faults are wrapped to them."""
    bit_lines: bool
    """Whether each bit of a flag byte has a line of its own."""
    field: int | None = None
    """Number of the field that is highlighted."""
    relations: tuple[str, ...] = ()
    """Result of `relation_lines`."""


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
    marked = [(MARKS[row.status], explanation, style) for explanation in explain(row)]
    if row.order_uncertain:
        marked.append((ORDER_MARK, UNCERTAIN_ORDER, Style.null()))
    marked += [(Sign.PAIRED.value, text, palette.signs) for text in layout.relations]
    for mark, text, style in marked:
        for n, part in enumerate(wrap(_(text), layout.width - 2)):
            lines.append(Text(f"{' ' if n else mark} {part}", style=style))
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


def _heading(row: Row, palette: Palette, layout: DetailLayout, zone: tzinfo) -> list[Text]:
    kind = row.kind if isinstance(row, Frame) else None
    name = kind.name if kind else _("unknown frame") if isinstance(row, Frame) else _("damage")
    time = _("no time") if row.t_ns is None else moment_text(row.t_ns, zone)
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
    if field.name != "pulses" or not field.value:
        return field
    turns = turns_text(int.from_bytes(field.raw, "big", signed=True), line_setup)
    return replace(field, value=f"{field.value}, {turns}") if turns else field


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
    mark = MARKS[status_of((field.fault,))] if field.fault else " "
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
    yield line
    for text in more:
        yield Text(text, style=palette.muted)
    for digits in [] if inline else _hex_lines(field.raw):
        yield Text.assemble((mark, style), " ", (digits, own))
    yield from _indented(_(field.note), style, layout)
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
    starts = range(0, len(raw), BYTES_PER_LINE)
    return [spaced_hex(raw[start : start + BYTES_PER_LINE]) for start in starts] or [""]


class DetailPane(Pane):
    """The explanation of the cursor's row."""

    NAME = "detail"
    EXPLAINS_ROW = True
    HINT = later("[ ]: field   J K: scroll   esc: close")
    _index: int | None = None
    """Index of the row that is shown."""

    def draw(self, context: PaneContext) -> None:
        """Explain the cursor's row, where it is not explained already."""
        self.set_title(_("the row, byte by byte"))
        layout = DetailLayout(
            self.page_size.width,
            self.app.size.height >= TALL,
            context.field,
            tuple(relation_lines(context)),
        )
        setup, zone = context.line_setup, context.zone
        if context.row is None:
            self.set_page_of(Text, _("no row"))
        elif (
            self.set_page_of(detail_text, context.row, context.palette, layout, setup, zone)
            and context.index != self._index
        ):
            self._index = context.index
            self.scroll_home(animate=False)
