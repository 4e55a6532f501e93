"""Measures of rows, rules that compare them with numbers, and verdicts.

    rule      measure ( == | != | < | <= | > | >= ) number
    measure   name ( [argument] [, filter] )

`counted` counts the tables of a stream for some rules; such parts add up (`summed`), and `verdicts`
judges the sum. A measure is two functions: what it counts in the rows of a table that the rule's
filter selects, and its value with what a failed rule counts most; a new one is an entry of
`MEASURES`.
"""

from __future__ import annotations

import math
import operator
import re
import tomllib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import partial
from typing import Any, Final, NamedTuple, TypeAlias

import numpy as np
import polars as pl

from fte_sniff.analysis import compare, events
from fte_sniff.analysis.durations import Durations, binned, chosen
from fte_sniff.analysis.filter.row_filter import RowFilter, nearest
from fte_sniff.analysis.filter.terms import both
from fte_sniff.analysis.findings import Cause, Finding, find, hidden_text
from fte_sniff.analysis.relations import FEEDBACK, AnswerState, values_at
from fte_sniff.analysis.segments import Analysis, Counts, extent_of
from fte_sniff.analysis.segments import summed as summed_counts
from fte_sniff.analysis.table import MOTOR, Table
from fte_sniff.errors import InputTextError, quoted
from fte_sniff.protocol.columns import COLUMN_BY_NAME, COLUMNS, ColumnType
from fte_sniff.protocol.rows import Bools, Ints, Row
from fte_sniff.protocol.spec import MOTORS, NAME_OF_ROLE, Role, motor_bit

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
    filter_text: str
    """The filter that selects rows, or commands; empty for all."""
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
    def bit(self) -> int:
        """The bit in ONLINE of the motor that the argument names."""
        return 1 << motor_bit(int(self.argument))

    @property
    def unit(self) -> str:
        """Unit of the measured value and the number; empty without one."""
        column = COLUMN_BY_NAME.get(self.argument)
        return (column and column.unit) or MEASURES[self.measure].unit


# What is counted

_NONE: Final[Ints] = np.zeros(0, np.int64)


class Counted(NamedTuple):
    """What a measure counted in a table."""

    counts: Counts
    rows: Ints = _NONE
    """The indices of rows that show a violation."""


Shown: TypeAlias = "tuple[Row, str] | None"
"""The first row that shows a violation, and its input."""

Part: TypeAlias = tuple[Counts, Sequence[tuple[Counts, Shown]]]
"""What was counted for all rules: the extent of the rows, and a part for each rule."""


def counted(table: Table, rules: Sequence[Rule]) -> Part:
    """Count the own rows of a table for some rules."""
    masks = {rule.filter_text: selected(table, rule.filter_text) for rule in rules}
    return extent_of(table), [_part(table, masks[rule.filter_text], rule) for rule in rules]


def selected(table: Table, filter_text: str) -> Bools:
    """The rows of a table, with those around its own, that a filter selects."""
    found = np.ones(len(table.rows), np.bool_)
    if filter_text:
        wanted = RowFilter.parse(filter_text)
        found = wanted.matches(table.with_facts if wanted.needs_facts else table.rows)
    return found if table.selected is None else found & table.selected


def _part(table: Table, matches: Bools, rule: Rule) -> tuple[Counts, Shown]:
    counts, at = MEASURES[rule.measure].counted(table, matches, rule)
    if not len(at):
        return counts, None
    first = int(at[np.argmin(table.rows.t_ns[at])])
    return counts, (table.rows[first], table.sources[table.source[first]])


def summed(parts: Iterable[Part]) -> Part:
    """The parts of a stream, in the order of time, as one."""
    extents, of_rules = zip(*parts, strict=True)
    return summed_counts(extents), [_added(group) for group in zip(*of_rules, strict=True)]


def _added(parts: Sequence[tuple[Counts, Shown]]) -> tuple[Counts, Shown]:
    counts, shown = zip(*parts, strict=True)
    return summed_counts(counts), next(filter(None, shown), None)


