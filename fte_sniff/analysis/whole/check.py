"""Measures of a table of rows, rules that compare them with numbers, and verdicts.

    rule      measure ( == | != | < | <= | > | >= ) number
    measure   name ( [argument] [, filter] )

A measure is a function of the table and the rows that the rule's filter selects; a new one is an
entry of `MEASURES`. It returns its value, None where the rows that it needs did not come, and the
rows that show a violation, the first of which is shown.
"""

from __future__ import annotations

import math
import operator
import re
import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, Final, NamedTuple

import numpy as np
import polars as pl

from fte_sniff.analysis.filter.row_filter import RowFilter
from fte_sniff.analysis.filter.terms import nearest
from fte_sniff.analysis.findings import Cause, Finding, Findings
from fte_sniff.analysis.whole.relations import AnswerState
from fte_sniff.analysis.whole.table import Table
from fte_sniff.errors import InputTextError, quoted
from fte_sniff.protocol import COLUMN_BY_NAME, COLUMNS, MOTORS, ColumnType, Direction, Row
from fte_sniff.protocol.rows import NO_TIME, Bools, Ints
from fte_sniff.protocol.spec import NAME_OF_ROLE, Role, motor_bit

OPERATORS: Final[Mapping[str, Callable[[Any, float], Any]]] = {
    "==": operator.eq,
    "!=": operator.ne,
    "<=": operator.le,
    ">=": operator.ge,
    "<": operator.lt,
    ">": operator.gt,
}

_PERCENTILES: Final = {"p50": 0.5, "p95": 0.95, "p99": 0.99, "max": 1.0}
_FIELDS: Final = [
    column.name for column in COLUMNS if column.type in (ColumnType.INT, ColumnType.REAL)
]
_MOTOR: Final = NAME_OF_ROLE[Role.MOTOR]


@dataclass(frozen=True, slots=True)
class Rule:
    """One comparison of a measure with a number; made by `parse_rule`."""

    name: str
    """What the user calls it; text from outside."""
    expect: str
    """As written: `count(malformed) == 0`."""
    measure: str
    """A key of `MEASURES`."""
    argument: str
    """A percentile, a field, a motor or a cause; empty if there is none."""
    filter: RowFilter | None
    """The filter that selects rows, or commands; None for all."""
    operator: str
    """A key of `OPERATORS`."""
    number: float
    may_be_uncovered: bool = False
    """Whether the check may succeed without a value of the measure."""

    def violated_by(self, values: Any) -> Bools:
        """Which values do not fulfil the rule."""
        found: Bools = ~np.asarray(OPERATORS[self.operator](np.asarray(values), self.number))
        return found

    @property
    def is_limit(self) -> bool:
        """Whether values that are too large violate it."""
        return self.operator in ("==", "<=", "<")

    @property
    def unit(self) -> str:
        """Unit of the measured value and the number; empty without one."""
        column = COLUMN_BY_NAME.get(self.argument)
        return (column and column.unit) or MEASURES[self.measure].unit


_NONE: Final[Ints] = np.zeros(0, np.int64)


class Measured(NamedTuple):
    """What a measure found."""

    value: float | None
    """None if the rows that it needs did not come."""
    rows: Ints = _NONE
    """Rows that show a violation, if single rows can."""
    like: str = ""
    """A filter for such rows, besides that of the rule."""
    finding: Finding | None = None


# The measures: functions of the table, the selected rows, and the rule


def _count(table: Table, matches: Bools, rule: Rule) -> Measured:
    found = np.flatnonzero(matches)
    most = math.ceil(rule.number) - 1 if rule.operator == "<" else math.floor(rule.number)
    return Measured(len(found), found[max(0, most) :] if rule.is_limit else _NONE)


def _share(table: Table, matches: Bools, rule: Rule) -> Measured:
    return Measured(matches.mean(), np.flatnonzero(matches) if rule.is_limit else _NONE)


def _rate(table: Table, matches: Bools, rule: Rule) -> Measured:
    """Matching rows per second; NaN, which fulfils no rule, if the duration is unknown or 0."""
    if not matches.any():
        return Measured(0)
    seconds = _duration(table, matches, rule).value
    rate = matches.sum() / seconds if seconds else math.nan
    return Measured(rate, np.flatnonzero(matches) if rule.is_limit else _NONE)


