"""The frame before of the same stream, and the answers of commands, against simple loops."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fte_sniff.analysis.facts import Facts
from fte_sniff.analysis.model import StreamChange
from fte_sniff.analysis.relations import (
    MOST_SEARCHED,
    UNCHANGED,
    AnswerState,
    CommandAnswer,
    RowRelations,
    answer_pairs,
    change_ages,
    frames_before,
)
from fte_sniff.analysis.row_store import RowStore
from fte_sniff.protocol import (
    KIND_BY_NAME,
    KINDS,
    MOTORS,
    Direction,
    Fault,
    Gap,
    GapKind,
    Row,
    encode,
)
from fte_sniff.protocol.rows import Rows

PORTS = ("host", "controller")
VALUES = st.integers(-2, 2)


@st.composite
def some_row(draw: st.DrawFn) -> Row:
    """A frame of any kind with few different values, or damage; without offset and time."""
    port = draw(st.sampled_from(PORTS))
    kind = draw(st.sampled_from([None, *KINDS]))
    if kind is None:
        return Row(port, 0, b"\x01\x02", None, (Fault.NOISE,), framed=False)
    values = {field.name: draw(VALUES) for field in kind.fields if field.unit}
    if kind.names_motor:
        values["motor"] = draw(st.sampled_from(MOTORS))
    return Row(port, 0, encode(kind, values, draw(st.sampled_from(kind.cmds))), None)


ROWS = st.lists(some_row(), max_size=60).map(
    lambda rows: [replace(row, offset=10 * n, t_ns=1000 * n) for n, row in enumerate(rows)]
)


def stream_of(row: Row) -> tuple[object, ...] | None:
    kind = row.kind if row.framed else None
    if kind is None:
        return None
    return row.port, kind.name, row.raw[2] if kind.names_motor else None


def before_of(rows: list[Row], number: int) -> int:
    stream = stream_of(rows[number])
    same = [n for n in range(number) if stream and stream_of(rows[n]) == stream]
    return same[-1] if same else -1


@given(ROWS)
def test_the_frame_before_is_the_last_one_of_its_stream(rows: list[Row]) -> None:
    found = frames_before(Rows.of(rows))
    assert found.tolist() == [before_of(rows, number) for number in range(len(rows))]


@given(ROWS)
def test_the_age_of_a_byte_counts_the_frames_since_it_changed(rows: list[Row]) -> None:
    batch = Rows.of(rows)
    ages = change_ages(batch.raw, frames_before(batch))
    for number, row in enumerate(rows):
        for at in range(min(10, len(row.raw))):
            here, age = number, 0
            while age < UNCHANGED:
                earlier = before_of(rows, here)
                if earlier < 0:
                    age = UNCHANGED
                elif rows[earlier].raw[at] != rows[here].raw[at]:
                    break
                else:
                    here, age = earlier, age + 1
            assert ages[number, at] == age


def is_to(row: Row, motor: int) -> bool:
    kind = row.kind if row.framed else None
    named = kind is not None and kind.names_motor
    is_command = kind is not None and kind.direction is Direction.CONTROL
    return is_command and (not named or row.raw[2] == motor)


def is_from(row: Row, motor: int) -> bool:
    kind = row.kind if row.framed else None
    return kind is not None and kind.direction is Direction.FEEDBACK and row.raw[2] == motor


def store_of(rows: list[Row], gaps: Mapping[int, bool] = MappingProxyType({})) -> RowStore:
    """A store of the rows and their facts; by index, gaps and whether a port is lost from there."""
    store, facts = RowStore(block_rows=7), Facts()
    batch = Rows.of(rows)
    store.append(batch)
    changes = [StreamChange(at, Gap(GapKind.PORT, port_lost=lost)) for at, lost in gaps.items()]
    store.landmarks.add([], changes)
    store.fill(facts.feed(batch, changes))
    store.fill(facts.interrupt())
    return store


def simple_answer(
    rows: list[Row], number: int, motor: int, end: int, without: AnswerState
) -> CommandAnswer:
    """The answer by a search; `without` is the state of a command that another one follows."""
    for n in range(number + 1, end):
        if is_to(rows[n], motor):
            return CommandAnswer(motor, without, number)
        if is_from(rows[n], motor) and rows[n].raw[1] == rows[number].raw[1]:
            state, delay_ns = AnswerState.ANSWERED, 1000 * (n - number)
            return CommandAnswer(motor, state, number, n, delay_ns)
    return CommandAnswer(motor, AnswerState.UNKNOWN, number)


@given(ROWS, st.dictionaries(st.integers(0, 59), st.booleans(), max_size=3))
def test_answers_are_those_of_a_search_row_by_row(rows: list[Row], lost: dict[int, bool]) -> None:
    gaps = {at: lost[at] for at in sorted(lost) if at < len(rows)}
    relations = RowRelations(store_of(rows, gaps))
    answered: dict[int, CommandAnswer] = {}
    for number, row in enumerate(rows):
        end = next((gap for gap in gaps if gap > number), len(rows))
        is_lost = [is_lost for gap, is_lost in gaps.items() if gap <= number][-1:] == [True]
        covered = any(is_from(before, motor) for before in rows[:number] for motor in MOTORS)
        unknown = is_lost or not covered
        without = AnswerState.UNKNOWN if unknown else AnswerState.UNANSWERED
        wanted = [
            simple_answer(rows, number, motor, end, without)
            for motor in MOTORS
            if is_to(row, motor) and row.raw[1] != 0
        ]
        assert relations.answers(number) == wanted
        answered |= {one.answer: one for one in wanted if one.answer is not None}
    for number in range(len(rows)):
        assert relations.command(number) == answered.get(number)


@given(ROWS)
def test_pairs_of_a_batch_are_the_answers_of_its_commands(rows: list[Row]) -> None:
    relations, pairs = RowRelations(store_of(rows)), answer_pairs(Rows.of(rows))
    found = [one for number in range(len(rows)) for one in relations.answers(number)]
    wanted = {(one.command, one.answer) for one in found if one.answer is not None}
    assert set(zip(*(own.tolist() for own in pairs), strict=True)) == wanted


@given(ROWS, st.sets(st.integers(0, 59), max_size=20))
def test_the_past_of_rows_is_that_of_a_search_row_by_row(rows: list[Row], shown: set[int]) -> None:
    batch = Rows.of(rows)
    ages = change_ages(batch.raw, frames_before(batch))
    indices = sorted(index for index in shown if index < len(rows))
    relations = RowRelations(store_of(rows))
    pasts = relations.pasts(indices)
    assert list(pasts) == indices
    for index, past in pasts.items():
        before, command = before_of(rows, index), relations.command(index)
        assert past.frame_ns == (None if before < 0 else rows[before].t_ns)
        assert past.command_ns == (None if command is None else rows[command.command].t_ns)
        assert past.ages == ages[index].tobytes()


@pytest.mark.parametrize(("away", "found"), [(1000, True), (MOST_SEARCHED + 1, False)])
def test_a_frame_before_is_found_far_away(away: int, found: bool) -> None:
    store = RowStore()
    first, second = (encode(KIND_BY_NAME["speed"], {"motor": 1, "rpm": rpm}) for rpm in (5, 6))
    noise = Row("p", 10, b"\x01", 0, (Fault.NOISE,), framed=False)
    store.append(Rows.of([Row("p", 0, first, 7), *[noise] * away, Row("p", 0, second, 8)]))
    past = RowRelations(store).pasts([store.next - 1])[store.next - 1]
    assert past.frame_ns == (7 if found else None)
    assert past.ages == bytes([UNCHANGED] * 4 + [0 if found else UNCHANGED] + [UNCHANGED] * 5)


def test_a_search_ends_after_many_rows() -> None:
    command = encode(KIND_BY_NAME["speed"], {"motor": 1, "rpm": 5})
    answer = encode(KIND_BY_NAME["speed_feedback"], {"motor": 1, "rpm": 5})
    other = Row("p", 10, b"\x01", 0, (Fault.NOISE,), framed=False)
    rows = [Row("p", 0, command, 0), *[other] * MOST_SEARCHED, Row("p", 0, answer, 1)]
    store = store_of(rows)
    [found] = RowRelations(store).answers(0)
    assert found.state is AnswerState.UNKNOWN
    assert RowRelations(store).command(store.next - 1) is None


def test_command_waits_until_its_facts_are_known() -> None:
    """On the screen those of the last second are not known yet."""
    answer, command = (
        Row("p", 0, encode(KIND_BY_NAME[kind], {"motor": 1, "rpm": 5}), 0)
        for kind in ("speed_feedback", "speed")
    )
    store, facts, batch = RowStore(), Facts(), Rows.of([answer, command, command])
    store.append(batch)
    relations = RowRelations(store)
    assert relations.answers(1)[0].state is AnswerState.WAITING
    store.fill(facts.feed(batch))
    assert relations.answers(1)[0].state is AnswerState.UNANSWERED
    assert relations.answers(2)[0].state is AnswerState.WAITING


@pytest.mark.parametrize("index", [-1, 5])
def test_a_row_that_is_not_in_the_store_has_no_relation(index: int) -> None:
    relations = RowRelations(RowStore())
    assert (relations.answers(index), relations.command(index)) == ([], None)


def test_no_rows_have_no_relations() -> None:
    none = Rows.of([])
    before = frames_before(none)
    assert len(before) == len(change_ages(none.raw, before)) == len(answer_pairs(none)[1]) == 0
    assert change_ages(np.zeros((1, 10), np.uint8), np.array([-1])).tolist() == [[UNCHANGED] * 10]
