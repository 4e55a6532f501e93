"""Statistics of one source and of several, checked against a count by hand."""

from __future__ import annotations

import pickle
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from fte_sniff.analysis.model import GapDetector
from fte_sniff.analysis.motors import Motors
from fte_sniff.analysis.statistics import LineSetup, Statistics, StatisticsSummary
from fte_sniff.protocol import (
    FRAME_LENGTH,
    KIND_BY_NAME,
    MOTORS,
    Direction,
    Fault,
    Gap,
    GapKind,
    PortEvent,
    PortEventKind,
    Row,
    Status,
    byte_time_ns,
    encode,
)
from fte_sniff.protocol.rows import Rows
from tests.analysis.pieces import Step, bauds_after, captures, observe, pieces_of, state_of

SECOND = 1_000_000_000
ROWS = st.lists(st.from_type(Row), max_size=15)
SETUP = LineSetup()


def statistics_of(rows: list[Row], cut: int = 0) -> Statistics:
    found = Statistics(SETUP)
    for part in (rows[:cut], rows[cut:]):
        found.observe(Rows.of(part))
    return found


@given(ROWS)
def test_counts_equal_a_count_by_hand(rows: list[Row]) -> None:
    found = statistics_of(rows)
    ports = {numbers.port: numbers for numbers in found.ports()}
    assert {name: numbers.rows for name, numbers in ports.items()} == Counter(
        row.port for row in rows
    )
    for name, numbers in ports.items():
        assert numbers.bytes == sum(len(row.raw) for row in rows if row.port == name)
    faults = Counter(fault for row in rows for fault in set(row.faults))
    assert {numbers.fault: numbers.count for numbers in found.faults()} == faults
    for numbers in found.faults():
        having = [row for row in rows if numbers.fault in row.faults and row.t_ns is not None]
        assert sum(numbers.over_time.values) == len(having)
    streams = Counter(
        (row.port, row.kind.name, row.values.get("motor"))
        for row in rows
        if row.framed and row.kind and (not row.kind.names_motor or row.values["motor"] in MOTORS)
    )
    assert streams == {
        (one.port, one.kind.name, one.motor): one.count for one in found.streams(None)
    }


def _rising(steps: list[int]) -> list[Row]:
    rows: list[Row] = []
    t_ns = 0
    for number, step in enumerate(steps):
        t_ns += step
        raw = encode(KIND_BY_NAME["speed"], {"motor": 1 + number % 2, "rpm": 5})
        time = None if number % 7 == 3 else t_ns
        rows.append(Row("pq"[number % 3 == 0], 10 * number, raw, time))
    return rows


@given(st.lists(st.integers(0, SECOND), max_size=30), st.integers(0, 30))
def test_batches_of_any_size_give_the_same_statistics(steps: list[int], cut: int) -> None:
    rows = _rising(steps)
    once, parts = statistics_of(rows), statistics_of(rows, cut)
    now = sum(steps)
    for one, other in zip(once.streams(now), parts.streams(now), strict=True):
        assert (one.count, one.per_s, one.lately_per_s) == (
            other.count,
            other.per_s,
            other.lately_per_s,
        )
        assert vars(one.periods).keys() == vars(other.periods).keys()
        assert one.jitter_ns == other.jitter_ns
        assert one.periods.longest_at_ns == other.periods.longest_at_ns
    for own, theirs in zip(once.ports(), parts.ports(), strict=True):
        assert (own.share, own.share_over_time) == (theirs.share, theirs.share_over_time)
        assert own.silences.longest_ns == theirs.silences.longest_ns


def _periodic(count: int, step: int) -> list[Row]:
    raw = encode(KIND_BY_NAME["speed"], {"motor": 2, "rpm": 5})
    return [Row("p", FRAME_LENGTH * number, raw, number * step) for number in range(count)]


