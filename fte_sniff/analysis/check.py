"""Measures of rows, rules that compare them with numbers, and verdicts.

    rule      measure ( == | != | < | <= | > | >= ) number
    measure   name ( [argument] [, filter] )

`counted` counts the tables of a stream for some rules; such parts add up, and `verdict` judges the
sum. A measure is two functions: what it counts in the rows of a table that the rule's
filter selects, with the rows that violate the rule, and its value; a new one is an entry of
`MEASURES`.
"""

from __future__ import annotations

import math
import operator
import re
import tomllib
from collections.abc import Callable, Iterable, Mapping, Sequence
from enum import StrEnum
from functools import partial
from typing import Any, Final, NamedTuple, TypeAlias

import numpy as np
import polars as pl

from fte_sniff.analysis import compare, events
from fte_sniff.analysis.dataframe import table_frame
from fte_sniff.analysis.durations import Durations, binned, chosen
from fte_sniff.analysis.filter.row_filter import RowFilter
from fte_sniff.analysis.findings import Cause, find, hidden_text
from fte_sniff.analysis.relations import AnswerState, feedback_with
from fte_sniff.analysis.segments import Analysis, Counts, extent_of
from fte_sniff.analysis.table import MOTOR, Table
from fte_sniff.errors import InputTextError, TranslatableText, listed, quoted
from fte_sniff.i18n import later
from fte_sniff.protocol.columns import COLUMN_BY_NAME, COLUMNS, ColumnType, iso_time
from fte_sniff.protocol.rows import Bools, Ints
from fte_sniff.protocol.spec import MOTORS, Role, motor_bit

OPERATORS: Final[Mapping[str, Callable[[Any, float], Any]]] = {
    "==": operator.eq,
    "!=": operator.ne,
    "<=": operator.le,
    ">=": operator.ge,
    "<": operator.lt,
    ">": operator.gt,
}

FIELDS: Final = [
    column.name for column in COLUMNS if column.type in (ColumnType.INT, ColumnType.REAL)
]
"""The fields that are measured."""

_PERCENTILES: Final = {"p50": 50, "p95": 95, "p99": 99, "max": 100}


class Rule(NamedTuple):
    """One comparison of a measure with a number; made by `parse_rule`."""

    name: str
    """What the user calls it; text from outside."""
    expect: str
    """As written: `count(malformed) == 0`."""
    measure: str
    """A key of `MEASURES`."""
    argument: str
    """A percentile, a field, a motor or a cause; empty if there is none."""
    filter_text: str
    """The filter that selects rows, or commands; `TRUE` for all."""
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
    def unit(self) -> str:
        """Unit of the measured value and the number; empty without one."""
        column = COLUMN_BY_NAME.get(self.argument)
        return (column and column.unit) or MEASURES[self.measure].unit


# What is counted

_NONE: Final[Ints] = np.zeros(0, np.int64)

_SHOWN: Final = ("time", "port", "offset", MOTOR, "raw")
"""The columns of a row that violates a rule; its input is `file`."""


def counted(table: Table, rules: Sequence[Rule]) -> Counts:
    """Count the own rows of a table for some rules; names begin with `Rule.expect`."""
    found = dict(extent_of(table))
    for rule in rules:
        found |= {f"{rule.expect} {name}": one for name, one in _part(table, rule).items()}
    return found


def _part(table: Table, rule: Rule) -> Counts:
    matches = selected(table, rule.filter_text)
    counts, at = MEASURES[rule.measure].counted(table, matches, rule)
    first = at[np.argmin(table.rows.t_ns[at])].reshape(1) if len(at) else at
    row = table_frame(table.rows.select(first), _SHOWN).with_columns(
        pl.col("time").cast(pl.Int64),
        file=pl.Series([table.sources[one] for one in table.source[first]], dtype=pl.String),
    )
    return {**counts, "violation": row.to_struct("first row").to_frame()}


def selected(table: Table, filter_text: str) -> Bools:
    """The rows of a table, with those around its own, that a filter selects."""
    wanted = RowFilter.parse(filter_text)
    found = wanted.matches(table.with_facts if wanted.needs_facts else table.rows)
    return found if table.selected is None else found & table.selected


