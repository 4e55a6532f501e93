"""Motors pane as text: cards, plots, numbers."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.cells import cell_len
from rich.style import Style

from fte_sniff.analysis.motors import Motors
from fte_sniff.analysis.statistics import LineSetup
from fte_sniff.analysis.traces import EnvelopeColumns, Traces
from fte_sniff.formats.cell_text import rate_text, share_text, short_number, sparkline
from fte_sniff.protocol import KIND_BY_NAME, Frame, Row, encode
from fte_sniff.row_batch import RowBatch
from fte_sniff.tui.panes.motors import SECOND_NS, MotorsView, grid
from fte_sniff.tui.panes.plot import Canvas, Curves, PlotStyles, dots_across, plot
from fte_sniff.tui.table.theme import DARK
from fte_sniff.tui.text import span_text, turns_text
from tests.tui.conftest import NOON_NS

STROKES = PlotStyles(Style(color="red"), Style(color="blue"), Style())


def _row(name: str, at_s: float | None, **values: int) -> Row:
    time = None if at_s is None else NOON_NS + round(at_s * SECOND_NS)
    return Frame("p", 0, encode(KIND_BY_NAME[name], values), time)


def _look(rows: Sequence[Row], at_s: float | None, bench: LineSetup | None = None) -> MotorsView:
    batch = RowBatch.from_rows(rows)
    motors, traces = Motors(), Traces()
    motors.observe(batch)
    traces.observe(batch)
    now = None if at_s is None else NOON_NS + round(at_s * SECOND_NS)
    return MotorsView(tuple(motors.states(now)), traces, now, 10 * SECOND_NS, bench or LineSetup())


def _drive() -> list[Row]:
    rows: list[Row] = []
    for number in range(100):
        at = number / 10
        rows.append(_row("speed", at, motor=1, rpm=1000))
        rows.append(_row("speed_feedback", at + 0.004, motor=1, rpm=990 + number % 3, error=4))
    rows.append(_row("speed_feedback", 9.95, motor=1, rpm=991, error=0))
    rows.append(_row("position", 9.96, motor=2, rpm=600, pulses=-5000))
    return rows


@pytest.mark.parametrize("size", [(20, 3), (40, 4), (40, 30), (79, 15), (118, 20), (199, 37)])
@pytest.mark.parametrize(
    "rows", [[], _drive(), [_row("mecanum", None, vx_cm_s=1, vy_cm_s=2, wz_mrad_s=3)]]
)
def test_the_grid_is_as_wide_as_there_is_room_and_has_every_motor(
    size: tuple[int, int], rows: list[Row]
) -> None:
    at_s = 10.0 if rows and rows[0].t_ns is not None else None
    text = grid(_look(rows, at_s), *size, DARK)
    lines = text.split("\n")
    assert all(line.cell_len <= size[0] for line in lines)
    if size[0] >= 68:
        assert [text.plain.count(f"motor {number}") for number in range(1, 5)] == [1] * 4
        assert len(lines) <= max(size[1], 28)


def test_a_card_tells_what_was_asked_and_what_is_told() -> None:
    page = grid(_look(_drive(), 9.97), 199, 37, DARK).plain
    assert "motor 1 online error 00 bit 2 cleared 12:00:09 " in page
    assert "target speed 1000 RPM" in page
    assert "now    991 RPM" in page
    assert "10.0/s commands, 0 of 100 unanswered" in page
    assert "10.5/s feedback, 4 ms after, p99 4 ms" in page
    assert "error bit 2 is 0 since 12:00:09.950" in page
    assert "target position -5000 pulses 600 RPM" in page


def test_a_bit_is_said_to_be_set_or_cleared() -> None:
    rows = [_row("speed_feedback", at, motor=1, rpm=0, error=8 * (at > 1)) for at in (0, 1, 2, 3)]
    assert "error 08 bit 3 set 12:00:02.000" in grid(_look(rows, 3), 199, 37, DARK).plain
    assert "error 08 b3=1 12:00:02" in grid(_look(rows, 3), 79, 15, DARK).plain


@pytest.mark.parametrize("cut", [1, 2, 3, 7])
def test_a_target_is_told_since_its_first_command_wherever_batches_are_cut(cut: int) -> None:
    rows = [
        _row("speed", 0, motor=1, rpm=0),
        _row("speed", 1, motor=1, rpm=500),
        _row("speed", 2, motor=2, rpm=7),
        _row("speed", 3.5, motor=1, rpm=0),
        _row("speed", 4, motor=1, rpm=0),
        _row("speed_feedback", 4.5, motor=1, rpm=3),
        _row("speed", 5, motor=1, rpm=0),
    ]
    motors = Motors()
    for start in range(0, len(rows), cut):
        motors.observe(RowBatch.from_rows(rows[start : start + cut]))
    first, second, *_ = motors.states(NOON_NS + 5 * SECOND_NS)
    assert first.target is not None
    assert second.target is not None
    assert first.target.since_ns == NOON_NS + 3_500_000_000
    assert first.target.t_ns == NOON_NS + 5 * SECOND_NS
    assert second.target.since_ns == NOON_NS + 2 * SECOND_NS
    assert "target speed 0 RPM since 12:00:03.5\n" in grid(_look(rows, 5), 60, 40, DARK).plain


@pytest.mark.parametrize("height", [4, 6, 8, 9, 12, 17])
def test_a_low_and_narrow_pane_uses_all_its_lines(height: int) -> None:
    lines = grid(_look(_drive(), 9.97), 38, height, DARK).plain.split("\n")
    assert len(lines) == height
    assert all(lines)
    heads = [line for line in lines if "online" in line]
    assert len(heads) == 4
    if height >= 12:
        assert "target speed 1000 RPM since 12:00:00.0" in lines


def test_what_was_never_told_is_a_dash() -> None:
    page = grid(_look([_row("reset", 0)], 0.5), 199, 37, DARK).plain
    assert page.count("– RPM") == page.count("– pulses") == 4
    assert page.count("online – error –") == 4
    assert page.count("– feedback") == 4
    assert " 0 RPM" not in page


def test_what_is_old_says_how_old_and_a_command_without_answer_how_long() -> None:
    page = grid(_look(_drive(), 12.0), 199, 37, DARK).plain
    assert "now    991 RPM 2.05 s ago" in page
    assert "no answer for 2.04 s" in page


def test_pulses_are_turns_too_where_the_bench_tells_how_many() -> None:
    rows = [_row("position_feedback", 1, motor=3, pulses=10_000)]
    page = grid(_look(rows, 1, LineSetup(resolution=500, gear_ratio=20)), 199, 37, DARK).plain
    assert "10000 pulses 1.000 turns" in page
    assert "turns" not in grid(_look(rows, 1), 199, 37, DARK).plain


def _spans(columns: int, at: dict[int, tuple[float, float]]) -> EnvelopeColumns:
    low, high = np.full(columns, np.nan), np.full(columns, np.nan)
    for column, (least, most) in at.items():
        low[column], high[column] = least, most
    return EnvelopeColumns(low, high, high.copy())


def _curves(
    told: dict[int, tuple[float, float]],
    asked: dict[int, tuple[float, float]],
    otherwise: Sequence[int] = (),
    standing: float | None = None,
) -> Curves:
    columns = dots_across(28)
    other = np.zeros(columns, np.bool_)
    other[list(otherwise)] = True
    return Curves(_spans(columns, asked), _spans(columns, told), other, standing, 0.1 * SECOND_NS)


def _drawn(curves: Curves) -> list[str]:
    return [line.plain for line in plot(curves, STROKES, 28, 4)]


def test_a_spike_of_one_column_is_seen_from_top_to_bottom() -> None:
    lines = _drawn(_curves(dict.fromkeys(range(40), (0, 0)) | {20: (0, 1000)}, {}))
    assert all(line[8 + 10] != " " for line in lines)
    assert all(line[8 + 15] == " " for line in lines[:-1])
    assert lines[0].startswith("   1000 ")
    assert lines[-1].startswith("      0 ")


def test_a_spike_that_would_press_all_else_flat_goes_over_the_end_and_is_told() -> None:
    wave = {n: (n % 20, n % 20 + 3) for n in range(40)}
    lines = _drawn(_curves(wave | {20: (0, 2**30)}, {}))
    assert lines[1].startswith(" ▲1.07G ")
    assert lines[0][8 + 10] != " "
    calm = _drawn(_curves(wave, {}))
    assert float(lines[0][:7]) <= 2 * float(calm[0][:7])
    assert sum(line[8:] != other[8:] for line, other in zip(lines, calm, strict=True)) <= 4
    low = _drawn(_curves(wave | {20: (-(2**30), 0)}, {}))
    assert low[2].startswith("▼-1.07G ")


def test_what_is_told_is_held_for_a_second_and_what_is_asked_until_something_else_is() -> None:
    told = _drawn(_curves({0: (5, 5)}, {}))[2][8:]
    assert told[:5].strip()
    assert not told[6:].strip()
    asked = _drawn(_curves({}, {0: (5, 5)}))[2][8:]
    assert asked[-2:].strip()
    ended = _drawn(_curves({}, {0: (5, 5)}, otherwise=[20]))[2][8:]
    assert ended[8:10].strip()
    assert not ended[10:].strip()


def test_what_was_asked_before_stands_from_the_left() -> None:
    assert _drawn(_curves({}, {}, standing=7.0))[2][8:].strip()
    assert not "".join(_drawn(_curves({}, {}))).strip()


def test_the_line_and_the_dots_differ_without_colour() -> None:
    told = "".join(_drawn(_curves(dict.fromkeys(range(40), (5, 5)), {})))
    asked = "".join(_drawn(_curves({}, dict.fromkeys(range(40), (5, 5)))))
    assert told != asked
    dots = [
        sum(bin(ord(sign) - 0x2800).count("1") for sign in text if sign >= "⠀")
        for text in (told, asked)
    ]
    assert dots[0] == 40
    assert 10 < dots[1] < 20


def test_a_target_of_another_mode_does_not_stand() -> None:
    rows = [
        _row("speed", 0, motor=1, rpm=500),
        _row("speed_feedback", 0.1, motor=1, rpm=500),
        _row("position", 30, motor=1, rpm=500, pulses=7),
        _row("mecanum", 32, vx_cm_s=1, vy_cm_s=0, wz_mrad_s=0),
        _row("speed_feedback", 33, motor=1, rpm=480),
    ]
    late = _look(rows, 33)
    state = late.states[0]
    assert (
        late.curves(state, "rpm", 40).first_target is None
        or late.curves(state, "rpm", 40).target_ended.any()
    )
    assert late.curves(state, "rpm", 40).first_target == 500
    assert late.curves(state, "pulses", 40).first_target is None
    assert late.curves(state, "pulses", 40).target_ended.sum() == 1


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
