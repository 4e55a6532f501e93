"""Curves in braille characters.

1000 ⡇⠁ ⠁ ⠁ ⠁⣀⠤⠔⠒⠒⠒     the scale's ends at the left
   0 ⣇⣀⡠⠔⠊⠁             the moment at the right
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt
from rich.style import Style
from rich.text import Text

from fte_sniff.analysis.fields import Bools, Ints
from fte_sniff.analysis.traces import EnvelopeColumns, Floats
from fte_sniff.tui.text import fit_right, short_number

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


SCALE_CELLS: Final = 8
"""Cells that the ends of the scale take at the left."""

HELD_NS: Final = 1_000_000_000
"""How long a line goes on behind the last value told; a longer silence is a gap."""

DOTTED_EVERY: Final = 3
"""Columns of dots from one dot of what was asked to the next."""


MOST_PRESSED: Final = 4
"""How many times longer the scale may become for the sake of a few values."""

CALM_OVER: Final = 5
"""Columns of which most must agree."""

ROOMY_SCALE: Final = 4
"""Lines from which on the scale's ends are told beside what goes over them."""

OVER: Final = "▲{value}"
UNDER: Final = "▼{value}"


@dataclass(frozen=True, slots=True)
class _Scale:
    """What the lowest and the highest dot stand for."""

    low: float
    high: float
    least: float
    most: float
    """The extreme values; dots over an end of the scale stand at that end."""


@dataclass(frozen=True, slots=True)
class Strokes:
    """The styles of a plot."""

    told: Style
    asked: Style
    scale: Style


@dataclass(frozen=True, slots=True)
class Curves:
    """What is plotted, in as many columns as the plot has dots across."""

    asked: EnvelopeColumns
    told: EnvelopeColumns
    otherwise: Bools
    """Columns in which something else was asked, which ends what was asked before."""
    standing: float | None
    """What was asked last before the plot begins."""
    column_ns: float
    """The time that a column takes."""


def plot(curves: Curves, strokes: Strokes, width: int, height: int, unit: str = "") -> list[Text]:
    """The plot in so many cells; empty but for its place where there is nothing to plot.

    `unit` stands between the ends of the scale, where there is room.
    """
    told = _joined(_told(curves))
    asked = _joined(_asked(curves))
    scale = _scale(told, asked)
    across = max(0, width - SCALE_CELLS)
    line, dots = Canvas(across, height), Canvas(across, height)
    if scale is not None:
        _draw(line, told, scale)
        _draw(dots, asked, scale)
        dots.dots[:, np.arange(dots.dots.shape[1]) % DOTTED_EVERY != 0] = False
    return _lines(line, dots, _marks(scale, height, unit), strokes)


def dots_across(width: int) -> int:
    """Columns of dots that a plot of so many cells has."""
    return max(0, width - SCALE_CELLS) * ACROSS


def _told(curves: Curves) -> EnvelopeColumns:
    """What was told, each value held until the next, if that comes soon enough."""
    told = ~np.isnan(curves.told.last)
    latest = _latest(told)
    soon = np.arange(len(told)) - latest <= max(1, round(HELD_NS / curves.column_ns))
    held = np.where((latest >= 0) & soon, curves.told.last[latest], np.nan)
    return _filled(curves.told, held)


def _asked(curves: Curves) -> EnvelopeColumns:
    """What was asked, which stands until something else is asked, however long that takes."""
    latest, other = _latest(~np.isnan(curves.asked.last)), _latest(curves.otherwise)
    before = np.nan if curves.standing is None else curves.standing
    held = np.where(latest >= 0, curves.asked.last[latest], before)
    held[other > latest] = np.nan
    return _filled(curves.asked, held)


def _latest(told: Bools) -> Ints:
    """For every column the last one so far in which something was told; -1 where there is none."""
    return np.maximum.accumulate(np.where(told, np.arange(len(told)), -1))


