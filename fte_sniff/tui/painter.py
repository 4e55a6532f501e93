"""What the table draws: its colours, rows as lines of styled segments, signs in the scroll bar.

The scroll bar shows where faults, flags, marks, gaps and lost ports are in all rows; Textual's
`ScrollBarRender` draws only the thumb. Its signs differ from those of rows, since the bar is beside
rows of other times.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from functools import cache, cached_property, lru_cache
from itertools import accumulate, chain, groupby, pairwise, takewhile
from math import log
from typing import TYPE_CHECKING, Final, TypeAlias

from rich.cells import cell_len
from rich.color import Color as TerminalColor
from rich.color import ColorSystem
from rich.errors import StyleSyntaxError
from rich.segment import Segment, Segments
from rich.style import Style
from textual.color import Color
from textual.filter import LineFilter
from textual.scrollbar import ScrollBarRender
from textual.strip import Strip
from textual.theme import Theme

from fte_sniff.analysis.relations import AnswerState
from fte_sniff.analysis.row_store import Overview, RowNote, RowStore
from fte_sniff.analysis.search import Search
from fte_sniff.errors import FilterError, TranslatableText, quoted
from fte_sniff.formats.cell_text import fit
from fte_sniff.protocol import (
    FRAME_LENGTH,
    KINDS,
    VALUE_FIELDS,
    Direction,
    Field,
    Row,
    Rows,
    Status,
    Value,
    record,
    spaced_hex,
    status_of,
)
from fte_sniff.protocol.columns import LOOKS, Ground, mark_of
from fte_sniff.protocol.dissect import byte_names, dissect
from fte_sniff.protocol.spec import FIELD_BY_NAME
from fte_sniff.tui.cells import (
    DELTA,
    RAISED_MARK,
    VALUES,
    TableColumn,
    TableLayout,
    bytes_text,
    faulty_text,
    is_raised,
    value_parts,
)
from fte_sniff.tui.i18n import CONTRAST_DARK, CONTRAST_LIGHT, ExplainedWord, later

if TYPE_CHECKING:
    from fte_sniff.analysis.filter.row_filter import RowFilter


PLAIN = Style.null()
BOLD = Style(bold=True)
REVERSED = Style(reverse=True, bold=True)
"""What must be seen without colours."""


@dataclass(frozen=True)
class Palette:
    """Styles of the table under one theme."""

    muted: Style
    """Times, and the bytes of rows without faults."""
    target: Style
    statuses: Mapping[Status, Style]
    marks: Mapping[Status, Style]
    raised: Style
    """Values of a row with a raised flag byte."""
    raised_mark: Style
    signs: Style
    """Signs of rows, and the lines of port events and gaps."""
    found: Style
    """Hits of the search; underlined too, since there may be no colours."""
    field_hues: tuple[str, ...]
    """A colour for CMD, then for each field of a value, in the order of the frame table."""
    faint: Style
    changed: tuple[Style, ...]
    """Bytes that changed, by the frames since then."""
    field: Style
    """The bytes of the field that the user looks at."""
    cursor_row: Style
    """The bytes of the cursor's row among others."""
    framing: Style
    few_colors: bool = False
    """Whether fields also differ by underline and bold: the terminal has at most 16 colours."""

    @cached_property
    def kinds(self) -> Mapping[str, Style]:
        """The style of each kind, by name: the colour of what it is about, else that of CMD."""
        return {
            kind.name: Style(
                color=self.values[kind.subject].color if kind.subject else self.field_hues[0],
                bold=kind.direction is Direction.CONTROL,
            )
            for kind in KINDS
        }

    @cached_property
    def values(self) -> Mapping[str, Style]:
        """The colour of each field of a value, by name."""
        hues = self.field_hues[1:]
        return {
            field.name: Style(color=hues[number % len(hues)])
            for number, field in enumerate(VALUE_FIELDS)
        }

    @cached_property
    def fields(self) -> Mapping[str, Style]:
        """The style of each field's bytes, by its name in `dissect`."""
        looks = _LOOKS if self.few_colors else (PLAIN,)
        values = {
            name: style + looks[number % len(looks)]
            for number, (name, style) in enumerate(self.values.items())
        }
        framing = dict.fromkeys(("header", "tail", "num"), self.framing)
        cmd = Style(color=self.field_hues[0], bold=True if self.few_colors else None)
        return {**framing, "reserve": self.faint, "cmd": cmd, **values}

    @cached_property
    def _sound(self) -> Mapping[str, tuple[Style, ...]]:
        """The style of each byte of a frame without faults, by the name of its kind."""
        return {kind.name: tuple(self.fields[name] for name in byte_names(kind)) for kind in KINDS}

    def of_bytes(self, row: Row) -> Sequence[Style]:
        """The style of each byte: that of its field; of bytes with a fault, that of the fault."""
        kind = row.kind
        if kind is None:
            return self._of_damage(row)
        styles: Sequence[Style] = self._sound[kind.name]
        if row.faults or is_raised(row):
            for field in dissect(row):
                if field.fault is not None:
                    look = self._standing_out(self.marks[status_of((field.fault,))])
                elif field.is_raised:
                    look = self._standing_out(self.raised_mark)
                else:
                    continue
                styles = _styled(styles, field.offsets, look)
        return styles

    def _of_damage(self, row: Row) -> Sequence[Style]:
        styles: Sequence[Style] = (self.statuses[row.status],) * len(row.raw)
        for field in dissect(row):
            if field.fault is not None and field.name in ("header", "cmd", "tail", "extra"):
                look = self._standing_out(self.marks[row.status])
                styles = _styled(styles, field.offsets, look)
        return styles

    def _standing_out(self, mark: Style) -> Style:
        """The style of a mark for bytes: reversed where its background may not show."""
        return REVERSED if self.few_colors else mark

    def aged(self, style: Style, age: int) -> Style:
        """The style of a byte that changed `age` frames ago."""
        return style + self.changed[age] if age < len(self.changed) else self.faint

    def of_kind(self, row: Row) -> Style:
        """The style of the row's kind."""
        kind = row.kind
        return PLAIN if kind is None else self.kinds[kind.name]

    def of_values(self, row: Row) -> Style:
        """The style of the row's numbers."""
        command = row.direction is Direction.CONTROL
        return BOLD if command else PLAIN


