"""The language of rules: what it takes, and what each mistake leads to."""

from __future__ import annotations

from contextlib import suppress

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fte_sniff.analysis.measures import MEASURES, OPERATORS
from fte_sniff.analysis.rules import FIELDS, RuleCheck, RuleResult, parse_rule, rules_of_toml
from fte_sniff.errors import InputTextError
from fte_sniff.protocol import COLUMNS, KINDS, Column, Row, encode
from fte_sniff.protocol.rows import Rows


@pytest.mark.parametrize(
    ("text", "measure", "argument", "filter_text", "sign", "number"),
    [
        ("count(status = 'malformed') == 0", "count", "", "status = 'malformed'", "==", 0),
        ("share( malformed OR (noise) )<=1e-3", "share", "", "malformed OR (noise)", "<=", 0.001),
        (
            "rate(kind IN ('speed', 'reset')) > 3.5",
            "rate",
            "",
            "kind IN ('speed', 'reset')",
            ">",
            3.5,
        ),
        ("max_gap(port = ')') < 1", "max_gap", "", "port = ')'", "<", 1),
        ("delay(p95) < 20", "delay", "p95", None, "<", 20),
        ("delay(max, abs(rpm) > 5) < 0x14", "delay", "max", "abs(rpm) > 5", "<", 20),
        ("unanswered() == 0", "unanswered", "", None, "==", 0),
        ("unanswered(motor = 1) != 2", "unanswered", "", "motor = 1", "!=", 2),
        ("online(4) >= 0.99", "online", "4", None, ">=", 0.99),
        ("min(rpm) > -300", "min", "rpm", None, ">", -300),
        ("mean(pulses, motor = 2) <= +7", "mean", "pulses", "motor = 2", "<=", 7),
        ("duration() >= 60", "duration", "", None, ">=", 60),
    ],
)
def test_a_rule(
    text: str, measure: str, argument: str, filter_text: str | None, sign: str, number: float
) -> None:
    rule = parse_rule(text)
    assert (rule.name, rule.expect, rule.may_be_uncovered) == (text, text, False)
    assert (rule.measure, rule.argument, rule.filter_text) == (measure, argument, filter_text)
    assert (rule.operator, rule.number) == (sign, number)


@pytest.mark.parametrize("name", MEASURES)
def test_the_example_of_every_measure_is_a_rule(name: str) -> None:
    assert parse_rule(MEASURES[name].example).measure == name


@pytest.mark.parametrize("column", COLUMNS, ids=[column.name for column in COLUMNS])
def test_every_column_is_measured_or_refused(column: Column) -> None:
    text = f"max({column.name}) >= 0"
    if column.name not in FIELDS:
        with pytest.raises(InputTextError, match=f"{column.name} is a .*, not a number"):
            parse_rule(text)
        return
    check = RuleCheck([parse_rule(text)])
    raws = [encode(kind, {field.name: 3 for field in kind.fields}) for kind in KINDS]
    check.observe(Rows.of([Row("a", 3, raw, None) for raw in raws]))
    (verdict,) = check.verdicts()
    wanted = RuleResult.NOT_COVERED if column.derived else RuleResult.PASS
    assert verdict.result is wanted


