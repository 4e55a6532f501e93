"""Colours of the table under each theme, the high-contrast themes, and NO_COLOR."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from functools import cache, cached_property, lru_cache
from typing import TYPE_CHECKING

from rich.color import Color as TerminalColor
from rich.color import ColorSystem
from rich.errors import StyleSyntaxError
from rich.segment import Segment
from rich.style import Style
from textual.color import Color
from textual.filter import LineFilter
from textual.theme import Theme

from fte_sniff.errors import FilterError, TranslatableText, quoted
from fte_sniff.protocol import KINDS, VALUE_FIELDS, Direction, Frame, Row, Rows, Status, status_of
from fte_sniff.protocol.dissect import byte_names, dissect
from fte_sniff.protocol.look import LOOKS, Ground
from fte_sniff.tui.i18n import CONTRAST_DARK, CONTRAST_LIGHT
from fte_sniff.tui.text import is_raised

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
    """Whether fields differ by underline and bold too, since there are no or 16 colours."""

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
        kind = row.kind if isinstance(row, Frame) else None
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
        kind = row.kind if isinstance(row, Frame) else None
        return PLAIN if kind is None else self.kinds[kind.name]

    def of_values(self, row: Row) -> Style:
        """The style of the row's numbers."""
        command = isinstance(row, Frame) and row.direction is Direction.CONTROL
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

# Red is the colour of damage. On white, yellow, green and cyan are not readable.
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
        batch = Rows.from_rows(row for _, row in new)
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