_LOOKS = (Style(underline=True), PLAIN, Style(bold=True))
"""Looks of adjacent fields without colours."""


def _styled(styles: Sequence[Style], offsets: range, look: Style) -> Sequence[Style]:
    return (*styles[: offsets.start], *[look] * len(offsets), *styles[offsets.stop :])


def _sign(color: str, background: str) -> Style:
    return Style(color=color, bgcolor=background, bold=True)


def _statuses(ground: Ground) -> Mapping[Status, Style]:
    return {
        status: Style(color=look.inks[ground].text) if look.inks else PLAIN
        for status, look in LOOKS.items()
    }


def _marks(ground: Ground) -> Mapping[Status, Style]:
    return {
        status: _sign(*look.inks[ground][1:]) if look.inks else PLAIN
        for status, look in LOOKS.items()
    }


DARK = Palette(
    muted=Style(color="#96a0ac"),
    target=Style(color="#e6b04a"),
    statuses=_statuses(Ground.DARK),
    marks=_marks(Ground.DARK),
    raised=Style(color="#f5a3a3"),
    raised_mark=_sign("#101010", "#f5a3a3"),
    signs=Style(color="#56b4e9", bold=True),
    found=Style(color="#101010", bgcolor="#9fd8ff", underline=True),
    field_hues=(
        *("#dd9fc3", "#b3a1f0", "#56b4e9", "#2fc49b", "#f0906a", "#b8d35a", "#e6b04a"),
        *("#c9b8a0", "#7fcfd0"),
    ),
    faint=Style(color="#78828e"),
    changed=(
        Style(color="#101010", bgcolor="#c9a0ff", bold=True),
        Style(color="#d9c2ff", bgcolor="#4f3a80", bold=True),
        Style(color="#d9c2ff", bgcolor="#2f2250"),
        Style(color="#d4c8e8"),
    ),
    field=Style(color="#101010", bgcolor="#ffffff", bold=True, underline=True),
    cursor_row=Style(bgcolor="#0f3a5c", bold=True),
    framing=Style(color="#96a0ac"),
)
LIGHT = Palette(
    muted=Style(color="#566069"),
    target=Style(color="#7a5200"),
    statuses=_statuses(Ground.LIGHT),
    marks=_marks(Ground.LIGHT),
    raised=Style(color="#a01030"),
    raised_mark=_sign("#ffffff", "#a01030"),
    signs=Style(color="#0062a0", bold=True),
    found=Style(color="#101010", bgcolor="#a8dcff", underline=True),
    field_hues=(
        *("#8f3a6b", "#5b3fb0", "#0062a0", "#00694b", "#9a3412", "#4a6300", "#7a5200"),
        *("#6b4a3a", "#00626b"),
    ),
    faint=Style(color="#6c747c"),
    changed=(
        Style(color="#ffffff", bgcolor="#6a3fb0", bold=True),
        Style(color="#101010", bgcolor="#c9aef2", bold=True),
        Style(color="#101010", bgcolor="#e4d6f8"),
        Style(color="#5b3fb0"),
    ),
    field=Style(color="#ffffff", bgcolor="#101010", bold=True, underline=True),
    cursor_row=Style(bgcolor="#c4dcf0", bold=True),
    framing=Style(color="#566069"),
)


