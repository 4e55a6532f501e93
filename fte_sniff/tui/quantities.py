"""Owns how numbers with units are put in few cells: durations, rates, shares, pulses and turns.

It must not know where they stand. What is not known is a dash, never 0.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from fte_sniff.analysis.statistics import Bench
from fte_sniff.tui.language import _, later

UNKNOWN: Final = "–"
"""Stands for what was never told or cannot be."""

TURNS: Final = later("{turns:,.3f} turns")

_SPANS: Final = (
    (1_000, 1, "{:.0f} ns"),
    (1_000_000, 1_000, "{:.3g} µs"),
    (1_000_000_000, 1_000_000, "{:.3g} ms"),
    (120_000_000_000, 1_000_000_000, "{:.3g} s"),
    (7_200_000_000_000, 60_000_000_000, "{:.3g} min"),
    (172_800_000_000_000, 3_600_000_000_000, "{:.3g} h"),
)
_DAYS: Final = 86_400_000_000_000
_SHORT: Final = ((1e9, "G"), (1e6, "M"), (1e4, "k"))
_BLOCKS: Final = " ▁▂▃▄▅▆▇█"


def span_text(ns: float | None) -> str:
    """A duration of 0 or more nanoseconds in three digits: `2.15 ms`."""
    if ns is None:
        return UNKNOWN
    for below, unit, form in _SPANS:
        # What rounds up to the next unit is told in that.
        if ns < below * 0.9995:
            return _plain(form, ns / unit)
    return _("{days:,.0f} days").format(days=ns / _DAYS)


def _plain(form: str, number: float) -> str:
    """Three digits, but never with an exponent."""
    return form.replace(".3g", ".0f").format(number) if number >= 100 else form.format(number)


def rate_text(per_s: float | None) -> str:
    """A rate: `12.5/s`; what comes now and then does not come 0 times."""
    if per_s is None:
        return UNKNOWN
    if 0 < per_s < 0.05:
        return "<0.1/s"
    return f"{per_s:,.0f}/s" if per_s >= 1000 else f"{per_s:.1f}/s"


def share_text(share: float | None) -> str:
    """A share of 1: `12.5 %`; what there is a little of is not 0."""
    if share is None:
        return UNKNOWN
    return "<0.1 %" if 0 < share < 0.0005 else f"{share * 100:.1f} %"


def short_number(value: float) -> str:
    """A number of up to ten digits in at most six cells: `-12.3k`."""
    for unit, sign in _SHORT:
        if abs(value) >= unit:
            scaled = value / (1e3 if sign == "k" else unit)
            return f"{scaled:.0f}{sign}" if abs(scaled) >= 100 else f"{scaled:.3g}{sign}"
    return f"{value:.0f}"


def turns_text(pulses: int, bench: Bench) -> str:
    """A position in turns; empty where nobody said how many pulses a turn has."""
    turns = bench.turns(pulses)
    return "" if turns is None else _(TURNS).format(turns=turns)


def sparkline(values: Sequence[float], width: int, full: float | None = None) -> str:
    """The values as blocks in `width` cells: the greatest of those that share a cell.

    `full` is what fills a cell; by default the greatest of all. Only 0 leaves a cell empty.
    """
    if not values or width < 1:
        return ""
    width = min(width, len(values))
    edges = [len(values) * cell // width for cell in range(width + 1)]
    tops = [max(values[edges[cell] : edges[cell + 1]]) for cell in range(width)]
    most = full or max(tops) or 1
    steps = len(_BLOCKS) - 1
    return "".join(
        _BLOCKS[min(steps, max(1, round(top / most * steps))) if top > 0 else 0] for top in tops
    )
