"""Measures, against a count by hand; any pieces of a capture give the verdicts of a single pass."""

from __future__ import annotations

import itertools
import math
import pickle
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import cache

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fte_sniff.analysis.facts import DEADLINE_NS
from fte_sniff.analysis.measures import MEASURES, OPERATORS, RowPosition
from fte_sniff.analysis.rules import RuleCheck, RuleResult, Verdict, parse_rule
from fte_sniff.protocol import Direction, Gap, GapKind, Row
from fte_sniff.protocol.rows import NO_TIME, Rows
from tests.analysis.pieces import MS, Step, captures, observe, pieces_of, state_of
from tests.analysis.test_statistics import SECOND, frame
from tests.examples import examples

EXPECTED = [
    "count(malformed) == 0",
    "count(motor = 1) <= 4",
    "share(motor = 1) <= 0.25",
    "rate(motor = 2) < 2",
    "max_gap(motor = 1) < 0.05",
    "max_gap(port = 'a') == 0.003",
    "delay(max) < 3",
    "delay(p95, rpm > 0) <= 1",
    "unanswered() == 0",
    "unanswered(motor = 1) <= 1",
    "online(1) == 1",
    "online(2) > 0.5",
    "min(rpm) >= 0",
    "max(rpm, motor = 2) < 5",
    "mean(offset) == -1",
    "duration() <= 0.1",
]
"""At least one rule for each measure but `findings`, whose state is that of `Findings`."""


@cache
def empty_check(*rules: str) -> RuleCheck:
    return RuleCheck([parse_rule(text) for text in rules])


def checked(*parts: Sequence[Step], rules: Sequence[str] = EXPECTED) -> RuleCheck:
    check = empty_check(*rules).copy()
    for part in parts:
        observe(check, part)
    return check


def test_each_measure_is_tested() -> None:
    assert {text.partition("(")[0] for text in EXPECTED} == {*MEASURES} - {"findings"}


@examples(25)
@given(captures(), st.lists(st.integers(0, 25), max_size=4), st.integers(0, 25))
def test_any_pieces_of_a_capture_give_the_verdicts_of_a_single_pass(
    steps: list[Step], cuts: list[int], batch: int
) -> None:
    whole, merged = checked(steps), checked()
    for piece in pieces_of(steps, cuts):
        part = checked(*pieces_of(piece, [batch]))
        merged.merge(pickle.loads(pickle.dumps(part)))
    assert merged.verdicts() == whole.verdicts()
    assert state_of(merged._measures) == state_of(whole._measures)
    copied = whole.copy()
    copied.merge(merged)
    observe(copied, steps)
    assert state_of(merged._measures) == state_of(whole._measures)


def measured(steps: Sequence[Step], text: str) -> float | None:
    (verdict,) = checked(steps, rules=[f"{text} == 0"]).verdicts()
    return verdict.value


def rows_of(steps: Sequence[Step]) -> list[Row]:
    return [step for step in steps if isinstance(step, Row)]


def runs_of(steps: Sequence[Step]) -> Iterator[list[Row]]:
    """The rows between gaps."""
    run: list[Row] = []
    for step in steps:
        if isinstance(step, Gap):
            yield run
            run = []
        elif isinstance(step, Row):
            run.append(step)
    yield run


@given(captures())
def test_counts_shares_rates_and_fields_equal_a_count_by_hand(steps: list[Step]) -> None:
    rows = rows_of(steps)
    own = [row for row in rows if row.framed and row.values.get("motor") == 1]
    times = [row.t_ns for row in rows if row.t_ns is not None]
    duration = (max(times) - min(times)) / SECOND if len(times) > 1 else None
    assert measured(steps, "duration()") == duration
    assert measured(steps, "count(motor = 1)") == (len(own) if rows else None)
    assert measured(steps, "share(motor = 1)") == (len(own) / len(rows) if rows else None)
    rate = measured(steps, "rate(motor = 1)")
    if own:
        assert rate == (pytest.approx(len(own) / duration) if duration else None)
    else:
        assert rate == (0 if rows else None)
    rpm = [row.values["rpm"] for row in rows if row.framed and "rpm" in row.values]
    assert measured(steps, "min(rpm)") == min(rpm, default=None)
    assert measured(steps, "max(rpm)") == max(rpm, default=None)
    assert measured(steps, "mean(rpm)") == (sum(rpm) / len(rpm) if rpm else None)
    assert measured(steps, "max(offset)") == max((row.offset for row in rows), default=None)
    cmds = [row.raw[1] for row in rows if row.framed]
    assert measured(steps, "min(cmd)") == min(cmds, default=None)