def _with_few_colors(palette: Palette, hues: tuple[str, ...], framing: Style) -> Palette:
    """The palette in the 16 colours of a terminal, with looks that need no colours."""
    _cmd, _motor, rpm, pulses, *_ = hues
    ground = Ground.DARK_16 if hues is _DARK_16 else Ground.LIGHT_16
    malformed = LOOKS[Status.MALFORMED].inks[ground]
    return replace(
        palette,
        statuses=_statuses(ground),
        marks=_marks(ground),
        raised=Style(color=malformed.text),
        raised_mark=_sign(*malformed[1:]),
        target=Style(color=pulses),
        signs=Style(color=rpm, bold=True),
        field_hues=hues,
        faint=framing,
        framing=framing,
        changed=_FEW_CHANGED,
        field=Style(reverse=True, bold=True, underline=True),
        cursor_row=Style(bold=True),
        few_colors=True,
    )


_FEW_CHANGED = (
    REVERSED,
    Style(bold=True, underline=True),
    Style(underline=True),
    PLAIN,
)
"""Changed bytes by age, without colours."""

# Among these, red is the colour of damage. On white, yellow, green and cyan are not readable.
_DARK_16 = ("#ff55ff", "#ffff55", "#55ffff", "#55ff55", "#ffff55", "#55ff55", "#ffffff")
_LIGHT_16 = ("#000000", "#aa00aa", "#0000aa", "#aa00aa", "#0000aa", "#aa00aa", "#000000")


_DARK = Theme(
    CONTRAST_DARK,
    primary="#6cb8ff",
    warning="#ffd24a",
    error="#ff9a6b",
    success="#7fe0b0",
    foreground="#ffffff",
    background="#000000",
    surface="#000000",
    panel="#202020",
    dark=True,
    variables={"primary-background": "#003a66"},
)
_LIGHT = Theme(
    CONTRAST_LIGHT,
    primary="#003f80",
    warning="#6b4a00",
    error="#8a2500",
    success="#00512f",
    foreground="#000000",
    background="#ffffff",
    surface="#ffffff",
    panel="#e0e0e0",
    dark=False,
    variables={"primary-background": "#b8d8f8"},
)
CONTRAST_THEMES = (_DARK, _LIGHT)

_PALETTES = {
    CONTRAST_DARK: replace(DARK, muted=Style(color="#ffffff"), faint=Style(color="#a0a0a0")),
    CONTRAST_LIGHT: replace(LIGHT, muted=Style(color="#000000"), faint=Style(color="#505050")),
}