def needed(table: Table, rules: Sequence[Rule]) -> Ints:
    """The rows of a table that later tables need: the last one that each filter selects."""
    texts = {rule.filter_text for rule in rules if rule.measure == "max_gap"}
    timed, found = table.rows.timed[: table.stop], [_NONE]
    for text in texts:
        found.append(np.flatnonzero(selected(table, text)[: table.stop] & timed)[-1:])
    return np.concatenate(found)


def analysis_of(rules: Sequence[Rule]) -> Analysis[Part]:
    """The analysis for some rules."""
    return Analysis(partial(counted, rules=rules), summed, partial(needed, rules=rules))


def _numbers(values: Mapping[str, int | float | None], kind: Any = pl.Int64) -> pl.DataFrame:
    return pl.DataFrame(
        {name: [value] for name, value in values.items()}, dict.fromkeys(values, kind)
    )


# The measures


class RuleContext(NamedTuple):
    """What a value depends on besides the counts of its rule."""

    extent: Mapping[str, Any]
    """The number and the times of all rows."""
    hidden: str
    """Why rows are missing; empty if a filter hid none."""
    baseline: Counts | None
    """The counts of `compare` to compare with."""


class Measured(NamedTuple):
    """The value of a measure, and what a failed rule counts most."""

    value: float | None
    """None if the rows that it needs did not come; NaN, which fulfils no rule, for a rate in no
    time."""
    finding: Finding | None = None
    text: str = ""
    """A motor, or a change."""


def _matching(table: Table, matches: Bools, rule: Rule) -> Counted:
    at = table.counted[matches[table.counted]]
    return Counted({"rows": _numbers({"sum matches": len(at)})}, at if rule.is_limit else _NONE)


def _matches(counts: Counts) -> int:
    return int(counts["rows"]["sum matches"][0])


def _count(counts: Counts, rule: Rule, context: RuleContext) -> Measured:
    return Measured(_matches(counts))


def _share(counts: Counts, rule: Rule, context: RuleContext) -> Measured:
    return Measured(_matches(counts) / int(context.extent["sum rows"]))


def _rate(counts: Counts, rule: Rule, context: RuleContext) -> Measured:
    """Matching rows per second; NaN if the duration is unknown or 0."""
    seconds = _duration(counts, rule, context).value
    if not seconds and _matches(counts):
        return Measured(math.nan)
    return Measured(_matches(counts) / (seconds or 1))


def _duration(counts: Counts, rule: Rule, context: RuleContext) -> Measured:
    extent = context.extent
    known = extent["sum timed"] > 1
    return Measured((extent["greatest t"] - extent["least t"]) / 1e9 if known else None)


def _nothing(table: Table, matches: Bools, rule: Rule) -> Counted:
    return Counted({})


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
    numbers = _numbers({"sum matches": count, "greatest gap": int(gaps.max(initial=0))})
    return Counted({"rows": numbers}, at[:-1][rule.violated_by(gaps / 1e9) & (gaps > 0)])


def _max_gap(counts: Counts, rule: Rule, context: RuleContext) -> Measured:
    known = _matches(counts) > 1
    return Measured(float(counts["rows"]["greatest gap"][0]) / 1e9 if known else None)


def _values(table: Table, matches: Bools, rule: Rule) -> Counted:
    of_rows, rows = COLUMN_BY_NAME[rule.argument].of_rows, table.with_facts
    at = table.counted[matches[table.counted]]
    values, known, _ = of_rows(rows) if of_rows else (matches, None, None)
    at = at if known is None else at[known[at]]
    own, some = values[at].astype(np.float64), len(at) > 0
    numbers = {
        "sum count": len(at),
        "sum value": float(own.sum()),
        "least value": float(own.min()) if some else None,
        "greatest value": float(own.max()) if some else None,
    }
    return Counted({"rows": _numbers(numbers, pl.Float64)}, at[rule.violated_by(own)])


def _value(counts: Counts, rule: Rule, context: RuleContext) -> Measured:
    """The smallest or greatest value of a field, or its mean."""
    found = counts["rows"].row(0, named=True)
    if rule.measure == "mean" and found["sum count"]:
        return Measured(found["sum value"] / found["sum count"])
    return Measured(found["least value" if rule.measure == "min" else "greatest value"])