def _filled(spans: EnvelopeColumns, held: Floats) -> EnvelopeColumns:
    """With what is held where nothing was told."""
    empty = np.isnan(spans.last)
    return EnvelopeColumns(
        np.where(empty, held, spans.low),
        np.where(empty, held, spans.high),
        np.where(empty, held, spans.last),
    )


def _joined(spans: EnvelopeColumns) -> EnvelopeColumns:
    """With each column reaching to where the one before ended, so that a line has no holes."""
    before = np.concatenate(([np.nan], spans.last[:-1]))
    before[np.isnan(spans.low)] = np.nan
    return EnvelopeColumns(np.fmin(spans.low, before), np.fmax(spans.high, before), spans.last)


def _scale(*curves: EnvelopeColumns) -> _Scale | None:
    """The scale that shows all values; None where there are none.

    Where a few values would press all others flat, as a flipped bit does, they go over its ends.
    """
    every = np.concatenate([part for spans in curves for part in (spans.low, spans.high)])
    every = every[~np.isnan(every)]
    if not len(every):
        return None
    least, most = float(every.min()), float(every.max())
    calm = np.concatenate([_calm(spans.last) for spans in curves])
    low, high = (float(calm.min()), float(calm.max())) if len(calm) else (least, most)
    if not 0 < (high - low) * MOST_PRESSED < most - least:
        return _Scale(least, most, least, most)
    room = (high - low) / 4
    return _Scale(max(least, low - room), min(most, high + room), least, most)


def _calm(values: Floats) -> Floats:
    """The middle one of each five values: what stands alone is in none of them."""
    told = values[~np.isnan(values)]
    if len(told) < CALM_OVER:
        return told
    calm: Floats = np.median(np.lib.stride_tricks.sliding_window_view(told, CALM_OVER), axis=1)
    return calm


def _draw(canvas: Canvas, spans: EnvelopeColumns, scale: _Scale) -> None:
    if not len(canvas.dots):
        return
    top, length = len(canvas.dots) - 1, scale.high - scale.low
    if length > 0:
        canvas.bars(*((end - scale.low) / length * top for end in (spans.low, spans.high)))
    else:
        level = np.where(np.isnan(spans.low), np.nan, top // 2)
        canvas.bars(level, level)


def _marks(scale: _Scale | None, height: int, unit: str) -> list[str]:
    """What stands at the left of each line: the scale's ends, what goes over them, the unit."""
    marks = [""] * height
    if scale is None or not height:
        return marks
    if scale.low == scale.high or height == 1:
        marks[(height * DOWN - 1 - (height * DOWN - 1) // 2) // DOWN] = short_number(scale.high)
        return marks
    marks[0], marks[-1] = short_number(scale.high), short_number(scale.low)
    inward = 1 if height >= ROOMY_SCALE else 0
    if scale.most > scale.high:
        marks[inward] = OVER.format(value=short_number(scale.most))
    if scale.least < scale.low:
        marks[-1 - inward] = UNDER.format(value=short_number(scale.least))
    if not marks[height // 2]:
        marks[height // 2] = unit
    return marks


def _lines(line: Canvas, dots: Canvas, scale: list[str], strokes: Strokes) -> list[Text]:
    cells = Canvas(0, 0)
    cells.dots = line.dots | dots.dots
    solid = line.cells != ord(" ")
    found = []
    for mark, characters, told in zip(scale, cells.lines, solid, strict=True):
        text = Text(fit_right(mark, SCALE_CELLS - 1) + " ", style=strokes.scale)
        text.append_text(_styled(characters, told, strokes))
        found.append(text)
    return found


def _styled(characters: str, told: npt.NDArray[np.bool_], strokes: Strokes) -> Text:
    """The line's style where it runs, that of the dots elsewhere."""
    text, start = Text(), 0
    for end in [*(np.flatnonzero(told[1:] != told[:-1]) + 1).tolist(), len(characters)]:
        if end > start:
            text.append(characters[start:end], strokes.told if told[start] else strokes.asked)
        start = end
    return text
