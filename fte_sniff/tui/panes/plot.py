"""Curves in braille characters.

1000 ⡇⠁ ⠁ ⠁ ⠁⣀⠤⠔⠒⠒⠒     scale at the left
   0 ⣇⣀⡠⠔⠊⠁             the present moment at the right
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt
from rich.style import Style
from rich.text import Text

from fte_sniff.analysis.traces import EnvelopeColumns, Floats
from fte_sniff.formats.cell_text import fit_right, short_number
from fte_sniff.row_batch import Bools, Ints

ACROSS: Final = 2
"""Dots across in a cell."""

DOWN: Final = 4
"""Dots down in a cell."""

_BLANK: Final = 0x2800
_BITS: Final = np.array([[0, 3], [1, 4], [2, 5], [6, 7]])

Dots = npt.NDArray[np.bool_]


class Canvas:
    """A raster of dots, drawn as braille characters."""

    def __init__(self, width: int, height: int) -> None:
        self.dots: Dots = np.zeros((height * DOWN, width * ACROSS), np.bool_)
        """Rows from the top, columns from the left."""

    def bars(self, low: npt.NDArray[np.float64], high: npt.NDArray[np.float64]) -> None:
        """Set the dots from `low` to `high` in every column; none where either is NaN.

        Both are in dots from the bottom, and are clipped to the canvas.
        """
        rows = len(self.dots)
        known = ~(np.isnan(low) | np.isnan(high))
        bottom = np.clip(np.where(known, low, 1).round(), 0, rows - 1)
        top = np.clip(np.where(known, high, 0).round(), 0, rows - 1)
        heights = np.arange(rows - 1, -1, -1)[:, None]
        self.dots |= known & (heights >= bottom) & (heights <= top)

    @property
    def cells(self) -> npt.NDArray[np.int64]:
        """Character code of every cell; a space where it has no dot."""
        rows, columns = self.dots.shape
        by_cell = self.dots.reshape(rows // DOWN, DOWN, columns // ACROSS, ACROSS)
        bits = (by_cell << _BITS[None, :, None, :]).sum(axis=(1, 3))
        return np.where(bits > 0, bits + _BLANK, ord(" "))

    @property
    def lines(self) -> list[str]:
        """Text of each line, from the top."""
        return ["".join(map(chr, line)) for line in self.cells.tolist()]


SCALE_CELLS: Final = 8
"""Cells of the scale at the left."""

HOLD_NS: Final = 1_000_000_000
"""How long a curve continues after the last feedback; a longer silence is a gap."""

DOT_SPACING: Final = 3
"""Columns from one dot of the target to the next."""

MAX_SCALE_FACTOR: Final = 4
"""How many times longer the scale may become because of outliers."""

MEDIAN_COLUMNS: Final = 5
"""Columns of the running median that removes outliers."""

TALL_SCALE: Final = 4
"""Lines from which on outliers have a line beside the scale's ends."""

ABOVE: Final = "▲{value}"
BELOW: Final = "▼{value}"


@dataclass(frozen=True, slots=True)
class _Scale:
    low: float
    high: float
    least: float
    most: float


@dataclass(frozen=True, slots=True)
class PlotStyles:
    """Styles of a plot."""

    feedback: Style
    target: Style
    scale: Style


@dataclass(frozen=True, slots=True)
class Curves:
    """Target and feedback, one value per column of dots."""

    target: EnvelopeColumns
    feedback: EnvelopeColumns
    target_ended: Bools
    """Columns in which a command of another kind ended the target."""
    first_target: float | None
    """Target at the start of the plot."""
    column_ns: float
    """Time span of a column."""


def plot(curves: Curves, styles: PlotStyles, width: int, height: int, unit: str = "") -> list[Text]:
    """Lines of a plot of `width` by `height` cells; blank where there are no values.

    `unit` is shown between the ends of the scale, where it fits.
    """
    feedback = _connected(_held_feedback(curves))
    target = _connected(_held_target(curves))
    scale = _scale(feedback, target)
    across = max(0, width - SCALE_CELLS)
    line, dots = Canvas(across, height), Canvas(across, height)
    if scale is not None:
        _draw(line, feedback, scale)
        _draw(dots, target, scale)
        dots.dots[:, np.arange(dots.dots.shape[1]) % DOT_SPACING != 0] = False
    return _lines(line, dots, _labels(scale, height, unit), styles)


def dots_across(width: int) -> int:
    """Columns of dots in a plot of `width` cells."""
    return max(0, width - SCALE_CELLS) * ACROSS


def _held_feedback(curves: Curves) -> EnvelopeColumns:
    """Feedback; each value is held until the next, for `HOLD_NS` at most."""
    known = ~np.isnan(curves.feedback.last)
    latest = _latest(known)
    recent = np.arange(len(known)) - latest <= max(1, round(HOLD_NS / curves.column_ns))
    held = np.where((latest >= 0) & recent, curves.feedback.last[latest], np.nan)
    return _filled(curves.feedback, held)


