"""The filter language: SQL conditions over the row columns.

    or          condition with OR ||, AND &&, NOT !, by rising precedence
    comparison  value (= != < <= > >= ~ !~ | [NOT] LIKE ILIKE REGEXP | [NOT] IN (...)
                | [NOT] BETWEEN low AND high | IS [NOT] NULL TRUE FALSE, DISTINCT FROM value)
    value       numbers joined by | & + - * / %, and a minus in front
    primary     number | 'text' | field | word | function(...) | ( or )

A text takes its meaning from the column that it is compared with: a time, a time of day, a word of
the contract, bytes. What cannot be compared is found by polars, which the condition is tried with.
"""

from __future__ import annotations

import operator
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, tzinfo
from difflib import get_close_matches
from math import isfinite
from typing import Any, Final

import polars as pl

from fte_sniff.analysis.dataframe import row_frame
from fte_sniff.analysis.filter.row_filter import _TEST_ROWS
from fte_sniff.analysis.time_text import DAY_NS, clock_time, time_ns
from fte_sniff.errors import FilterError, listed, printable
from fte_sniff.protocol import COLUMN_BY_NAME, COLUMNS, Column, ColumnType
from fte_sniff.protocol.columns import DERIVED, PREVIOUS
from fte_sniff.protocol.rows import Bools, Rows

COLUMN_OF_WORD: Final = {word: column for column in COLUMNS for word in column.words}

FUNCTIONS: Final[Mapping[str, Callable[..., pl.Expr]]] = {
    "abs": pl.Expr.abs,
    "coalesce": pl.Expr.fill_null,
    "lower": lambda text: text.cast(pl.String).str.to_lowercase(),
    "upper": lambda text: text.cast(pl.String).str.to_uppercase(),
    "previous": lambda one: pl.col(PREVIOUS[one.meta.output_name()].name),
}
"""The functions of the language; `previous` is the value in the motor's frame before."""

_OPERATORS: Final[Mapping[str, Callable[[Any, Any], pl.Expr]]] = {
    "=": operator.eq,
    "!=": operator.ne,
    "<": operator.lt,
    "<=": operator.le,
    ">": operator.gt,
    ">=": operator.ge,
    "+": operator.add,
    "-": operator.sub,
    "*": operator.mul,
    "/": lambda left, right: left / _null_if_zero(right),
    "%": lambda left, right: left % _null_if_zero(right),
    "&": operator.and_,
    "|": operator.or_,
}
_SAME: Final = {"==": "=", "<>": "!=", "&&": "AND", "||": "OR", "!": "NOT"}
_MIRRORED: Final = {"<": ">", ">": "<", "<=": ">=", ">=": "<="}
_COMPARISONS: Final = ("=", "!=", "<", "<=", ">", ">=")
_PATTERNS: Final = ("LIKE", "ILIKE", "~", "REGEXP", "RLIKE")
_ARITHMETIC: Final = (("|",), ("&",), ("+", "-"), ("*", "/", "%"))
"""The operators of numbers by rising precedence."""

_KEYWORDS: Final = frozenset(
    "AND OR NOT IN IS BETWEEN LIKE ILIKE REGEXP RLIKE NULL TRUE FALSE DISTINCT FROM".split()
)
_TOKEN: Final = re.compile(
    r"""\s*(?: (?P<number> (?: 0x[0-9a-f]+ | 0b[01]+ | (?:\d+\.?\d*|\.\d+)(?:e[-+]?\d+)? )(?!\w) )
    | '(?P<text> (?:[^']|'')* )' | "(?P<quoted> [^"]* )" | `(?P<field> [^`]* )`
    | (?P<name> [^\W\d]\w* ) | (?P<sign> && | \|\| | [=!<>]= | <> | !~ | [-=<>+*/%&|(),!~] )
    | (?P<end> $ ) )""",
    re.IGNORECASE | re.VERBOSE,
)
_MOST_TOKENS: Final = 600
_MOST_NESTED: Final = 25
"""Polars evaluates conditions by recursion: this bounds its stack."""


