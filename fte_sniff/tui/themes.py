"""Owns the themes that are our own, and which of the table's palettes goes with each.

It must not know what is drawn. All palettes keep to hues that colour-blind people can tell apart.
"""

from __future__ import annotations

from dataclasses import replace

from rich.style import Style
from textual.theme import Theme

from fte_sniff.tui.table.palette import DARK, LIGHT, Palette
from fte_sniff.tui.theme_names import CONTRAST_DARK, CONTRAST_LIGHT

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
OWN = (_DARK, _LIGHT)
"""Themes that are to be made known to Textual."""

_PALETTES = {
    CONTRAST_DARK: replace(DARK, muted=Style(color="#ffffff")),
    CONTRAST_LIGHT: replace(LIGHT, muted=Style(color="#000000")),
}


def palette_of(theme: Theme) -> Palette:
    """The table's colours under a theme."""
    return _PALETTES.get(theme.name, DARK if theme.dark else LIGHT)
