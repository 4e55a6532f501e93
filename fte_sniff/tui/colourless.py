"""Owns the screen without colours, as `NO_COLOR` asks for: what is bold or reversed stays.

It must not know what is drawn. The terminal's own two colours are then the only ones; greys would
be colours too, and may be hard to read on them.
"""

from __future__ import annotations

from rich.segment import Segment
from rich.style import Style
from textual.color import Color
from textual.filter import LineFilter


class Colourless(LineFilter):
    """Takes every colour out of a line."""

    def apply(self, segments: list[Segment], background: Color) -> list[Segment]:
        """The same line without colours; every segment keeps a style, as Textual needs it."""
        return [
            Segment(text, Style.null() if style is None else style.without_color, control)
            for text, style, control in segments
        ]