class ColorRules:
    """Styles of rows that match a filter; the first rule that matches wins."""

    def __init__(self, rules: Mapping[str, str]) -> None:
        """Compile rules, a style by filter; those with a mistake are left out, see `mistakes`."""
        self.mistakes: list[str] = []
        """What is wrong with the rules, one line each."""
        self._rules: list[tuple[RowFilter, Style]] = []
        self._styles: dict[int, Style] = {}
        for text, style in rules.items():
            try:
                self._rules.append((_parsed(text), Style.parse(style)))
            except (FilterError, StyleSyntaxError) as error:
                mistake = TranslatableText(
                    "the rule {rule} in [colors] of the settings is ignored: {why}",
                    rule=quoted(text),
                    why=str(error),
                )
                self.mistakes.append(mistake)

    def styles(self, rows: Sequence[tuple[int, Row]]) -> Sequence[Style]:
        """The styles of rows with their indices; those of the previous call are known."""
        new = [(index, row) for index, row in rows if index not in self._styles]
        found = [PLAIN] * len(new)
        batch = Rows.of(row for _, row in new)
        for row_filter, style in reversed(self._rules if new else ()):
            for number in row_filter.matches(batch).nonzero()[0].tolist():
                found[number] = style
        known = self._styles | {index: style for (index, _), style in zip(new, found, strict=True)}
        self._styles = {index: known[index] for index, _ in rows}
        return list(self._styles.values())


def _parsed(text: str) -> RowFilter:
    # The import loads polars, which is slow; most screens have no rules.
    from fte_sniff.analysis.filter.row_filter import RowFilter

    return RowFilter.parse(text)


class Colors(Enum):
    """The colours of a terminal."""

    ALL = "all"
    SIXTEEN = "16"
    NONE = "none"


def palette_of(theme: Theme, colors: Colors = Colors.ALL) -> Palette:
    """The palette for a theme; it needs no colours where there are few or none."""
    return _palette(theme.name, theme.dark, colors)


@cache
def _palette(name: str, dark: bool, colors: Colors) -> Palette:
    palette = _PALETTES.get(name, DARK if dark else LIGHT)
    if colors is Colors.ALL:
        return palette
    # Dim text is not visible in all themes of 16 colours.
    framing = palette.muted if colors is Colors.SIXTEEN else Style(dim=True)
    return _with_few_colors(palette, _DARK_16 if dark else _LIGHT_16, framing)


_LEAST_CONTRAST = 3.0
"""Of a text and its background, by WCAG 2: from 1 to 21."""

_DARK_GROUND = 0.22
"""Luminance up to which a background needs white text, from 0 to 1; bright black has 0.216."""


class ReadableColors(LineFilter):
    """Draws text black or white where its colour is not readable among the terminal's 16.

    Both colours of a theme are replaced by the nearest of the 16, which may be similar.
    """

    def apply(self, segments: list[Segment], background: Color) -> list[Segment]:
        """The line with readable text."""
        return [
            Segment(text, None if style is None else _readable(style), control)
            for text, style, control in segments
        ]


@lru_cache(4096)
def _readable(style: Style) -> Style:
    text, ground = (_luminance_among_16(color) for color in (style.color, style.bgcolor))
    if text is None or ground is None:
        return style
    if (max(text, ground) + 0.05) / (min(text, ground) + 0.05) >= _LEAST_CONTRAST:
        return style
    return style + Style(color="#ffffff" if ground <= _DARK_GROUND else "#000000")


def _luminance_among_16(color: TerminalColor | None) -> float | None:
    """Relative luminance of the nearest of 16 colours, by WCAG 2; None for the default colour."""
    if color is None or color.is_default:
        return None
    parts = [part / 255 for part in color.downgrade(ColorSystem.STANDARD).get_truecolor()]
    red, green, blue = (p / 12.92 if p <= 0.04045 else ((p + 0.055) / 1.055) ** 2.4 for p in parts)
    return 0.2126 * red + 0.7152 * green + 0.0722 * blue


class NoColor(LineFilter):
    """Removes the colours of a line, as https://no-color.org asks."""

    def apply(self, segments: list[Segment], background: Color) -> list[Segment]:
        """The line without colours; every segment keeps a style, which Textual needs."""
        return [
            Segment(text, Style.null() if style is None else style.without_color, control)
            for text, style, control in segments
        ]


FAULT_COLUMNS = ("kind", VALUES, *(field.name for field in VALUE_FIELDS))
"""Columns that a row without values uses to show its faults."""

_BYTE_CELLS = 3

_Run: TypeAlias = tuple[str, Style]
"""A text and its style, without that of the line."""

_NOT_REVERSED: Final = Style(reverse=False)
_SPACE: Final = (" ", PLAIN)
_OWN_FIELDS: Final = {(kind.name, field.name): field for kind in KINDS for field in kind.fields}