def _silences(run: Sequence[Row], kind: str) -> Iterator[int]:
    timed = [row for row in run if row.t_ns is not None]
    if timed:
        marks = [row.t_ns for row in timed if row.framed and row.kind.name == kind]
        marks = [timed[0].t_ns, *marks, timed[-1].t_ns]
        yield from (after - before for before, after in itertools.pairwise(marks))


@given(captures())
def test_the_longest_gap_includes_both_ends_of_each_run(steps: list[Step]) -> None:
    expected = None
    matching = [row for row in rows_of(steps) if row.framed and row.kind.name == "speed"]
    if sum(row.t_ns is not None for row in matching) > 1:
        gaps = [gap for run in runs_of(steps) for gap in _silences(run, "speed")]
        expected = max(0, *gaps, 0) / SECOND
    assert measured(steps, "max_gap(kind = 'speed')") == expected


def _is_late(command: Row, row: Row) -> bool:
    timed = command.t_ns is not None and row.t_ns is not None
    return timed and row.t_ns - command.t_ns > DEADLINE_NS


def covered(steps: Sequence[Step]) -> set[int]:
    """The `id` of the rows before which feedback of the same recording came."""
    found, has_feedback = set[int](), False
    for step in steps:
        if isinstance(step, Gap):
            has_feedback = has_feedback and step.kind is not GapKind.OTHER_RECORDING
        elif isinstance(step, Row) and step.framed:
            has_feedback |= step.direction is Direction.FEEDBACK
        if has_feedback:
            found.add(id(step))
    return found


@given(captures(), st.sampled_from([None, 1, 2]))
def test_answers_equal_a_count_by_hand(steps: list[Step], only: int | None) -> None:
    delays, rows, known = [], rows_of(steps), covered(steps)
    found, answered = {True: 0, False: 0}, 0

    def miss(command: Row | None, motor: int) -> None:
        if command is not None and only in (None, motor):
            found[id(command) in known] += 1

    for run in runs_of(steps):
        for motor in (1, 2, 3, 4):
            waiting: Row | None = None
            for row in run:
                if waiting is not None and _is_late(waiting, row):
                    miss(waiting, motor)
                    waiting = None
                if not row.framed or row.values.get("motor", motor) != motor:
                    continue
                if row.direction is Direction.CONTROL:
                    miss(waiting, motor)
                    waiting = row if row.raw[1] in (1, 2) else None
                elif waiting is not None and row.raw[1] == waiting.raw[1]:
                    if None not in (row.t_ns, waiting.t_ns) and row.t_ns >= waiting.t_ns:
                        delays += [row.t_ns - waiting.t_ns] if only in (None, motor) else []
                    answered += only in (None, motor)
                    waiting = None
    chosen = "" if only is None else f"motor = {only}"
    unknown = not rows or (found[False] and not answered + found[True])
    assert measured(steps, f"unanswered({chosen})") == (None if unknown else found[True])
    text = f"delay(max, {chosen})" if chosen else "delay(max)"
    assert measured(steps, text) == (max(delays) / MS if delays else None)
    half = measured(steps, text.replace("max", "p50"))
    assert (half is None) is (not delays)
    if delays:
        assert half == pytest.approx(sorted(delays)[math.ceil(len(delays) / 2) - 1] / MS, rel=5e-4)


@given(captures(), st.integers(1, 4))
def test_the_online_share_equals_a_count_by_hand(steps: list[Step], motor: int) -> None:
    on = known = 0
    frames = []
    for run in runs_of(steps):
        own = [row for row in run if row.framed and "online" in row.values]
        frames += own
        timed = [row for row in own if row.t_ns is not None]
        for before, after in itertools.pairwise(timed):
            held = max(0, after.t_ns - before.t_ns)
            known += held
            on += held * (before.values["online"] >> (motor - 1) & 1)
    share = None
    if any(row.values["motor"] == motor for row in frames):
        bits = [row.values["online"] >> (motor - 1) & 1 for row in frames]
        share = on / known if known else sum(bits) / len(bits)
    assert measured(steps, f"online({motor})") == share


def verdict(text: str, *rows: Row) -> Verdict:
    (found,) = checked(rows, rules=[text]).verdicts()
    return found