@dataclass(frozen=True, slots=True)
class RowFilter:
    """A compiled filter; made by `parse`."""

    text: str
    names: frozenset[str]
    """Columns that it reads."""
    expression: pl.Expr = field(compare=False, repr=False)
    """True, false or null for every row of a `row_frame`."""

    @classmethod
    def parse(cls, text: str, zone: tzinfo = UTC) -> RowFilter:
        """Compile a filter; raises FilterError with the mistake, its position, and the fix.

        `zone` is that of times without one.
        """
        expression = _Parser(text, zone).parse()
        made = cls(text, frozenset(expression.meta.root_names()), expression)
        made.matches(_TEST_ROWS)
        return made

    @property
    def needs_facts(self) -> bool:
        """Whether it reads a column that depends on other rows."""
        return not DERIVED.isdisjoint(self.names)

    def matches(self, rows: Rows) -> Bools:
        """Whether each row passes; a null does not."""
        frame = row_frame(rows, self.names or ("offset",))
        try:
            passes = frame.select((pl.repeat(True, pl.len()) & self.expression).fill_null(False))
        except (pl.exceptions.PolarsError, pl.exceptions.PanicException) as error:
            why = printable(str(error).split("\n", 1)[0][:120])
            raise FilterError(
                "filter: it cannot be computed ({why}); compare fields with plain values", why=why
            ) from None
        return passes.to_series().to_numpy()


@dataclass(frozen=True, slots=True)
class _Token:
    kind: str
    """`number`, `text`, `name`, `sign` or `end`."""
    text: str
    start: int


@dataclass(frozen=True, slots=True)
class _Term:
    """A part of a filter."""

    expr: pl.Expr
    start: int
    column: Column | None = None
    """The column, if it is just a field."""
    literal: str | None = None
    """The text, if it is one in quotes or a word, whose meaning depends on the column."""
    is_word: bool = False
    """Whether it is a word of the contract without quotes."""
    is_condition: bool = False


