"""Dots, sparklines and numbers in few cells."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.cells import cell_len

from fte_sniff.analysis.statistics import LineSetup
from fte_sniff.tui.panes.plot import Canvas
from fte_sniff.tui.text import rate_text, share_text, short_number, span_text, sparkline, turns_text


def test_each_dot_has_its_bit() -> None:
    dots = {(0, 0): "⠁", (1, 0): "⠂", (2, 0): "⠄", (3, 0): "⡀",
            (0, 1): "⠈", (1, 1): "⠐", (2, 1): "⠠", (3, 1): "⢀"}  # fmt: skip
    for place, character in dots.items():
        canvas = Canvas(1, 1)
        canvas.dots[place] = True
        assert canvas.lines == [character]


@given(st.lists(st.tuples(st.floats(-9, 20), st.floats(0, 9)) | st.none(), min_size=6, max_size=6))
def test_bars_reach_from_low_to_high_and_are_kept_on_the_canvas(
    bars: list[tuple[float, float] | None],
) -> None:
    canvas = Canvas(3, 2)
    low = np.array([np.nan if bar is None else bar[0] for bar in bars])
    canvas.bars(low, low + [0 if bar is None else bar[1] for bar in bars])
    for column, bar in enumerate(bars):
        places = {7 - int(row) for row in np.flatnonzero(canvas.dots[:, column])}
        if bar is None:
            assert not places
        else:
            ends = [min(7, max(0, round(end))) for end in (bar[0], bar[0] + bar[1])]
            assert places == set(range(ends[0], ends[1] + 1))


@pytest.mark.parametrize(
    ("ns", "text"),
    [
        (None, "–"),
        (0, "0 ns"),
        (999, "999 ns"),
        (1_000, "1 µs"),
        (86_800, "86.8 µs"),
        (999_600, "1 ms"),
        (2_150_000, "2.15 ms"),
        (150_000_000, "150 ms"),
        (90_000_000_000, "90 s"),
        (600_000_000_000, "10 min"),
        (14_400_000_000_000, "4 h"),
        (864_000_000_000_000, "10 days"),
    ],
)
def test_durations(ns: float | None, text: str) -> None:
    assert span_text(ns) == text


@given(st.integers(0, 2**62))
def test_a_duration_is_short_and_never_an_exponent(ns: int) -> None:
    assert len(span_text(ns)) <= 11
    assert "e+" not in span_text(ns)


@given(st.integers(-(2**31), 2**31))
def test_a_scale_has_at_most_six_cells(value: int) -> None:
    assert len(short_number(value)) <= 6
    assert "e" not in short_number(value)


def test_what_is_not_known_is_a_dash_and_what_there_is_little_of_is_not_0() -> None:
    assert (rate_text(None), share_text(None)) == ("–", "–")
    assert (rate_text(0), share_text(0)) == ("0.0/s", "0.0 %")
    assert (rate_text(1234.5), share_text(0.0001)) == ("1,234/s", "<0.1 %")
    assert (rate_text(0.03), rate_text(0.05)) == ("<0.1/s", "0.1/s")
    assert turns_text(5, LineSetup()) == ""
    assert turns_text(-1500, LineSetup(resolution=500, gear_ratio=2)) == "-1.500 turns"


@given(st.lists(st.floats(0, 1e6), max_size=50), st.integers(0, 60))
def test_a_sparkline_leaves_a_cell_empty_only_where_there_is_nothing(
    values: list[float], width: int
) -> None:
    line = sparkline(values, width)
    assert cell_len(line) == min(width, len(values))
    assert (line.strip() == "") == (not any(values) or width == 0)
    if line and any(values):
        assert "█" in line