def speeds(*rpm_at_ms: tuple[int, int]) -> list[Row]:
    return [
        Row("p", 10 * at, frame("speed", 0, motor=1, rpm=rpm).raw, ms * MS)
        for at, (ms, rpm) in enumerate(rpm_at_ms)
    ]


THREE = speeds((0, 5), (10, 50), (500, 20))


@pytest.mark.parametrize(
    ("text", "value", "result", "row"),
    [
        ("count(rpm > 0) == 0", 3, "fail", 0),
        ("count(rpm > 0) <= 2", 3, "fail", 2),
        ("count(rpm > 0) < 2", 3, "fail", 1),
        ("count(rpm > 0) >= 4", 3, "fail", None),
        ("count(rpm > 0) != 3", 3, "fail", None),
        ("count(rpm > 0) == 3", 3, "pass", None),
        ("share(rpm > 10) <= 0.5", 2 / 3, "fail", 1),
        ("rate(rpm > 10) < 1", 4, "fail", 1),
        ("max_gap(rpm > 0) < 0.1", 0.49, "fail", 1),
        ("max_gap(rpm < 60) <= 0.49", 0.49, "pass", None),
        ("unanswered() == 0", None, "not covered", None),
        ("max(rpm) < 50", 50, "fail", 1),
        ("min(rpm) > 5", 5, "fail", 0),
        ("mean(rpm) < 20", 25, "fail", None),
        ("duration() > 1", 0.5, "fail", None),
        ("delay(p95) < 20", None, "not covered", None),
        ("online(1) > 0", None, "not covered", None),
        ("max_gap(rpm = 5) < 9", None, "not covered", None),
        ("max(pulses) < 9", None, "not covered", None),
    ],
)
def test_a_verdict_and_the_first_row_that_violates_it(
    text: str, value: float | None, result: str, row: int | None
) -> None:
    found = verdict(text, *THREE)
    assert found.value == (pytest.approx(value) if value is not None else None)
    assert found.result == result
    expected = None
    if row is not None:
        shown = THREE[row]
        motor = shown.values.get("motor")
        expected = RowPosition(shown.t_ns or 0, "p", shown.offset, "", motor, shown.raw)
    assert found.row == expected
    assert found.refuses is (result != "pass")


@pytest.mark.parametrize(("most", "row"), [(0, 1), (1, 2)])
def test_unanswered_commands_name_the_first_that_is_too_many(most: int, row: int) -> None:
    feedback = frame("speed_feedback", 0, motor=2, rpm=0, online=15)
    rows = [feedback, *THREE]
    found = verdict(f"unanswered() <= {most}", *rows)
    assert (found.value, found.result) == (2, "fail")
    assert found.row is not None
    assert (found.row.t_ns, found.row.offset) == (rows[row].t_ns, rows[row].offset)


NO_TIMES = "two different times; no row has a time, try --start"


