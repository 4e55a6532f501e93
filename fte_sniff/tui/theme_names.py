"""Owns the names of the themes, in the order in which one is switched for the next.

It must not know colours, nor Textual: the settings check a name here without loading a screen.
"""

from __future__ import annotations

from typing import Final

CONTRAST_DARK: Final = "contrast-dark"
CONTRAST_LIGHT: Final = "contrast-light"

THEMES: Final = ("textual-dark", "textual-light", CONTRAST_DARK, CONTRAST_LIGHT, "nord")
"""All of them; the first is the usual one."""


def theme_after(name: str) -> str:
    """The theme behind the one of that name; the first where there is none."""
    at = THEMES.index(name) + 1 if name in THEMES else 0
    return THEMES[at % len(THEMES)]
