"""Curves in braille characters.

1000 ⡇⠁ ⠁▲⠁ ⠁⣀⠤⠔⠒⠒⠒     scale at the left, a marker at the edge for an outlier
   0 ⣇⣀⡠⠔⠊⠁
     ╵-10 s ╵-5 s now╵     time axis

The libraries draw points, not the minimum and maximum of what a column of dots covers, they connect
a curve over silences, and they cost more: for the eight plots of a 200x60 terminal at 6 frames/s,
plotext 5.3 (textual-plotext) takes 19 % of a core, textual-plot 0.10 42 %, and this module 4 %.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np
import numpy.typing as npt
from rich.cells import cell_len
from rich.style import Style
from rich.text import Text

from fte_sniff.analysis.counters import EnvelopeColumns, Floats
from fte_sniff.analysis.plots import inside, medians, usual_targets
from fte_sniff.formats.cell_text import fit_right, short_number
from fte_sniff.protocol.rows import Bools, Ints
from fte_sniff.tui.painter import Palette

ACROSS: Final = 2

DOWN: Final = 4

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


SCALE_CELLS: Final = 8

HOLD_NS: Final = 1_000_000_000
"""How long a curve continues after the last feedback; a longer silence is a gap."""

DASH: Final = 4
"""Columns of a dash of the target, and of the gap after it."""

FINE_COLUMNS: Final = 256
"""Fewest columns of the curves from which the usual range is calculated."""

TALL_SCALE: Final = 4
"""Lines from which on outliers have a line beside the scale's ends."""

ABOVE: Final = "▲"
BELOW: Final = "▼"


@dataclass(frozen=True, slots=True)
class _Scale:
    low: float
    high: float
    least: float
    most: float


@dataclass(frozen=True, slots=True)
class Curves:
    """Target and feedback, one value per column of dots."""

    target: EnvelopeColumns
    feedback: EnvelopeColumns
    target_ended: Bools
    """Columns in which a command of another kind ended the target."""
    first_target: float | None
    column_ns: float

    def merged(self, columns: int) -> Curves:
        """These curves in `columns` columns, which divide the number of theirs."""
        by = len(self.target_ended) // columns if columns else 1
        ended = np.logical_or.reduce(self.target_ended.reshape(-1, by), axis=1)
        return Curves(
            _merged(self.target, by),
            _merged(self.feedback, by),
            ended,
            self.first_target,
            self.column_ns * by,
        )


def _merged(spans: EnvelopeColumns, by: int) -> EnvelopeColumns:
    low, high, last = (each.reshape(-1, by) for each in (spans.low, spans.high, spans.last))
    latest = _latest(~np.isnan(spans.last))[by - 1 :: by] - np.arange(len(last)) * by
    values = np.where(latest >= 0, last[np.arange(len(last)), np.maximum(latest, 0)], np.nan)
    return EnvelopeColumns(np.fmin.reduce(low, axis=1), np.fmax.reduce(high, axis=1), values)


def plot(
    fine: Curves,
    feedback_style: Style,
    palette: Palette,
    width: int,
    height: int,
    unit: str = "",
    *,
    full_range: bool = False,
) -> list[Text]:
    """Lines of a plot of `width` by `height` cells; blank where values are missing.

    The curves have `fine_columns(width)`. `unit` is shown between the ends of the scale, where it
    fits. Without `full_range`, outliers are markers at the edge.
    """
    across = max(0, width - SCALE_CELLS)
    curves = fine.merged(across * ACROSS)
    both = _held_feedback(curves), _held_target(curves)
    usual = None if full_range else _usual(fine)
    scale = _scale(both, usual)
    line, dashes = Canvas(across, height), Canvas(across, height)
    above = below = np.zeros(across, np.bool_)
    if scale is not None:
        feedback, target = (_connected(_within(spans, scale)) for spans in both)
        _draw(line, feedback, scale)
        _draw(dashes, target, scale)
        _dash(dashes)
        above = _by_cell(*(spans.high > scale.high for spans in both))
        below = _by_cell(*(spans.low < scale.low for spans in both))
    labels = _labels(scale, height, unit)
    styles = feedback_style, palette.target, palette.raised
    return _drawn_lines(line, dashes, above, below, labels, styles, palette.muted)


def time_axis(width: int, span: str, half: str, end: str, style: Style) -> Text:
    """The line below a plot: a tick and a text at its start, middle and end.

    `span` and `half` are the texts of the plot's time and of half of it.
    """
    across = max(0, width - SCALE_CELLS)
    cells = [" "] * across
    middle, right = across // 2, across - cell_len(end) - 1
    for at, text in ((0, f"╵-{span}"), (middle, f"╵-{half}"), (right, f"{end}╵")):
        size = cell_len(text)
        free = at >= 0 and at + size <= across
        if free and all(cell == " " for cell in cells[max(0, at - 1) : at + size + 1]):
            cells[at : at + size] = [text, *[""] * (size - 1)]
    return Text(" " * SCALE_CELLS + "".join(cells), style=style)