def _on(line: Style, style: Style) -> Style:
    """A style without its background on a line that is highlighted."""
    return Style.combine([style, Style(bgcolor=line.bgcolor)]) if line.bold else style


class Sign(ExplainedWord):
    """The sign in the first cell after the status."""

    NONE = " ", ""
    MARKED = "*", "marked by m"
    NOTED = "#", "marked, with a note"
    SELECTED = "|", "selected by v"
    UNANSWERED = "x", "a command without an answer"
    PAIRED = "&", "the command or the answer of the row under the cursor"


NO_ANSWER: Final = {
    AnswerState.UNANSWERED: later(
        "unanswered: the motor's next command, or the deadline, came first"
    ),
    AnswerState.WAITING: later("unanswered so far"),
    AnswerState.UNKNOWN: later("whether it was answered is unknown"),
}
"""What is known of a command that has no answer."""


@dataclass(frozen=True, slots=True)
class RowCell:
    """A row with its sign, as a line of the window shows it."""

    row: Row
    sign: Sign = Sign.NONE
    time_ns: int | None = None
    """The time that is shown: since 1970 UTC, or since another time."""
    delta_ns: int | None = None
    ages: bytes | None = None
    """By byte, the frames since it changed; None where changes are not shown."""
    field: range | None = None
    style: Style | None = None
    """The user's style of the row, over all others but that of the line."""


EVENT_SIGN = "="