def _commands(table: Table, matches: Bools) -> pl.DataFrame:
    """The answers of the commands that a filter selects."""
    found = table.answers
    return found.filter(pl.Series(matches[found["command"].to_numpy()], dtype=pl.Boolean))


def _states(table: Table, matches: Bools, rule: Rule) -> Counted:
    own = _commands(table, matches)
    counts = own.group_by("motor", "state").agg(pl.len().cast(pl.Int64).alias("sum commands"))
    missed = own.filter(pl.col("state") == AnswerState.UNANSWERED)["command"].to_numpy()
    return Counted({"answers": counts}, missed if rule.is_limit else _NONE)


def _unanswered(counts: Counts, rule: Rule, context: RuleContext) -> Measured:
    """The commands without an answer; None if feedback never came before them."""
    found, state = counts["answers"], pl.col("state")
    asked = found.filter(state <= AnswerState.UNANSWERED)
    if not len(asked) and (found["state"] == AnswerState.UNCOVERED).any():
        return Measured(None)
    missed = asked.filter(state == AnswerState.UNANSWERED).sort("sum commands", "motor")
    text = ""
    for motor, _, most in missed[-1:].select("motor", "state", "sum commands").iter_rows():
        commands = chosen(asked, motor=motor)["sum commands"].sum()
        text = f"most of motor {motor}: {most:,} of {commands:,} commands"
    return Measured(int(missed["sum commands"].sum()), text=text)


def _delays(table: Table, matches: Bools, rule: Rule) -> Counted:
    own = _commands(table, matches).drop_nulls("delay_ns")
    late = own["command"].to_numpy()[rule.violated_by(own["delay_ns"].to_numpy() / 1e6)]
    all_ = own.with_columns(of=pl.lit(""))
    return Counted(binned("delays", all_, ["of"], "delay_ns", "end_ns"), late)


def _delay(counts: Counts, rule: Rule, context: RuleContext) -> Measured:
    """Milliseconds from a command to its answer."""
    found = Durations.of(counts, "delays")
    percent = _PERCENTILES[rule.argument]
    value = found.longest_ns if percent == 100 else found.percentile_ns(percent)
    return Measured(None if value is None else value / 1e6)


def _online_bits(table: Table, matches: Bools, rule: Rule) -> Counted:
    rows, motor = table.rows, int(rule.argument)
    at = table.counted[FEEDBACK[rows.kinds[table.counted]]]
    is_on = values_at(rows, NAME_OF_ROLE[Role.ONLINE], at) & rule.bit != 0
    own = int((rows.nums[at] == motor).sum())
    numbers = {"sum on": int(is_on.sum()), "sum frames": len(at), "sum own": own}
    return Counted({"rows": _numbers(numbers)}, at[~is_on])


def _online(counts: Counts, rule: Rule, context: RuleContext) -> Measured:
    """The share of the feedback in which a motor is online; None without feedback of it."""
    on, frames, own = counts["rows"].row(0)
    return Measured(on / frames if own else None)


def _events(table: Table, matches: Bools, rule: Rule) -> Counted:
    return Counted(events.counted(table))


def _findings(counts: Counts, rule: Rule, context: RuleContext) -> Measured:
    """The findings that a rule counts; None if they could not be examined."""
    cause, _, motor = rule.argument.partition(",")
    report = find(counts)
    if cause in report.not_covered or len(report.not_covered) == len(Cause):
        return Measured(None)
    found = [
        one
        for one in report.found
        if cause in ("", one.cause) and motor in ("", str(one.motor or motor))
    ]
    return Measured(len(found), next(iter(found), None))


def _compared(table: Table, matches: Bools, rule: Rule) -> Counted:
    return Counted(compare.counted(table))


def _changed(counts: Counts, rule: Rule, context: RuleContext) -> Measured:
    """The changes since the baseline; None if they could not be compared."""
    if context.baseline is None:
        return Measured(None)
    found = compare.compared(context.baseline, counts)
    changes, numbers = (
        [one for one in some if rule.argument in ("", one.measure)]
        for some in (found.changes, found.numbers)
    )
    return Measured(len(changes) if numbers else None, text=changes[0].text if changes else "")


