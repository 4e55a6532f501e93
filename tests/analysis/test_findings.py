"""Findings: what is wrong is found, and nothing is invented."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from functools import cache
from itertools import pairwise

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
from fte_sniff.analysis.counters import Keep
from fte_sniff.analysis.events import MOST_WINDOWS, Events
from fte_sniff.analysis.facts import Facts
from fte_sniff.analysis.filter.row_filter import RowFilter
from fte_sniff.analysis.findings import Cause, Finding, Findings, spans_of
from fte_sniff.protocol import KIND_BY_NAME, Fault, Gap, PortEvent, PortEventKind, Row, encode
from fte_sniff.protocol.rows import NO_TIME, Rows, fault_bits
from tests.analysis import pieces

COMMAND = bytes.fromhex("AA0101000000000000EE")


def rows_with(kind: str, seed: int = 1) -> tuple[Rows, Episode]:
    what = Episode(kind, 300, 300 + LENGTHS.get(kind, 100), 3, 0.4, feedback=True)
    return recording(np.random.default_rng(seed), 900, what), what


def findings_in(*parts: Rows) -> Findings:
    found = Findings()
    for rows in parts:
        found.observe(rows)
    return found


@pytest.mark.parametrize("kind", EPISODES)
def test_an_episode_is_found_with_its_motor_and_span(kind: str) -> None:
    rows, what = rows_with(kind)
    found = find(rows, events=port_events(np.random.default_rng(1), what))
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


def shown_rows(rows: Rows, found: Finding) -> Rows:
    """The rows that the filter of a finding shows in its span."""
    facts = Facts()
    known = Rows.concat([facts.feed(rows), facts.interrupt()])
    inside = (known.t_ns >= found.first_ns) & (known.t_ns <= found.last_ns)
    return RowFilter.parse(found.filter).select(known.select(inside))


@pytest.mark.parametrize("kind", ["lost", "late", "damage", "error", "offline"])
def test_the_filter_of_a_finding_shows_its_events_from_the_first_to_the_last(kind: str) -> None:
    rows, _ = rows_with(kind)
    found = find(rows)[0]
    shown = shown_rows(rows, found)
    assert found.events == len(shown) or kind == "damage"
    assert (found.first_ns, found.last_ns) == (shown.t_ns.min(), shown.t_ns.max())


def test_a_finding_names_the_numbers_of_answers_and_commands() -> None:
    (found,) = find(rows_with("lost")[0])
    text = f"motor 3 answered {found.rows - found.events:,} of {found.rows:,} commands"
    assert (found.cause, found.motor) == (Cause.UNANSWERED, 3)
    assert text in found.text


def polled(seconds: int, changes: Callable[[int, int], dict[str, int]]) -> Rows:
    """Feedback of four motors, 20 times a second; `changes` are values by number and motor."""
    return Rows.of(
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
    values = rows.values("online", np.arange(len(rows))) == 0b1011
    if cause is Cause.ERROR_FLAG:
        values = rows.values("error", np.arange(len(rows))) != 0
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


def test_flipped_bits_in_flags_are_not_a_finding() -> None:
    rows = polled(600, lambda n, motor: {"error": 1 << n % 8 if n % 40 < 4 else 0})
    assert find(rows) == []


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


def test_damage_names_a_direction_only_where_its_rows_have_one() -> None:
    raw = bytes.fromhex("5501")
    some = [
        Row("bus", n, raw, START_NS + n * SECOND // 20, (Fault.TRUNCATED,), framed=False)
        if n % 2 and 2000 < n < 4000
        else feedback(n * SECOND // 20)
        for n in range(6000)
    ]
    (found,) = find(Rows.of(some))
    assert found.text.endswith("mostly truncated")
    assert found.motor == 1
    wrong = bytes.fromhex("550109000000000000EE")
    framed = [
        Row("bus", one.offset, wrong, one.t_ns, (Fault.BAD_MOTOR,)) if not one.framed else one
        for one in some
    ]
    (found,) = find(Rows.of(framed))
    assert found.text.endswith("mostly bad_motor, feedback")
    assert found.motor == 1


def _damaged_now_and_then(motors: tuple[int, ...]) -> Rows:
    """Ten minutes of feedback; of the fourth, every twentieth row of these motors is damaged."""
    rows = list[Row]()
    for n in range(12_000):
        motor, t_ns = n % 4 + 1, n * SECOND // 20
        if 3600 <= n < 4800 and motor in motors and n // 4 % 20 == 0:
            raw = bytes.fromhex(f"5501{motor:02X}")
            rows.append(Row("bus", n, raw, START_NS + t_ns, (Fault.TRUNCATED,), framed=False))
        else:
            rows.append(feedback(t_ns, motor=motor))
    return Rows.of(rows)


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
    ],
)
def test_errors_of_a_port_are_a_finding_with_their_times(
    kind: PortEventKind, count: int, is_wrong: bool
) -> None:
    rows = recording(np.random.default_rng(5), 300, None)
    times = [START_NS + 100 * SECOND + n * SECOND // 3 for n in range(count)]
    model = Findings()
    events = [PortEvent(t_ns, "bus", kind, "") for t_ns in times]
    model.observe(rows.replace(events))
    found = [(one.cause, one.events, one.first_ns, one.last_ns) for one in model.found()]
    assert found == [(Cause.PORT, count, times[0], times[-1])] * is_wrong


@pytest.mark.parametrize("kind", ["lost", "damage", "error"])
def test_batches_and_parts_give_the_findings_of_a_single_pass(kind: str) -> None:
    rows, _ = rows_with(kind)
    whole = findings_in(rows).found()
    cuts = [0, 1, 5000, 5001, 30_000, len(rows)]
    parts = [rows[start:end] for start, end in pairwise(cuts)]
    assert findings_in(*parts).found() == whole
    merged = Findings()
    for part in parts:
        merged.merge(pickle.loads(pickle.dumps(findings_in(part))))
    assert merged.found() == whole


@given(pieces.captures(), st.lists(st.integers(0, 25), max_size=4))
def test_any_parts_merge_to_the_events_of_a_single_pass(
    steps: list[pieces.Step], cuts: list[int]
) -> None:
    steps = [one for one in steps if not isinstance(one, Row) or one.t_ns is not None]
    whole, merged = Findings(), Findings()
    pieces.observe(whole, steps)
    for part in pieces.pieces_of(steps, cuts):
        model = Findings()
        pieces.observe(model, part)
        merged.merge(model)
    found, wanted = counts_in(merged.events), counts_in(whole.events)
    if any(isinstance(one, Gap) for one in steps):
        # After a gap, a part does not know whether feedback came before it.
        for counts in (found, wanted):
            for key in [one for one in counts if one[2].split()[0] in ("asked", "missed")]:
                del counts[key]
    assert found == wanted


@given(st.lists(st.booleans(), min_size=1, max_size=40), st.lists(st.integers(0, 40), max_size=4))
def test_flags_across_cuts_are_those_of_a_single_pass(raised: list[bool], cuts: list[int]) -> None:
    rows = Rows.of(
        feedback(n * SECOND // 3, error=4 * is_raised) for n, is_raised in enumerate(raised)
    )
    merged = Findings()
    for start, end in pairwise([0, *sorted(cuts), len(rows)]):
        merged.merge(findings_in(rows[start:end]))
    assert merged.found() == findings_in(rows).found()
    runs = [len(run) for run in "".join("01"[one] for one in raised).split("0")]
    counted = merged.events.windows.count("raised 1").sum()
    assert counted == sum(run for run in runs if run >= 3)


def counts_in(events: Events) -> dict[tuple[str, Keep, str], list[list[int]]]:
    """All counts and ranges, without the empty ones."""
    found = {}
    for port, windows in {**events.ports, "": events.windows}.items():
        starts_ns = windows.starts_ns
        for (keep, name), column in windows._columns.items():
            own = column != keep.value
            if own.any():
                found[port, keep, name] = [starts_ns[own].tolist(), column[own].tolist()]
    return found


def feedback(at_ns: int, motor: int = 1, error: int = 0, online: int = 15) -> Row:
    return Row("bus", 0, feedback_bytes(motor, error, online), START_NS + at_ns)


@cache
def feedback_bytes(motor: int, error: int, online: int) -> bytes:
    values = {"motor": motor, "rpm": 0, "error": error, "online": online}
    return encode(KIND_BY_NAME["speed_feedback"], values)


def test_findings_of_the_last_minutes_are_those_of_their_rows() -> None:
    rows, what = rows_with("error")
    model = findings_in(rows)
    before, after = (START_NS + int(t * SECOND) for t in (what.start_s - 60, what.end_s + 30))
    assert [(one.cause, one.motor) for one in model.recent(before)] == [(Cause.ERROR_FLAG, 3)]
    assert model.recent(after) == []
    last_ns = int(rows.t_ns[-1])
    found, recent = model.found_and_recent(last_ns - before)
    assert [(one.cause, one.motor) for one in found] == [(Cause.ERROR_FLAG, 3)]
    assert [(one.cause, one.motor) for one in recent] == [(Cause.ERROR_FLAG, 3)]
    assert model.found_and_recent(last_ns - after)[1] == []
    assert model.found_and_recent(0) == (model.found(), [])


def test_a_lost_port_explains_what_happens_while_it_is_lost() -> None:
    rows, what = rows_with("lost")
    start, end = (START_NS + int(t * SECOND) for t in (what.start_s - 5, what.end_s + 5))
    events = [
        PortEvent(start, "bus", PortEventKind.LOST, ""),
        PortEvent(end, "bus", PortEventKind.FOUND_AGAIN, ""),
    ]
    model = Findings()
    model.observe(rows.replace(events))
    assert [(one.cause, one.port) for one in model.found()] == [(Cause.PORT, "bus")]


def test_one_wire_leaves_answers_unexamined() -> None:
    rows, _ = rows_with("lost")
    control = findings_in(rows.select(rows.directions == 0))
    assert control.found() == []
    assert {Cause.UNANSWERED, Cause.LATE, Cause.SILENCE} <= control.not_covered().keys()
    feedback = findings_in(rows.select(rows.directions == 1))
    assert feedback.found() == []
    assert {Cause.UNANSWERED, Cause.IRREGULAR_COMMANDS} <= feedback.not_covered().keys()


def test_commands_on_several_ports_leave_answers_unexamined() -> None:
    rows, _ = rows_with("lost")
    columns = {**rows.columns, "port": np.arange(len(rows), dtype=np.uint16) % 4}
    several = Rows(columns, tuple("abcd"))
    model = findings_in(several)
    assert not {one.cause for one in model.found()} & {Cause.UNANSWERED, Cause.LATE, Cause.SILENCE}
    assert Cause.UNANSWERED in model.not_covered()


def test_damage_on_one_of_four_ports_is_named_with_its_port() -> None:
    what = Episode("damage", 100, 200, 3, 0.4, feedback=True)
    several = [
        recording(np.random.default_rng(20 + number), 400, what if number == 2 else None)
        for number in range(4)
    ]
    rows = Rows.concat(
        [Rows(one.columns, (name,)) for one, name in zip(several, "abcd", strict=True)]
    )
    model = findings_in(rows.select(np.argsort(rows.t_ns, kind="stable")))
    (found,) = model.found()
    assert (found.cause, found.port, found.filter) == (
        *(Cause.DAMAGE, "c"),
        "malformed AND port = 'c'",
    )


def test_captures_of_other_ports_at_other_times_are_examined() -> None:
    rows, what = rows_with("lost")
    later = recording(np.random.default_rng(9), 300, None)
    later = Rows({**later.columns, "t_ns": later.t_ns + 3600 * SECOND}, ("other",))
    model = findings_in(rows)
    model.merge(findings_in(later))
    assert model.not_covered() == {}
    assert is_found(model.found(), what)


@pytest.mark.parametrize(
    ("rows", "text"),
    [
        ([], "nothing could be examined: the input has no rows"),
        ([Row("p", 0, COMMAND, START_NS)], "only one wire was recorded"),
        ([Row("p", 0, COMMAND, None)] * 50, "no row has a time"),
        (
            [Row("p", n, b"\x01", START_NS + n, (Fault.NOISE,), framed=False) for n in range(500)],
            "is a frame",
        ),
        (
            [Row("p", n, b"\x01", None, (Fault.NOISE,), framed=False) for n in range(500)],
            "is a frame",
        ),
    ],
    ids=["no row", "one row", "no times", "noise", "noise without times"],
)
def test_rows_that_show_nothing_have_no_findings(rows: list[Row], text: str) -> None:
    model = findings_in(Rows.of(rows))
    assert model.found() == []
    assert model.not_covered()
    assert any(text in line for line in model.coverage([]))


def test_times_that_fall_invent_nothing() -> None:
    rows = recording(np.random.default_rng(7), 600, None)
    fallen = rows.t_ns.copy()
    fallen[len(rows) // 2 :] -= 400 * SECOND
    assert find(rows.replace(t_ns=fallen)) == []
    some = rows.t_ns.copy()
    some[::7] = NO_TIME
    assert not {one.cause for one in find(rows.replace(t_ns=some))} & {
        Cause.PORT,
        Cause.SILENCE,
    }


def test_windows_are_bounded_and_lose_no_event() -> None:
    events, count = Events(), 3 * MOST_WINDOWS
    raw = bytes.fromhex("1234")
    rows = Rows.of(
        Row("p", n, raw, START_NS + n * SECOND * 2, (Fault.NOISE,), framed=False)
        for n in range(count)
    )
    for start in range(0, count, 1000):
        events.observe(rows[start : start + 1000])
    windows = events.ports["p"]
    assert len(windows) <= MOST_WINDOWS
    assert windows.count("damaged").sum() == count


def test_windows_of_parts_are_those_of_the_whole() -> None:
    rows, _ = rows_with("damage")
    whole, first, second = Events(), Events(), Events()
    whole.observe(rows)
    first.observe(rows[:4000])
    second.observe(rows[4000:])
    first.merge(second)
    for name in ("rows", "damaged", "commands", "feedback"):
        assert first.ports["bus"].count(name).tolist() == whole.ports["bus"].count(name).tolist()


def test_the_scan_keeps_its_bound_for_chance() -> None:
    rng = np.random.default_rng(3)
    exposed = np.ones(1200, np.bool_)
    for rate in (0.002, 0.05, 0.5):
        for _ in range(40):
            assert spans_of((rng.random(1200) < rate).astype(np.int64), exposed) == []


def test_the_scan_finds_a_span_and_its_ends() -> None:
    rng = np.random.default_rng(4)
    counts = (rng.random(1200) < 0.02).astype(np.int64)
    counts[500:530] = 1
    ((start, end, _),) = spans_of(counts, np.ones(1200, np.bool_))
    assert abs(start - 500) <= 3
    assert abs(end - 529) <= 3


def test_what_is_counted_is_reported_where_there_is_no_finding() -> None:
    def changes(n: int, motor: int) -> dict[str, int]:
        is_single = motor == 2 and n in (100, 900)
        return {"error": 4 if is_single else 0, "online": 0b1011 if n == 501 and motor == 1 else 15}

    rows = list(polled(60, changes))
    for at in range(0, len(rows), 80):
        rows[at] = Row(rows[at].port, at, b"\x01", rows[at].t_ns, (Fault.NOISE,), framed=False)
    model = findings_in(Rows.of(rows))
    assert model.found() == []
    (line,) = [line for line in model.coverage([]) if "for a finding" in line]
    assert line.endswith(
        ": malformed rows 60 (1.2 %), frames with an ERROR flag 2,"
        " frames that lack a bit of ONLINE 1"
    )
    assert model.counts() == {Cause.DAMAGE: 60, Cause.ERROR_FLAG: 2, Cause.OFFLINE: 1}
    assert not [
        line for line in findings_in(polled(60, lambda *_: {})).coverage([]) if "few" in line
    ]


def test_a_port_that_may_come_back_is_not_given_up() -> None:
    model = findings_in(polled(10, lambda *_: {}))
    model.observe_events([PortEvent(START_NS, "p", PortEventKind.LOST, "")])
    assert [str(one.text) for one in model.found()] == ["the port was lost and not found again"]
    model.grows = True
    (found,) = model.found()
    assert found.text == "the port was lost and not found again so far"
