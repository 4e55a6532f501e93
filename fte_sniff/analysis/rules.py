"""Rules of a check about rows, and their verdicts: pass, fail, or not covered.

A rule compares a measure of the rows with a number:

    rule      measure ( == | != | < | <= | > | >= ) number
    measure   name ( [argument [, argument]] )

The names and their arguments are those of `measures.MEASURES`.
"""

from __future__ import annotations

import math
import re
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from decimal import Decimal
from enum import StrEnum
from typing import Any, Final, Self

import numpy as np

from fte_sniff.analysis.dataframe import row_frame
from fte_sniff.analysis.facts import Facts
from fte_sniff.analysis.filter.parser import Token, TokenReader, TokenType, parse, tokens
from fte_sniff.analysis.filter.row_filter import RowFilter
from fte_sniff.analysis.filter.terms import excerpt, nearest
from fte_sniff.analysis.findings import Finding, Findings
from fte_sniff.analysis.measures import MEASURES, OPERATORS, Argument, RowPosition, Rule
from fte_sniff.analysis.model import RowCount, RowModel
from fte_sniff.analysis.time_text import SECOND_NS, duration_ns
from fte_sniff.errors import InputTextError, quoted
from fte_sniff.protocol import COLUMN_BY_NAME, COLUMNS, MOTORS, ColumnType, Gap, GapKind, PortEvent
from fte_sniff.protocol.columns import DERIVED
from fte_sniff.protocol.items import BaudChange
from fte_sniff.protocol.rows import NO_TIME, Bools, Rows
from fte_sniff.protocol.spec import NAME_OF_ROLE, Role

PERCENTILES: Final = ("p50", "p95", "p99", "max")

FIELDS: Final = tuple(
    column.name for column in COLUMNS if column.type in (ColumnType.INT, ColumnType.REAL)
)
"""The fields that `min`, `max` and `mean` take."""

_UNIT_AT_END: Final = re.compile(
    r"""[=<>](?P<number>(?>\s*[+-]?\s*)
    (?>0[xX][0-9A-Fa-f]+|0[bB][01]+|(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)(?:[eE][+-]?[0-9]+)?))
    (?>\s*)(?P<unit>%|/s|(?!_|(?i:and|or|not)\b)[^\W\d]\w*(?:/\w+)?)\s*$""",
    re.VERBOSE,
)
"""A number, and after it what is probably its unit."""

