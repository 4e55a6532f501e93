"""Colours of the table under each theme, the high-contrast themes, and NO_COLOR."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

from rich.segment import Segment
from rich.style import Style
from textual.color import Color
from textual.filter import LineFilter
from textual.theme import Theme

from fte_sniff.protocol import KINDS, Direction, Frame, Row, Status
from fte_sniff.tui.i18n import CONTRAST_DARK, CONTRAST_LIGHT

_PLAIN = Style.null()
_COMMAND = Style(bold=True)


@dataclass(frozen=True)
class Palette:
    """Styles of the table under one theme."""

    muted: Style
    """Times, and the bytes of rows without faults."""
    hues: tuple[str, ...]
    """A colour for each quantity, in the order of the frame table."""
    target: Style
    """The target, in a plot."""
    statuses: Mapping[Status, Style]
    """Names of faults."""
    marks: Mapping[Status, Style]
    """The sign of each status."""
    raised: Style
    """Values of a row with a raised flag byte."""
    raised_mark: Style
    """The sign of such a row."""
    signs: Style
    """The sign of a marked or selected row."""
    found: Style
    """Hits of the search; underlined too, since there may be no colours."""

    @cached_property
    def kinds(self) -> Mapping[str, Style]:
        """The style of each kind, by name."""
        subjects = list(dict.fromkeys(kind.subject for kind in KINDS))
        return {
            kind.name: Style(
                color=self.hues[subjects.index(kind.subject) % len(self.hues)],
                bold=kind.direction is Direction.CONTROL,
            )
            for kind in KINDS
        }

    def of_kind(self, row: Row) -> Style:
        """The style of the row's kind."""
        kind = row.kind if isinstance(row, Frame) else None
        return _PLAIN if kind is None else self.kinds[kind.name]

    def of_values(self, row: Row) -> Style:
        """The style of the row's numbers."""
        command = isinstance(row, Frame) and row.direction is Direction.CONTROL
        return _COMMAND if command else _PLAIN


def _sign(color: str, background: str) -> Style:
    return Style(color=color, bgcolor=background, bold=True)


def _by_status(suspect: Style, malformed: Style) -> Mapping[Status, Style]:
    return {Status.OK: _PLAIN, Status.SUSPECT: suspect, Status.MALFORMED: malformed}


DARK = Palette(
    muted=Style(color="#8a94a0"),
    hues=("#dd9fc3", "#56b4e9", "#2fc49b", "#e6b04a"),
    target=Style(color="#e6b04a"),
    statuses=_by_status(Style(color="#f0e442"), Style(color="#ff8f50")),
    marks=_by_status(_sign("#101010", "#f0e442"), _sign("#ffffff", "#b84a00")),
    raised=Style(color="#f5a3a3"),
    raised_mark=_sign("#101010", "#f5a3a3"),
    signs=Style(color="#56b4e9", bold=True),
    found=Style(color="#101010", bgcolor="#9fd8ff", underline=True),
)
LIGHT = Palette(
    muted=Style(color="#66707a"),
    hues=("#8f3a6b", "#0062a0", "#00694b", "#7a5200"),
    target=Style(color="#7a5200"),
    statuses=_by_status(Style(color="#6b5e00"), Style(color="#a33c00")),
    marks=_by_status(_sign("#101010", "#e0d030"), _sign("#ffffff", "#b84a00")),
    raised=Style(color="#a01030"),
    raised_mark=_sign("#ffffff", "#a01030"),
    signs=Style(color="#0062a0", bold=True),
    found=Style(color="#101010", bgcolor="#a8dcff", underline=True),
)


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
    CONTRAST_DARK: replace(DARK, muted=Style(color="#ffffff")),
    CONTRAST_LIGHT: replace(LIGHT, muted=Style(color="#000000")),
}


def palette_of(theme: Theme) -> Palette:
    """The palette for a theme."""
    return _PALETTES.get(theme.name, DARK if theme.dark else LIGHT)


class NoColor(LineFilter):
    """Removes the colours of a line, as https://no-color.org asks."""

    def apply(self, segments: list[Segment], background: Color) -> list[Segment]:
        """The line without colours; every segment keeps a style, which Textual needs."""
        return [
            Segment(text, Style.null() if style is None else style.without_color, control)
            for text, style, control in segments
        ]
