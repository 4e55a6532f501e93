"""What is typed into the fields, without a screen."""

from __future__ import annotations

import re
from datetime import time, timedelta, timezone

import pytest

from fte_sniff.analysis.filter.row_filter import RowFilter
from fte_sniff.analysis.time_text import ClockTime
from fte_sniff.errors import FilterError, InputTextError
from fte_sniff.tui.goto import Goal, ToDistance, ToRow, ToTimeOfDay, parse_goal
from fte_sniff.tui.prompt import History, completed


@pytest.mark.parametrize(
    ("text", "goal"),
    [
        ("1", ToRow(1)),
        (" 1,200 ", ToRow(1200)),
        ("12:00", ToTimeOfDay(ClockTime(time(12)))),
        ("00:00:03.5", ToTimeOfDay(ClockTime(time(0, 0, 3), 500_000_000))),
        ("23:59:59.999999999", ToTimeOfDay(ClockTime(time(23, 59, 59), 999_999_999))),
        ("20:00+08:00", ToTimeOfDay(ClockTime(time(20, tzinfo=timezone(timedelta(hours=8)))))),
        ("+2s", ToDistance(2 * 10**9)),
        ("-50ms", ToDistance(-50_000_000)),
        ("+0.25s", ToDistance(250_000_000)),
        ("-1.5us", ToDistance(-1_500)),
        ("+7ns", ToDistance(7)),
        ("+1m30s", ToDistance(90 * 10**9)),
        ("-2min", ToDistance(-120 * 10**9)),
    ],
)
def test_a_goal_is_understood(text: str, goal: Goal) -> None:
    assert parse_goal(text) == goal


@pytest.mark.parametrize(
    "text", ["", "x", "24:00", "12:60", "12:00:61", "2s", "--1s", "1.5", "٣", "+1y"]
)
def test_what_is_no_goal_is_told_with_examples(text: str) -> None:
    with pytest.raises(InputTextError, match=r"1200.*12:00:03\.5.*-50ms"):
        parse_goal(text)


@pytest.mark.parametrize("text", ["+5", "-50", "+0.5"])
def test_a_distance_without_a_unit_is_told_with_units(text: str) -> None:
    with pytest.raises(InputTextError, match=re.escape(f"{text}s, {text}ms")):
        parse_goal(text)


@pytest.mark.parametrize(
    ("typed", "whole"),
    [
        ("mo", "motor"),
        ("motor = 1 AND r", "motor = 1 AND rpm"),
        ("kind = 'speed_", "kind = 'speed_feedback'"),
        ("motor = 1 an", "motor = 1 AND"),
        ("motor ", "motor ="),
        ("zz", None),
        ("vx > ti", None),
        ("vx > ", None),
        ("", None),
    ],
)
def test_the_last_word_is_completed(typed: str, whole: str | None) -> None:
    assert completed(typed) == whole


@pytest.mark.parametrize(("short", "name"), [("vx", "vx_cm_s"), ("wz", "wz_mrad_s")])
def test_the_short_names_of_the_table_lead_to_those_of_a_filter(short: str, name: str) -> None:
    with pytest.raises(FilterError, match=f"did you mean {name}"):
        RowFilter.parse(f"{short} > 10")


def test_history_goes_back_and_returns_to_what_was_typed() -> None:
    history = History()
    for line in ("a", "b", "a", ""):
        history.add(line)
    assert [history.go(-1, "half") for _ in range(3)] == ["a", "b", "b"]
    assert [history.go(1, "half") for _ in range(3)] == ["a", "half", "half"]


def test_history_without_lines_keeps_what_is_typed() -> None:
    history = History()
    assert history.go(-1, "half") == history.go(1, "half") == "half"