def needed(table: Table, rules: Sequence[Rule]) -> Ints:
    """The rows of a table that later tables need: the last one that each filter selects."""
    timed, found = table.rows.timed[: table.stop], [_NONE]
    for text in {rule.filter_text for rule in rules if rule.measure == "max_gap"}:
        found.append(np.flatnonzero(selected(table, text)[: table.stop] & timed)[-1:])
    return np.concatenate(found)


def analysis_of(rules: Sequence[Rule]) -> Analysis:
    """The analysis for some rules."""
    return Analysis(partial(counted, rules=rules), partial(needed, rules=rules))


# The measures: each counts rows, and returns those that violate the rule

Counted: TypeAlias = tuple[Counts, Ints]


def _numbers(values: Mapping[str, Any], kind: Any = pl.Int64) -> Counts:
    """The numbers of a table, which add up by the first words of their names."""
    return {"rows": pl.DataFrame([values], dict.fromkeys(values, kind))}


def _matching(table: Table, matches: Bools, rule: Rule) -> Counted:
    at = table.counted[matches[table.counted]]
    return _numbers({"sum matches": len(at)}), at[rule.violated_by(np.full(len(at), math.inf))]


def _nothing(table: Table, matches: Bools, rule: Rule) -> Counted:
    return {}, _NONE


def _values(table: Table, matches: Bools, rule: Rule) -> Counted:
    """The matching rows that have a field."""
    at = table.counted[matches[table.counted]]
    values = table_frame(table.with_facts, [rule.argument]).to_series()
    own = values.gather(at).cast(pl.Float64)
    numbers = {
        "sum count": own.count(),
        "sum value": own.sum(),
        "least value": own.min(),
        "greatest value": own.max(),
    }
    is_wrong = own.is_not_null().to_numpy() & rule.violated_by(own.to_numpy())
    return _numbers(numbers, pl.Float64), at[is_wrong]


def _gaps(table: Table, matches: Bools, rule: Rule) -> Counted:
    """The longest time without a matching row in a run, also before its first and after its last.

    Runs in which a port is lost count only between two matching rows.
    """
    rows, runs = table.rows, table.runs["number"]
    timed = np.flatnonzero(rows.timed[: table.stop])
    if table.selected is not None:
        timed = timed[table.selected[timed]]
    ends = np.diff(runs[timed], prepend=-1, append=2**62) != 0
    ends = (ends[:-1] | ends[1:]) & ~table.runs["lost"][timed]
    at = timed[matches[timed] | ends]
    gaps = np.diff(rows.t_ns[at])
    gaps[(np.diff(runs[at]) != 0) | (at[1:] < table.start)] = 0
    count = int(matches[timed[timed >= table.start]].sum())
    numbers = {"sum matches": count, "greatest gap": int(gaps.max(initial=0))}
    return _numbers(numbers), at[:-1][rule.violated_by(gaps / 1e9) & (gaps > 0)]


def _commands(table: Table, matches: Bools) -> pl.DataFrame:
    """The answers of the commands that a filter selects."""
    found = table.answers
    return found.filter(pl.Series(matches[found["command"].to_numpy()], dtype=pl.Boolean))


def _states(table: Table, matches: Bools, rule: Rule) -> Counted:
    own = _commands(table, matches)
    counts = own.group_by("motor", "state").agg(pl.len().cast(pl.Int64).alias("sum commands"))
    missed = own.filter(pl.col("state") == AnswerState.UNANSWERED)["command"].to_numpy()
    return {"answers": counts}, missed[rule.violated_by(np.full(len(missed), math.inf))]


def _delays(table: Table, matches: Bools, rule: Rule) -> Counted:
    own = _commands(table, matches).drop_nulls("delay_ns")
    late = own["command"].to_numpy()[rule.violated_by(own["delay_ns"].to_numpy() / 1e6)]
    return binned("delays", own, [], "delay_ns", "end_ns"), late


