"""What the table draws: its styles, and rows as lines of styled segments.

Colour is for status only: damage, suspect rows, flags, hits. What is about a row itself, such as
its kind and values, is plain, and bold in commands.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, cached_property, lru_cache
from itertools import groupby
from typing import Final, TypeAlias

from rich.cells import cell_len
from rich.segment import Segment
from rich.style import Style
from textual.strip import Strip

from fte_sniff.errors import ExplainedWord
from fte_sniff.formats.cell_text import fit
from fte_sniff.formats.looks import LOOKS, mark_of
from fte_sniff.protocol.columns import record, spaced_hex
from fte_sniff.protocol.dissect import dissect
from fte_sniff.protocol.rows import Row
from fte_sniff.protocol.spec import FRAME_LENGTH, Direction, Status, status_of
from fte_sniff.tui.cells import (
    RAISED_MARK,
    TableColumn,
    TableLayout,
    bytes_text,
    padded_cell,
    value_parts,
)

PLAIN: Final = Style.null()
BOLD: Final = Style(bold=True)
REVERSED: Final = Style(reverse=True, bold=True)
UNDERLINED: Final = Style(underline=True)


@dataclass(frozen=True, eq=False)
class Palette:
    """Styles under dark or light themes."""

    muted: Style
    """Times, bytes, labels."""
    statuses: Mapping[Status, Style]
    good: Style
    raised: Style
    """Flags that are raised."""
    signs: Style
    """Signs of rows, and the lines of events."""
    changed: Style
    """Bytes that differ from the frame before."""

    def of_bytes(self, row: Row, *, is_raised: bool) -> list[Style]:
        """The style of each byte: muted, or that of its fault or flag."""
        plain = self.statuses[row.status] if row.kind is None else self.muted
        styles = [plain] * len(row.raw)
        if row.faults or is_raised:
            for field in dissect(row):
                for at in field.offsets:
                    if field.fault is not None:
                        styles[at] = self.statuses[status_of((field.fault,))] + REVERSED
                    elif field.is_raised:
                        styles[at] = self.raised + REVERSED
        return styles


def _palette(
    suspect: str, malformed: str, muted: str, good: str, raised: str, signs: str, changed: str
) -> Palette:
    """Colours as `#rrggbb`; the contrast by WCAG 2 is at least 4.5 on the ground of each theme."""
    statuses = {Status.SUSPECT: Style(color=suspect), Status.MALFORMED: Style(color=malformed)}
    return Palette(
        muted=Style(color=muted),
        statuses={Status.OK: PLAIN} | statuses,
        good=Style(color=good),
        raised=Style(color=raised),
        signs=Style(color=signs, bold=True),
        changed=Style(color=changed) + REVERSED,
    )


DARK: Final = _palette("#f0e442", "#ff8f50", "#96a0ac", "#5fd38d", "#f5a3a3", "#56b4e9", "#c9a0ff")
LIGHT: Final = _palette("#6b5e00", "#a33c00", "#566069", "#00694b", "#a01030", "#0062a0", "#6a3fb0")


_BYTE_CELLS: Final = 3

_Run: TypeAlias = tuple[str, Style]
"""A text and its style, without that of the line."""

_SPACE: Final = (" ", PLAIN)


class Sign(ExplainedWord):
    """The sign in the first cell after the status."""

    NONE = " ", ""
    MARKED = "*", "marked by m"
    NOTED = "#", "marked, with a note"
    SELECTED = "|", "selected by v"
    UNANSWERED = "x", "a command without an answer"
    PAIRED = "&", "the command or the answer of the row under the cursor"


@dataclass(frozen=True, slots=True)
class RowCell:
    """A row with its sign, as a line of the window shows it."""

    row: Row
    sign: Sign = Sign.NONE
    time_ns: int | None = None
    """The time that is shown: since 1970 UTC, or since another time."""
    delta_ns: int | None = None
    changed: tuple[bool, ...] | None = None
    """By byte, whether it differs from the frame before; None where that is not shown."""
    field: range | None = None
    is_raised: bool = False
    """Whether a flag byte differs from its default."""


EVENT_SIGN: Final = "="


@dataclass(frozen=True)
class Painter:
    """Paints rows for one layout, palette and width."""

    layout: TableLayout
    palette: Palette
    width: int
    hidden: int = 0
    """Columns after the first that are scrolled out at the left."""

    def row(self, cell: RowCell, line: Style) -> Strip:
        """The row, over the style of its line."""
        signs = PLAIN if cell.sign is Sign.NONE else self.palette.signs
        runs = [self._mark(cell), (cell.sign.value, signs)]
        for number, column in enumerate(self._columns.columns):
            runs += [_SPACE] if number else []
            runs += self._cell(column, cell)
        used = max(self._columns.width, 2)  # the mark and the sign, without any column
        runs.append((" " * (self.width - used), PLAIN))
        # Measured by Textual, a line takes twice as long.
        return self._strip(runs, line, max(self.width, used)).crop(0, self.width)

    def event(self, text: str, line: Style) -> Strip:
        """The line of a port event or a gap; the text is printable."""
        text = fit(f" {text} ", self.width - 1).rstrip()
        rule = "─" * max(0, self.width - 1 - cell_len(text) - 1)
        strip = self._strip([(f"{EVENT_SIGN}{text} {rule}", self.palette.signs)], line)
        return strip.adjust_cell_length(self.width, line)

    def head(self, line: Style) -> Strip:
        """The column names, with `<` and `>` where there are more columns."""
        runs = [(LOOKS[Status.OK].mark, PLAIN)]
        for number, column in enumerate(self._columns.columns):
            edge = "<" if number == 1 and self.hidden else " "
            runs.append((edge + column.head_cell, PLAIN))
        strip = self._strip(runs, line).adjust_cell_length(self.width, line)
        if self.shown.width > self.width > 0:
            strip = Strip([*strip.crop(0, self.width - 1), Segment(">", line)], self.width)
        return strip

    def _mark(self, cell: RowCell) -> _Run:
        row = cell.row
        if row.status is Status.OK and cell.is_raised:
            return RAISED_MARK, self.palette.raised + REVERSED
        style = PLAIN if row.status is Status.OK else self.palette.statuses[row.status] + REVERSED
        return mark_of(row), style

    @cached_property
    def shown(self) -> TableLayout:
        """The columns that are not scrolled out."""
        return self.layout.without(self.hidden)

    @cached_property
    def _columns(self) -> TableLayout:
        return self.shown.within(self.width)

    def _cell(self, column: TableColumn, cell: RowCell) -> Sequence[_Run]:
        """The runs of one cell, exactly as wide as its column."""
        row, style = cell.row, self.palette.muted
        value: object
        match column.name:
            case "raw":
                return self._bytes(column, cell)
            case "values":
                return self._short_values(column, cell)
            case "time" | "delta" as name:
                value = getattr(cell, f"{name}_ns")
            case "kind":
                value, style = row.kind and row.kind.name, _weight(row)
            case "faults" | "status" as name:
                value, style = getattr(row, name), self.palette.statuses[row.status]
            case "port" | "offset" | "direction" | "cmd" as name:
                value = getattr(row, name)
            case "length":
                value = len(row.raw)
            case name:
                value, style = record(row)[name], self._value_style(name, row)
        return [(padded_cell(column, value), style)]

    def _value_style(self, name: str, row: Row) -> Style:
        """Bold in commands; that of a flag if it is raised."""
        kind = row.kind
        field = kind.field(name) if kind else None
        if field is None:
            return self.palette.muted
        return self.palette.raised if field.raised(field.read(row.raw)) else _weight(row)

    def _short_values(self, column: TableColumn, cell: RowCell) -> Sequence[_Run]:
        """The values, after the faults where their column is not in the window."""
        row, left = cell.row, column.width
        runs = list[_Run]()
        if row.faults and all(one.name != "faults" for one in self._columns.columns):
            faults = fit(",".join(row.faults), min(left, sum(len(one) + 1 for one in row.faults)))
            runs.append((faults, self.palette.statuses[row.status]))
            left -= len(faults)
        parts = value_parts(row.kind, row.raw, left) if row.kind else ()
        text = fit(" ".join(one for one, _field in parts), left)
        for one, field in parts if cell.is_raised else ():
            end = len(one)
            runs += [(text[:end], self._value_style(field.name, row)), (text[end : end + 1], PLAIN)]
            text = text[end + 1 :]
        return [*runs, (text, _weight(row))]

    def _bytes(self, column: TableColumn, cell: RowCell) -> Sequence[_Run]:
        row, width, palette = cell.row, column.width, self.palette
        if len(row.raw) > FRAME_LENGTH:
            return [(fit(bytes_text(row.raw, width), width), palette.statuses[row.status])]
        text = fit(spaced_hex(row.raw), width)
        if not (row.faults or cell.is_raised or cell.field or cell.changed):
            return [(text, palette.muted)]
        styles = palette.of_bytes(row, is_raised=cell.is_raised)
        for at, style in enumerate(styles):
            if cell.field is not None and at in cell.field:
                styles[at] = style + REVERSED + UNDERLINED
            elif cell.changed is not None and cell.changed[at]:
                styles[at] = palette.changed
        runs, start = list[_Run](), 0
        for style, group in groupby(styles):
            end = start + _BYTE_CELLS * sum(1 for _ in group)
            runs += [(text[start : end - 1], style), (text[end - 1 : end], PLAIN)]
            start = end
        return [*runs, (text[start:], PLAIN)]

    def _strip(self, runs: Iterable[_Run], line: Style, length: int | None = None) -> Strip:
        # Fewer segments take less time to draw; `Strip.apply_style` takes five times as long.
        texts, styles, is_boxed = [""], [PLAIN], False
        for text, style in runs:
            if style is styles[-1] or (style is PLAIN and not is_boxed and text.isspace()):
                texts[-1] += text
            elif text:
                texts.append(text)
                styles.append(style)
                is_boxed = _is_boxed(style)
        joined = zip(texts, styles, strict=True)
        return Strip([Segment(text, line + style) for text, style in joined if text], length)


painter_for: Final = lru_cache(8)(Painter)
"""A painter; the same one for the same arguments, so that it keeps its columns."""


def _weight(row: Row) -> Style:
    """Bold for commands."""
    kind = row.kind
    return BOLD if kind is not None and kind.direction is Direction.CONTROL else PLAIN


@cache
def _is_boxed(style: Style) -> bool:
    """Whether the style shows on a space."""
    return bool(style.underline or style.reverse or style.bgcolor)