def _duration(table: Table, matches: Bools, rule: Rule) -> Measured:
    t_ns = table.rows.t_ns[table.rows.timed]
    return Measured(float(np.ptp(t_ns)) / 1e9 if len(t_ns) > 1 else None)


def _max_gap(table: Table, matches: Bools, rule: Rule) -> Measured:
    """The longest time without a matching row in a run, also before its first and after its last.

    Runs in which a port is lost count only between two matching rows.
    """
    rows, runs = table.rows, table.runs.number
    timed = np.flatnonzero(rows.timed)
    if matches[timed].sum() < 2:
        return Measured(None)
    ends = np.diff(runs[timed], prepend=-1, append=len(rows)) != 0
    ends = (ends[:-1] | ends[1:]) & ~table.runs.lost[timed]
    at = timed[matches[timed] | ends]
    gaps = np.diff(rows.t_ns[at])
    gaps[np.diff(runs[at]) != 0] = 0
    return Measured(gaps.max() / 1e9, at[:-1][rule.violated_by(gaps / 1e9)])


def _field(table: Table, matches: Bools, rule: Rule) -> Measured:
    """The smallest or greatest value of a field, or its mean."""
    of_rows = COLUMN_BY_NAME[rule.argument].of_rows
    values, known, _ = of_rows(table.with_facts) if of_rows else (matches, None, None)
    at = np.flatnonzero(matches if known is None else matches & known)
    if not len(at):
        return Measured(None)
    if rule.measure == "mean":
        return Measured(values[at].mean(dtype=np.float64))
    limit = values[at].min() if rule.measure == "min" else values[at].max()
    like = f"NOT {rule.argument} {rule.operator} {rule.number:.15g}"
    return Measured(float(limit), at[rule.violated_by(values[at])], like)


def _commands(table: Table, matches: Bools) -> pl.DataFrame:
    """The answers of the commands that a filter selects."""
    return table.answers.filter(pl.Series(matches)[pl.Series(table.answers["command"])])


def _unanswered(table: Table, matches: Bools, rule: Rule) -> Measured:
    """The commands without an answer; None if feedback never came before them."""
    own = _commands(table, matches)
    missed = own.filter(pl.col("state") == AnswerState.UNANSWERED)["command"].sort()
    decided = own["state"] <= AnswerState.UNANSWERED
    uncovered = own["state"] == AnswerState.UNCOVERED
    if uncovered.any() and not decided.any():
        return Measured(None)
    return Measured(len(missed), missed.to_numpy()[max(0, math.floor(rule.number)) :], "unanswered")


def _delay(table: Table, matches: Bools, rule: Rule) -> Measured:
    """Milliseconds from a command to its answer."""
    own = _commands(table, matches).drop_nulls("delay_ns").sort("command")
    delays = own["delay_ns"] / 1e6
    value: Any = delays.quantile(_PERCENTILES[rule.argument], "equiprobable")
    late = rule.violated_by(delays.to_numpy())
    like = f"NOT answer_ms {rule.operator} {rule.number:.15g}"
    return Measured(value, own["command"].to_numpy()[late], like)


def _online(table: Table, matches: Bools, rule: Rule) -> Measured:
    """The share of time in which a motor was online: a byte holds until the next feedback."""
    rows, motor = table.rows, int(rule.argument)
    feedback = np.flatnonzero(rows.field(NAME_OF_ROLE[Role.ONLINE])[1])
    if not (rows.nums[feedback] == motor).any():
        return Measured(None)
    on = (rows.values(Role.ONLINE, feedback) >> motor_bit(motor) & 1) == 1
    timed = rows.timed[feedback]
    t_ns, runs, held = rows.t_ns[feedback][timed], table.runs.number[feedback][timed], on[timed]
    spans = np.where(np.diff(runs) == 0, np.maximum(np.diff(t_ns), 0), 0)
    share = spans[held[:-1]].sum() / spans.sum() if spans.any() else on.mean()
    return Measured(float(share), feedback[~on], str(Direction.FEEDBACK))