def test_a_periodic_stream_has_its_rate_and_no_jitter() -> None:
    rows = _periodic(101, SECOND // 100)
    found = statistics_of(rows, 30)
    (stream,) = found.streams(SECOND)
    assert stream.motor == 2
    assert stream.per_s == pytest.approx(100)
    assert stream.lately_per_s == pytest.approx(100)
    assert stream.periods.percentile_ns(50) == pytest.approx(SECOND / 100, rel=0.0005)
    assert stream.jitter_ns == 0
    (port,) = found.ports()
    taken = FRAME_LENGTH * byte_time_ns(SETUP.baud)
    assert port.share == pytest.approx(101 * taken / (SECOND + taken))
    assert port.silences.longest_ns == SECOND // 100 - taken
    assert port.silences.count == 100


@pytest.mark.parametrize(("frames", "jitter_ns"), [(1, None), (2, None), (3, 0)])
def test_one_period_does_not_vary(frames: int, jitter_ns: float | None) -> None:
    (stream,) = statistics_of(_periodic(frames, SECOND)).streams(None)
    assert stream.jitter_ns == jitter_ns


def test_rows_back_to_back_fill_the_line() -> None:
    (port,) = statistics_of(_periodic(500, FRAME_LENGTH * byte_time_ns(SETUP.baud))).ports()
    assert port.share == pytest.approx(1)
    assert port.silences.count == 0


def test_without_times_there_is_no_rate_and_no_share() -> None:
    raw = encode(KIND_BY_NAME["reset"], {})
    found = statistics_of(
        [Row("p", 0, raw, None), Row("p", 10, b"x", None, (Fault.NOISE,), framed=False)]
    )
    (stream,) = found.streams(None)
    assert (stream.motor, stream.count, stream.per_s, stream.jitter_ns) == (None, 1, None, None)
    assert found.ports()[0].share is None


def test_port_events_are_counted_also_before_the_first_row() -> None:
    found = Statistics(SETUP)
    found.observe_events([PortEvent(1, "p", PortEventKind.OPENED, "")])
    found.observe_events([PortEvent(2, "p", PortEventKind.LINE_ERROR, "parity")] * 2)
    (port,) = found.ports()
    assert [(event.kind, event.count, event.last_ns) for event in port.events] == [
        (PortEventKind.OPENED, 1, 1),
        (PortEventKind.LINE_ERROR, 2, 2),
    ]
    assert (port.rows, port.share, port.silences.longest_ns) == (0, None, None)


def test_turns_come_from_resolution_and_gear_ratio() -> None:
    assert LineSetup().turns(500) is None
    assert LineSetup(resolution=500, gear_ratio=20).turns(-15_000) == -1.5


MS = 1_000_000


def summary_of(*sources: Sequence[Row], baud: int = 115_200) -> StatisticsSummary:
    summary = StatisticsSummary(LineSetup(baud))
    for number, rows in enumerate(sources):
        summary.begin(f"{number}.mcap")
        summary.observe(Rows.of(rows))
    return summary


def frame(kind: str, t_ns: int | None, *, port: str = "p", **values: int) -> Row:
    return Row(port, 0, encode(KIND_BY_NAME[kind], values), t_ns)


@given(ROWS, ROWS)
def test_totals_equal_a_count_by_hand(one: list[Row], other: list[Row]) -> None:
    summary, rows = summary_of(one, other), [*one, *other]
    for source, own in zip(summary.sources, (one, other), strict=True):
        assert (source.count.rows, source.count.bytes) == (len(own), sum(len(r.raw) for r in own))
    times = [row.t_ns for row in rows if row.t_ns is not None]
    total = summary.total
    assert total.rows == len(rows)
    assert (total.first_ns, total.last_ns) == (min(times, default=None), max(times, default=None))


@given(st.lists(st.integers(1, 60), min_size=1, max_size=5), st.integers(0, 300))
def test_gaps_leave_the_measurements_of_the_rows_between_them(sizes: list[int], cut: int) -> None:
    pieces, gaps, t_ns = [], list[Gap](), SECOND
    for size in sizes:
        pieces.append([frame("speed", t_ns + at * MS, motor=1, rpm=5) for at in range(size)])
        end = t_ns + size * MS
        gaps.append(Gap(GapKind.DAMAGE, None, end, end + SECOND))
        t_ns += size * MS + 2 * SECOND
    rows = [row for piece in pieces for row in piece]
    summary = StatisticsSummary(LineSetup(115_200))
    summary.begin("a.mcap")
    detector = GapDetector()
    detector.begin({}, gaps)
    for part in (rows[:cut], rows[cut:]):
        summary.observe(Rows.of(part), detector.changes(Rows.of(part)))
    (port,), (stream,) = summary.statistics.ports(), summary.statistics.streams(None)
    measured = len(rows) - len(pieces)
    assert (stream.periods.count, port.silences.count) == (measured, measured)
    for per_s in (stream.per_s, port.per_s):
        assert per_s == (pytest.approx(1000) if measured else None)
    taken = 10 * byte_time_ns(115_200)
    share = len(rows) * taken / (measured * MS + len(pieces) * taken)
    assert port.share == (pytest.approx(share) if measured else None)
    answers = summary.answers.stats()[0]
    assert (answers.pairing.uncovered, answers.neither) == (measured, len(rows))
    assert answers.unanswered == (None if measured else 0)


@given(ROWS)
def test_directions_and_ranges_equal_a_count_by_hand(rows: list[Row]) -> None:
    summary = summary_of(rows)
    frames = [row for row in rows if row.framed]
    for port in summary.statistics.ports():
        for direction in Direction:
            own = [f for f in frames if f.port == port.port and f.direction is direction]
            assert port.frames[direction] == len(own)
    for stream in summary.statistics.streams(None):
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
def test_answers_equal_those_of_the_motor_states(rows: list[Row], cut: int) -> None:
    summary = summary_of(rows[:cut], rows[cut:])
    motors = Motors()
    motors.observe(Rows.of(rows))
    for found, state in zip(summary.answers.stats(), motors.states(None), strict=True):
        assert (
            found.motor,
            found.commands,
            found.feedback,
            found.pairing.answered,
            found.pairing.unanswered,
        ) == (
            state.motor,
            state.commands,
            state.feedback,
            state.answered,
            state.unanswered,
        )
        pairing = found.pairing
        judged = pairing.answered + pairing.unanswered + pairing.uncovered + _resets(rows)
        assert pairing.waiting == (judged < found.commands)


def _resets(rows: list[Row]) -> int:
    """Commands to every motor that no feedback can answer."""
    return sum(row.framed and row.kind is KIND_BY_NAME["reset"] for row in rows)


def test_delays_cover_all_answers_and_have_the_time_of_the_longest() -> None:
    rows: list[Row] = []
    for number in range(1000):
        asked = number * SECOND
        late = 200 * MS if number == 7 else 5 * MS
        rows.append(frame("speed", asked, motor=2, rpm=5))
        rows.append(frame("speed_feedback", asked + late, motor=2, rpm=5))
    found = summary_of(rows).answers.stats()[1]
    assert (found.pairing.answered, found.pairing.unanswered, found.pairing.waiting) == (
        1000,
        0,
        False,
    )
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
def test_flags_equal_a_count_by_hand(reported: list[tuple[int, int, int]], cut: int) -> None:
    rows = [
        frame("speed_feedback", at * MS, motor=motor, rpm=0, error=error, online=online)
        for at, (motor, error, online) in enumerate(reported)
    ]
    for flags in summary_of(rows[:cut], rows[cut:]).flags.stats():
        own = [(at, error) for at, (motor, error, _) in enumerate(reported) if motor == flags.motor]
        bits = {}
        for bit in range(8):
            at = [at for at, error in own if error >> bit & 1]
            if at:
                bits[bit] = len(at), at[0] * MS, at[-1] * MS
        found = {b: (s.rows, s.first_ns, s.last_ns) for b, s in flags.error_bits.items()}
        assert found == bits
        assert list(found) == sorted(found)
        there = [bool(online >> (flags.motor - 1) & 1) for _, _, online in reported]
        away = [at for at, here in enumerate(there) if not here]
        assert flags.offline.rows == len(away)
        assert flags.offline.first_ns == (away[0] * MS if away else None)
        assert flags.offline.last_ns == (away[-1] * MS if away else None)
        assert flags.times_lost == sum(one and not other for one, other in pairwise(there))


def test_utilization_follows_a_baud_change() -> None:
    slow, fast = byte_time_ns(9600), byte_time_ns(115_200)
    rows = [frame("reset", at * SECOND) for at in range(4)]
    change = PortEvent(2 * SECOND - 1, "p", PortEventKind.BAUD_CHANGED, "", 9600)
    expected = (20 * fast + 20 * slow) / (3 * SECOND + 10 * slow)
    for cut in range(5):
        summary = StatisticsSummary(LineSetup(1200))
        detector = GapDetector()
        first, second = ([change], []) if cut > 1 else ([], [change])
        for name, part, events in (("a", rows[:cut], first), ("b", rows[cut:], second)):
            summary.begin(name)
            # The second file of a capture names the baud of its beginning too.
            changes = detector.begin({"p": 115_200})
            observed = Rows.of(part, events=events)
            summary.observe(observed, changes + detector.changes(observed))
        (port,) = summary.statistics.ports()
        assert port.share == pytest.approx(expected), cut
        assert port.baud == 9600
        assert [event.kind for event in port.events] == [PortEventKind.BAUD_CHANGED]


def test_the_baud_of_the_user_has_priority() -> None:
    summary = StatisticsSummary(LineSetup(1200))
    summary.begin("a")
    rows = [frame("reset", at * SECOND) for at in range(2)]
    events = [PortEvent(0, "p", PortEventKind.BAUD_CHANGED, "", 9600)]
    observed = Rows.of(rows, events=events)
    summary.observe(observed, GapDetector().changes(observed))
    assert summary.statistics.ports()[0].baud == 1200


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
def test_inputs_without_overlap_are_in_order(sources: list[list[Row]], in_order: bool) -> None:
    assert summary_of(*sources).in_order is in_order


def test_a_summary_without_rows() -> None:
    summary = summary_of([])
    assert summary.total.rows == 0
    assert summary.total.duration_ns is None
    assert summary.statistics.ports() == []
    assert summary.statistics.streams(None) == []
    counts = summary.statistics.tally.by_status()
    assert {status: count.rows for status, count in counts.items()} == dict.fromkeys(Status, 0)


FOUND_AGAIN: Sequence[Step] = [
    frame("speed_feedback", 0, motor=1, rpm=0),
    *(Gap(GapKind.PORT, port_lost=is_lost) for is_lost in (True, False)),
    *[frame("speed", 0, motor=1, rpm=0)] * 2,
]
"""A port that was lost for a time, then a command without an answer."""


@given(captures(), st.lists(st.integers(0, 25), max_size=4), st.integers(0, 25))
@example(FOUND_AGAIN, [2, 4], 0)
def test_any_pieces_of_a_capture_merge_to_a_single_pass(
    steps: list[Step], cuts: list[int], batch: int
) -> None:
    whole = summary_of([])
    observe(whole, steps)
    merged, before = summary_of([]), list[Step]()
    for piece in pieces_of(steps, cuts):
        part = StatisticsSummary(LineSetup(115_200))
        part.begin("part")
        for some in pieces_of([*bauds_after(before), *piece], [batch]):
            observe(part, some)
        merged.merge(pickle.loads(pickle.dumps(part)))
        before += piece
    assert merged.total == whole.total
    for name in ("statistics", "answers", "flags"):
        assert state_of(getattr(merged, name)) == state_of(getattr(whole, name))
    kept = state_of(merged)
    copied = merged.copy()
    assert state_of(copied) == kept
    copied.merge(whole)
    observe(copied, steps)
    assert state_of(merged) == kept
    assert state_of(merged.statistics.ports()) == state_of(whole.statistics.ports())
    assert state_of(merged.statistics.streams(None)) == state_of(whole.statistics.streams(None))
    assert state_of(merged.statistics.faults()) == state_of(whole.statistics.faults())
