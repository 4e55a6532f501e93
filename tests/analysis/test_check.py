"""Rules: their language, what each measure counts, and verdicts of parts."""

from __future__ import annotations

import pickle
from contextlib import suppress

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fte_sniff.analysis import check
from fte_sniff.analysis.check import (
    MEASURES,
    RuleResult,
    Verdict,
    counted,
    needed,
    parse_rule,
    rules_of_toml,
)
from fte_sniff.analysis.segments import Segments, summed
from fte_sniff.errors import InputTextError
from fte_sniff.protocol.items import Gap, GapKind
from fte_sniff.protocol.rows import Item, Row
from tests.analysis.captures import MS, START, captures, damage, frame, items_of, polled

RULES = [
    "count(malformed) == 0",
    "count(motor = 1) <= 3",
    "share(speed) < 0.1",
    "rate(motor = 1) > 1",
    "max_gap(motor = 1) < 0.5",
    "max_gap(feedback) < 0.01",
    "delay(p95) < 2",
    "delay(max, motor = 1) < 3",
    "unanswered() == 0",
    "unanswered(motor = 2) < 2",
    "online(1) >= 0.99",
    "min(rpm) > -3",
    "max(length, motor = 1) <= 2",
    "max(answer_ms) < 1",
    "mean(rpm) == 0",
    "duration() >= 60",
    "findings(damage) == 0",
]


def judged(steps: list[Row | Item], rules: list[str], most: int = 2**62) -> list[Verdict]:
    """The verdicts about steps in tables of at least some rows."""
    wanted = [parse_rule(text) for text in rules]
    cutter = Segments(most=most, keep=lambda table: needed(table, wanted))
    cutter.begin("file")
    tables = [one for step in steps for item in items_of([step]) for one in cutter.push(item)]
    parts = [counted(one, wanted) for one in (*tables, cutter.rest())]
    total = summed([pickle.loads(pickle.dumps(one)) for one in parts])
    return [check.verdict(rule, total) for rule in wanted]


def verdict(steps: list[Row | Item], rule: str) -> Verdict:
    """The verdict of one rule."""
    return judged(steps, [rule])[0]


@given(captures(), st.integers(1, 12))
def test_parts_have_the_verdicts_of_the_whole(steps: list[Row | Item], most: int) -> None:
    whole, parts = judged(steps, RULES), judged(steps, RULES, most)
    for one, other in zip(whole, parts, strict=True):
        expected = None if one.value is None else pytest.approx(one.value)
        assert (other.result, other.value, other.row) == (one.result, expected, one.row)
        assert (other.needs, other.text) == (one.needs, one.text)


@pytest.mark.parametrize("name", MEASURES)
def test_example_of_every_measure_is_a_rule(name: str) -> None:
    assert parse_rule(MEASURES[name].example).measure == name


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "as in count(malformed) == 0"),
        ("count(malformed) = 0", "is not a rule"),
        ("delay(p95) < 20 ms", "without a unit"),
        ("cuont(malformed) == 0", "write a measure (count, share"),
        ("count() == 0", "does not fit count; write count(malformed) == 0"),
        ("count(moter = 1) == 0", "did you mean motor?"),
        ("online(5) == 1", "write online(1) >= 0.99"),
        ("max(port) == 1", "write max(rpm) <= 300"),
        ("duration(rpm) > 1", "write duration() >= 60"),
        ("findings(lat) == 0", "write findings(unanswered, 3) == 0"),
        ("count(malformed) == 1e999", "'1e999' does not fit count"),
    ],
)
def test_mistake_in_a_rule_has_an_example(text: str, message: str) -> None:
    with pytest.raises(InputTextError) as caught:
        parse_rule(text)
    assert message in str(caught.value)


@given(st.text(max_size=40) | st.sampled_from(RULES).map(lambda text: text[:-1]))
def test_any_text_is_a_rule_or_refused(text: str) -> None:
    with suppress(InputTextError):
        assert parse_rule(text).measure in MEASURES


RULE = '[[rule]]\nname = "a"\nexpect = "count(malformed) == 0"\n'


def test_rules_of_a_file_are_in_its_order() -> None:
    first, second = rules_of_toml(f"{RULE}may_be_uncovered = true\n{RULE}", "x.toml")
    assert (first.name, first.may_be_uncovered, second.may_be_uncovered) == ("a", True, False)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[[rule", "x.toml: is not valid TOML"),
        ("", "has no rules"),
        ("rule = 1", "has no rules"),
        (f"{RULE}[other]", "more than rules"),
        (f"{RULE}\nlimit = 1", "rule 1: needs a name and expect"),
        ('[[rule]]\nname = 1\nexpect = "duration() > 1"', "rule 1: needs a name"),
        (f'{RULE}[[rule]]\nname = "b"\nexpect = "x"', "rule 2: 'x' is not a rule"),
    ],
)
def test_mistake_in_a_file_of_rules_names_the_rule(text: str, message: str) -> None:
    with pytest.raises(InputTextError) as caught:
        rules_of_toml(text, "x.toml")
    assert message in str(caught.value)


HEALTHY: list[Row | Item] = [*polled(100)]


