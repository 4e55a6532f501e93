"""Parser of the rules of a check: a measure of the rows, compared with a number.

rule      measure ( == | != | < | <= | > | >= ) number
measure   count(FILTER) | share(FILTER) | rate(FILTER) | max_gap(FILTER)
          | delay(p50 | p95 | p99 | max [, FILTER]) | unanswered([FILTER]) | online(MOTOR)
          | findings([CAUSE [, MOTOR]])
          | min(FIELD [, FILTER]) | max(FIELD [, FILTER]) | mean(FIELD [, FILTER]) | duration()
"""

from __future__ import annotations

import math
import re
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from decimal import Decimal
from typing import Any, Final

from fte_sniff.analysis.filter.parser import Token, TokenReader, TokenType, parse, tokens
from fte_sniff.analysis.filter.row_filter import RowFilter
from fte_sniff.analysis.filter.terms import excerpt, nearest
from fte_sniff.analysis.findings import Findings
from fte_sniff.analysis.measures import MEASURES, OPERATORS, Argument, Rule
from fte_sniff.analysis.time_text import SECOND_NS, duration_ns
from fte_sniff.errors import InputTextError, quoted
from fte_sniff.protocol import COLUMN_BY_NAME, COLUMNS, MOTORS, ColumnType

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
