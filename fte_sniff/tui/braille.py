"""Owns drawing with braille: a canvas of dots, two across and four down in every cell.

It must not know what is drawn.

    dots of a cell    bits of its character, from U+2800
        o o                 0  3
        o o                 1  4
        o o                 2  5
        o o                 6  7
"""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

ACROSS: Final = 2
"""Dots across in a cell."""

DOWN: Final = 4
"""Dots down in a cell."""

_BLANK: Final = 0x2800
_BITS: Final = np.array([[0, 3], [1, 4], [2, 5], [6, 7]])

Dots = npt.NDArray[np.bool_]


class Canvas:
    """So many cells across and down, at first without a dot."""

    def __init__(self, width: int, height: int) -> None:
        """`width` and `height` are in cells, 0 or more."""
        self.dots: Dots = np.zeros((height * DOWN, width * ACROSS), np.bool_)
        """By row from the top and column from the left."""

    def bars(self, low: npt.NDArray[np.float64], high: npt.NDArray[np.float64]) -> None:
        """Set the dots from `low` to `high` in every column of dots; nothing where they are NaN.

        Both are in dots from the bottom, and are moved onto the canvas where they lie outside.
        """
        rows = len(self.dots)
        told = ~(np.isnan(low) | np.isnan(high))
        bottom = np.clip(np.where(told, low, 1).round(), 0, rows - 1)
        top = np.clip(np.where(told, high, 0).round(), 0, rows - 1)
        places = np.arange(rows - 1, -1, -1)[:, None]
        self.dots |= told & (places >= bottom) & (places <= top)

    @property
    def cells(self) -> npt.NDArray[np.int64]:
        """The code of every cell's character; those without a dot have that of a space."""
        rows, columns = self.dots.shape
        split = self.dots.reshape(rows // DOWN, DOWN, columns // ACROSS, ACROSS)
        bits = (split << _BITS[None, :, None, :]).sum(axis=(1, 3))
        return np.where(bits > 0, bits + _BLANK, ord(" "))

    @property
    def lines(self) -> list[str]:
        """The canvas as text, from the top."""
        return ["".join(map(chr, line)) for line in self.cells.tolist()]
