"""Findings: what is wrong is found, and nothing is invented."""

from __future__ import annotations

import pickle
from itertools import pairwise

import numpy as np
import pytest

from benchmarks.findings_quality import (
    EPISODES,
    SECOND,
    START_NS,
    Episode,
    find,
    is_found,
    recording,
)
from fte_sniff.analysis.events import MOST_WINDOWS, Events
from fte_sniff.analysis.findings import Cause, Findings, spans_of
from fte_sniff.protocol import Damage, Fault, Frame, PortEvent, PortEventKind
from fte_sniff.protocol.rows import NO_TIME, Rows

COMMAND = bytes.fromhex("AA0101000000000000EE")


def rows_with(kind: str, seed: int = 1, **changed: object) -> tuple[Rows, Episode]:
    what = Episode(kind, 300, 312 if kind == "silent" else 400, 3, 0.4, feedback=True)
    return recording(np.random.default_rng(seed), 900, what), what


def findings_in(*parts: Rows) -> Findings:
    found = Findings()
    for rows in parts:
        found.observe(rows)
    return found


@pytest.mark.parametrize("kind", EPISODES)
def test_an_episode_is_found_with_its_motor_and_span(kind: str) -> None:
    rows, what = rows_with(kind)
    assert is_found(find(rows), what)


def test_nothing_is_found_where_nothing_is_wrong() -> None:
    assert find(recording(np.random.default_rng(5), 1800, None)) == []


@pytest.mark.parametrize(("share", "is_wrong"), [(0.002, False), (0.2, True)])
def test_a_line_that_is_damaged_all_the_time_is_a_finding(share: float, is_wrong: bool) -> None:
    what = Episode("damage", 0, 900, 3, share, feedback=True)
    found = find(recording(np.random.default_rng(7), 900, what))
    assert [one.cause for one in found] == [Cause.DAMAGE] * is_wrong


def test_a_finding_names_events_rows_and_the_filter_that_shows_them() -> None:
    from fte_sniff.analysis.facts import Facts
    from fte_sniff.analysis.filter.row_filter import RowFilter

    rows, _ = rows_with("lost")
    (found,) = find(rows)
    facts = Facts()
    known = Rows.concat([facts.feed(rows), facts.interrupt()])
    inside = (known.t_ns >= found.first_ns) & (known.t_ns <= found.last_ns)
    shown = RowFilter.parse(found.filter).select(known.select(inside))
    assert (found.cause, found.motor, found.events) == (Cause.UNANSWERED, 3, len(shown))
    assert (
        f"motor 3 answered {found.rows - found.events:,} of {found.rows:,} commands" in found.text
    )


@pytest.mark.parametrize("kind", ["lost", "damage", "error"])
def test_batches_and_parts_give_the_findings_of_a_single_pass(kind: str) -> None:
    rows, _ = rows_with(kind)
    whole = findings_in(rows).found()
    cuts = [0, 1, 5000, 5001, len(rows)]
    parts = [rows[start:end] for start, end in pairwise(cuts)]
    assert findings_in(*parts).found() == whole
    merged = Findings()
    for part in parts:
        merged.merge(pickle.loads(pickle.dumps(findings_in(part))))
    found = merged.found()
    assert [(one.cause, one.motor) for one in found] == [(one.cause, one.motor) for one in whole]


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
    model.observe(rows, events)
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
    for name in "abcd":
        rows.codebook.port_code(name)
    several = rows.with_columns(port=np.arange(len(rows), dtype=np.uint16) % 4)
    model = findings_in(several)
    assert not {one.cause for one in model.found()} & {Cause.UNANSWERED, Cause.LATE, Cause.SILENCE}
    assert Cause.UNANSWERED in model.not_covered()


def test_captures_of_other_ports_at_other_times_are_examined() -> None:
    rows, what = rows_with("lost")
    rows.codebook.port_code("other")
    later = recording(np.random.default_rng(9), 300, None).recoded(rows.codebook)
    later = later.with_columns(
        t_ns=later.t_ns + 3600 * SECOND, port=np.full(len(later), 1, np.uint16)
    )
    model = findings_in(rows)
    model.merge(findings_in(later))
    assert model.not_covered() == {}
    assert is_found(model.found(), what)


@pytest.mark.parametrize(
    ("rows", "text"),
    [
        ([], "nothing could be examined: there is no row"),
        ([Frame("p", 0, COMMAND, START_NS)], "there is no feedback: only one wire was recorded"),
        ([Frame("p", 0, COMMAND, None)] * 50, "no row has a time"),
        (
            [Damage("p", n, b"\x01\x02", START_NS + n, (Fault.NOISE,)) for n in range(500)],
            "no row is a frame",
        ),
        (
            [Damage("p", n, b"\x01\x02", None, (Fault.NOISE,)) for n in range(500)],
            "no row is a frame",
        ),
    ],
    ids=["no row", "one row", "no times", "noise", "noise without times"],
)
def test_rows_that_show_nothing_have_no_findings(rows: list[Frame | Damage], text: str) -> None:
    model = findings_in(Rows.from_rows(rows))
    assert model.found() == []
    assert model.not_covered()
    assert any(text in line for line in model.coverage([]))


def test_times_that_fall_invent_nothing() -> None:
    rows = recording(np.random.default_rng(7), 600, None)
    fallen = rows.t_ns.copy()
    fallen[len(rows) // 2 :] -= 400 * SECOND
    assert find(rows.with_columns(t_ns=fallen)) == []
    some = rows.t_ns.copy()
    some[::7] = NO_TIME
    assert not {one.cause for one in find(rows.with_columns(t_ns=some))} & {
        Cause.PORT,
        Cause.SILENCE,
    }


def test_windows_are_bounded_and_lose_no_event() -> None:
    events, count = Events(), 3 * MOST_WINDOWS
    raw = bytes.fromhex("1234")
    rows = Rows.from_rows(
        Damage("p", n, raw, START_NS + n * SECOND * 2, (Fault.NOISE,)) for n in range(count)
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