@dataclass(frozen=True)
class Painter:
    """Paints rows for one layout, palette and width."""

    layout: TableLayout
    palette: Palette
    width: int
    hidden: int = 0
    """Columns after the first that are scrolled out at the left."""
    search: Search | None = None

    def row(self, cell: RowCell, line: Style) -> Strip:
        """The row, over the style of its line."""
        row, columns = cell.row, self._columns
        is_damaged = row.kind is None
        spanned: Sequence[int] = self._spanned if is_damaged else ()
        runs = [self._mark(row), (cell.sign.value, self.palette.signs)]
        values = record(row) if self._needs_record else {}
        for number, column in enumerate(columns):
            if number not in spanned:
                runs += self._highlighted(self._cell(column, cell, values))
            elif number == spanned[0]:
                runs += self._highlighted(self._damage(row, spanned))
            if number + 1 < len(columns) and number + 1 not in spanned[1:]:
                runs.append(_SPACE)
        if cell.style is not None:
            # The background of the cursor's line is more important.
            over = _on(line, cell.style)
            runs = [(text, style + over) for text, style in runs]
        return self._strip(runs, line)

    def event(self, text: str, line: Style) -> Strip:
        """The line of a port event or a gap; the text is printable."""
        text = fit(f" {text} ", self.width - 1).rstrip()
        rule = "─" * max(0, self.width - 1 - cell_len(text) - 1)
        style = self.palette.signs
        return self._strip([(EVENT_SIGN, style), (f"{text} {rule}", style)], line)

    def head(self, line: Style) -> Strip:
        """The column names, with `<` and `>` where there are more columns."""
        runs = [(LOOKS[Status.OK].mark, PLAIN)]
        for number, column in enumerate(self._columns):
            edge = "<" if number == 1 and self.hidden else " "
            runs.append((edge + column.head_cell, PLAIN))
        strip = self._strip(runs, line)
        if self.shown.width > self.width > 0:
            strip = Strip([*strip.crop(0, self.width - 1), Segment(">", line)], self.width)
        return strip

    def byte_at(self, row: Row, cell: int) -> int | None:
        """The offset in the row of the byte that is drawn at a cell of its line, or None."""
        if "raw" not in self._names:
            return None
        columns = self._columns[: self._names.index("raw") + 1]
        at, gap = divmod(cell - TableLayout(columns).width + columns[-1].width, _BYTE_CELLS)
        shown = min(len(row.raw), (columns[-1].width + 1) // _BYTE_CELLS)
        return at if 0 <= at < shown and gap < _BYTE_CELLS - 1 else None

    def _mark(self, row: Row) -> _Run:
        if row.status is Status.OK and is_raised(row):
            return RAISED_MARK, self.palette.raised_mark
        return mark_of(row), self.palette.marks[row.status]

    @cached_property
    def _over_lines(self) -> dict[Style, dict[Style, Style]]:
        """By style of a line, the styles of segments over it."""
        return {}

    @cached_property
    def shown(self) -> TableLayout:
        """The columns that are not scrolled out."""
        return self.layout.without(self.hidden)

    @cached_property
    def _columns(self) -> tuple[TableColumn, ...]:
        return self.shown.within(self.width).columns

    @cached_property
    def _names(self) -> tuple[str, ...]:
        return tuple(column.name for column in self._columns)

    @cached_property
    def _spanned(self) -> Sequence[int]:
        """Numbers of the adjacent columns that show the faults of a row without values."""
        if not self._faults_cut:
            return ()
        names = FAULT_COLUMNS if self._raw_whole else (*FAULT_COLUMNS, "raw")
        numbers = [n for n, name in enumerate(self._names) if name in names]
        adjacent = takewhile(lambda pair: pair[0] + numbers[0] == pair[1], enumerate(numbers))
        return [number for _, number in adjacent]

    @cached_property
    def _raw_whole(self) -> bool:
        whole = _BYTE_CELLS * FRAME_LENGTH - 1
        return any(column.name == "raw" and column.width >= whole for column in self._columns)

    @cached_property
    def _faults_cut(self) -> bool:
        return "faults" not in self._names

    @cached_property
    def _needs_record(self) -> bool:
        """Whether a column shows more than those of a narrow table."""
        return not {"time", DELTA, "port", "kind", VALUES, "raw"}.issuperset(self._names)

    def _cell(
        self, column: TableColumn, cell: RowCell, values: Mapping[str, Value]
    ) -> Sequence[_Run]:
        """The runs of one cell, exactly as wide as its column."""
        row = cell.row
        match column.name:
            case "raw":
                return self._bytes(column, cell)
            case "values":
                return self._short_values(column, cell)
            case "time":
                return [(column.cell(cell.time_ns), self.palette.muted)]
            case "delta":
                return [(column.cell(cell.delta_ns), self.palette.muted)]
            case "kind":
                kind = row.kind
                return [(column.cell(kind.name if kind else None), self.palette.of_kind(row))]
            case "port":
                return [(column.cell(row.port), self.palette.muted)]
            case name:
                text = column.cell(values[name])
                space = len(text) - len(text.lstrip())
                return [(text[:space], PLAIN), (text[space:], self._style(name, cell))]

    def _style(self, name: str, cell: RowCell) -> Style:
        field = FIELD_BY_NAME.get(name)
        if field is not None:
            return self._value_style(field, cell)
        is_about_faults = name in ("faults", "status")
        return self.palette.statuses[cell.row.status] if is_about_faults else self.palette.muted

    def _value_style(self, field: Field, cell: RowCell) -> Style:
        """The style of a value: as its bytes, bold in commands."""
        row, palette = cell.row, self.palette
        kind = row.kind
        own = _OWN_FIELDS.get((kind.name, field.name)) if kind else None
        if own is None:
            return PLAIN
        if own.raised(own.read(row.raw)):
            return palette.raised
        style = palette.of_values(row) + palette.values[field.name]
        if cell.ages is None:
            return style
        return palette.aged(style, min(cell.ages[at] for at in own.offsets))

    def _short_values(self, column: TableColumn, cell: RowCell) -> Sequence[_Run]:
        """The values, after the faults where their column is not in the window."""
        row, left = cell.row, column.width
        runs = list[_Run]()
        if self._faults_cut and row.faults:
            faults = fit(",".join(row.faults), min(left, sum(len(one) + 1 for one in row.faults)))
            runs.append((faults, self.palette.statuses[row.status]))
            left -= len(faults)
        kind = row.kind
        for text, field in value_parts(kind, row.raw, left) if kind else ():
            text = text[:left]
            runs += [(text, self._value_style(field, cell)), (_SPACE[0][: left - len(text)], PLAIN)]
            left = max(0, left - len(text) - 1)
        return [*runs, (" " * left, PLAIN)]

    def _damage(self, row: Row, spanned: Sequence[int]) -> Sequence[_Run]:
        """The faults, then the bytes where they have no column of their own."""
        width = sum(self._columns[one].width + 1 for one in spanned) - 1
        faults = fit(",".join(row.faults), width)
        text = faults if self._raw_whole else faulty_text(row, width)
        return [(text, self.palette.statuses[row.status])]

    def _bytes(self, column: TableColumn, cell: RowCell) -> Sequence[_Run]:
        row, width = cell.row, column.width
        if len(row.raw) > FRAME_LENGTH:
            return [(fit(bytes_text(row.raw, width), width), self.palette.statuses[row.status])]
        text = fit(spaced_hex(row.raw), width)
        styles = self.palette.of_bytes(row)
        if cell.ages is not None:
            styles = tuple(map(self.palette.aged, styles, cell.ages))
        if cell.field is not None:
            styles = tuple(
                style + self.palette.field if at in cell.field else style
                for at, style in enumerate(styles)
            )
        runs = list[_Run]()
        for start, end, style in _byte_runs(tuple(styles)):
            runs += [(text[start:end], style), (text[end : end + 1], PLAIN)]
        return [*runs, (text[_BYTE_CELLS * len(styles) :], PLAIN)]

    def _highlighted(self, runs: Sequence[_Run]) -> Sequence[_Run]:
        if self.search is None:
            return runs
        text = "".join(run[0] for run in runs)
        spans = self.search.spans(text)
        edges = sorted({0, len(text), *accumulate(len(run[0]) for run in runs), *chain(*spans)})
        found = list[_Run]()
        for start, end in pairwise(edges):
            is_hit = any(first <= start < last for first, last in spans)
            style = self.palette.found if is_hit else _style_at(runs, start)
            found.append((text[start:end], style))
        return found

    def _strip(self, runs: Iterable[_Run], line: Style) -> Strip:
        # Fewer segments take less time to draw; `Strip.apply_style` takes five times as long.
        joined = list[_Run]()
        for text, style in runs:
            if joined and text.isspace() and not (_is_boxed(joined[-1][1]) or _is_boxed(style)):
                joined[-1] = (joined[-1][0] + text, joined[-1][1])
            elif text:
                joined.append((text, style))
        over = self._over_lines.setdefault(line, {})
        segments = [
            Segment(text, over.get(style) or over.setdefault(style, over_line(line, style)))
            for text, style in joined
        ]
        width = sum(len(segment.text) for segment in segments)
        if not all(segment.text.isascii() for segment in segments):
            width = sum(cell_len(segment.text) for segment in segments)
        if width < self.width:
            segments.append(Segment(" " * (self.width - width), line))
        strip = Strip(segments, max(width, self.width))
        return strip if width <= self.width else strip.crop(0, self.width)


def over_line(line: Style, style: Style) -> Style:
    """A style over that of its line; in a reversed line, what has a background is not reversed."""
    if not line.reverse:
        return line + style
    if style.reverse or style.bgcolor:
        return line + style + _NOT_REVERSED
    return line + style.without_color


@cache
def _is_boxed(style: Style) -> bool:
    """Whether the style shows on a space."""
    return bool(style.underline or style.reverse or style.bgcolor)


@lru_cache(2048)
def _byte_runs(styles: tuple[Style, ...]) -> tuple[tuple[int, int, Style], ...]:
    """Runs of bytes with the same style: start and end in the text, and the style."""
    runs, start = list[tuple[int, int, Style]](), 0
    for style, group in groupby(styles):
        end = start + sum(1 for _ in group)
        runs.append((_BYTE_CELLS * start, _BYTE_CELLS * end - 1, style))
        start = end
    return tuple(runs)


def _style_at(runs: Sequence[_Run], at: int) -> Style:
    for text, style in runs:
        if at < len(text):
            return style
        at -= len(text)
    return PLAIN


SHADES: Final = "░▒▓█"
"""Signs of faults in a cell of the bar, from few to as many as in the fullest cell."""

SPARSE: Final = 0.0003
"""Share of the rows with a fault up to which a cell has the lightest shade."""

DENSE: Final = 0.01
"""Share from which on the fullest cell has the darkest shade."""

BAR_RAISED: Final = "▲"
BAR_MARKED: Final = "◄"
BAR_EVENT: Final = "═"

_BAR_SIGNS: Final = {RowNote.RAISED: BAR_RAISED, RowNote.UNANSWERED: Sign.UNANSWERED.value}
_STATUSES: Final = {RowNote.SUSPECT: Status.SUSPECT, RowNote.MALFORMED: Status.MALFORMED}


@dataclass(frozen=True, slots=True)
class BarSign:
    """What one cell of the bar shows."""

    text: str
    style: Style

    def over(self, cell: Style) -> Style:
        """The style over that of a cell of the bar; the thumb, which is reversed, stays visible."""
        return cell + (Style(bgcolor=self.style.color) if cell.reverse else self.style)


class OverviewBar:
    """Signs of the shown rows for the cells of a bar."""

    def __init__(self, store: RowStore, marks: Iterable[int]) -> None:
        """`marks` are the indices of the marked rows, which may change."""
        self._store, self._marks = store, marks
        self._overview = Overview(store)
        self._height = self._rows = 0

    def signs(self, height: int, palette: Palette) -> Mapping[int, BarSign]:
        """The signs by cell, for a bar of `height` cells."""
        self._height, self._rows = height, self._store.view.count
        found, cells = {}, self._overview.cells(height)
        fullest = max((cell.share for cell in cells if cell.worst in _STATUSES), default=0.0)
        for at, cell in enumerate(cells):
            if cell.worst in _BAR_SIGNS:
                text = _BAR_SIGNS[cell.worst]
                found[at] = BarSign(text, Style(color=palette.raised.color))
            elif cell.worst:
                color = palette.statuses[_STATUSES[cell.worst]].color
                found[at] = BarSign(shade(cell.share, fullest), Style(color=color))
        for index in self._landmarks():
            found[self._cell_of(index)] = BarSign(BAR_EVENT, palette.signs)
        for index in self._marks:
            found[self._cell_of(index)] = BarSign(BAR_MARKED, palette.signs)
        return found

    def _landmarks(self) -> Iterator[int]:
        """The indices of the landmarks that are not routine."""
        every = self._store.landmarks.between(self._store.first, self._store.next + 1)
        return (one.index for one in every if not one.is_routine)

    @property
    def _per_cell(self) -> int:
        return max(1, -(-self._rows // max(1, self._height)))

    def _cell_of(self, index: int) -> int:
        position = min(self._store.view.position_of(index), max(0, self._rows - 1))
        return position // self._per_cell

    def position_at(self, cell: int) -> int | None:
        """Position of the row to which a click on a cell goes."""
        start, end = cell * self._per_cell, (cell + 1) * self._per_cell
        view = self._store.view
        special = [*self._marks, *self._landmarks()]
        positions = sorted(
            position for one in special if start <= (position := view.position_of(one)) < end
        )
        if positions:
            return positions[0]
        return self._overview.worst_between(start, end)


def shade(share: float, fullest: float) -> str:
    """The sign of a share of rows with a fault, on a logarithmic scale up to the fullest cell."""
    level = log(max(share, SPARSE) / SPARSE) / log(max(fullest, DENSE) / SPARSE)
    return SHADES[min(int(level * len(SHADES)), len(SHADES) - 1)]


class OverviewRender(ScrollBarRender):
    """The scroll bar with the signs of an overview."""

    signs: Mapping[int, BarSign]

    @classmethod
    def with_signs(cls, signs: Mapping[int, BarSign]) -> type[OverviewRender]:
        """A renderer of these signs."""
        return type("OverviewRender", (cls,), {"signs": signs})

    @classmethod
    def render_bar(
        cls,
        size: int = 25,
        virtual_size: float = 50,
        window_size: float = 20,
        position: float = 0,
        thickness: int = 1,
        vertical: bool = True,
        back_color: TerminalColor = TerminalColor.parse("#555555"),  # noqa: B008
        bar_color: TerminalColor = TerminalColor.parse("bright_magenta"),  # noqa: B008
    ) -> Segments:
        """The bar of the base class, with a sign in some of its cells."""
        bar = super().render_bar(
            size, virtual_size, window_size, position, thickness, vertical, back_color, bar_color
        )
        segments = list(bar.segments)
        for cell, sign in cls.signs.items():
            if cell < len(segments):
                style = segments[cell].style or Style.null()
                shown = sign.over(style)
                if not style.reverse:
                    shown += Style(meta={"@mouse.down": f"app.overview({cell})"})
                segments[cell] = Segment(sign.text, shown)
        return Segments(segments, new_lines=True)