def _findings(table: Table, matches: Bools, rule: Rule) -> Measured:
    cause, _, motor = rule.argument.partition(",")
    findings = Findings()
    findings.observe(table.rows, table.changes)
    missing = findings.not_covered()
    if cause in missing or len(missing) == len(Cause):
        return Measured(None)
    found = [
        one
        for one in findings.found()
        if cause in ("", one.cause) and motor in ("", str(one.motor or motor))
    ]
    return Measured(len(found), finding=found[0] if found else None)


class Measure(NamedTuple):
    """A measure of the language."""

    of: Callable[[Table, Bools, Rule], Measured]
    example: str
    needs: str
    """What it needs to have a value: `a row`."""
    unit: str = ""
    argument: str = ""
    """The pattern of the first argument; empty if it takes only a filter."""


_ANY: Final = "|".join
_ROW: Final = "a row"

MEASURES: Final[Mapping[str, Measure]] = {
    "count": Measure(_count, "count(malformed) == 0", _ROW, "rows"),
    "share": Measure(_share, "share(malformed) <= 0.001", _ROW),
    "rate": Measure(_rate, "rate(feedback) >= 30", "two different times", "1/s"),
    "max_gap": Measure(_max_gap, "max_gap(motor = 1) < 0.5", "two matching rows with times", "s"),
    "delay": Measure(
        _delay, "delay(p95) < 20", "an answered command with times", "ms", _ANY(_PERCENTILES)
    ),
    "unanswered": Measure(
        _unanswered, "unanswered() == 0", "feedback before the commands", "commands"
    ),
    "online": Measure(
        _online, "online(1) >= 0.99", "feedback of the motor", "", _ANY(map(str, MOTORS))
    ),
    "findings": Measure(
        _findings,
        "findings(unanswered, 3) == 0",
        "rows with times that show the cause",
        "findings",
        rf"(?:{_ANY(Cause)})(?:,\s*[{MOTORS[0]}-{MOTORS[-1]}])?|",
    ),
    **{
        name: Measure(
            _field, f"{name}(rpm) <= 300", "a matching row with the field", "", _ANY(_FIELDS)
        )
        for name in ("min", "max", "mean")
    },
    "duration": Measure(_duration, "duration() >= 60", "two rows with times", "s", "(?=$)"),
}
"""The measures of the language."""


# Rules

_RULE: Final = re.compile(
    r"\s*(\w+)\s*\((.*)\)\s*([=!<>]=|<|>)\s*([-+]?(?:0x[0-9a-f]+|[0-9.]+(?:e[+-]?\d+)?))\s*",
    re.IGNORECASE | re.DOTALL,
)


def parse_rule(expect: str, name: str = "", *, may_be_uncovered: bool = False) -> Rule:
    """Parse a rule, by default named like its text; raises InputTextError with the fix."""
    match = _RULE.fullmatch(expect)
    if match is None:
        raise InputTextError(
            f"{quoted(expect)} is not a rule; write a measure, a comparison and a number without a"
            " unit, as in count(malformed) == 0"
        )
    measure, inner, symbol, number = match.groups()
    if measure not in MEASURES:
        fix = nearest(measure, MEASURES) or f"the measures are {', '.join(MEASURES)}"
        raise InputTextError(f"{quoted(measure)} is not a measure; {fix}")
    argument, filter_text = "", inner.strip()
    if pattern := MEASURES[measure].argument:
        parts = re.fullmatch(rf"\s*({pattern})\s*(?:,(.*))?", inner, re.DOTALL)
        if parts is None:
            raise InputTextError(
                f"{quoted(inner)} is not an argument of {measure}; write {MEASURES[measure].example}"
            )
        argument, filter_text = re.sub(r"\s", "", parts[1]), (parts[2] or "").strip()
    elif not filter_text and measure != "unanswered":
        raise InputTextError(f"{measure} needs a filter; write {MEASURES[measure].example}")
    value = float(int(number, 0)) if "x" in number.lower() else float(number)
    wanted = RowFilter.parse(filter_text) if filter_text else None
    return Rule(name or expect, expect, measure, argument, wanted, symbol, value, may_be_uncovered)