def _held_target(curves: Curves) -> EnvelopeColumns:
    """Targets; each is held until another command ends it."""
    latest, ended = _latest(~np.isnan(curves.target.last)), _latest(curves.target_ended)
    first = np.nan if curves.first_target is None else curves.first_target
    held = np.where(latest >= 0, curves.target.last[latest], first)
    held[ended > latest] = np.nan
    return _filled(curves.target, held)


def _latest(known: Bools) -> Ints:
    """For every column, the last one up to it that is known; -1 where there is none."""
    return np.maximum.accumulate(np.where(known, np.arange(len(known)), -1))


def _filled(spans: EnvelopeColumns, held: Floats) -> EnvelopeColumns:
    """The spans, with the held value where there is none."""
    empty = np.isnan(spans.last)
    return EnvelopeColumns(
        np.where(empty, held, spans.low),
        np.where(empty, held, spans.high),
        np.where(empty, held, spans.last),
    )


def _connected(spans: EnvelopeColumns) -> EnvelopeColumns:
    """Each column extended to the end of the one before, so that a line has no gaps."""
    before = np.concatenate(([np.nan], spans.last[:-1]))
    before[np.isnan(spans.low)] = np.nan
    return EnvelopeColumns(np.fmin(spans.low, before), np.fmax(spans.high, before), spans.last)


def _scale(*curves: EnvelopeColumns) -> _Scale | None:
    """The scale of all values; None where there are none.

    A few outliers, as after a flipped bit, do not flatten the rest: they are clipped.
    """
    values = np.concatenate([ends for spans in curves for ends in (spans.low, spans.high)])
    values = values[~np.isnan(values)]
    if not len(values):
        return None
    least, most = float(values.min()), float(values.max())
    typical = np.concatenate([_medians(spans.last) for spans in curves])
    low, high = (float(typical.min()), float(typical.max())) if len(typical) else (least, most)
    if not 0 < (high - low) * MAX_SCALE_FACTOR < most - least:
        return _Scale(least, most, least, most)
    margin = (high - low) / 4
    return _Scale(max(least, low - margin), min(most, high + margin), least, most)


def _medians(values: Floats) -> Floats:
    known = values[~np.isnan(values)]
    if len(known) < MEDIAN_COLUMNS:
        return known
    windows = np.lib.stride_tricks.sliding_window_view(known, MEDIAN_COLUMNS)
    medians: Floats = np.median(windows, axis=1)
    return medians


def _draw(canvas: Canvas, spans: EnvelopeColumns, scale: _Scale) -> None:
    if not len(canvas.dots):
        return
    top, length = len(canvas.dots) - 1, scale.high - scale.low
    if length > 0:
        canvas.bars(*((end - scale.low) / length * top for end in (spans.low, spans.high)))
    else:
        level = np.where(np.isnan(spans.low), np.nan, top // 2)
        canvas.bars(level, level)


def _labels(scale: _Scale | None, height: int, unit: str) -> list[str]:
    """Text at the left of each line: ends of the scale, outliers, the unit."""
    labels = [""] * height
    if scale is None or not height:
        return labels
    if scale.low == scale.high or height == 1:
        labels[(height * DOWN - 1 - (height * DOWN - 1) // 2) // DOWN] = short_number(scale.high)
        return labels
    labels[0], labels[-1] = short_number(scale.high), short_number(scale.low)
    inward = 1 if height >= TALL_SCALE else 0
    if scale.most > scale.high:
        labels[inward] = ABOVE.format(value=short_number(scale.most))
    if scale.least < scale.low:
        labels[-1 - inward] = BELOW.format(value=short_number(scale.least))
    if not labels[height // 2]:
        labels[height // 2] = unit
    return labels


def _lines(line: Canvas, dots: Canvas, labels: list[str], styles: PlotStyles) -> list[Text]:
    both = Canvas(0, 0)
    both.dots = line.dots | dots.dots
    on_line = line.cells != ord(" ")
    lines = []
    for label, characters, solid in zip(labels, both.lines, on_line, strict=True):
        text = Text(fit_right(label, SCALE_CELLS - 1) + " ", style=styles.scale)
        text.append_text(_styled(characters, solid, styles))
        lines.append(text)
    return lines


def _styled(characters: str, solid: npt.NDArray[np.bool_], styles: PlotStyles) -> Text:
    """The feedback's style where its line runs, the target's elsewhere."""
    text, start = Text(), 0
    for end in [*(np.flatnonzero(solid[1:] != solid[:-1]) + 1).tolist(), len(characters)]:
        if end > start:
            style = styles.feedback if solid[start] else styles.target
            text.append(characters[start:end], style)
        start = end
    return text
