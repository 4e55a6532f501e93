"""Owns the plot of one quantity of one motor: what it told as a line, what was asked as dots.

It must not know whose quantity it is. The two differ by their form, not by their colour alone. A
column of dots shows the least and the greatest value in its time, so that spikes survive.

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

from fte_sniff.analysis.envelope import Floats, Spans
from fte_sniff.analysis.fields import Bools, Ints
from fte_sniff.tui.braille import ACROSS, DOWN, Canvas
from fte_sniff.tui.fitting import fit_right
from fte_sniff.tui.quantities import short_number

SCALE_CELLS: Final = 7
"""Cells that the ends of the scale take at the left."""

HELD_NS: Final = 1_000_000_000
"""How long a line goes on behind the last value told; a longer silence is a gap."""

DOTTED_EVERY: Final = 3
"""Columns of dots from one dot of what was asked to the next."""


@dataclass(frozen=True, slots=True)
class Strokes:
    """The styles of a plot."""

    told: Style
    asked: Style
    scale: Style


@dataclass(frozen=True, slots=True)
class Curves:
    """What is plotted, in as many columns as the plot has dots across."""

    asked: Spans
    told: Spans
    otherwise: Bools
    """Columns in which something else was asked, which ends what was asked before."""
    standing: float | None
    """What was asked last before the plot begins."""
    column_ns: float
    """The time that a column takes."""


def plot(curves: Curves, strokes: Strokes, width: int, height: int) -> list[Text]:
    """The plot in so many cells; empty but for its place where there is nothing to plot."""
    told = _joined(_told(curves))
    asked = _joined(_asked(curves))
    low, high = _ends(told, asked)
    across = max(0, width - SCALE_CELLS)
    line, dots = Canvas(across, height), Canvas(across, height)
    _draw(line, told, low, high)
    _draw(dots, asked, low, high)
    dots.dots[:, np.arange(dots.dots.shape[1]) % DOTTED_EVERY != 0] = False
    return _lines(line, dots, _scale(low, high, height), strokes)


def dots_across(width: int) -> int:
    """Columns of dots that a plot of so many cells has."""
    return max(0, width - SCALE_CELLS) * ACROSS


def _told(curves: Curves) -> Spans:
    """What was told, each value held until the next, if that comes soon enough."""
    told = ~np.isnan(curves.told.last)
    latest = _latest(told)
    soon = np.arange(len(told)) - latest <= max(1, round(HELD_NS / curves.column_ns))
    held = np.where((latest >= 0) & soon, curves.told.last[latest], np.nan)
    return _filled(curves.told, held)


def _asked(curves: Curves) -> Spans:
    """What was asked, which stands until something else is asked, however long that takes."""
    latest, other = _latest(~np.isnan(curves.asked.last)), _latest(curves.otherwise)
    before = np.nan if curves.standing is None else curves.standing
    held = np.where(latest >= 0, curves.asked.last[latest], before)
    held[other > latest] = np.nan
    return _filled(curves.asked, held)


def _latest(told: Bools) -> Ints:
    """For every column the last one so far in which something was told; -1 where there is none."""
    return np.maximum.accumulate(np.where(told, np.arange(len(told)), -1))


def _filled(spans: Spans, held: Floats) -> Spans:
    """With what is held where nothing was told."""
    empty = np.isnan(spans.last)
    return Spans(
        np.where(empty, held, spans.low),
        np.where(empty, held, spans.high),
        np.where(empty, held, spans.last),
    )


def _joined(spans: Spans) -> Spans:
    """With each column reaching to where the one before ended, so that a line has no holes."""
    before = np.concatenate(([np.nan], spans.last[:-1]))
    before[np.isnan(spans.low)] = np.nan
    return Spans(np.fmin(spans.low, before), np.fmax(spans.high, before), spans.last)


def _ends(*curves: Spans) -> tuple[float, float] | tuple[None, None]:
    """The least and the greatest value of all; None where there are none."""
    every = np.concatenate([part for spans in curves for part in (spans.low, spans.high)])
    every = every[~np.isnan(every)]
    return (float(every.min()), float(every.max())) if len(every) else (None, None)


def _draw(canvas: Canvas, spans: Spans, low: float | None, high: float | None) -> None:
    if low is None or high is None or not len(canvas.dots):
        return
    top = len(canvas.dots) - 1
    if high > low:
        canvas.bars((spans.low - low) / (high - low) * top, (spans.high - low) / (high - low) * top)
    else:
        level = np.where(np.isnan(spans.low), np.nan, top // 2)
        canvas.bars(level, level)


def _scale(low: float | None, high: float | None, height: int) -> list[str]:
    """What stands at the left of each line."""
    marks = [""] * height
    if low is None or high is None or not height:
        return marks
    if low == high or height == 1:
        marks[(height * DOWN - 1 - (height * DOWN - 1) // 2) // DOWN] = short_number(high)
    else:
        marks[0], marks[-1] = short_number(high), short_number(low)
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