@pytest.mark.parametrize(
    ("times", "value", "needs"),
    [
        ([5], None, "two different times"),
        ([5, 5], None, "two different times"),
        ([None], None, NO_TIMES),
        ([None, None], None, NO_TIMES),
        ([5, None], None, "two different times"),
        ([0, SECOND // 2], 4, ""),
    ],
)
def test_a_rate_of_matching_rows_fails_without_two_different_times(
    times: list[int | None], value: float | None, needs: str
) -> None:
    rows = [
        replace(frame("speed", 0, motor=1, rpm=1), t_ns=t_ns, offset=10 * number)
        for number, t_ns in enumerate(times)
    ]
    for sign, number in itertools.product(OPERATORS, (0, 4, 9)):
        rule = parse_rule(f"rate(motor = 1) {sign} {number}", may_be_uncovered=True)
        parts = [RuleCheck([rule]) for _ in rows]
        for part, row in zip(parts, rows, strict=True):
            part.observe(Rows.of([row]))
        whole, *rest = parts
        for part in rest:
            whole.merge(part)
        (matching,) = whole.verdicts()
        passes = value is not None and rule.holds(value)
        assert matching.result == ("pass" if passes else "fail")
        assert (matching.value, matching.needs, matching.refuses) == (value, needs, not passes)
        assert value is not None or matching.row is None
    other = verdict("rate(motor = 2) == 0", *rows)
    assert (other.value, other.result, other.needs) == (0, "pass", "")
    assert verdict("rate(motor = 2) == 0").needs == "a row"


def test_times_are_needed_only_where_they_would_help() -> None:
    command = frame("speed", None, motor=1, rpm=1)
    feedback = frame("speed_feedback", None, motor=1, rpm=1, online=1)
    assert verdict("online(1) > 0", command).needs == "feedback of the motor"
    assert verdict("online(1) == 1", command, feedback).result == "pass"
    timed = ("delay(max) < 1", "max_gap(motor = 1) < 1", "duration() > 0")
    assert all("--start" in verdict(text, command, feedback).needs for text in timed)


@pytest.mark.parametrize("text", EXPECTED)
@pytest.mark.parametrize("steps", [[], [*THREE, Gap(GapKind.NOT_SHOWN, 1)]], ids=["none", "some"])
def test_without_the_rows_nothing_is_covered(text: str, steps: Sequence[Step]) -> None:
    (found,) = checked(steps, rules=[text]).verdicts()
    assert (found.value, found.result, found.refuses) == (None, RuleResult.NOT_COVERED, True)
    assert bool(found.needs) is not bool(steps)


def test_a_rule_may_be_uncovered() -> None:
    check = RuleCheck([parse_rule("delay(p95) < 20", may_be_uncovered=True)])
    check.observe(Rows.of(THREE))
    (found,) = check.verdicts()
    assert (found.result, found.refuses) == (RuleResult.NOT_COVERED, False)


def test_a_row_without_a_time_is_named_by_its_offset() -> None:
    found = verdict("count(rpm > 0) == 0", frame("speed", None, motor=1, rpm=5))
    assert found.row is not None
    assert found.row[:4] == (NO_TIME, "p", 0, "")
    assert found.filter == "rpm > 0 AND motor = 1 AND offset = 0"


@pytest.mark.parametrize("text", ["count(ok) == 0", "max_gap(ok) < 1e-9", "unanswered() == 0"])
def test_the_first_row_keeps_its_file_when_files_merge(text: str) -> None:
    commands = [frame("speed", at * MS, motor=1, rpm=5) for at in range(4)]
    early, late = (RuleCheck([parse_rule(text)]) for _ in "12")
    early.begin("early")
    feedback = frame("speed_feedback", 0, motor=2, rpm=5, online=15)
    rows = [feedback, commands[0]] if "unanswered" in text else commands[:1]
    early.observe(Rows.of(rows))  # its verdict comes with the next row
    late.begin("late")
    late.observe(Rows.of(commands[1:]))
    early.merge(pickle.loads(pickle.dumps(late)))
    (found,) = early.verdicts()
    assert found.row is not None
    assert found.row[:4] == (0, "p", 0, "early")
    if "unanswered" not in text:  # in that file alone no answer is known to be missing
        assert [one.row and one.row.file for one in late.verdicts()] == ["late"]


def test_a_delay_and_an_offline_motor_name_their_rows() -> None:
    rows = [
        frame("speed", MS, motor=1, rpm=5),
        frame("speed_feedback", 3 * MS, motor=1, rpm=5, error=0, online=15),
        frame("speed_feedback", 4 * MS, motor=1, rpm=5, error=0, online=14),
        frame("speed_feedback", 8 * MS, motor=1, rpm=5, error=0, online=15),
    ]
    slow = verdict("delay(p99) < 1", *rows)
    assert slow.value == pytest.approx(2, rel=5e-4)
    assert slow.row is not None
    assert slow.row[:3] == (MS, "p", 0)
    gone = verdict("online(1) >= 0.9", *rows)
    assert gone.row is not None
    assert (gone.value, gone.row[:3]) == (pytest.approx(1 / 5), (4 * MS, "p", 0))


def test_commands_of_captures_that_overlap_in_time_are_counted_by_capture() -> None:
    rules = ["unanswered() == 0", "delay(max) < 1", "count(rpm > 0) == 6"]
    answer = [
        frame("speed", MS, motor=1, rpm=5),
        frame("speed_feedback", 3 * MS, motor=1, rpm=5, error=0, online=15),
    ]
    feedback = frame("speed_feedback", 0, motor=1, rpm=0, online=15)
    check = checked([feedback, *THREE], rules=rules)
    check.observe_change(Gap(GapKind.OTHER_RECORDING))
    check.merge(checked(answer, rules=rules))
    check.observe_change(Gap(GapKind.OTHER_RECORDING))
    check.merge(checked([feedback, *THREE], rules=rules))
    assert [found.value for found in check.verdicts()] == [4, pytest.approx(2), 8]