@pytest.mark.parametrize("sign", OPERATORS)
@pytest.mark.parametrize("value", [-1, 0, 1])
def test_signs_compare_as_in_python(sign: str, value: int) -> None:
    assert parse_rule(f"duration() {sign} 0").holds(value) is eval(f"{value} {sign} 0")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "cuont(malformed) == 0",
            "'cuont' is not a measure at character 1 of \"-->cuont(malformed) == 0\"; "
            "did you mean count?",
        ),
        ("", "the rule ends too soon: a rule begins with a measure"),
        ("0 == count(malformed)", "a rule begins with a measure at character 1"),
        ("count", "a '(' is missing at character 6"),
        ("count()", "count needs a filter at character 7"),
        (
            "count(statsu = 'ok') == 0",
            "unknown name 'statsu' at character 7 of \"count(-->statsu = 'ok') == 0\"; "
            "did you mean status?",
        ),
        ("count(status = 'malformd') == 0", "did you mean malformed?"),
        ("count(malformed == 0", "the ')' of count is missing at character 21"),
        ("count(rpm) == 0", "at character 7"),
        (
            "count(malformed) = 0",
            'a comparison is missing at character 18 of "count(malformed) -->= 0"; write ==',
        ),
        ("count(malformed) <> 0", "write !="),
        ("count(malformed) => 0", "write >="),
        ("count(malformed)", "the rule ends too soon: a comparison is missing"),
        ("count(malformed) ==", "the rule ends too soon: a number is missing"),
        (
            "count(malformed) == NaN",
            'NaN is not a number at character 21 of "count(malformed) == -->NaN"; '
            "every comparison with NaN is false",
        ),
        ("count(malformed) == -nan", "NaN is not a number"),
        ("count(malformed) == 1e999", "this number is too large"),
        ("count(malformed) == none", "a number is missing"),
        (
            "delay(p96) < 20",
            "delay needs p50, p95, p99 or max, and 'p96' is none "
            'at character 7 of "delay(-->p96) < 20"; did you mean p9',
        ),
        ("delay() < 20", "delay needs p50, p95, p99 or max"),
        ("delay(p95 motor = 1) < 20", "a ')' is missing at character 11"),
        ("delay(p95, ) < 20", "delay needs a filter"),
        (
            "online(5) > 0",
            "online needs a motor, and '5' is none "
            'at character 8 of "online(-->5) > 0"; there are 1, 2, 3, 4',
        ),
        ("min(kind) > 0", "kind is a word, not a number at character 5"),
        ("max(port) > 0", "port is a text, not a number"),
        ("mean(time) > 0", "time is a time, not a number"),
        ("max(faults) > 0", "faults is a words, not a number"),
        (
            "max(rmp) < 3",
            "max needs a field, and 'rmp' is none "
            'at character 5 of "max(-->rmp) < 3"; did you mean rpm?',
        ),
        ("mean(speed) < 3", "did you mean rpm?"),
        ("duration(1) > 0", "a ')' is missing at character 10"),
        ("duration() > 0 AND duration() < 9", "a rule is one comparison at character 16"),
        (
            "delay(p95) < 20ms",
            'a rule has no unit at character 16 of "delay(p95) < 20-->ms"; '
            "delay is in ms: write < 20",
        ),
        ("share(malformed) <= 1.5 %", "share is 0 to 1: write <= 0.015"),
        ("online(1)>99%", "online is 0 to 1: write > 0.99"),
        ("max(rpm) < 300rpm", "max is in RPM: write < 300"),
        ("rate(ok) >= 30/s", '30-->/s"; rate is in 1/s: write >= 30'),
        ("max_gap(ok) < 500ms", "max_gap is in s: write < 0.5"),
        ("duration() >= 1h", "duration is in s: write >= 3600"),
        ("duration() >= 1h30min", "duration is in s: write >= 5400"),
        ("delay(p95) < 0.02 s", "delay is in ms: write < 20"),
        ("delay(p95) < 1e1 ms", "delay is in ms: write < 10"),
        (f"duration() >= 1h{'9' * 400}min", "duration is in s: write >= 6"),
        ("duration() >= 1 week", "duration is in s: write the number in s"),
        ("duration() > -1h", "duration is in s: write the number in s"),
        ("max(rpm) < 5rps", "max is in RPM: write the number in RPM"),
        ("duration() > 5 and", "a rule is one comparison at character 16"),
        ("duration() > 1_000", "'1_000' is not a number at character 14"),
        ("mean(error) < 1x", "mean is without a unit: write the number alone"),
        ("dealy(p95) < 20ms", "did you mean delay?"),
        ("count(malformed; DROP) == 0", "';' has no meaning in a filter"),
    ],
)
def test_a_mistake_is_named_with_its_place_and_the_fix(text: str, message: str) -> None:
    with pytest.raises(InputTextError) as found:
        parse_rule(text)
    assert message in str(found.value)


@given(st.text() | st.text(alphabet="count(rpm,)=<>0p95'- ", max_size=30))
def test_any_text_is_a_rule_or_a_mistake(text: str) -> None:
    with suppress(InputTextError):
        parse_rule(text)


GOOD = '[[rule]]\nname = "no damage"\nexpect = "count(malformed) == 0"\n'


def test_rules_of_a_file() -> None:
    more = '[[rule]]\nname = "fast"\nexpect = "delay(p95) < 20"\nmay_be_uncovered = true\n'
    first, second = rules_of_toml(GOOD + more, "rules.toml")
    assert (first.name, first.expect, first.may_be_uncovered) == (
        "no damage",
        "count(malformed) == 0",
        False,
    )
    assert (second.name, second.may_be_uncovered) == ("fast", True)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[[rule]", "r.toml: is not valid TOML: "),
        ("", "r.toml: has no rules; a rule is a table [[rule]] with name and expect"),
        ("[rule]\nname = 'x'", "r.toml: has no rules"),
        ("rule = [1]", "r.toml: has no rules"),
        ("[[rules]]\nname = 'x'", "r.toml: unknown key 'rules'; did you mean rule?"),
        (
            GOOD + "expct = 'x'",
            "r.toml: rule 1 'no damage': unknown key 'expct'; did you mean expect?",
        ),
        (GOOD + "level = 1", "unknown key 'level'; the keys are name, expect, may_be_uncovered"),
        (
            GOOD + "may_be_uncovered = 1",
            "r.toml: rule 1 'no damage': may_be_uncovered must be true or false",
        ),
        (
            GOOD + "[[rule]]\nexpect = 'duration() > 1'",
            'r.toml: rule 2: name is missing; write name = "..."',
        ),
        (GOOD + "[[rule]]\nname = 'x'", "r.toml: rule 2 'x': expect is missing"),
        (
            GOOD + "[[rule]]\nname = 3\nexpect = 'x'",
            "r.toml: rule 2: name must be a text in quotes",
        ),
        (GOOD + GOOD, "r.toml: rule 2 'no damage': another rule has this name"),
        (
            GOOD + "[[rule]]\nname = 'x'\nexpect = 'delay(p9) < 2'",
            "r.toml: rule 2 'x': delay needs p50, p95, p99 or max",
        ),
    ],
)
def test_a_mistake_in_a_file_is_named(text: str, message: str) -> None:
    with pytest.raises(InputTextError) as found:
        rules_of_toml(text, "r.toml")
    assert message in str(found.value)