def rules_of_toml(text: str, source: str) -> list[Rule]:
    """The rules of a TOML text with `[[rule]]` tables; `source` names it in errors.

    Raises InputTextError: which rule is invalid, and what was probably meant.
    """
    try:
        tables = tomllib.loads(text)["rule"]
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        raise InputTextError(f"{source}: is not valid TOML: {error}") from error
    except KeyError:
        raise InputTextError(
            f"{source}: has no rules; a rule is a table [[rule]] with name and expect"
        ) from None
    found = list[Rule]()
    for number, table in enumerate(tables, 1):
        where = f"{source}: rule {number}"
        match table:
            case {"name": str(name), "expect": str(expect), **rest} if rest.keys() <= {
                "may_be_uncovered"
            }:
                found.append(rule_at(where, expect, name, may_be_uncovered=bool(rest)))
            case _:
                raise InputTextError(f"{where}: has other keys than name, expect, may_be_uncovered")
    return found


def rule_at(where: str, expect: str, name: str = "", *, may_be_uncovered: bool = False) -> Rule:
    """`parse_rule` with errors that begin with the rule's place."""
    try:
        return parse_rule(expect, name, may_be_uncovered=may_be_uncovered)
    except InputTextError as error:
        raise InputTextError(f"{where}: {error}") from error


# Verdicts


class RuleResult(StrEnum):
    """The result of a rule."""

    PASS = "pass"
    FAIL = "fail"
    NOT_COVERED = "not covered"
    """The rows that the measure needs did not come."""


class Verdict(NamedTuple):
    """What a rule found."""

    rule: Rule
    value: float | None
    """The measure, in the rule's unit; None if not covered, NaN for a failed rate in no time."""
    result: RuleResult
    row: Row | None = None
    """The first row that violates a failed rule, if one row can show it."""
    file: str = ""
    """The input that the row is from."""
    needs: str = ""
    """What the measure needs to have a value, if the rows lack it."""
    filter: str = ""
    """A filter for rows like the one that is shown; empty for all."""
    finding: Finding | None = None
    """The best finding that a failed rule counts."""

    @property
    def refuses(self) -> bool:
        """Whether the check does not succeed because of this rule."""
        uncovered = self.result is RuleResult.NOT_COVERED and not self.rule.may_be_uncovered
        return uncovered or self.result is RuleResult.FAIL


def verdict(table: Table, rule: Rule) -> Verdict:
    """Judge a rule."""
    if not len(table.rows):
        return Verdict(rule, None, RuleResult.NOT_COVERED, needs=_ROW)
    matches = np.ones(len(table.rows), np.bool_)
    if rule.filter is not None:
        matches = rule.filter.matches(table.with_facts if rule.filter.needs_facts else table.rows)
    measured = MEASURES[rule.measure].of(table, matches, rule)
    if measured.value is None:
        needs = MEASURES[rule.measure].needs
        if not table.rows.timed.any():
            needs += "; no row has a time, try --start"
        return Verdict(rule, None, RuleResult.NOT_COVERED, needs=needs)
    if not rule.violated_by(measured.value).any():
        return Verdict(rule, measured.value, RuleResult.PASS)
    row = _first(table, measured.rows)
    like = [measured.like, "" if rule.filter is None or rule.measure == "max_gap" else rule.filter.text]
    if row is not None and row.motor is not None and any(like):
        like.append(f"{_MOTOR} = {row.motor}")
    shown = " AND ".join(f"({one})" for one in like if one)
    if row is None:
        return Verdict(rule, measured.value, RuleResult.FAIL, filter=shown, finding=measured.finding)
    return Verdict(rule, measured.value, RuleResult.FAIL, row.row, row.file, filter=shown)


class _Shown(NamedTuple):
    row: Row
    file: str
    motor: int | None


def _first(table: Table, at: Ints) -> _Shown | None:
    """The first of some rows by time."""
    if not len(at):
        return None
    found = int(at[np.argmin(np.where(table.rows.t_ns[at] == NO_TIME, 2**62, table.rows.t_ns[at]))])
    files = [name for name, start in table.sources.items() if start <= found]
    values, known = table.rows.field(_MOTOR)
    return _Shown(table.rows[found], files[-1], int(values[found]) if known[found] else None)