def _online_bits(table: Table, matches: Bools, rule: Rule) -> Counted:
    rows, motor = table.rows, int(rule.argument)
    having, online = feedback_with(rows, Role.ONLINE)
    own = np.isin(having, table.counted)
    at, is_on = having[own], online[own] >> motor_bit(motor) & 1 == 1
    numbers = {
        "sum on": int(is_on.sum()),
        "sum feedback": len(at),
        "sum own": int((rows.nums[at] == motor).sum()),
    }
    return _numbers(numbers), at[~is_on]


def _events(table: Table, matches: Bools, rule: Rule) -> Counted:
    return events.counted(table), _NONE


def _compared(table: Table, matches: Bools, rule: Rule) -> Counted:
    return compare.counted(table), _NONE


# The values of the measures


class Found(NamedTuple):
    """What the value of a rule's measure depends on."""

    rule: Rule
    counts: Counts
    sums: pl.DataFrame
    """The extent of all rows, and the numbers that were counted; one row."""
    baseline: Counts | None
    """The counts of `compare` to compare with."""


class Measured(NamedTuple):
    """The value of a measure."""

    value: float | None
    """None if the rows that it needs did not come."""
    text: str = ""
    """What counts most: a motor, a finding, or a change."""


def _of(value: pl.Expr) -> Callable[[Found], Measured]:
    """The value of a measure that is an expression of the sums."""

    def measured(found: Found) -> Measured:
        return Measured(found.sums.select(value).item())

    return measured


_MOST: Final = later("most of motor {motor}: {most:,} of {commands:,} commands")
_SECONDS: Final = pl.when(pl.col("sum timed") > 1).then(
    (pl.col("greatest t") - pl.col("least t")) / 1e9
)
_count = _of(pl.col("sum matches"))
_share = _of(pl.col("sum matches") / pl.col("sum rows"))
_duration = _of(_SECONDS)
_rate = _of(pl.when(_SECONDS > 0).then(pl.col("sum matches") / _SECONDS))
_max_gap = _of(pl.when(pl.col("sum matches") > 1).then(pl.col("greatest gap") / 1e9))
_min, _max = (_of(pl.col(f"{end} value")) for end in ("least", "greatest"))
_mean = _of(pl.when(pl.col("sum count") > 0).then(pl.col("sum value") / pl.col("sum count")))
_online = _of(pl.when(pl.col("sum own") > 0).then(pl.col("sum on") / pl.col("sum feedback")))


def _unanswered(found: Found) -> Measured:
    """The commands without an answer; None if feedback never came before them."""
    answers, state = found.counts["answers"], pl.col("state")
    asked = answers.filter(state <= AnswerState.UNANSWERED)
    if not len(asked) and (answers["state"] == AnswerState.UNCOVERED).any():
        return Measured(None)
    missed = asked.filter(state == AnswerState.UNANSWERED).sort("sum commands", "motor")
    text = ""
    for motor, _, most in missed[-1:].select("motor", "state", "sum commands").iter_rows():
        commands = chosen(asked, motor=motor)["sum commands"].sum()
        text = TranslatableText(_MOST, motor=motor, most=most, commands=commands)
    return Measured(int(missed["sum commands"].sum()), text)


def _delay(found: Found) -> Measured:
    """Milliseconds from a command to its answer."""
    delays = Durations.of(found.counts, "delays")
    percent = _PERCENTILES[found.rule.argument]
    value = delays.longest_ns if percent == 100 else delays.percentile_ns(percent)
    return Measured(None if value is None else value / 1e6)


def _findings(found: Found) -> Measured:
    """The findings that a rule counts; None if they could not be examined."""
    cause, _, motor = found.rule.argument.partition(",")
    report = find(found.counts)
    if cause in report.not_covered or len(report.not_covered) == len(Cause):
        return Measured(None)
    own = [
        TranslatableText(
            "{cause} from {first} to {last}: {text}",
            cause=one.cause,
            first=iso_time(one.first_ns),
            last=iso_time(one.last_ns),
            text=one.text,
        )
        for one in report.found
        if cause in ("", one.cause) and motor in ("", str(one.motor or motor))
    ]
    return Measured(len(own), next(iter(own), ""))


