"""The state of the motors at a row."""

from __future__ import annotations

import numpy as np
import pytest

from fte_sniff.analysis.motors import MotorState, Trouble, motors_at
from fte_sniff.analysis.plots import envelope, motor_values
from fte_sniff.protocol.rows import Row
from fte_sniff.protocol.spec import Direction
from tests.analysis.captures import (
    MS,
    SECOND,
    START,
    damage,
    frame,
    polled,
    table_of,
    talk_with_feedback_without_flags,
)
from tests.support.columns import rows_from


def states(rows: list[Row]) -> list[MotorState]:
    """The states after some rows, in order of time."""
    rows = sorted(rows, key=lambda row: row.t_ns or 0)
    table = table_of([*rows])
    return motors_at(table.with_facts, table.runs)


def without(rows: list[Row], motor: int, from_ms: float) -> list[Row]:
    """The rows without the feedback of a motor from a time on."""
    return [
        row
        for row in rows
        if row.raw[:1] == b"\xaa" or row.raw[2] != motor or row.t_ns < START + from_ms * MS  # type: ignore[operator]
    ]


HEALTHY = polled(400)
"""20 s of commands and answers after 3 ms."""


def test_motor_in_order() -> None:
    state = states(HEALTHY)[1]
    assert (state.trouble, state.text) == (Trouble.NONE, "ok")
    assert (state.answered, state.unanswered) == (200, 0)
    assert state.delay_p99_ns == 3 * MS
    assert state.target is not None
    assert state.target.values["rpm"] == 100
    assert [(one.values["rpm"], one.t_ns) for one in state.present] == [(100, HEALTHY[-5].t_ns)]


def test_motor_from_which_nothing_comes_any_more_is_not_ok() -> None:
    rows = rows_from(HEALTHY)
    table = table_of([*HEALTHY])
    later_ns = int(rows.t_ns.max()) + 11_000 * MS
    assert {one.text for one in motors_at(table.with_facts, table.runs, later_ns)} == {"–"}


@pytest.mark.parametrize(
    ("rows", "text"),
    [
        ([], "–"),
        ([row for row in HEALTHY if row.raw[2] != 2], "–"),
        (without(HEALTHY, 2, 9_000), "silent"),
        (without(HEALTHY, 2, 19_000), "unanswered"),
        ([*HEALTHY, frame("speed_feedback", 20_500, motor=1, online=13)], "offline"),
        ([*HEALTHY, frame("speed_feedback", 20_500, motor=2, error=4)], "ERROR 04"),
        ([*HEALTHY, *(damage(at, b"\xaa\x01\x02\x00") for at in range(19_000, 19_020))], "damage"),
        ([*HEALTHY, frame("speed_feedback", 20_500, motor=1, error=4)], "ok"),
    ],
)
def test_motor_in_trouble(rows: list[Row], text: str) -> None:
    assert states(rows)[1].text == text


@pytest.mark.usefixtures("feedback_without_flags")
def test_feedback_without_online_takes_no_motor_offline() -> None:
    rows = talk_with_feedback_without_flags(20)
    assert rows[-1].raw[1] == 0
    assert [one.text for one in states(rows)] == ["ok"] * 4


def test_late_motor_is_named() -> None:
    rows = polled(400, motors=(1, 3, 4))
    rows += polled(300, motors=(2,), delay_ms=3)
    rows += [
        Row(row.port, 0, row.raw, (row.t_ns or 0) + 15 * SECOND)
        for row in polled(100, motors=(2,), delay_ms=7)
    ]
    assert [one.text for one in states(rows)] == ["ok", "late", "ok", "ok"]


def test_two_late_answers_by_chance_are_not_a_late_motor() -> None:
    rows = polled(30)
    for at in (11, 171):
        rows[at] = Row("a", 0, rows[at].raw, (rows[at].t_ns or 0) + 6_000_000)
    assert [one.text for one in states(sorted(rows, key=lambda row: row.t_ns or 0))] == ["ok"] * 4


def test_motor_that_does_not_follow_is_off_target() -> None:
    rows = polled(400, motors=(1, 3, 4))
    for at in range(0, 20_000, 50):
        rows += [frame("speed", at, motor=2, rpm=500), frame("speed_feedback", at + 3, motor=2)]
    assert states(rows)[1].text == "off target"


def test_rows_without_times_have_values_and_no_rates() -> None:
    rows = rows_from([frame("speed", None, rpm=7), frame("speed_feedback", None, rpm=7)])
    table = table_of([*rows])
    state = motors_at(table.with_facts, table.runs)[0]
    assert (state.answered, state.delay_p99_ns) == (1, None)
    assert state.target is not None
    assert state.target.values["rpm"] == 7


def test_envelope_has_the_extremes_and_last_value_of_each_column() -> None:
    rows = rows_from([frame("speed_feedback", at, rpm=int(at % 7)) for at in range(100)])
    t_ns, values = motor_values(rows, 1, Direction.FEEDBACK, "rpm")
    low, high, last = envelope(t_ns, values, (START, START + 200 * MS), 20)
    assert low[:10].tolist() == [0] * 10
    assert high[:10].tolist() == [6] * 10
    assert last[:10].tolist() == [(10 * at + 9) % 7 for at in range(10)]
    assert np.isnan([low[10:], high[10:], last[10:]]).all()
    assert not len(motor_values(rows, 1, Direction.CONTROL, "rpm")[0])
