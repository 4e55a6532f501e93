"""Text fitted to terminal cells; times, durations and numbers in few characters."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import UTC, datetime, tzinfo
from functools import lru_cache
from os.path import commonprefix
from typing import Final

from rich.cells import cell_len, set_cell_size

from fte_sniff.errors import TranslatableText

ELLIPSIS = "…"
"""The mark of cut text."""


def fit(text: str, width: int) -> str:
    """Pad a text at the right, or cut it with an ellipsis, to exactly `width` cells."""
    if cell_len(text) <= width:
        return set_cell_size(text, width)
    return set_cell_size(text, width - 1) + ELLIPSIS if width > 0 else ""


def fit_right(text: str, width: int) -> str:
    """Pad a text at the left, or cut it with an ellipsis, to exactly `width` cells."""
    space = width - cell_len(text)
    return " " * space + text if space >= 0 else fit(text, width)


def fit_path(path: str, width: int) -> str:
    """Cut a path to at most `width` cells; its end, which distinguishes files, is kept."""
    if cell_len(path) <= width:
        return path
    while cell_len(path) >= width > 0:
        path = path[1:]
    return ELLIPSIS + path if width > 0 else ""


def padded(text: str, width: int) -> str:
    """Pad a text at the right to at least `width` cells."""
    return text + " " * (width - cell_len(text))


def clock_text(t_ns: int, digits: int, zone: tzinfo = UTC) -> str:
    """The time of day in a zone, with 1-9 digits after the second."""
    seconds, nanoseconds = divmod(t_ns, 1_000_000_000)
    return f"{_second_text(seconds, zone)}.{nanoseconds:09d}"[: 9 + digits]


@lru_cache(256)
def _second_text(seconds: int, zone: tzinfo) -> str:
    return f"{datetime.fromtimestamp(seconds, zone):%H:%M:%S}"


def elapsed_text(ns: int, width: int) -> str:
    """A time difference in signed seconds, with 6, 3 or no decimals to fit the width."""
    sign, seconds, rest = "-" if ns < 0 else "+", *divmod(abs(ns), 1_000_000_000)
    for digits in (6, 3):
        text = f"{sign}{seconds}.{rest:09d}"[: len(f"{seconds}") + 2 + digits]
        if len(text) <= width:
            return text
    return f"{sign}{seconds}"


UNKNOWN: Final = "–"
"""The text of an unknown or inapplicable value."""

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


def span_text(ns: float | None) -> str:
    """A duration of 0 or more nanoseconds in three digits: `2.15 ms`; `UNKNOWN` for None."""
    if ns is None:
        return UNKNOWN
    for below, unit, form in _SPANS:
        # A number that rounds up to the next unit has that unit.
        if ns < below * 0.9995:
            return _plain(form, ns / unit)
    return TranslatableText("{days:,.0f} days", days=ns / _DAYS)


def _plain(form: str, number: float) -> str:
    return form.replace(".3g", ".0f").format(number) if number >= 100 else form.format(number)


def rate_text(per_s: float | None) -> str:
    """A rate: `12.5/s`; a small one is `<0.1/s`, not 0."""
    if per_s is None:
        return UNKNOWN
    if 0 < per_s < 0.05:
        return "<0.1/s"
    return f"{per_s:,.0f}/s" if per_s >= 1000 else f"{per_s:.1f}/s"


def share_text(share: float | None) -> str:
    """A share of 1: `12.5 %`; a small one is `<0.1 %`, not 0."""
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


_SEPARATORS = "/\\:?& "


@lru_cache(256)
def short_names(names: tuple[str, ...], width: int) -> Mapping[str, str]:
    """Shorten names to at most `width` cells, keeping them distinct if the width allows.

    The common prefix, up to the last part of a path, is removed, and long names are cut at their
    start; if two would be equal, they are numbered.
    """
    common = commonprefix(names) if len(set(names)) > 1 else ""  # noqa: RUF071 - also of URLs
    start = 1 + max(common.rfind(separator) for separator in _SEPARATORS)
    parts = [name[start:] or name for name in names]
    cut = [fit_path(part, width) for part in parts]
    if len(set(cut)) < len(set(names)):
        cut = [fit(f"{at} {part}", width).rstrip() for at, part in enumerate(parts, 1)]
    return dict(zip(names, cut, strict=True))