def _changed(found: Found) -> Measured:
    """The changes since the baseline; None if they could not be compared."""
    if found.baseline is None:
        return Measured(None)
    compared = compare.compared(found.baseline, found.counts)
    if not any(found.rule.argument in ("", one.measure) for one in compared.numbers):
        return Measured(None)
    own = [one.text for one in compared.changes if found.rule.argument in ("", one.measure)]
    return Measured(len(own), next(iter(own), ""))


class Measure(NamedTuple):
    """A measure of the language."""

    counted: Callable[[Table, Bools, Rule], Counted]
    value: Callable[[Found], Measured]
    example: str
    needs: str
    """What it needs to have a value: `a row`."""
    unit: str = ""
    argument: str = ""
    """The pattern of `argument` and `filter`."""
    needs_all: bool = True
    """Whether rows that a filter hid would decide it."""


def _any(words: Iterable[object]) -> str:
    return rf"(?P<argument>{'|'.join(map(str, words))})"


_ROW: Final = "a row"
_ALL_ROWS: Final = later("all rows")
_FILTER: Final = r"(?P<filter>.*\S.*)"
_MORE: Final = r"\s*(?:,(?P<filter>.*))?"
_CAUSE: Final = rf"(?:{'|'.join(Cause)})(?:,\s*[{MOTORS[0]}-{MOTORS[-1]}])?"
_FIELD: Final = ("a matching row with the field", "", _any(FIELDS) + _MORE, False)
_TIMES: Final = "two different times"

MEASURES: Final[Mapping[str, Measure]] = {
    "count": Measure(_matching, _count, "count(malformed) == 0", _ROW, "rows", _FILTER, False),
    "share": Measure(_matching, _share, "share(malformed) <= 0.001", _ROW, "", _FILTER, False),
    "rate": Measure(_matching, _rate, "rate(feedback) >= 30", _TIMES, "1/s", _FILTER, False),
    "min": Measure(_values, _min, "min(rpm) >= 0", *_FIELD),
    "max": Measure(_values, _max, "max(rpm) <= 300", *_FIELD),
    "mean": Measure(_values, _mean, "mean(rpm) <= 300", *_FIELD),
    "duration": Measure(
        *(_nothing, _duration, "duration() >= 60", "two rows with times", "s", "", False)
    ),
    "max_gap": Measure(
        *(_gaps, _max_gap, "max_gap(motor = 1) < 0.5", "two matching rows with times"),
        *("s", _FILTER),
    ),
    "delay": Measure(
        *(_delays, _delay, "delay(p95) < 20", "an answered command with times"),
        *("ms", _any(_PERCENTILES) + _MORE),
    ),
    "unanswered": Measure(
        *(_states, _unanswered, "unanswered() == 0", "feedback before the commands"),
        *("commands", "(?P<filter>.*)"),
    ),
    "online": Measure(
        *(_online_bits, _online, "online(1) >= 0.99", "feedback of the motor", "", _any(MOTORS))
    ),
    "findings": Measure(
        *(_events, _findings, "findings(unanswered, 3) == 0"),
        *("rows with times that show the cause", "findings", _any([_CAUSE, ""])),
    ),
    "changed": Measure(
        *(_compared, _changed, "changed(delay) == 0"),
        *("--baseline, and rows on both sides that can be compared", "changes"),
        _any([*compare.MEASURES, ""]),
    ),
}
"""The measures of the language."""


# Rules

_RULE: Final = re.compile(
    r"\s*(\w+)\s*\((.*)\)\s*([=!<>]=|<|>)\s*([-+]?(?:0x[0-9a-f]+|(?:\d+\.?\d*|\.\d+)(?:e[+-]?\d+)?))\s*",
    re.IGNORECASE | re.DOTALL,
)


