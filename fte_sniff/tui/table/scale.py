"""Owns the scroll bar's measure: millions of rows on a scale that the bar can draw.

It must not know the bar. Were a unit a row, the bar would be drawn anew for every row that comes,
although it looks the same.
"""

from __future__ import annotations

from dataclasses import dataclass

STEPS = 64
"""Units of the scale for each row of the window, at most: many more than the bar can show."""


@dataclass(frozen=True, slots=True)
class Scale:
    """The measure for `count` rows in a window of `height`."""

    count: int
    height: int

    @property
    def total(self) -> int:
        """Units of all rows."""
        return min(self.count, max(1, self.height) * STEPS)

    def unit_of(self, top: int) -> int:
        """Where the window begins on the scale when `top` is its first row; the ends are exact."""
        return self._across(top, self.count - self.height, self.total - self.height)

    def row_of(self, unit: float) -> int:
        """The window's first row when it begins there on the scale; the ends are exact."""
        return self._across(unit, self.total - self.height, self.count - self.height)

    @staticmethod
    def _across(value: float, span: int, other: int) -> int:
        return round(value * other / span) if span > 0 else 0