@pytest.mark.parametrize(
    ("rule", "value"),
    [
        ("count(motor = 1) == 200", 200),
        ("share(feedback) == 0.5", 0.5),
        ("rate(motor = 1) > 40", pytest.approx(200 / 4.9718, rel=1e-3)),
        ("max_gap(motor = 1) < 0.05", pytest.approx(0.047)),
        ("delay(p50) < 3.1", pytest.approx(3, rel=5e-4)),
        ("delay(max) == 3", 3),
        ("delay(max, abs(rpm) > 5) < 0x14", 3),
        ("count(port = ')') == 0", 0),
        ("unanswered() == 0", 0),
        ("online(2) == 1", 1),
        ("min(rpm) == 100", 100),
        ("mean(rpm, feedback) == 100", 100),
        ("duration() < 5", pytest.approx(4.97175)),
        ("findings() == 0", 0),
    ],
)
def test_rule_that_passes(rule: str, value: float) -> None:
    found = verdict(HEALTHY, rule)
    assert (found.result, found.value) == (RuleResult.PASS, value)


@pytest.mark.parametrize(
    ("rule", "at_ms"),
    [
        ("count(malformed) == 0", 7),
        ("share(malformed) < 0.001", 7),
        ("max(rpm) <= 100", 500),
        ("unanswered() == 0", 500),
        ("max_gap(feedback) < 0.02", 28),
        ("max_gap(motor = 3) < 0.04", 21.75),
        ("delay(max) < 3", 6.25),
    ],
)
def test_rule_that_fails_names_the_first_row(rule: str, at_ms: float) -> None:
    more = [damage(7), damage(1007), frame("speed", 500, rpm=200)]
    rows = sorted([*polled(100), *more], key=lambda row: row.t_ns or 0)
    found = verdict([*rows], rule)
    assert found.result is RuleResult.FAIL
    assert found.row is not None
    shown = next(row for row in rows if row.t_ns == frame("speed", at_ms).t_ns)
    assert found.row == {
        "time": shown.t_ns, "port": "a", "offset": shown.offset, "file": "file",
        "motor": shown.values.get("motor"), "raw": shown.raw.hex().upper(),
    }  # fmt: skip


def test_failed_rule_about_answers_names_the_worst_motor() -> None:
    """Motor 1 misses one answer, and motor 3 misses three later ones."""
    rows: list[Row | Item] = [*polled(100)]
    for index in (9, 13, 21, 29):
        rows[index] = damage(((rows[index].t_ns or 0) - START) / MS)
    found = verdict(rows, "unanswered() == 0")
    assert found.text == "most of motor 3: 3 of 100 commands"
    assert found.row is not None
    assert found.row["motor"] == 1
    assert verdict(rows, "unanswered(motor = 4) == 0").text == ""


@pytest.mark.parametrize(
    ("rule", "needs"),
    [
        ("max(pulses) < 1", "a matching row with the field"),
        ("delay(p50) < 1", "an answered command with times"),
        ("unanswered() == 0", "feedback before the commands"),
        ("online(1) == 1", "feedback of the motor"),
        ("changed() == 0", "--baseline"),
    ],
)
def test_rule_without_its_rows_is_not_covered(rule: str, needs: str) -> None:
    found = verdict([frame("speed", 0), frame("speed", 10)], rule)
    assert found.result is RuleResult.NOT_COVERED
    assert needs in found.needs
    assert found.refuses
    assert verdict([], rule).needs == "a row"


def test_rule_without_times_advises_a_start() -> None:
    found = verdict([frame("speed", None)], "duration() > 1")
    assert (found.needs, found.text) == ("two rows with times", "no row has a time, try --start")
    assert verdict([frame("speed", None)], "rate(speed) > 1").result is RuleResult.NOT_COVERED


@pytest.mark.parametrize("rule", [one for one in MEASURES.values() if one.needs_all])
def test_what_hidden_rows_decide_is_not_covered(rule: object) -> None:
    text = next(one.example for one in MEASURES.values() if one is rule)
    found = verdict([Gap(GapKind.SELECTED, reason="motor = 1"), *polled(20)], text)
    assert found.result is RuleResult.NOT_COVERED
    assert found.needs == "all rows"
    assert "for which this held: motor = 1" in found.text
    assert verdict([Gap(GapKind.SELECTED, reason="x"), *polled(2)], "count(speed) > 1").value == 8


def test_gap_ends_the_time_without_a_row() -> None:
    rows = [frame("speed", 0), frame("speed", 10), Gap(GapKind.DAMAGE), frame("speed", 5000)]
    assert verdict([*rows, frame("speed", 5010)], "max_gap(speed) < 1").value == pytest.approx(0.01)


def test_finding_of_a_failed_rule_is_named() -> None:
    rows: list[Row | Item] = [
        row
        for row in polled(2400)
        if row.raw[:1] == b"\xaa" or row.raw[2] != 3 or (row.t_ns or 0) % (60 * 10**9) > 20 * 10**9
    ]
    found = verdict(rows, "findings(silence) == 0")
    assert found.result is RuleResult.FAIL
    assert found.text.startswith("silence from 2023-11-14T")
    assert "motor 3" in found.text
