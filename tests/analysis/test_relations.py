"""Relations are those that a reader finds who goes through the rows one by one."""

from __future__ import annotations

import pytest
from hypothesis import given

from fte_sniff.analysis.relations import AnswerState, motor_hints, row_before, stream_keys
from fte_sniff.protocol.items import Gap, GapKind
from fte_sniff.protocol.rows import Item, Row
from fte_sniff.protocol.spec import MOTORS, Direction
from tests.analysis.captures import SECOND, captures, damage, frame, polled, table_of


def expected_answers(steps: list[Row | Item]) -> list[tuple[int, int, int | None]]:
    """Command, motor and answer, found one by one from the definition."""
    rows, run_of, run = list[Row](), list[int](), 0
    for step in steps:
        if isinstance(step, Row):
            rows.append(step)
            run_of.append(run)
        elif isinstance(step, Gap):
            run += 1
    found = []
    for at, command in enumerate(rows):
        if command.direction is not Direction.CONTROL or command.kind is None:
            continue
        for motor in MOTORS if not command.kind.names_motor else [command.raw[2]]:
            found.append((at, motor, answer_of(rows, run_of, at, motor)))
    return sorted(found)


def answer_of(rows: list[Row], run_of: list[int], at: int, motor: int) -> int | None:
    """The first feedback with the CMD before the next command and the deadline."""
    for later in range(at + 1, len(rows)):
        one, kind = rows[later], rows[later].kind
        if run_of[later] != run_of[at]:
            return None
        if kind is None or (kind.names_motor and one.raw[2] != motor):
            continue
        if kind.direction is Direction.CONTROL:
            return None
        if one.cmd == rows[at].cmd:
            start, end = rows[at].t_ns, one.t_ns
            is_late = start is not None and end is not None and end - start > SECOND
            return None if is_late else later
    return None


@given(captures())
def test_answers_follow_the_definition(steps: list[Row | Item]) -> None:
    found = table_of(steps).answers
    pairs = [
        (command, motor, None if answer < 0 else answer)
        for command, answer, motor in found.select("command", "answer", "motor").iter_rows()
    ]
    assert sorted(pairs) == expected_answers(steps)


@given(captures())
def test_frame_before_is_of_its_stream_and_run(steps: list[Row | Item]) -> None:
    table = table_of(steps)
    rows, last, expected = [*table.rows], dict[object, int](), list[int]()
    for at, row in enumerate(rows):
        number = row.raw[2] if row.kind is not None and row.kind.names_motor else 0
        key = (row.port, row.kind and row.kind.name, number, int(table.runs["number"][at]))
        expected.append(last.get(key, -1) if row.kind is not None else -1)
        last[key] = at
    assert row_before(stream_keys(table.rows), table.runs).tolist() == expected


ASKED = [frame("speed_feedback", 0), frame("speed", 1), frame("speed", 2)]
"""Feedback, a command whose wait the next one ends, and that one."""
LOST, FOUND = Gap(GapKind.PORT, port_lost=True), Gap(GapKind.PORT, port_lost=False)
HID, OTHER = Gap(GapKind.SELECTED), Gap(GapKind.OTHER_RECORDING, port_lost=False)


@pytest.mark.parametrize(
    ("steps", "expected"),
    [
        (
            [frame("speed", 0), frame("speed", 10), frame("speed_feedback", 12)],
            "UNCOVERED ANSWERED",
        ),
        ([*ASKED, frame("speed_feedback", 4)], "UNANSWERED ANSWERED"),
        ([frame("speed_feedback", -5), frame("speed", 0), damage(900)], "UNKNOWN"),
        ([frame("speed_feedback", -5), frame("speed", 0), damage(1100)], "UNANSWERED"),
        ([ASKED[0], frame("reset", 1), frame("speed_feedback", 3000)], "UNKNOWN"),
        ([ASKED[0], Gap(GapKind.PORT), *ASKED[1:]], "UNANSWERED UNKNOWN"),
        ([ASKED[0], LOST, *ASKED[1:]], "UNCOVERED UNKNOWN"),
        ([ASKED[0], OTHER, *ASKED[1:]], "UNCOVERED UNKNOWN"),
        ([ASKED[0], HID, *ASKED[1:]], "HIDDEN HIDDEN"),
        ([LOST, *ASKED, FOUND, *ASKED], "UNCOVERED UNKNOWN UNANSWERED UNKNOWN"),
        ([HID, *ASKED, OTHER, *ASKED], "HIDDEN HIDDEN UNANSWERED UNKNOWN"),
    ],
)
def test_rows_and_gaps_decide_whether_a_command_is_unanswered(
    steps: list[Row | Item], expected: str
) -> None:
    found = table_of(steps).answers.filter(motor=1).sort("command")["state"]
    assert [AnswerState(state).name for state in found] == expected.split()


def test_facts_of_hidden_answers_are_null() -> None:
    rows = polled(5)
    facts = table_of([Gap(GapKind.SELECTED, reason="x"), *rows]).with_facts
    assert {(row.answer_ns, row.unanswered) for row in facts} == {(None, None)}
    assert any(row.answer_ns for row in table_of(rows).with_facts)


def test_facts_of_a_command_to_all_motors_are_those_of_the_slowest() -> None:
    rows = [frame("mecanum", 0)]
    rows += [frame("speed_feedback", 1 + motor, motor=motor) for motor in MOTORS]
    answered = [row.raw[:1] + b"\x03" + row.raw[2:] for row in rows[1:]]
    rows[1:] = [
        Row(row.port, 0, raw, row.t_ns) for row, raw in zip(rows[1:], answered, strict=True)
    ]
    command = table_of(rows).with_facts[0]
    assert (command.answer_ns, command.unanswered) == (5_000_000, False)
    (missed, *_) = table_of([rows[1], *rows[:4], frame("mecanum", 20)]).with_facts[1:2]
    assert (missed.answer_ns, missed.unanswered) == (None, True)


@pytest.mark.parametrize(
    ("rows", "motor"),
    [
        ([damage(0, b"\xaa\x01\x03\x00")], 3),
        ([damage(0, b"\xaa\x01\x09\x00")], -1),
        ([frame("speed", 0, motor=2), damage(1)], 2),
        ([frame("speed", 0, motor=2), frame("speed", 1, motor=3), damage(2)], -1),
        ([frame("speed", 0, motor=2), damage(1500)], -1),
        (
            [
                *(frame("speed_feedback", at, motor=at) for at in (1, 2)),
                damage(2.5),
                *(frame("speed_feedback", at, motor=at) for at in (4, 1)),
            ],
            3,
        ),
    ],
)
def test_motor_of_damage_follows_its_bytes_or_neighbours(rows: list[Row], motor: int) -> None:
    table = table_of(rows)
    at = next(index for index, row in enumerate(rows) if not row.framed)
    assert motor_hints(table.rows, table.runs)[at] == motor
