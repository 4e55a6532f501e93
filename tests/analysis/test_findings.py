"""Findings: what is wrong is found, and nothing is invented."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from benchmarks.findings_quality import (
    EPISODES,
    LENGTHS,
    SECOND,
    START_NS,
    Episode,
    find,
    is_found,
    port_events,
    recording,
)
from fte_sniff.analysis import events
from fte_sniff.analysis import segments as segments_
from fte_sniff.analysis.findings import Cause, Report
from fte_sniff.analysis.findings import find as find_counted
from fte_sniff.analysis.segments import summed
from fte_sniff.analysis.spans import spans_of
from fte_sniff.analysis.table import Table
from fte_sniff.protocol.items import Gap, GapKind, PortEvent, PortEventKind
from fte_sniff.protocol.rows import Item, Row, Rows, fault_bits
from fte_sniff.protocol.spec import KIND_BY_NAME, Fault, encode
from tests.analysis import captures as some
from tests.analysis.captures import segments, table_of
from tests.analysis.test_compare import counts_by_key
from tests.analysis.test_segments import tables
from tests.support.columns import rows_from


@cache
def rows_with(kind: str, seed: int = 1) -> tuple[Rows, Episode]:
    what = Episode(kind, 300, 300 + LENGTHS.get(kind, 100), 3, 0.4, feedback=True)
    return recording(np.random.default_rng(seed), 900, what), what


def report(*items: Item) -> Report:
    return find_counted(summed(map(events.counted, segments(items))))


@pytest.mark.parametrize("kind", EPISODES)
def test_an_episode_is_found_with_its_motor_and_span(kind: str) -> None:
    rows, what = rows_with(kind)
    found = find(rows, happened=port_events(np.random.default_rng(1), what))
    assert is_found(found, what)
    of_rows = [one for one in found if one.cause is not Cause.PORT]
    ends_ns = {one_ns for one in of_rows for one_ns in (one.first_ns, one.last_ns)}
    assert ends_ns <= set(rows.t_ns.tolist())


def test_nothing_is_found_where_nothing_is_wrong() -> None:
    assert find(recording(np.random.default_rng(5), 1800, None)) == []


@pytest.mark.parametrize(("share", "is_wrong"), [(0.002, False), (0.2, True)])
def test_a_line_that_is_damaged_all_the_time_is_a_finding(share: float, is_wrong: bool) -> None:
    what = Episode("damage", 0, 900, 3, share, feedback=True)
    found = find(recording(np.random.default_rng(7), 900, what))
    assert [one.cause for one in found] == [Cause.DAMAGE] * is_wrong
    assert all("; throughout that time; mostly " in one.text for one in found)


def test_a_second_offline_does_not_explain_answers_that_are_lost_all_the_time() -> None:
    rows, _ = rows_with("brief_offline")
    lost = (rows.directions == 1) & (rows.nums == 3)
    lost &= np.random.default_rng(1).random(len(rows)) < 0.3
    found = {(one.cause, one.motor) for one in find(rows.select(~lost))}
    assert found >= {(Cause.OFFLINE, 3), (Cause.UNANSWERED, 3)}


def polled(seconds: int, changes: Callable[[int, int], dict[str, int]]) -> Rows:
    """Feedback of four motors, 20 times a second; `changes` are values by number and motor."""
    return rows_from(
        feedback(n * SECOND // 20 + motor, motor, **changes(n, motor))
        for n in range(20 * seconds)
        for motor in (1, 2, 3, 4)
    )


@pytest.mark.parametrize(("cause", "frames"), [(Cause.ERROR_FLAG, 1), (Cause.OFFLINE, 4)])
@pytest.mark.parametrize(("count", "is_wrong"), [(2, False), (3, True), (23, True)])
def test_a_flag_in_three_frames_in_a_row_is_a_finding(
    cause: Cause, frames: int, count: int, is_wrong: bool
) -> None:
    first = 20 * 30

    def changes(n: int, motor: int) -> dict[str, int]:
        inside = first <= n * 4 + motor - 3 < first + count if frames == 4 else True
        if cause is Cause.OFFLINE:
            return {"online": 0b1011 if inside else 15}
        return {"error": 4 if motor == 3 and first <= n < first + count else 0}

    rows = polled(120, changes)
    values = rows.field("online")[0] == 0b1011
    if cause is Cause.ERROR_FLAG:
        values = rows.field("error")[0] != 0
    found = find(rows)
    assert [(one.cause, one.motor) for one in found] == [(cause, 3)] * is_wrong
    for one in found:
        own = rows.t_ns[values]
        assert (one.events, one.first_ns, one.last_ns) == (count, own[0], own[-1])
        assert ("bit 2 of ONLINE (taken as motor 3)" in one.text) == (cause is Cause.OFFLINE)


def test_a_finding_about_most_motors_leaves_the_others_as_they_are() -> None:
    def changes(n: int, motor: int) -> dict[str, int]:
        first = 20 * (30 if motor < 4 else 80)
        return {"error": 4 if first <= n < first + 100 else 0}

    found = find(polled(120, changes))
    assert {(one.cause, one.motor, one.events) for one in found} == {
        (Cause.ERROR_FLAG, None, 300),
        (Cause.ERROR_FLAG, 4, 100),
    }


@pytest.mark.usefixtures("feedback_without_flags")
def test_feedback_without_online_takes_no_motor_offline() -> None:
    assert report(rows_from(some.talk_with_feedback_without_flags(60))).found == []


def test_flags_that_come_again_and_again_are_few_findings_with_all_of_them() -> None:
    rows = polled(1200, lambda n, motor: {"error": 2 if motor == 1 and n % 1200 < 5 else 0})
    found = find(rows)
    assert {(one.cause, one.motor) for one in found} == {(Cause.ERROR_FLAG, 1)}
    assert len(found) <= 5
    assert sum(one.events for one in found) == 20 * 5


def test_silence_begins_with_the_last_feedback_and_ends_with_the_next() -> None:
    rows, what = rows_with("silent")
    (found,) = find(rows)
    own = (rows.directions == 1) & (rows.nums == what.motor)
    times = rows.t_ns[own]
    after = int(np.searchsorted(times, START_NS + what.start_s * SECOND + SECOND))
    assert (found.first_ns, found.last_ns) == (times[after - 1], times[after])


def test_a_host_that_leaves_a_motor_out_is_not_silence() -> None:
    rows = recording(np.random.default_rng(2), 900, None)
    times = (rows.t_ns - START_NS) / SECOND
    left_out = (times > 300) & (times < 400) & (rows.nums == 2)
    assert find(rows.select(~left_out)) == []


def _damaged_now_and_then(motors: tuple[int, ...]) -> Rows:
    """Ten minutes of feedback; of the fourth, every twentieth row of these motors is damaged."""
    rows = list[Row]()
    for n in range(12_000):
        motor, t_ns = n % 4 + 1, n * SECOND // 20
        if 3600 <= n < 4800 and motor in motors and n // 4 % 20 == 0:
            raw = bytes.fromhex(f"5501{motor:02X}")
            rows.append(cut(t_ns, raw))
        else:
            rows.append(feedback(t_ns, motor=motor))
    return rows_from(rows)


def test_damage_explains_no_more_late_answers_than_it_can() -> None:
    rows, what = rows_with("late")
    inside = (rows.t_ns >= START_NS + what.start_s * SECOND) & (rows.nums == what.motor)
    inside &= rows.t_ns < START_NS + what.end_s * SECOND
    hit = np.flatnonzero(inside)[::25]
    framed, length, faults = rows.framed.copy(), rows.length.copy(), rows.faults.copy()
    framed[hit], length[hit] = False, 4
    faults[hit] = fault_bits([Fault.TRUNCATED])
    found = find(rows.replace(framed=framed, length=length, faults=faults))
    causes = {(one.cause, one.motor) for one in found}
    assert causes >= {(Cause.LATE, what.motor), (Cause.DAMAGE, what.motor)}


@pytest.mark.parametrize(
    ("motors", "motor", "shown"),
    [
        ((3,), 3, "malformed AND motor_hint = 3"),
        ((1, 2, 3, 4), None, "malformed"),
    ],
)
def test_little_damage_is_of_a_motor_if_most_of_it_is(
    motors: tuple[int, ...], motor: int | None, shown: str
) -> None:
    (found,) = find(_damaged_now_and_then(motors))
    assert (found.cause, found.motor, found.filter) == (Cause.DAMAGE, motor, shown)
    assert found.events / found.rows == pytest.approx(0.05, abs=0.01)


@pytest.mark.parametrize(
    ("kind", "count", "is_wrong"),
    [
        (PortEventKind.LINE_ERROR, 2, False),
        (PortEventKind.LINE_ERROR, 5, True),
        (PortEventKind.OVERRUN, 1, True),
        (PortEventKind.OVERRUN, 2, True),
    ],
)
def test_errors_of_a_port_are_a_finding_with_their_times(
    kind: PortEventKind, count: int, is_wrong: bool
) -> None:
    rows = recording(np.random.default_rng(5), 300, None)
    times = [START_NS + 100 * SECOND + n * SECOND // 3 for n in range(count)]
    happened = [PortEvent(t_ns, "bus", kind, "") for t_ns in times]
    found = find(rows, happened=happened)
    spans = [(one.cause, one.events, one.first_ns, one.last_ns) for one in found]
    assert spans == [(Cause.PORT, count, times[0], times[-1])] * is_wrong
    assert [one.text.endswith(f", {count} times") for one in found] == [count > 1] * is_wrong


@given(some.captures(), st.integers(1, 12))
def test_counts_of_parts_add_up_to_the_whole(steps: list[Row | Item], most: int) -> None:
    parts = [pickle.loads(pickle.dumps(events.counted(one))) for one in tables(steps, most)]
    whole = events.counted(table_of(steps))
    assert counts_by_key(summed(parts)) == counts_by_key(whole)


def tables_of(rows: Rows) -> list[Table]:
    return [*segments([rows], most=4096)]


def test_windows_of_a_long_recording_are_merged(monkeypatch: pytest.MonkeyPatch) -> None:
    rows, what = rows_with("lost")
    monkeypatch.setattr(segments_, "MOST_ROWS", 20_000)
    found = summed(map(events.counted, tables_of(rows)))
    assert 10_000 < len(found["windows"]) <= 20_000
    assert len(found["delays"]) <= 20_000
    assert len(events.Events(found).windows.starts_ns) < 400
    assert is_found(find_counted(found).found, what)


def slower(motor: int, delay_ms: float) -> list[Item]:
    """Five minutes of motors that answer after 3 ms, and one that does otherwise."""
    rows = some.polled(6000, motors=[one for one in (1, 2, 3, 4) if one != motor])
    rows += some.polled(6000, motors=(motor,), delay_ms=delay_ms)
    return [rows_from(sorted(rows, key=lambda row: row.t_ns or 0))]


def test_motor_that_is_slower_all_the_time_is_unlike_the_others() -> None:
    (found,) = report(*slower(2, 6.6)).found
    assert (found.cause, found.motor, found.kind) == (Cause.UNLIKE_OTHERS, 2, "speed")
    assert found.text == "motor 2 answers speed after 6.6 ms (median), the others after 3 ms"
    assert found.filter == "answer_ms >= 6 AND kind = 'speed' AND motor = 2"


def test_minute_of_lost_answers_is_before_a_second_of_a_flag() -> None:
    lost: list[Row | Item] = []
    for row in some.polled(6000):
        t_s = ((row.t_ns or 0) - some.START) / some.SECOND
        if row.raw[0] == 0x55 and row.raw[2] == 3 and 100 < t_s < 137 and row.raw[5] % 2 == 0:
            continue
        is_off = row.raw[0] == 0x55 and 200 < t_s < 201
        raw = row.raw[:8] + b"\x07" + row.raw[9:]
        lost.append(replace(row, raw=raw) if is_off else row)
    found = report(*some.items_of(lost)).found
    assert [(one.cause, one.motor) for one in found][:2] == [
        (Cause.SILENCE, 3),
        (Cause.OFFLINE, 4),
    ]


def test_motor_with_more_damage_all_the_time_is_unlike_the_others() -> None:
    rows = Rows.concat([one for one in slower(2, 3) if isinstance(one, Rows)])
    rng, length, framed, faults = np.random.default_rng(3), rows.length, rows.framed, rows.faults
    share = np.where(rows.nums == 3, 0.02, 0.004)
    hit = np.flatnonzero((rng.random(len(rows)) < share) & (rows.raw[:, 0] == 0x55))
    length[hit], framed[hit], faults[hit] = 6, False, fault_bits([Fault.TRUNCATED])
    found = report(rows.replace(length=length, framed=framed, faults=faults)).found
    assert [(one.cause, one.motor) for one in found] == [(Cause.UNLIKE_OTHERS, 3)]
    assert found[0].filter == "malformed AND motor_hint = 3"
    assert found[0].usual < 0.003 < found[0].events / found[0].rows


def test_motor_that_never_answers_is_one_finding() -> None:
    rows = some.polled(1000)
    rows = [row for row in rows if row.raw[:1] == b"\xaa" or row.raw[2] != 4]
    (found,) = report(rows_from(rows)).found
    assert (found.cause, found.motor, found.events) == (Cause.UNANSWERED, 4, 999)
    assert found.text == "motor 4 answered none of 999 commands; other motors answered"


def test_recording_of_selected_rows_is_not_examined() -> None:
    gap = Gap(GapKind.SELECTED, reason="direction = 'control'")
    event = PortEvent(START_NS + 50 * SECOND, "bus", PortEventKind.OVERRUN, "", 9)
    found = report(gap, event, rows_with("lost")[0])
    assert [one.cause for one in found.found] == [Cause.PORT]
    assert set(found.not_covered) == {*map(str, Cause)} - {"port"}
    assert all("for which this held: direction = 'control'" in line for line in found.coverage())


@pytest.mark.parametrize(
    ("rows", "causes", "why"),
    [
        ([], len(Cause), "the input has no rows"),
        ([some.damage(0)], len(Cause) - 1, "no row is a frame; is the baud rate right?"),
        ([some.frame("speed", None)], len(Cause), "no row has a time; try --start"),
        ([some.frame("speed", 0)], 5, "feedback is missing: only one wire was recorded"),
        ([some.frame("speed_feedback", 0)], 5, "no command awaits an answer"),
    ],
)
def test_what_rows_cannot_show_is_named(rows: list[Row], causes: int, why: str) -> None:
    found = find_counted(events.counted(table_of([*rows])))
    assert [str(one) for one in found.not_covered.values()].count(why) == causes
    assert any(why in line for line in found.coverage())


@pytest.mark.parametrize(
    ("data", "text"),
    [
        (bytes(2), "only 00 for 9 s: the wire is held low (a break, no power, no ground)"),
        (b"\xff\xff", "only FF for 9 s: an open wire"),
        (b"\x01\x02", "no frame in 40 bytes for 9 s: another baud"),
    ],
)
def test_wire_without_a_frame_is_what_it_is(data: bytes, text: str) -> None:
    rows = [some.damage(at, data) for at in range(0, 10_000, 500)]
    (found,) = report(rows_from(rows)).found
    assert (found.cause, found.port, found.events) == (Cause.PORT, "a", 20)
    assert found.text.startswith(text)
    (other,) = report(rows_from([*rows, some.frame("speed", 10_000)])).found
    assert other.cause is Cause.DAMAGE
    two = [*rows, *(replace(one, port="b") for one in some.polled(200))]
    found, *_ = report(rows_from(sorted(two, key=lambda row: row.t_ns or 0))).found
    assert (found.port, found.filter) == ("a", "port = 'a'")


def test_misspelt_column_is_an_error() -> None:
    windows = events.Events(events.counted(table_of(some.polled(2)))).windows
    assert windows.total("missed 1") == 0
    with pytest.raises(KeyError, match="mised 1"):
        windows["mised 1"]


@given(st.lists(st.integers(0, 3), max_size=60), st.integers(0, 60))
def test_spans_are_of_windows_with_events(counts: list[int], burst: int) -> None:
    values = np.array([*counts, *[9] * burst, *counts], np.int64)
    exposed = np.ones(len(values), np.bool_)
    for score, start, end in spans_of(values, exposed):
        assert values[start] > 0
        assert values[end] > 0
        assert score > 0


def cut(at_ns: int, raw: bytes) -> Row:
    return Row("bus", 0, raw, START_NS + at_ns, (Fault.TRUNCATED,), framed=False)


def feedback(at_ns: int, motor: int = 1, error: int = 0, online: int = 15) -> Row:
    return Row("bus", 0, feedback_bytes(motor, error, online), START_NS + at_ns)


@cache
def feedback_bytes(motor: int, error: int, online: int) -> bytes:
    values = {"motor": motor, "rpm": 0, "error": error, "online": online}
    return encode(KIND_BY_NAME["speed_feedback"], values)


def test_damage_between_silences_is_a_finding_of_its_own() -> None:
    rows, what = rows_with("damage")
    times = [START_NS + at * SECOND for at in (299, 350, 401)]
    happened = [PortEvent(t_ns, "bus", PortEventKind.SILENT, "") for t_ns in times]
    found = find(rows, happened=happened)
    assert any(one.cause is Cause.PORT and one.events == 3 for one in found)
    assert is_found(found, what)