_TIME_UNITS: Final = {"s": SECOND_NS, "ms": SECOND_NS // 1000}
"""The units of measures that are times, in nanoseconds."""


def parse_rule(expect: str, name: str = "", *, may_be_uncovered: bool = False) -> Rule:
    """Parse a rule, by default named like its text.

    Raises InputTextError with the mistake, its position, and what was probably meant.
    """
    unit = _UNIT_AT_END.search(expect)
    text = expect if unit is None else expect[: unit.start("unit")]
    rule = _RuleParser(text, tokens(text)).parse()
    if unit is not None:
        raise _unit_error(rule, expect, unit)
    return replace(rule, name=name or expect, may_be_uncovered=may_be_uncovered)


def _unit_error(rule: Rule, expect: str, found: re.Match[str]) -> InputTextError:
    at, unit = found.start("unit"), found["unit"]
    of_measure = (
        "0 to 1" if rule.kind.is_share else f"in {rule.unit}" if rule.unit else "without a unit"
    )
    fix = f"the number in {rule.unit}" if rule.unit else "the number alone"
    length_ns = duration_ns(found["number"].strip() + unit) if rule.unit in _TIME_UNITS else None
    if length_ns is not None:
        fix = f"{rule.operator} {Decimal(length_ns) / _TIME_UNITS[rule.unit]:.12g}"
    elif unit.lower() == ("%" if rule.kind.is_share else rule.unit.lower().removeprefix("1")):
        fix = f"{rule.operator} {rule.number / (100 if rule.kind.is_share else 1):.12g}"
    return InputTextError(
        f'a rule has no unit at character {at + 1} of "{excerpt(expect, at)}";'
        f" {rule.measure} is {of_measure}: write {fix}"
    )


class _RuleParser(TokenReader):
    def parse(self) -> Rule:
        name = self._advance()
        if name.type is not TokenType.NAME:
            raise self._error(name, "a rule begins with a measure", _measures())
        measure = name.text
        if measure not in MEASURES:
            what = f"'{measure}' is not a measure"
            raise self._error(name, what, nearest(measure, MEASURES) or _measures())
        self._expect_symbol("(", f"write {MEASURES[measure].example}")
        argument, filter_text = self._arguments(measure)
        sign = self._operator()
        number = self._number()
        rest = self._peek()
        if rest.type is not TokenType.END:
            raise self._error(rest, "a rule is one comparison", "write another rule for the rest")
        return Rule("", self._text, measure, argument, filter_text, sign, number)

    def _error(self, token: Token, what: str, fix: str) -> InputTextError:
        if token.type is TokenType.END:
            what = f"the rule ends too soon: {what}"
        where = f'{what} at character {token.start + 1} of "{excerpt(self._text, token.start)}"'
        return InputTextError(f"{where}; {fix}")

    def _expect_symbol(self, symbol: str, fix: str) -> None:
        if not self._accept(symbol):
            raise self._error(self._peek(), f"a '{symbol}' is missing", fix)

    def _arguments(self, measure: str) -> tuple[str, str | None]:
        """The first argument, unless it is a filter, and the filter; after the closing bracket."""
        takes = MEASURES[measure].takes
        argument = ""
        if takes is Argument.CAUSE:
            return self._cause(measure), None
        if takes in (Argument.PERCENTILE, Argument.FIELD, Argument.MOTOR):
            argument = self._first_argument(takes, measure)
            if takes is not Argument.MOTOR and self._accept(","):
                takes = Argument.FILTER
        if takes is Argument.FILTER or (takes is Argument.OPTIONAL_FILTER and not self._at(")")):
            return argument, self._filter(measure)
        self._expect_symbol(")", f"write {MEASURES[measure].example}")
        return argument, None

    def _cause(self, measure: str) -> str:
        """A cause, `cause,motor`, or nothing; after the closing bracket."""
        argument = ""
        if not self._at(")"):
            argument = self._first_argument(Argument.CAUSE, measure)
            if self._accept(","):
                argument += f",{self._first_argument(Argument.MOTOR, measure)}"
        self._expect_symbol(")", f"write {MEASURES[measure].example}")
        return argument

    def _first_argument(self, takes: Argument, measure: str) -> str:
        token = self._advance()
        choices = {
            Argument.PERCENTILE: PERCENTILES,
            Argument.MOTOR: tuple(map(str, MOTORS)),
            Argument.FIELD: FIELDS,
            Argument.CAUSE: Findings.CAUSES,
        }[takes]
        if token.text in choices and token.type in (TokenType.NAME, TokenType.NUMBER):
            return token.text
        what = f"{measure} needs {takes.value}"
        column = COLUMN_BY_NAME.get(token.text)
        if takes is Argument.FIELD and column is not None:
            what = f"{token.text} is a {column.type.value}, not a number"
        elif token.type is not TokenType.END:
            what += f", and {quoted(self._text[token.start : token.end])} is none"
        raise self._error(
            token, what, nearest(token.text, choices) or f"there are {', '.join(choices)}"
        )

    def _filter(self, measure: str) -> str:
        """The filter up to the closing bracket, which is taken too."""
        start, depth = self._index, 0
        while depth or not self._at(")"):
            token = self._advance()
            depth += (token.operator == "(") - (token.operator == ")")
            if token.type is TokenType.END:
                raise self._error(token, f"the ')' of {measure} is missing", "close it")
        first, end = self._tokens[start], self._advance()
        if first is end:
            fix = f"write {MEASURES[measure].example}"
            raise self._error(end, f"{measure} needs a filter", fix)
        parse(self._text, first.start, end.start)
        text = self._text[first.start : end.start].strip()
        RowFilter.parse(text)
        return text

    def _operator(self) -> str:
        token = self._advance()
        if token.operator in OPERATORS:
            return token.operator
        meant = {"=": "write ==", "<>": "write !=", "=>": "write >=", "=<": "write <="}
        fix = meant.get(token.operator, f"compare it with a number: {' '.join(OPERATORS)}")
        raise self._error(token, "a comparison is missing", fix)

    def _number(self) -> float:
        sign = -1 if self._accept("-", "+") == "-" else 1
        token = self._advance()
        if token.word == "NAN":
            fix = "every comparison with NaN is false; write a number"
            raise self._error(token, "NaN is not a number", fix)
        if token.type is not TokenType.NUMBER:
            raise self._error(token, "a number is missing", "compare the measure with a number")
        if not math.isfinite(token.number):
            raise self._error(token, "this number is too large", "write a smaller one")
        return sign * token.number


def _measures() -> str:
    return f"the measures are {', '.join(MEASURES)}"


_KEYS: Final[Mapping[str, type]] = {"name": str, "expect": str, "may_be_uncovered": bool}
_TYPE_NAMES: Final = {str: "a text in quotes", bool: "true or false"}


def rules_of_toml(text: str, source: str) -> list[Rule]:
    """The rules of a TOML text with `[[rule]]` tables; `source` names it in errors.

    Raises InputTextError: which rule is invalid, where, and what was probably meant.
    """
    try:
        document = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise InputTextError(f"{source}: is not valid TOML: {error}") from error
    except RecursionError as error:
        raise InputTextError(f"{source}: is nested too deeply for rules") from error
    for key in document:
        if key != "rule":
            near = nearest(key, ["rule"]) or "rules are [[rule]] tables"
            raise InputTextError(f"{source}: unknown key {quoted(key)}; {near}")
    tables = document.get("rule")
    if not isinstance(tables, list) or not all(isinstance(table, dict) for table in tables):
        raise InputTextError(
            f"{source}: has no rules; a rule is a table [[rule]] with name and expect"
        )
    return list(_rules_of(tables, source))


def _rules_of(tables: Sequence[Mapping[str, Any]], source: str) -> Iterator[Rule]:
    names: set[str] = set()
    for number, table in enumerate(tables, 1):
        name = table.get("name")
        where = f"{source}: rule {number}" + (f" {quoted(name)}" if isinstance(name, str) else "")
        _check_keys(table, where)
        if name in names:
            raise InputTextError(f"{where}: another rule has this name; give each its own")
        names.add(table["name"])
        allowed = table.get("may_be_uncovered", False)
        yield rule_at(where, table["expect"], table["name"], may_be_uncovered=allowed)


def _check_keys(table: Mapping[str, Any], where: str) -> None:
    for key, value in table.items():
        if key not in _KEYS:
            near = nearest(key, _KEYS) or f"the keys are {', '.join(_KEYS)}"
            raise InputTextError(f"{where}: unknown key {quoted(key)}; {near}")
        if not isinstance(value, _KEYS[key]):
            raise InputTextError(f"{where}: {key} must be {_TYPE_NAMES[_KEYS[key]]}")
    for key in ("name", "expect"):
        if not table.get(key):
            raise InputTextError(f'{where}: {key} is missing; write {key} = "..."')


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


@dataclass(frozen=True, slots=True)
class Verdict:
    """What a rule found."""

    rule: Rule
    value: float | None
    """The measure, in the rule's unit; None if not covered, and for a failed rate in no time."""
    result: RuleResult
    row: RowPosition | None = None
    """The first row that violates a failed rule, if one row can show it."""
    needs: str = ""
    """What the measure needs to have a value, if the rows lack it."""
    filter: str = ""
    """A filter for rows as the one that is shown; empty for all."""
    finding: Finding | None = None
    """The best finding that a failed rule counts."""

    @property
    def refuses(self) -> bool:
        """Whether the check does not succeed because of this rule."""
        if self.result is RuleResult.NOT_COVERED:
            return not self.rule.may_be_uncovered
        return self.result is RuleResult.FAIL


def _needs_facts(rule: Rule) -> bool:
    """Whether it reads a column that depends on other rows."""
    text = rule.filter_text
    return rule.argument in DERIVED or (text is not None and RowFilter.parse(text).needs_facts)


def _filter_of(conditions: Sequence[str], row: RowPosition | None) -> str:
    """The filter for rows as the one that violates a rule."""
    parts = dict.fromkeys(filter(None, conditions))
    if parts and row is not None and row.motor is not None:
        parts[f"{NAME_OF_ROLE[Role.MOTOR]} = {row.motor}"] = None
    if row is not None and row.t_ns == NO_TIME:
        parts[f"offset = {row.offset}"] = None
    if len(parts) == 1:
        return next(iter(parts))
    return " AND ".join(
        f"({part})" if re.search(r"\bor\b", part, re.IGNORECASE) else part for part in parts
    )


class RuleCheck(RowModel):
    """Measures consecutive rows and judges rules about them."""

    def __init__(self, rules: Sequence[Rule]) -> None:
        self.rules = rules
        self.total = RowCount()
        self.unseen = 0
        """Rows that a view was too slow to receive: what they would change is not known."""
        self._measures = [rule.kind.make(rule) for rule in rules]
        self._filters: dict[str, RowFilter] = {}
        self._names: frozenset[str] = frozenset()
        self._facts = Facts() if any(map(_needs_facts, rules)) else None

    def __getstate__(self) -> Mapping[str, Any]:
        """Everything but the compiled filters."""
        return {**self.__dict__, "_filters": {}, "_names": frozenset()}

    def begin(self, name: str) -> None:
        """Start the next input."""
        for measure in self._measures:
            measure.begin(name)

    def observe_change(self, change: Gap | BaudChange) -> None:
        """Apply a change before the next rows."""
        if isinstance(change, Gap):
            self._settle(change)
            if change.kind is GapKind.NOT_SHOWN:
                self.unseen += change.rows or 0
            for measure in self._measures:
                measure.interrupt(change)

    def observe_events(self, events: Sequence[PortEvent]) -> None:
        """Add port events."""
        for measure in self._measures:
            measure.observe_events(events)

    def _observe(self, rows: Rows) -> None:
        self.total.observe(rows)
        self._measure(rows if self._facts is None else self._facts.feed(rows))

    def _settle(self, gap: Gap | None = None) -> None:
        """Measure the rows that wait for their facts, at a gap or at the end."""
        if self._facts is not None:
            self._measure(self._facts.interrupt(gap))

    def _measure(self, rows: Rows) -> None:
        if not len(rows):
            return
        masks = self._masks(rows)
        for rule, measure in zip(self.rules, self._measures, strict=True):
            measure.observe(rows, masks[rule.filter_text])

    def _masks(self, rows: Rows) -> dict[str | None, Bools]:
        if not self._filters:
            texts = {rule.filter_text for rule in self.rules if rule.filter_text is not None}
            self._filters = {text: RowFilter.parse(text) for text in texts}
            self._names = frozenset().union(*(one.names for one in self._filters.values()))
        masks: dict[str | None, Bools] = {None: np.ones(len(rows), np.bool_)}
        if self._filters:
            frame = row_frame(rows, self._names or ("offset",))
            masks |= {text: one.mask(frame).to_numpy() for text, one in self._filters.items()}
        return masks

    def merge(self, later: Self) -> None:
        """Add the rows that follow, as if they had been observed here."""
        self._settle()
        later._settle()
        self.unseen += later.unseen
        self.total.merge(later.total)
        for measure, other in zip(self._measures, later._measures, strict=True):
            measure.merge(other)

    def verdicts(self) -> list[Verdict]:
        """By rule, in their order; commands that still wait for an answer are not decided."""
        self._settle()
        found = []
        for rule, measure in zip(self.rules, self._measures, strict=True):
            value = None if self.unseen else measure.value(self.total)
            if value is None:
                needs = "" if self.unseen else self._needs(rule)
                found.append(Verdict(rule, None, self._without_value(rule), None, needs))
            elif rule.holds(value):
                found.append(Verdict(rule, value, RuleResult.PASS))
            else:
                row = measure.row
                shown = _filter_of(measure.conditions(), row)
                finding = measure.finding()
                found.append(Verdict(rule, value, RuleResult.FAIL, row, "", shown, finding))
        return found

    def _without_value(self, rule: Rule) -> RuleResult:
        """Rows in no time have no rate: the rule fails with every comparison."""
        covered = self.total.rows and not self.unseen
        fails = covered and rule.kind.covered_by_any_row
        return RuleResult.FAIL if fails else RuleResult.NOT_COVERED

    def _needs(self, rule: Rule) -> str:
        if not self.total.rows:
            return "a row"
        if rule.kind.is_timed and self.total.first_ns is None:
            return f"{rule.kind.needs}; no row has a time, try --start"
        return rule.kind.needs
