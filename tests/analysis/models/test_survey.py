"""All numbers over whole inputs, against the rows counted by hand."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fte_sniff.analysis.fields import Decoded
from fte_sniff.analysis.motors import Motors
from fte_sniff.analysis.statistics import LineSetup
from fte_sniff.analysis.summary import StatisticsSummary
from fte_sniff.protocol import (
    KIND_BY_NAME,
    MOTORS,
    Damage,
    Direction,
    Fault,
    Frame,
    PortEvent,
    PortEventKind,
    Row,
    Status,
    byte_time_ns,
    encode,
)
from fte_sniff.row_batch import Codebook, pack

MS = 1_000_000
SECOND = 1000 * MS
ROWS = st.lists(st.from_type(Frame) | st.from_type(Damage), max_size=15)


def survey_of(*sources: Sequence[Row], baud: int = 115_200) -> StatisticsSummary:
    survey = StatisticsSummary(LineSetup(baud))
    for number, rows in enumerate(sources):
        survey.begin(f"{number}.mcap", {})
        survey.add(rows)
    return survey


def frame(kind: str, t_ns: int | None, *, port: str = "p", **values: int) -> Frame:
    return Frame(port, 0, encode(KIND_BY_NAME[kind], values), t_ns)


@given(ROWS, ROWS)
def test_extents_status_and_faults_are_what_one_counts(one: list[Row], other: list[Row]) -> None:
    survey, rows = survey_of(one, other), [*one, *other]
    for source, own in zip(survey.sources, (one, other), strict=True):
        assert (source.count.rows, source.count.bytes) == (len(own), sum(len(r.raw) for r in own))
    times = [row.t_ns for row in rows if row.t_ns is not None]
    total = survey.total
    assert total.rows == len(rows)
    assert (total.first_ns, total.last_ns) == (min(times, default=None), max(times, default=None))
    for status, count in survey.faults.by_status().items():
        having: list[Row] = [row for row in rows if row.status is status]
        assert (count.rows, count.bytes) == (len(having), sum(len(row.raw) for row in having))
    for port in {row.port for row in rows}:
        for fault in Fault:
            having = [row for row in rows if fault in row.faults and row.port == port]
            found = survey.faults.by_fault(port).get(fault)
            assert (found.rows if found else 0) == len(having)
            assert (found.bytes if found else 0) == sum(len(row.raw) for row in having)
            times = [row.t_ns for row in having if row.t_ns is not None]
            assert (found.first_ns if found else None) == min(times, default=None)
            assert (found.last_ns if found else None) == max(times, default=None)


@given(st.lists(st.integers(1, 60), min_size=1, max_size=5), st.integers(0, 300))
def test_pieces_with_gaps_between_tell_what_each_tells_alone(sizes: list[int], cut: int) -> None:
    pieces, gaps, t_ns = [], list[tuple[int, int]](), SECOND
    for size in sizes:
        pieces.append([frame("speed", t_ns + at * MS, motor=1, rpm=5) for at in range(size)])
        gaps.append((t_ns + size * MS, t_ns + size * MS + SECOND))
        t_ns += size * MS + 2 * SECOND
    rows = [row for piece in pieces for row in piece]
    survey = StatisticsSummary(LineSetup(115_200))
    survey.begin("a.mcap", {}, gaps)
    survey.add(rows[:cut])
    survey.add(rows[cut:])
    (port,), (stream,) = survey.ports(), survey.streams()
    measured = len(rows) - len(pieces)
    assert (stream.periods.count, port.silences.count) == (measured, measured)
    for per_s in (stream.per_s, port.per_s):
        assert per_s == (pytest.approx(1000) if measured else None)
    taken = 10 * byte_time_ns(115_200)
    assert port.share == pytest.approx(len(rows) * taken / (measured * MS + len(pieces) * taken))
    answers = survey.answers()[0]
    assert (answers.unanswered, answers.neither) == (measured, len(pieces))


@given(ROWS)
def test_directions_and_ranges_are_what_one_counts(rows: list[Row]) -> None:
    survey = survey_of(rows)
    frames = [row for row in rows if isinstance(row, Frame)]
    for port in survey.ports():
        for direction in Direction:
            own = [f for f in frames if f.port == port.port and f.direction is direction]
            assert port.frames[direction] == len(own)
    for stream in survey.streams():
        values = [
            f.values
            for f in frames
            if (f.port, f.kind) == (stream.port, stream.kind)
            and (stream.motor is None or f.values["motor"] == stream.motor)
        ]
        assert stream.count == len(values)
        names = [field.name for field in stream.kind.fields if field.unit]
        assert stream.ranges == {
            name: (min(v[name] for v in values), max(v[name] for v in values)) for name in names
        }


@given(ROWS, st.integers(0, 15))
def test_answers_are_those_of_the_motors_pane(rows: list[Row], cut: int) -> None:
    survey = survey_of(rows[:cut], rows[cut:])
    motors = Motors()
    motors.add(Decoded(pack(rows, Codebook())[0]))
    for found, state in zip(survey.answers(), motors.states(None), strict=True):
        assert (found.motor, found.commands, found.feedback, found.answered, found.unanswered) == (
            state.motor,
            state.commands,
            state.feedback,
            state.answered,
            state.unanswered,
        )
        judged = found.answered + found.unanswered + _resets(rows)
        assert found.waiting == (judged < found.commands)


def _resets(rows: list[Row]) -> int:
    """Commands to every motor that no feedback can answer."""
    return sum(isinstance(row, Frame) and row.kind is KIND_BY_NAME["reset"] for row in rows)


def test_delays_are_over_all_answers_and_know_when_the_longest_was() -> None:
    rows: list[Row] = []
    for number in range(1000):
        asked = number * SECOND
        late = 200 * MS if number == 7 else 5 * MS
        rows.append(frame("speed", asked, motor=2, rpm=5))
        rows.append(frame("speed_feedback", asked + late, motor=2, rpm=5))
    found = survey_of(rows).answers()[1]
    assert (found.answered, found.unanswered, found.waiting) == (1000, 0, False)
    assert found.delays.count == 1000
    assert found.delays.percentile_ns(50) == pytest.approx(5 * MS, rel=0.05)
    assert found.delays.longest_ns == 200 * MS
    assert found.delays.longest_at_ns == 7 * SECOND + 200 * MS


@given(
    st.lists(
        st.tuples(st.sampled_from(MOTORS), st.integers(0, 255), st.integers(0, 255)), max_size=20
    ),
    st.integers(0, 20),
)
def test_flags_are_what_one_counts(told: list[tuple[int, int, int]], cut: int) -> None:
    rows = [
        frame("speed_feedback", at * MS, motor=motor, rpm=0, error=error, online=online)
        for at, (motor, error, online) in enumerate(told)
    ]
    for flags in survey_of(rows[:cut], rows[cut:]).flags():
        own = [(at, error) for at, (motor, error, _) in enumerate(told) if motor == flags.motor]
        bits = {}
        for bit in range(8):
            at = [at for at, error in own if error >> bit & 1]
            if at:
                bits[bit] = len(at), at[0] * MS, at[-1] * MS
        found = {b: (s.frames, s.first_ns, s.last_ns) for b, s in flags.error_bits.items()}
        assert found == bits
        assert list(found) == sorted(found)
        there = [bool(online >> (flags.motor - 1) & 1) for _, _, online in told]
        away = [at for at, here in enumerate(there) if not here]
        assert flags.offline.frames == len(away)
        assert flags.offline.first_ns == (away[0] * MS if away else None)
        assert flags.offline.last_ns == (away[-1] * MS if away else None)
        assert flags.times_lost == sum(one and not other for one, other in pairwise(there))


def test_the_use_of_a_line_follows_its_baud() -> None:
    slow, fast = byte_time_ns(9600), byte_time_ns(115_200)
    rows = [frame("reset", at * SECOND) for at in range(4)]
    change = PortEvent(2 * SECOND - 1, "p", PortEventKind.BAUD_CHANGED, "", 9600)
    expected = (20 * fast + 20 * slow) / (3 * SECOND + 10 * slow)
    for cut in range(5):
        survey = StatisticsSummary(LineSetup(1200))
        survey.begin("a", {"p": 115_200})
        survey.add(rows[:cut], [change] if cut > 1 else [])
        # The next file of a capture tells how it began.
        survey.begin("b", {"p": 115_200})
        survey.add(rows[cut:], [] if cut > 1 else [change])
        (port,) = survey.ports()
        assert port.share == pytest.approx(expected), cut
        assert port.baud == 9600
        assert [event.kind for event in port.events] == [PortEventKind.BAUD_CHANGED]


def test_a_baud_that_the_user_said_is_not_overruled() -> None:
    survey = StatisticsSummary(LineSetup(1200))
    survey.begin("a", {})
    rows = [frame("reset", at * SECOND) for at in range(2)]
    survey.add(rows, [PortEvent(0, "p", PortEventKind.BAUD_CHANGED, "", 9600)])
    assert survey.ports()[0].baud == 1200


TIMED = [frame("reset", at) for at in (10, 20, 30, 40)]
UNTIMED = [replace(TIMED[0], t_ns=None)]


@pytest.mark.parametrize(
    ("sources", "in_order"),
    [
        ([], True),
        ([TIMED], True),
        ([UNTIMED], True),
        ([TIMED[:2], TIMED[2:]], True),
        ([TIMED[:2], [], TIMED[2:]], True),
        ([TIMED[2:], TIMED[:2]], False),
        ([TIMED[:3], TIMED[1:]], False),
        ([UNTIMED, UNTIMED], False),
        ([TIMED, UNTIMED], False),
    ],
)
def test_whether_inputs_follow_each_other(sources: list[list[Row]], in_order: bool) -> None:
    assert survey_of(*sources).in_order is in_order


def test_a_survey_of_nothing() -> None:
    survey = survey_of([])
    assert survey.total.rows == 0
    assert survey.total.span_ns is None
    assert survey.ports() == []
    assert survey.streams() == []
    assert {status: count.rows for status, count in survey.faults.by_status().items()} == (
        dict.fromkeys(Status, 0)
    )
