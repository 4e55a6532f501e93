"""Events of the motors over time."""

from __future__ import annotations

import pytest

from fte_sniff.analysis.facts import Facts
from fte_sniff.analysis.motor_events import Health, MotorEvent, MotorEvents
from fte_sniff.analysis.motors import Motors
from fte_sniff.protocol import KIND_BY_NAME, Frame, Row, encode
from fte_sniff.protocol.rows import Rows

SECOND_NS = 1_000_000_000


def row(name: str, at_ms: float, **values: int) -> Row:
    return Frame("p", 0, encode(KIND_BY_NAME[name], values), round(at_ms * 1_000_000))


def session() -> list[Row]:
    """Motor 1 answers, motor 2 only every second command, motor 3 late once, motor 4 never."""
    rows = []
    for number in range(200):
        at, motor, turn = 20 * number, 1 + number % 4, number // 4
        rows.append(row("speed", at, motor=motor, rpm=5))
        if motor == 1 or (motor == 2 and turn % 2) or motor == 3:
            delay = 15 if (motor, turn) == (3, 30) else 3
            rows.append(row("speed_feedback", at + delay, motor=motor, rpm=5))
    return rows


@pytest.mark.parametrize("every", [1, 7, 1000])
def test_events_are_the_same_however_rows_are_divided(every: int) -> None:
    facts, motors, events, rows = Facts(), Motors(), MotorEvents(), session()
    for start in range(0, len(rows), every):
        batch = Rows.from_rows(rows[start : start + every])
        motors.observe(batch)
        events.observe(batch, motors)
        events.observe_facts(facts.feed(batch))
    span = (0, 10 * SECOND_NS)
    found = {motor: events.counts(motor, span) for motor in (1, 2, 3, 4)}
    assert {motor: one.unanswered for motor, one in found.items()} == {1: 0, 2: 25, 3: 0, 4: 49}
    assert {motor: one.events[MotorEvent.LATE] for motor, one in found.items()} == {
        **dict.fromkeys((1, 2, 4), 0),
        3: 1,
    }
    assert found[1].asked == 50
    assert events.health(span) == {
        **{1: Health.SOUND, 2: Health.TROUBLED},
        **{3: Health.SOUND, 4: Health.SILENT},
    }
    assert events.delay_ns(50, span) == 3_000_000
    assert events.delay_ns(100, span) == 15_000_000
    assert events.ticks(4, MotorEvent.UNANSWERED, (0, 4 * SECOND_NS), 4).tolist() == [
        *(12, 13, 12, 12),
    ]


def test_nothing_is_known_of_rows_without_a_time_or_without_commands() -> None:
    events, motors = MotorEvents(), Motors()
    rows = Rows.from_rows(
        [Frame("p", 0, encode(KIND_BY_NAME["speed"], {"motor": 1, "rpm": 0}), None)] * 3
    )
    motors.observe(rows)
    events.observe(rows, motors)
    assert events.health((0, SECOND_NS)) == {}
    assert events.delay_ns(99, (0, SECOND_NS)) is None


def test_motors_are_not_called_silent_where_no_feedback_was_recorded() -> None:
    events, motors = MotorEvents(), Motors()
    rows = Rows.from_rows([row("speed", 20 * number, motor=1, rpm=5) for number in range(50)])
    motors.observe(rows)
    events.observe(rows, motors)
    assert events.counts(1, (0, SECOND_NS)).asked == 0
    assert events.health((0, SECOND_NS)) == {}