def parse_rule(expect: str, name: str = "", *, may_be_uncovered: bool = False) -> Rule:
    """Parse a rule, by default named like its text; raises InputTextError with the fix."""
    match = _RULE.fullmatch(expect)
    if match is None or match[1] not in MEASURES:
        raise InputTextError(
            f"{quoted(expect)} is not a rule; write a measure ({listed(MEASURES)}), a comparison"
            " and a number without a unit, as in count(malformed) == 0"
        )
    measure, inner, symbol, number = match.groups()
    kind = MEASURES[measure]
    parts = re.fullmatch(rf"\s*{kind.argument}\s*", inner, re.DOTALL)
    value = float(int(number, 0)) if "x" in number.lower() else float(number)
    if parts is None or not math.isfinite(value):
        wrong = inner if parts is None else number
        raise InputTextError(f"{quoted(wrong)} does not fit {measure}; write {kind.example}")
    argument, filter_text = (parts.groupdict("").get(one, "") for one in ("argument", "filter"))
    argument, filter_text = re.sub(r"\s", "", argument), filter_text.strip() or "TRUE"
    RowFilter.parse(filter_text)
    return Rule(
        name or expect, expect, measure, argument, filter_text, symbol, value, may_be_uncovered
    )


_KEYS: Final = {"name": str, "expect": str, "may_be_uncovered": bool}
"""The types of a rule's keys in a file."""


def rules_of_toml(text: str, source: str) -> list[Rule]:
    """The rules of a TOML text with `[[rule]]` tables; `source` names it in errors.

    Raises InputTextError: which rule is invalid, and what was probably meant.
    """
    try:
        tables = tomllib.loads(text)
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        raise InputTextError(f"{source}: is not valid TOML: {error}") from error
    match tables:
        case {"rule": [_, *_] as listed, **rest} if not rest:
            return [_of_table(f"{source}: rule {at}", one) for at, one in enumerate(listed, 1)]
    example = 'write [[rule]], name = "no damage", expect = "count(malformed) == 0"'
    raise InputTextError(f"{source}: has no rules, or more than rules; {example}")


def _of_table(where: str, table: object) -> Rule:
    given = {"may_be_uncovered": False, **table} if isinstance(table, dict) else {}
    if {key: type(value) for key, value in given.items()} != _KEYS:
        raise InputTextError(
            f"{where}: needs a name and expect, which are texts; may_be_uncovered = true may follow"
        )
    try:
        return parse_rule(**given)
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
    result: RuleResult
    value: float | None = None
    """The measure, in the rule's unit; None if it is not covered."""
    needs: str = ""
    """What the measure needs to have a value, if the rows lack it."""
    row: Mapping[str, Any] | None = None
    """The first row that violates a failed rule, if one row can show it.

    `file`, `time` (nanoseconds since 1970 UTC), `port`, `offset`, `motor`, `raw` (hex).
    """
    text: str = ""
    """What a failed rule counts most: a finding, a change, or a motor; or why rows are missing."""

    @property
    def refuses(self) -> bool:
        """Whether the check does not succeed because of this rule."""
        uncovered = self.result is RuleResult.NOT_COVERED and not self.rule.may_be_uncovered
        return uncovered or self.result is RuleResult.FAIL


def verdict(rule: Rule, total: Counts, baseline: Counts | None = None) -> Verdict:
    """The verdict of a rule on the sum of parts; `changed` compares with counts of `compare`."""
    measure, start = MEASURES[rule.measure], f"{rule.expect} "
    counts = {name.removeprefix(start): total[name] for name in total if name.startswith(start)}
    extent, hidden = total["extent"].row(0, named=True), total["hidden"]["hidden_by"].to_list()
    if not extent["sum rows"]:
        return Verdict(rule, RuleResult.NOT_COVERED, needs=_ROW)
    if hidden and measure.needs_all:
        return Verdict(rule, RuleResult.NOT_COVERED, needs=_ALL_ROWS, text=hidden_text(hidden))
    sums = pl.concat([total["extent"], counts.get("rows", pl.DataFrame())], how="horizontal")
    value, text = measure.value(Found(rule, counts, sums, baseline))
    if value is None:
        advice = "" if extent["sum timed"] else later("no row has a time, try --start")
        return Verdict(rule, RuleResult.NOT_COVERED, needs=measure.needs, text=advice)
    if not rule.violated_by(value).any():
        return Verdict(rule, RuleResult.PASS, value)
    return Verdict(rule, RuleResult.FAIL, value, "", counts["violation"]["first row"][0], text)