class _Parser:
    def __init__(self, text: str, zone: tzinfo) -> None:
        self._text, self._zone = text, zone
        self._tokens, self._index, self._nested = self._tokenized(), 0, 0

    def _tokenized(self) -> Sequence[_Token]:
        found, at = list[_Token](), 0
        while not found or found[-1].kind != "end":
            match = _TOKEN.match(self._text, at)
            if match is None or len(found) > _MOST_TOKENS:
                many = match is not None
                raise self._mistake(at, "too long" if many else "this has no meaning in a filter")
            kind = str(match.lastgroup)
            content, start, at = match[kind], match.start(kind), match.end()
            if kind in ("quoted", "field"):
                kind = "name" if content.lower() in COLUMN_BY_NAME else "text"
            found.append(_Token(kind, content.replace("''", "'"), start))
        return found

    def _mistake(self, at: int, what: str, fix: str = "") -> FilterError:
        before, after = printable(self._text[max(0, at - 24) : at]), printable(self._text[at : at + 24])
        return FilterError(
            'filter: {what} at character {at} of "{excerpt}"' + (f"; {fix}" if fix else ""),
            what=what,
            at=at + 1,
            excerpt=f"{before}-->{after}",
        )

    def _accept(self, *choices: str) -> str | None:
        token = self._tokens[self._index]
        found = token.text.upper() if token.kind in ("name", "sign") else ""
        found = _SAME.get(found, found)
        if found not in choices or not found:
            return None
        self._index += 1
        return found

    def _expect(self, choice: str) -> None:
        if self._accept(choice) is None:
            raise self._mistake(self._here, f"a '{choice}' is missing")

    @property
    def _here(self) -> int:
        return self._tokens[self._index].start

    # Conditions

    def parse(self) -> pl.Expr:
        """The whole filter."""
        found = self._condition(self._or())
        if self._tokens[self._index].kind != "end":
            raise self._mistake(self._here, "this is out of place", "join conditions with AND or OR")
        return found

    def _or(self) -> _Term:
        return self._chain("OR", lambda: self._chain("AND", self._not))

    def _chain(self, joint: str, inner: Callable[[], _Term]) -> _Term:
        """Conditions joined in pairs of pairs, which keeps the expression shallow."""
        first = inner()
        terms = [first]
        while self._accept(joint):
            terms.append(inner())
        if len(terms) == 1:
            return first
        level = [self._condition(term) for term in terms]
        join = operator.and_ if joint == "AND" else operator.or_
        while len(level) > 1:
            pairs = zip(level[::2], level[1::2], strict=False)
            level = [join(*pair) for pair in pairs] + level[len(level) // 2 * 2 :]
        return _Term(level[0], first.start, is_condition=True)

    def _not(self) -> _Term:
        start = self._here
        if self._accept("NOT"):
            return _Term(~self._condition(self._within(self._not)), start, is_condition=True)
        return self._comparison()

    def _within(self, inner: Callable[[], _Term]) -> _Term:
        self._nested += 1
        if self._nested > _MOST_NESTED:
            raise self._mistake(self._here, "nested too deeply", "simplify it")
        found = inner()
        self._nested -= 1
        return found

    def _condition(self, term: _Term) -> pl.Expr:
        """A condition; a word such as `noise` is true for rows that have it."""
        if term.is_condition or (term.column and term.column.type is ColumnType.BOOL):
            return term.expr
        if not term.is_word or term.literal is None:
            raise self._mistake(term.start, "a condition is missing", "compare it, as in motor = 1")
        column = COLUMN_OF_WORD[term.literal]
        own = pl.col(column.name)
        is_list = column.type is ColumnType.WORDS
        return own.list.contains(term.literal) if is_list else own.eq_missing(pl.lit(term.literal))

    def _comparison(self) -> _Term:
        left = self._value()
        found = self._compared(left)
        if found is None:
            return left
        if self._accept(*_COMPARISONS):
            self._index -= 1
            raise self._mistake(self._here, "this is out of place", "join comparisons with AND")
        return _Term(found, left.start, is_condition=True)

    def _compared(self, left: _Term) -> pl.Expr | None:
        if symbol := self._accept(*_COMPARISONS):
            return self._compare(left, symbol, self._value())
        if self._accept("IS"):
            negated = self._accept("NOT")
            found = self._is(left)
            return ~found if negated else found
        negated = self._accept("NOT", "!~")
        if negated == "!~":
            return ~self._like(left, "~", self._value())
        if self._accept("IN"):
            items = self._arguments()
            found = pl.any_horizontal([self._compare(left, "=", one) for one in items])
        elif self._accept("BETWEEN"):
            low = self._value()
            self._expect("AND")
            found = self._compare(left, ">=", low) & self._compare(left, "<=", self._value())
        elif symbol := self._accept(*_PATTERNS):
            found = self._like(left, symbol, self._value())
        elif negated:
            raise self._mistake(self._here, "IN, BETWEEN or LIKE is missing after NOT")
        else:
            return None
        return ~found if negated else found

    def _is(self, left: _Term) -> pl.Expr:
        is_list = left.column is not None and left.column.type is ColumnType.WORDS
        if self._accept("NULL"):
            own = self._condition(left) if left.is_word else left.expr
            return own.list.len() == 0 if is_list else own.is_null()
        if word := self._accept("TRUE", "FALSE"):
            return self._condition(left).eq_missing(pl.lit(word == "TRUE"))
        if not self._accept("DISTINCT"):
            raise self._mistake(self._here, "NULL, TRUE, FALSE or DISTINCT FROM is missing after IS")
        self._expect("FROM")
        return ~self._compare(left, "=", self._value()).fill_null(False)

    def _compare(self, left: _Term, symbol: str, right: _Term) -> pl.Expr:
        if left.column is None and right.column is not None:
            left, right, symbol = right, left, _MIRRORED.get(symbol, symbol)
        column, text = left.column, right.literal
        if text is None or column is None:
            if left.literal is not None or right.is_word:
                term = right if right.is_word else left
                raise self._mistake(term.start, "a text or word is not compared with a field here")
            return _OPERATORS[symbol](left.expr, right.expr)
        match column.type:
            case ColumnType.TIME:
                clock = clock_time(text)
                t_ns = time_ns(text, self._zone) if clock is None else clock.since_midnight_ns
                if t_ns is None or abs(t_ns) >= 2**63:
                    fix = "write '2026-01-31T12:00:00Z', or '12:00:05' for that time of any day"
                    raise self._mistake(right.start, "this is not a time", fix)
                own = left.expr if clock is None else left.expr % DAY_NS
                return _OPERATORS[symbol](own, pl.lit(t_ns, pl.Int64))
            case ColumnType.WORD | ColumnType.WORDS:
                return self._compare_word(column, symbol, right)
            case ColumnType.HEX:
                return _OPERATORS[symbol](left.expr, pl.lit(self._hex(right, "")))
            case ColumnType.TEXT:
                return _OPERATORS[symbol](left.expr, pl.lit(text))
        raise self._mistake(right.start, f"{column.name} is a number", "write it without quotes")

    def _compare_word(self, column: Column, symbol: str, right: _Term) -> pl.Expr:
        word = (right.literal or "").strip().lower()
        own, is_list = pl.col(column.name), column.type is ColumnType.WORDS
        if symbol not in ("=", "!="):
            raise self._mistake(right.start, f"{column.name} has no order", "use = or !=")
        if is_list and not word:
            found = own.list.len() == 0
        elif word not in column.words:
            what = f"{column.name} is never '{printable(word)}'"
            raise self._mistake(right.start, what, nearest(word, column.words))
        else:
            found = own.list.contains(word) if is_list else own == pl.lit(word)
        return found if symbol == "=" else ~found

    def _like(self, left: _Term, symbol: str, pattern: _Term) -> pl.Expr:
        column = left.column
        text = left.expr.list.join(",") if column and column.type is ColumnType.WORDS else left.expr
        if pattern.literal is None:
            raise self._mistake(pattern.start, f"{symbol} needs a pattern in quotes")
        is_hex = column is not None and column.type is ColumnType.HEX
        found, ignores_case = pattern.literal, is_hex or symbol == "ILIKE"
        if symbol in ("LIKE", "ILIKE"):
            wanted = self._hex(pattern, "_") if is_hex else found
            anything = "(?:..)*" if is_hex else ".*"
            inner = re.escape(wanted).replace("_", ".").replace("%", anything)
            found = f"^(?s:{inner})$"
        return text.cast(pl.String).str.contains(f"(?i){found}" if ignores_case else found)

    def _hex(self, literal: _Term, wildcards: str) -> str:
        digits = "".join((literal.literal or "").split()).upper()
        anything = "%|" if wildcards else ""
        if not re.fullmatch(f"(?:{anything}[0-9A-F{wildcards}]{{2}})*", digits):
            raise self._mistake(literal.start, "these are not whole bytes", "write two digits a byte")
        return digits

    # Values

    def _value(self, level: int = 0) -> _Term:
        if level == len(_ARITHMETIC):
            return self._primary()
        left = self._value(level + 1)
        while symbol := self._accept(*_ARITHMETIC[level]):
            right = self._value(level + 1)
            if left.literal is not None or right.literal is not None:
                raise self._mistake(right.start, f"'{symbol}' joins numbers")
            left = _Term(_OPERATORS[symbol](left.expr, right.expr), left.start)
        return left

    def _arguments(self) -> list[_Term]:
        self._expect("(")
        found = [self._within(self._or)]
        while self._accept(","):
            found.append(self._within(self._or))
        self._expect(")")
        return found

    def _primary(self) -> _Term:
        token = self._tokens[self._index]
        if self._accept("-"):
            return _Term(-self._within(self._primary).expr, token.start)
        if self._accept("("):
            found = self._within(self._or)
            self._expect(")")
            return replace(found, start=token.start)
        self._index += 1
        name = token.text.lower()
        match token.kind:
            case "number":
                return _Term(self._number(token), token.start)
            case "text":
                return _Term(pl.lit(token.text), token.start, literal=token.text)
            case "name" if name in COLUMN_BY_NAME:
                return self._field(COLUMN_BY_NAME[name], token.start)
            case "name" if name in COLUMN_OF_WORD:
                return _Term(pl.lit(name), token.start, literal=name, is_word=True)
            case "name" if name in ("true", "false"):
                return _Term(pl.lit(name == "true"), token.start, is_condition=True)
            case "name" if name in FUNCTIONS:
                return self._call(name, token.start)
            case "name" if token.text.upper() not in _KEYWORDS:
                fix = nearest(name, [*COLUMN_BY_NAME, *COLUMN_OF_WORD, *FUNCTIONS])
                raise self._mistake(token.start, f"unknown name '{printable(token.text)}'", fix)
        raise self._mistake(token.start, "here a field or a value is missing")

    def _field(self, column: Column, start: int) -> _Term:
        own = pl.col(column.name)
        return _Term(own.cast(pl.Int64) if column.type is ColumnType.TIME else own, start, column)

    def _number(self, token: _Token) -> pl.Expr:
        is_whole = re.fullmatch(r"\d+|0[xb].*", token.text, re.IGNORECASE)
        value: float
        if is_whole:
            value = int(token.text, 0) if token.text[1:2].isalpha() else int(token.text)
        else:
            value = float(token.text)
        if not isfinite(value) or abs(value) >= 2**63:
            raise self._mistake(token.start, "this number is too large")
        return pl.lit(value, pl.Int64 if is_whole else pl.Float64)

    def _call(self, name: str, start: int) -> _Term:
        try:
            return _Term(FUNCTIONS[name](*(one.expr for one in self._arguments())), start)
        except (TypeError, KeyError):
            raise self._mistake(start, f"{name} takes other values") from None


def _null_if_zero(divisor: pl.Expr) -> pl.Expr:
    """A divisor that is null for 0: polars' infinity and NaN are greater than any number."""
    return pl.when(divisor != 0).then(divisor)


def nearest(word: str, choices: Sequence[str]) -> str:
    """What was probably meant, or what there is."""
    near = [one for one in choices if len(word) > 1 and one.startswith(word)]
    near = near or get_close_matches(word, choices, n=1)
    return f"did you mean {near[0]}?" if near else f"there are {listed(choices)}"