class Measure(NamedTuple):
    """A measure of the language."""

    counted: Callable[[Table, Bools, Rule], Counted]
    value: Callable[[Counts, Rule, RuleContext], Measured]
    example: str
    needs: str
    """What it needs to have a value: `a row`."""
    unit: str = ""
    argument: str = ""
    """The pattern of `argument` and `filter`."""
    like: str = ""
    """The form of a filter for rows like those that show a violation, with the rule as `{0}`."""
    needs_all: bool = True
    """Whether rows that a filter hid would decide it."""


def _any(words: Iterable[object]) -> str:
    return rf"(?P<argument>{'|'.join(map(str, words))})"


_ROW: Final = "a row"
_FILTER: Final = r"(?P<filter>.*\S.*)"
_MORE: Final = r"\s*(?:,(?P<filter>.*))?"
_CAUSE: Final = rf"(?:{'|'.join(Cause)})(?:,\s*[{MOTORS[0]}-{MOTORS[-1]}])?"
_FIELD: Final = "a matching row with the field"
_OTHER: Final = "NOT {0.argument} {0.operator} {0.number:.15g}"

_OF_ROWS: Final = {
    "count": Measure(_matching, _count, "count(malformed) == 0", _ROW, "rows", _FILTER),
    "share": Measure(_matching, _share, "share(malformed) <= 0.001", _ROW, "", _FILTER),
    "rate": Measure(
        _matching, _rate, "rate(feedback) >= 30", "two different times", "1/s", _FILTER
    ),
    **{
        name: Measure(
            _values, _value, f"{name}(rpm) <= 300", _FIELD, "", _any(FIELDS) + _MORE, like
        )
        for name, like in {"min": _OTHER, "max": _OTHER, "mean": ""}.items()
    },
    "duration": Measure(*(_nothing, _duration, "duration() >= 60", "two rows with times", "s")),
}
"""Measures that rows which a filter hid do not change."""

