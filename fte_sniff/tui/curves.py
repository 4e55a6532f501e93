"""Curves in braille characters.

1000 ⡇⠁ ⠁▲⠁ ⠁⣀⠤⠔⠒⠒⠒     scale at the left, a marker at the edge for an outlier
   0 ⣇⣀⡠⠔⠊⠁
     ╵-10 s ╵-5 s now╵     time axis

The libraries draw points, not the minimum and maximum of what a column of dots covers, they connect
a curve over silences, and they take five times as much of a core.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Final

import numpy as np
import numpy.typing as npt
from rich.cells import cell_len
from rich.style import Style
from rich.text import Text

from fte_sniff.analysis.plots import Envelope
from fte_sniff.formats.cell_text import fit_right, short_number
from fte_sniff.protocol.rows import Bools, Floats, Ints
from fte_sniff.tui.painter import Palette

ACROSS: Final = 2
"""Columns of dots in a cell."""

DOWN: Final = 4

SCALE_CELLS: Final = 8

HOLD_NS: Final = 1_000_000_000
"""How long a curve continues after the last feedback; a longer silence is a gap."""

DASH: Final = 4
"""Columns of a dash of the target, and of the gap after it."""

BESIDE: Final = 2
"""Columns beside a value that decide, by their median, whether it is an outlier."""

NEAR: Final = 0.25
"""Values at most this far outside the usual ones are not outliers; a share of their range."""

ABOVE: Final = "▲"
BELOW: Final = "▼"

_BLANK: Final = 0x2800
_BITS: Final = np.array([[0, 3], [1, 4], [2, 5], [6, 7]])


@dataclass(frozen=True, slots=True)
class Curves:
    """Target and feedback, a value for each column of dots."""

    target: Envelope
    """Each target is held until another command."""
    feedback: Envelope

    @property
    def has_values(self) -> bool:
        """Whether there is anything to draw."""
        return not (np.isnan(self.target.last).all() and np.isnan(self.feedback.last).all())


def dots_across(width: int) -> int:
    """Columns of dots in a plot of `width` cells."""
    return max(0, width - SCALE_CELLS) * ACROSS


def held(spans: Envelope, first: float = np.nan, columns: int = 1 << 30) -> Envelope:
    """Each value held until the next, for a number of columns at most; `first` is that before."""
    known = ~np.isnan(spans.last)
    at = np.arange(len(known))
    latest = np.maximum.accumulate(np.where(known, at, -1))
    last = np.where(latest >= 0, spans.last[latest], first)
    last[(latest >= 0) & (at - latest > columns)] = np.nan
    return Envelope(np.where(known, spans.low, last), np.where(known, spans.high, last), last)


def plot(curves: Curves, palette: Palette, size: tuple[int, int], unit: str) -> list[Text]:
    """Lines of a plot of `size` (width and height) in cells; blank where values are missing.

    `unit` is shown between the ends of the scale, where it fits. Outliers are markers at the edge.
    """
    width, height = size
    across = max(0, width - SCALE_CELLS)
    both = curves.feedback, curves.target
    low, high, least, most = _scale(both)
    line, dashes = (np.zeros((height * DOWN, across * ACROSS), np.bool_) for _ in both)
    above = below = np.zeros(across, np.bool_)
    if across and height and low <= high:
        for dots, spans in ((line, curves.feedback), (dashes, curves.target)):
            _draw(dots, _connected(spans, low, high), low, high)
        level = dashes.sum(axis=0) <= 1  # where it rises or falls it stays whole
        dashes[:, level & (np.arange(across * ACROSS) // DASH % 2 == 1)] = False
        above = _by_cell(spans.high > high for spans in both)
        below = _by_cell(spans.low < low for spans in both)
    labels = _labels(height, unit, low, high, least, most)
    cells, numbers = _cells(line | dashes), (_cells(dashes) != ord(" ")).astype(np.int8)
    for at, found, sign in ((-1, below, BELOW), (0, above, ABOVE)):
        if height:
            cells[at][found], numbers[at][found] = ord(sign), 2
    styles = Style(), palette.muted, palette.raised
    return [
        _drawn(label, codes, own, styles, palette.muted)
        for label, codes, own in zip(labels, cells.tolist(), numbers.tolist(), strict=True)
    ]


def _drawn(
    label: str, codes: list[int], numbers: list[int], styles: Sequence[Style], muted: Style
) -> Text:
    text, at = Text(fit_right(label, SCALE_CELLS - 1) + " ", style=muted), 0
    for number, group in groupby(numbers):
        end = at + len([*group])
        text.append("".join(map(chr, codes[at:end])), styles[number])
        at = end
    return text


def time_axis(width: int, texts: Sequence[str], style: Style) -> Text:
    """The line below a plot: a tick and a text at its start, middle and end, as far as they fit."""
    across = max(0, width - SCALE_CELLS)
    start, middle, end = f"╵{texts[0]}", f"╵{texts[1]}", f"{texts[2]}╵"
    line, rest = start, across - cell_len(end)
    if cell_len(start) < across // 2 and across // 2 + cell_len(middle) < rest:
        line += " " * (across // 2 - cell_len(line)) + middle
    if cell_len(line) < rest:
        line += " " * (rest - cell_len(line)) + end
    return Text(" " * SCALE_CELLS + line, style=style)


def _scale(curves: Iterable[Envelope]) -> tuple[float, float, float, float]:
    """The ends of the scale, and the extreme values; without any, the first is above."""
    values = [ends for spans in curves for ends in (spans.low, spans.high)]
    known = np.concatenate(values)
    known = known[~np.isnan(known)]
    if not len(known):
        return 1.0, 0.0, 0.0, 0.0
    usual = np.concatenate([_smooth(one) for one in values])
    usual = usual if len(usual) else known
    near = NEAR * (usual.max() - usual.min())
    scaled = known[(known >= usual.min() - near) & (known <= usual.max() + near)]
    return float(scaled.min()), float(scaled.max()), float(known.min()), float(known.max())


def _smooth(values: Floats) -> Floats:
    """The median of each value and those beside it: a flipped bit must not flatten the rest."""
    values = values[~np.isnan(values)]
    if len(values) <= BESIDE:
        return values
    padded = np.pad(values, BESIDE, "edge")
    found: Floats = np.median(
        np.lib.stride_tricks.sliding_window_view(padded, 2 * BESIDE + 1), axis=1
    )
    return found


def _connected(spans: Envelope, low: float, high: float) -> Envelope:
    """The spans without outliers, each extended to the end of the one before."""
    ends = [np.where((one < low) | (one > high), np.nan, one) for one in spans]
    ends[0], ends[1] = np.fmin(ends[0], ends[2]), np.fmax(ends[1], ends[2])
    ends[0], ends[1] = np.fmin(ends[0], ends[1]), np.fmax(ends[0], ends[1])
    before = np.concatenate(([np.nan], ends[2][:-1]))
    before[np.isnan(ends[0])] = np.nan
    return Envelope(np.fmin(ends[0], before), np.fmax(ends[1], before), ends[2])


def _draw(dots: npt.NDArray[np.bool_], spans: Envelope, low: float, high: float) -> None:
    """Set the dots between the ends in every column, none where these are unknown."""
    top = len(dots) - 1
    if high > low:
        first, last = ((end - low) / (high - low) * top for end in (spans.low, spans.high))
    else:
        first = last = np.where(np.isnan(spans.low), np.nan, top // 2)
    known = ~np.isnan(first)
    first, last = np.where(known, first, 1).round(), np.where(known, last, 0).round()
    heights = np.arange(top, -1, -1)[:, None]
    dots |= known & (heights >= first) & (heights <= last)


def _labels(
    height: int, unit: str, low: float, high: float, least: float, most: float
) -> list[str]:
    """Text at the left of each line: ends of the scale, outliers, the unit."""
    labels = [""] * height
    if low > high or not height:
        return labels
    if low == high or height == 1:
        labels[(height - 1) // 2] = short_number(high)
        return labels
    labels[0], labels[-1] = short_number(high), short_number(low)
    inward = 1 if height >= DOWN else 0
    if most > high:
        labels[inward] = ABOVE + short_number(most)
    if least < low:
        labels[-1 - inward] = BELOW + short_number(least)
    labels[height // 2] = labels[height // 2] or unit
    return labels


def _cells(dots: npt.NDArray[np.bool_]) -> Ints:
    """The character code of every cell; a space where it has no dot."""
    rows, columns = dots.shape
    by_cell = dots.reshape(rows // DOWN, DOWN, columns // ACROSS, ACROSS)
    bits = (by_cell << _BITS[None, :, None, :]).sum(axis=(1, 3))
    return np.where(bits > 0, bits + _BLANK, ord(" "))


def _by_cell(columns: Iterable[Bools]) -> Bools:
    """Whether any of these columns of dots is set, by cell."""
    found: Bools = np.logical_or.reduce([*columns]).reshape(-1, ACROSS).any(axis=1)
    return found