def has_values(curves: Curves) -> bool:
    """Whether there is anything to draw."""
    held = (_held_feedback(curves), _held_target(curves))
    return any(not np.isnan(spans.last).all() for spans in held)


def dots_across(width: int) -> int:
    """Columns of dots in a plot of `width` cells."""
    return max(0, width - SCALE_CELLS) * ACROSS


def fine_columns(width: int) -> int:
    """Columns of the curves of a plot of `width` cells: enough to recognise outliers."""
    dots = dots_across(width)
    return dots * -(-FINE_COLUMNS // dots) if dots else 0


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


def _within(spans: EnvelopeColumns, scale: _Scale) -> EnvelopeColumns:
    """The spans without outliers: in their place is the value before."""
    usual = (spans.last >= scale.low) & (spans.last <= scale.high)
    latest = _latest(usual)
    last = np.where(latest >= 0, spans.last[latest], np.nan)
    last[np.isnan(spans.last)] = np.nan
    low, high = (
        np.where((ends < scale.low) | (ends > scale.high), last, ends)
        for ends in (spans.low, spans.high)
    )
    return EnvelopeColumns(np.fmin(low, high), np.fmax(low, high), last)


def _usual(fine: Curves) -> Floats:
    """Feedback and targets without outliers."""
    feedback = medians(fine.feedback.low), medians(fine.feedback.high)
    return np.concatenate([*feedback, _usual_targets(fine)])


def _usual_targets(fine: Curves) -> Floats:
    held = _held_target(fine).last
    known = ~np.isnan(held)
    commands = _latest(~np.isnan(fine.target.last))[known]
    if not len(commands):
        return commands.astype(np.float64)
    first, columns = np.unique(commands, return_index=True, return_counts=True)[1:]
    begins, holds = bool(commands[0] >= 0), bool(known[-1])
    return usual_targets(held[known][first], columns, begins=begins, holds=holds)


def _scale(curves: Iterable[EnvelopeColumns], usual: Floats | None) -> _Scale | None:
    """The scale of all values; None where there are none.

    With `usual` values, outliers are not in it: a flipped bit must not flatten the rest.
    """
    values = np.concatenate([ends for spans in curves for ends in (spans.low, spans.high)])
    values = values[~np.isnan(values)]
    if not len(values):
        return None
    least, most = float(values.min()), float(values.max())
    if usual is None:
        return _Scale(least, most, least, most)
    shown = inside(values, usual)
    return _Scale(float(shown.min()), float(shown.max()), least, most)


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
        labels[inward] = ABOVE + short_number(scale.most)
    if scale.least < scale.low:
        labels[-1 - inward] = BELOW + short_number(scale.least)
    if not labels[height // 2]:
        labels[height // 2] = unit
    return labels


def _dash(canvas: Canvas) -> None:
    """Make the curve dashed; where it rises or falls it stays whole."""
    dots = canvas.dots
    level = dots.sum(axis=0) <= 1
    gaps = np.arange(dots.shape[1]) // DASH % 2 == 1
    dots[:, level & gaps] = False


def _by_cell(*columns: Bools) -> Bools:
    """Whether any of these columns of dots is set, by cell."""
    found: Bools = np.logical_or.reduce(columns).reshape(-1, ACROSS).any(axis=1)
    return found


def _drawn_lines(
    line: Canvas,
    dashes: Canvas,
    above: Bools,
    below: Bools,
    labels: Sequence[str],
    styles: Sequence[Style],
    label_style: Style,
) -> list[Text]:
    """The curves with a label at the left of each line, and markers in cells with outliers.

    The `styles` are those of feedback, target and markers.
    """
    both = Canvas(0, 0)
    both.dots = line.dots | dashes.dots
    cells = both.cells
    # The target's cells have its style, so that both are seen where they are the same.
    used = (dashes.cells != ord(" ")).astype(np.int8)
    if len(cells):
        for at, found, sign in ((-1, below, BELOW), (0, above, ABOVE)):
            cells[at][found], used[at][found] = ord(sign), 2
    lines = []
    for label, codes, numbers in zip(labels, cells.tolist(), used, strict=True):
        text = Text(fit_right(label, SCALE_CELLS - 1) + " ", style=label_style)
        starts = [0, *(np.flatnonzero(np.diff(numbers)) + 1).tolist(), len(codes)]
        for start, end in pairwise(starts):
            if end > start:
                text.append("".join(map(chr, codes[start:end])), styles[numbers[start]])
        lines.append(text)
    return lines