MEASURES: Final[Mapping[str, Measure]] = {
    **{name: one._replace(needs_all=False) for name, one in _OF_ROWS.items()},
    "max_gap": Measure(
        *(_gaps, _max_gap, "max_gap(motor = 1) < 0.5", "two matching rows with times"),
        *("s", _FILTER),
    ),
    "delay": Measure(
        *(_delays, _delay, "delay(p95) < 20", "an answered command with times"),
        *("ms", _any(_PERCENTILES) + _MORE, "NOT answer_ms {0.operator} {0.number:.15g}"),
    ),
    "unanswered": Measure(
        *(_states, _unanswered, "unanswered() == 0", "feedback before the commands"),
        *("commands", "(?P<filter>.*)", "unanswered"),
    ),
    "online": Measure(
        *(_online_bits, _online, "online(1) >= 0.99", "feedback of the motor"),
        *("", _any(MOTORS), f"{NAME_OF_ROLE[Role.ONLINE]} & {{0.bit}} = 0"),
    ),
    "findings": Measure(
        *(_events, _findings, "findings(unanswered, 3) == 0"),
        *("rows with times that show the cause", "findings", _any([_CAUSE, ""])),
    ),
    "changed": Measure(
        *(_compared, _changed, "changed(delay) == 0"),
        *(
            "--baseline, and rows on both sides that can be compared",
            "changes",
            _any([*compare.MEASURES, ""]),
        ),
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
    if match is None:
        raise InputTextError(
            f"{quoted(expect)} is not a rule; write a measure, a comparison and a number without a"
            " unit, as in count(malformed) == 0"
        )
    measure, inner, symbol, number = match.groups()
    if measure not in MEASURES:
        fix = nearest(measure, MEASURES)
        raise InputTextError(f"{quoted(measure)} is not a measure; {fix}")
    kind = MEASURES[measure]
    parts = re.fullmatch(rf"\s*{kind.argument}\s*", inner, re.DOTALL)
    value = float(int(number, 0)) if "x" in number.lower() else float(number)
    if parts is None or not math.isfinite(value):
        wrong = inner if parts is None else number
        raise InputTextError(f"{quoted(wrong)} does not fit {measure}; write {kind.example}")
    argument, filter_text = (parts.groupdict("").get(one, "") for one in ("argument", "filter"))
    argument, filter_text = re.sub(r"\s", "", argument), filter_text.strip()
    if filter_text:
        RowFilter.parse(filter_text)
    return Rule(
        name or expect, expect, measure, argument, filter_text, symbol, value, may_be_uncovered
    )


def rules_of_toml(text: str, source: str) -> list[Rule]:
    """The rules of a TOML text with `[[rule]]` tables; `source` names it in errors.

    Raises InputTextError: which rule is invalid, and what was probably meant.
    """
    example = 'write [[rule]], name = "no damage", expect = "count(malformed) == 0"'
    try:
        tables = tomllib.loads(text)
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        raise InputTextError(f"{source}: is not valid TOML: {error}") from error
    match tables:
        case {"rule": [_, *_] as listed, **rest} if not rest:
            return [_of_table(f"{source}: rule {at}", one) for at, one in enumerate(listed, 1)]
    raise InputTextError(f"{source}: has no rules, or more than rules; {example}")


def _of_table(where: str, table: object) -> Rule:
    match table:
        case {"name": str(name), "expect": str(expect), **rest} if name.strip():
            allowed = rest.pop("may_be_uncovered", False)
            if isinstance(allowed, bool) and not rest:
                return rule_at(where, expect, name, may_be_uncovered=allowed)
    raise InputTextError(
        f"{where}: needs a name and expect, which are texts; may_be_uncovered = true may follow"
    )


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
    """The measure, in the rule's unit; None if not covered, and for a rate in no time."""
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
    text: str = ""
    """What a failed rule counts most: a change, or the commands of a motor."""

    @property
    def refuses(self) -> bool:
        """Whether the check does not succeed because of this rule."""
        uncovered = self.result is RuleResult.NOT_COVERED and not self.rule.may_be_uncovered
        return uncovered or self.result is RuleResult.FAIL


def verdicts(total: Part, rules: Sequence[Rule], baseline: Counts | None = None) -> list[Verdict]:
    """By rule, in their order; `baseline` are the counts of `compare` to compare with."""
    counts, parts = total
    hidden = counts["hidden"]["hidden_by"].to_list()
    context = RuleContext(
        counts["extent"].row(0, named=True), hidden_text(hidden) if hidden else "", baseline
    )
    return [_verdict(rule, part, context) for rule, part in zip(rules, parts, strict=True)]


def _verdict(rule: Rule, part: tuple[Counts, Shown], context: RuleContext) -> Verdict:
    kind, extent, (counts, shown) = MEASURES[rule.measure], context.extent, part
    if not extent["sum rows"]:
        return Verdict(rule, None, RuleResult.NOT_COVERED, needs=_ROW)
    if context.hidden and kind.needs_all:
        needs = f"all rows; {context.hidden}"
        return Verdict(rule, None, RuleResult.NOT_COVERED, needs=needs)
    value, finding, text = kind.value(counts, rule, context)
    if value is None or math.isnan(value):
        # Rows in no time have no rate: the rule fails with every comparison.
        result = RuleResult.NOT_COVERED if value is None else RuleResult.FAIL
        untimed = "; no row has a time, try --start" if not extent["sum timed"] else ""
        return Verdict(rule, None, result, needs=kind.needs + untimed)
    if not rule.violated_by(value).any():
        return Verdict(rule, value, RuleResult.PASS)
    row, file = shown or (None, "")
    like = _filter_of(rule, row)
    return Verdict(rule, value, RuleResult.FAIL, row, file, "", like, finding, text)


def _filter_of(rule: Rule, row: Row | None) -> str:
    """The filter for rows as the one that violates a rule."""
    found, like = rule.filter_text, MEASURES[rule.measure].like.format(rule)
    motor = row and row.values.get(MOTOR)
    if rule.measure == "max_gap":  # all rows around the gap, of the motor that the rule names
        found = found if MOTOR in RowFilter.parse(found).names else ""
    elif like:
        found = both(found, like)
    if found and motor is not None and rule.measure not in ("max_gap", "online"):
        found = both(found, f"{MOTOR} = {motor}")
    return both(found, f"offset = {row.offset}") if row and row.t_ns is None else found
