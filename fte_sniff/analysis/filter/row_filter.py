"""The filter language: SQL conditions over the row columns.

    or          condition with OR ||, AND &&, NOT !, by rising precedence
    comparison  value (= != < <= > >= ~ !~ | [NOT] LIKE ILIKE REGEXP | [NOT] IN (...)
                | [NOT] BETWEEN low AND high | IS [NOT] NULL TRUE FALSE, DISTINCT FROM value)
    value       numbers joined by | & + - * / %, and a minus in front
    primary     number | 'text' | field | word | function(...) | ( or )

A text takes its meaning from the column that it is compared with: a time, a time of day, a word of
the contract, bytes. What cannot be compared is found by polars, which the condition is tried with.

As in SQL, a comparison with a null is null, and the filter drops the row: `kind != 'speed'` drops
damage. `kind IS DISTINCT FROM 'speed'` and `NOT speed` keep it. Arithmetic is in floating-point
numbers, which do not overflow; `&` and `|` take whole numbers of 64 bits.
"""

from __future__ import annotations

import operator
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, tzinfo
from difflib import get_close_matches
from math import inf, isfinite
from typing import Any, Final, NamedTuple

import numpy as np
import polars as pl

from fte_sniff.analysis.dataframe import row_frame
from fte_sniff.analysis.relations import last_of, row_before, runs_of, stream_keys
from fte_sniff.analysis.time_text import DAY_NS, clock_time, time_ns
from fte_sniff.errors import FilterError, TranslatableText, listed, printable
from fte_sniff.protocol import COLUMN_BY_NAME, COLUMNS, Column, ColumnType
from fte_sniff.protocol.columns import DERIVED, PREVIOUS
from fte_sniff.protocol.items import Change, PortEvent, PortEventKind
from fte_sniff.protocol.rows import NO_FACT, NO_ROWS, Bools, Row, Rows
from fte_sniff.protocol.spec import KINDS, NAME_OF_ROLE, Fault, Role, Status, encode, status_of

COLUMN_OF_WORD: Final = {word: column for column in COLUMNS for word in column.words}


class Function(NamedTuple):
    """A function of the language."""

    of: Callable[..., pl.Expr]
    """Makes its expression from those of the arguments."""
    example: str
    meaning: str


FUNCTIONS: Final[Mapping[str, Function]] = {
    "abs": Function(pl.Expr.abs, "abs(rpm) > 500", "without the sign"),
    "coalesce": Function(
        lambda first, second: first.fill_null(second),
        "coalesce(rpm, 0) < 10",
        "the second value where the first is null",
    ),
    "lower": Function(
        lambda text: text.cast(pl.String).str.to_lowercase(),
        "lower(port) LIKE '%usb%'",
        "in lower case",
    ),
    "upper": Function(
        lambda text: text.cast(pl.String).str.to_uppercase(),
        "upper(port) LIKE '%USB%'",
        "in upper case",
    ),
    "previous": Function(
        lambda one: pl.col(PREVIOUS[one.meta.output_name()].name),
        "abs(rpm - previous(rpm)) > 500",
        "value in the motor's frame before",
    ),
}

_OPERATORS: Final[Mapping[str, Callable[[Any, Any], pl.Expr]]] = {
    "=": operator.eq,
    "!=": operator.ne,
    "<": operator.lt,
    "<=": operator.le,
    ">": operator.gt,
    ">=": operator.ge,
    "+": lambda left, right: _real(left) + right,
    "-": lambda left, right: _real(left) - right,
    "*": lambda left, right: _real(left) * right,
    "/": lambda left, right: left / _null_if_zero(right),
    "%": lambda left, right: _real(left) % _null_if_zero(right),
    "&": lambda left, right: _whole(left) & _whole(right),
    "|": lambda left, right: _whole(left) | _whole(right),
}
_SAME: Final = {"==": "=", "<>": "!=", "&&": "AND", "||": "OR", "!": "NOT"}
_MIRRORED: Final = {"<": ">", ">": "<", "<=": ">=", ">=": "<="}
COMPARISONS: Final = ("=", "!=", "<", "<=", ">", ">=")
PATTERNS: Final = ("LIKE", "ILIKE", "~", "REGEXP", "RLIKE")
_ARITHMETIC: Final = (("|",), ("&",), ("+", "-"), ("*", "/", "%"))
"""The operators of numbers by rising precedence."""

_WORDS: Final = "AND|OR|NOT|IN|IS|BETWEEN|LIKE|ILIKE|REGEXP|RLIKE|NULL|TRUE|FALSE|DISTINCT|FROM"
KEYWORDS: Final = frozenset(_WORDS.split("|"))
_TOKEN: Final = re.compile(
    r"""\s*(?: (?P<number> (?: 0x[0-9a-f]+ | 0b[01]+ | (?:\d+\.?\d*|\.\d+)(?:e[-+]?\d+)? )(?!\w) )
    | '(?P<text> (?:[^'\ud800-\udfff]|'')* )' | "(?P<quoted> [^"\ud800-\udfff]* )"
    | `(?P<field> [^`\ud800-\udfff]* )`
    | (?P<name> [^\W\d]\w* ) | (?P<sign> && | \|\| | [=!<>]= | <> | !~ | [-=<>+*/%&|(),!~] )
    | (?P<end> $ ) )""",
    re.IGNORECASE | re.VERBOSE,
)
_TIME_FIX: Final = "write '2026-01-31T12:00:00Z', or '12:00:05' for that time of any day"
_YEAR_2000_NS: Final = 946_684_800 * 10**9
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
    def parse(cls, text: str, zone: tzinfo | None = None) -> RowFilter:
        """Compile a filter; raises FilterError with the mistake, its position, and the fix.

        `zone` is that of times without one, by default UTC.
        """
        expression = _Parser(text, zone or UTC).parse()
        return cls(text, frozenset(expression.meta.root_names()), expression)

    @property
    def needs_facts(self) -> bool:
        """Whether it reads a column that depends on other rows."""
        return not DERIVED.isdisjoint(self.names)

    @property
    def advice(self) -> str:
        """What the user probably wants instead, one line; empty if nothing."""
        motor, words = NAME_OF_ROLE[Role.MOTOR], set(re.findall(r"[a-z_]+", self.text.lower()))
        if motor not in words or words & DERIVED or words.isdisjoint(_DAMAGED):
            return ""
        return TranslatableText(
            "{motor} is empty in most damaged rows; {hint} is the motor that they probably"
            " belonged to",
            motor=motor,
            hint="motor_hint",
        )

    def matches(self, rows: Rows) -> Bools:
        """Whether each row passes; a null does not.

        Raises FilterError if the filter cannot be computed for these rows.
        """
        try:
            return _passes(self.expression, rows)
        except _REFUSED as error:
            raise FilterError(
                "filter: it cannot be computed ({why}); compare fields with plain values",
                why=_reason(error),
            ) from None

    def stream(self) -> StreamFilter:
        """This filter, for rows that come one after the other."""
        return StreamFilter(self)


_REFUSED: Final = (pl.exceptions.PolarsError, pl.exceptions.PanicException)
"""What polars raises for an expression that it cannot compute."""


def _passes(expression: pl.Expr, rows: Rows) -> Bools:
    frame = row_frame(rows, expression.meta.root_names() or ("offset",))
    # A constant would be one row.
    found = frame.select((pl.repeat(True, pl.len()) & expression).fill_null(False))
    return found.to_series().to_numpy()


def _reason(error: BaseException) -> str:
    return printable(str(error).split("\n", 1)[0][:120])


class StreamFilter:
    """A filter of rows that come one after the other, and do not wait for later ones.

    What depends on later rows is null; `previous` is known.
    """

    def __init__(self, row_filter: RowFilter) -> None:
        self.filter = row_filter
        self._before = NO_ROWS
        """The last frame of every stream."""

    def matches(self, rows: Rows, changes: Iterable[Change] = ()) -> Bools:
        """Whether each of the next rows passes; the gaps are between them."""
        if not self.filter.needs_facts:
            return self.filter.matches(rows)
        count, joined = len(self._before), Rows.concat([self._before, rows])
        keys = stream_keys(joined)
        gaps = [Change(count + one.index, one.what) for one in changes]
        before = row_before(keys, runs_of(joined, gaps))
        previous = np.where(before < 0, NO_FACT, joined.payloads[before])
        self._before = joined.select(np.sort(last_of(keys)))
        return self.filter.matches(joined.replace(previous=previous))[count:]

    def select(self, rows: Rows, changes: Iterable[Change] = ()) -> Rows:
        """The rows that pass, in order."""
        return rows.select(self.matches(rows, changes))


ALERT_INTERVAL_S: Final = 1.0
"""Shortest time between two signals of an alert, seconds."""


class Alert:
    """Counts the rows that match a filter, and decides when to signal them."""

    def __init__(self, row_filter: RowFilter) -> None:
        self._filter = StreamFilter(row_filter)
        self._due_s = -inf
        self.count = 0
        self.last: Row | None = None

    def observe(self, rows: Rows, now_s: float, _events: Sequence[PortEvent] = ()) -> bool:
        """Count the next rows; returns whether to signal now, by any monotonic clock, seconds."""
        if not len(rows):  # most polls of a quiet line
            return False
        (matching,) = self._filter.matches(rows).nonzero()
        if not len(matching):
            return False
        self.count += len(matching)
        self.last = rows[int(matching[-1])]
        is_due = now_s >= self._due_s
        if is_due:
            self._due_s = now_s + ALERT_INTERVAL_S
        return is_due


class SilenceAlert:
    """Counts the silences of wires that last some seconds, and signals each."""

    last: Row | None = None

    def __init__(self, seconds: float) -> None:
        self._seconds = seconds
        self._due_s: dict[str, float] = {}
        """By wire that is silent: when its silence has lasted so long."""
        self.count = 0

    def observe(self, _rows: Rows, now_s: float, events: Sequence[PortEvent] = ()) -> bool:
        """Follow the next events; returns whether to signal now, by any monotonic clock."""
        for event in events:
            self._due_s.pop(event.port, None)
            if event.kind is PortEventKind.SILENT:
                self._due_s[event.port] = now_s + self._seconds - event.count / 1000
        due = [port for port, due_s in self._due_s.items() if due_s <= now_s]
        for port in due:
            del self._due_s[port]
        self.count += len(due)
        return bool(due)


_DAMAGED: Final = frozenset(
    [str(Status.MALFORMED), *(str(one) for one in Fault if status_of((one,)) is Status.MALFORMED)]
)
"""Words of filters for damaged rows."""


def _test_rows() -> Rows:
    """Rows of every kind with the lowest and highest values, and a row without values."""
    found = [Row("port", 0, b"\0", None, (Fault.NOISE, Fault.LINE_ERROR), framed=False)]
    for kind in KINDS:
        for end in ("low", "high"):
            values = {field.name: getattr(field, end) for field in kind.fields}
            found.append(Row("port", 0, encode(kind, values), 0))
    return Rows.of(found)


_TEST_ROWS: Final = _test_rows()


class _Token(NamedTuple):
    """A part of a filter's text."""

    kind: str
    """`number`, `text`, `name`, `sign` or `end`."""
    text: str
    start: int

    @property
    def word(self) -> str:
        """The operator or keyword in its first spelling; empty for numbers and texts."""
        found = self.text.upper() if self.kind in ("name", "sign") else ""
        return _SAME.get(found, found)


@dataclass(frozen=True, slots=True)
class _Term:
    """A part of a filter."""

    expr: pl.Expr
    start: int
    column: Column | None = None
    """The column, if it is just a field."""
    text: str | None = None
    """The text, if it is one in quotes or a word, whose meaning depends on the column."""
    is_word: bool = False
    """Whether it is a word of the contract without quotes."""
    is_condition: bool = False
    number: float | None = None
    """The value of a plain number."""


class _Parser:
    def __init__(self, text: str, zone: tzinfo) -> None:
        self._text, self._zone = text, zone
        self._index = self._nested = 0
        self._tokens = [*self._tokenized()]

    def _tokenized(self) -> Iterator[_Token]:
        at, kind = 0, ""
        for _ in range(_MOST_TOKENS):
            match = _TOKEN.match(self._text, at)
            if match is None:
                raise self._mistake(at, "this has no meaning in a filter")
            kind = str(match.lastgroup)
            content, start, at = match[kind], match.start(kind), match.end()
            start -= kind in ("text", "quoted", "field")
            if kind in ("quoted", "field"):
                kind = "name" if content.lower() in COLUMN_BY_NAME else "text"
            yield _Token(kind, content.replace("''", "'"), start)
            if kind == "end":
                return
        raise self._mistake(at, "too long")

    def _mistake(self, at: int, what: str, fix: str = "") -> FilterError:
        """A mistake with its position."""
        before, after = (
            printable(self._text[one]) for one in (slice(max(0, at - 24), at), slice(at, at + 24))
        )
        return FilterError(
            'filter: {what} at character {at} of "{excerpt}"' + (f"; {fix}" if fix else ""),
            what=what,
            at=at + 1,
            excerpt=f"{before}-->{after}",
        )

    def _accept(self, *choices: str) -> str | None:
        found = self._tokens[self._index].word
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
        if self._tokens[0].kind == "end":
            raise self._mistake(
                0, "it is empty", "write a condition, as in motor = 1 AND rpm > 500"
            )
        found = self._condition(self._or())
        if self._tokens[self._index].kind != "end":
            raise self._mistake(
                self._here, "this is out of place", "join conditions with AND or OR"
            )
        return found

    def _or(self) -> _Term:
        return self._chain("OR", lambda: self._chain("AND", self._not))

    def _chain(self, joint: str, inner: Callable[[], _Term]) -> _Term:
        """One or more conditions; they are joined at once, which keeps the expression shallow."""
        terms = [inner()]
        while self._accept(joint):
            terms.append(inner())
        if len(terms) == 1:
            return terms[0]
        join = pl.all_horizontal if joint == "AND" else pl.any_horizontal
        found = join([self._condition(term) for term in terms])
        return _Term(found, terms[0].start, is_condition=True)

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
        if not term.is_word or term.text is None:
            raise self._mistake(term.start, "a condition is missing", "compare it, as in motor = 1")
        column = COLUMN_OF_WORD[term.text]
        own, is_list = pl.col(column.name), column.type is ColumnType.WORDS
        return own.list.contains(term.text) if is_list else own.eq_missing(pl.lit(term.text))

    def _comparison(self) -> _Term:
        left = self._value()
        found = self._compared(left)
        if found is None:
            return left
        if self._accept(*COMPARISONS):
            self._index -= 1
            raise self._mistake(self._here, "this is out of place", "join comparisons with AND")
        try:
            _passes(found, _TEST_ROWS)
        except _REFUSED as error:
            what = f"this cannot be compared ({_reason(error)})"
            fix = "compare fields with values of their type"
            raise self._mistake(left.start, what, fix) from None
        return _Term(found, left.start, is_condition=True)

    def _compared(self, left: _Term) -> pl.Expr | None:
        if symbol := self._accept(*COMPARISONS):
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
        elif symbol := self._accept(*PATTERNS):
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
            raise self._mistake(
                self._here, "NULL, TRUE, FALSE or DISTINCT FROM is missing after IS"
            )
        self._expect("FROM")
        if self._accept("NULL"):
            return ~left.expr.is_null()
        right = self._value()
        equal, unknown = self._compare(left, "=", right), left.expr.is_null()
        return ~equal.fill_null(unknown & right.expr.is_null())

    def _compare(self, left: _Term, symbol: str, right: _Term) -> pl.Expr:
        if left.column is None and right.column is not None:
            left, right, symbol = right, left, _MIRRORED.get(symbol, symbol)
        column, text, compare = left.column, right.text, _OPERATORS[symbol]
        if symbol in ("=", "!=") and (left.is_condition or right.is_condition):
            return compare(self._condition(left), self._condition(right))
        if text is None or column is None:
            for term in (one for one in (right, left) if one.is_word or (one.text and one is left)):
                raise self._mistake(term.start, "a text or word is not compared with a field here")
            is_time = column is not None and column.type is ColumnType.TIME
            if is_time and right.number is not None and right.number < _YEAR_2000_NS:
                raise self._mistake(right.start, "this is a time before the year 2000", _TIME_FIX)
            return compare(left.expr, right.expr)
        match column.type:
            case ColumnType.TIME:
                clock = clock_time(text)
                if clock is None:
                    own, t_ns = left.expr, time_ns(text, self._zone)
                else:
                    own, t_ns = left.expr % DAY_NS, clock.since_midnight_ns(self._zone)
                if clock is not None and t_ns is None:
                    what = f"the offset of '{printable(text)}' depends on the season"
                    raise self._mistake(right.start, what, "write it, as in '12:00:05+01:00'")
                if t_ns is None or abs(t_ns) >= 2**63:
                    raise self._mistake(right.start, "this is not a time", _TIME_FIX)
                return compare(own, pl.lit(t_ns, pl.Int64))
            case ColumnType.WORD | ColumnType.WORDS:
                return self._compare_word(column, symbol, right)
            case ColumnType.HEX:
                return compare(left.expr, pl.lit(self._hex(right, "")))
            case ColumnType.TEXT:
                return compare(left.expr, pl.lit(text))
        raise self._mistake(right.start, f"{column.name} is a number", "write it without quotes")

    def _compare_word(self, column: Column, symbol: str, right: _Term) -> pl.Expr:
        word = (right.text or "").strip().lower()
        own, is_list = pl.col(column.name), column.type is ColumnType.WORDS
        if symbol not in ("=", "!="):
            raise self._mistake(right.start, f"{column.name} has no order", "use = or !=")
        if is_list and not word:
            found = own.list.len() == 0
        elif word not in column.words:
            fix = nearest(word, column.words) or _there_are(column.words)
            raise self._mistake(right.start, f"{column.name} is never '{printable(word)}'", fix)
        else:
            found = own.list.contains(word) if is_list else own == pl.lit(word)
        return found if symbol == "=" else ~found

    def _like(self, left: _Term, symbol: str, pattern: _Term) -> pl.Expr:
        of, own, found = left.column and left.column.type, left.expr, pattern.text
        if found is None:
            raise self._mistake(pattern.start, f"{symbol} needs a pattern in quotes")
        if of in (ColumnType.WORD, ColumnType.WORDS):
            own = own.cast(pl.String) if of is ColumnType.WORD else own.list.join(",")
        is_hex = of is ColumnType.HEX
        if symbol in ("LIKE", "ILIKE"):
            anything = "(?:..)*" if is_hex else ".*"
            inner = re.escape(self._hex(pattern, "_") if is_hex else found)
            found = f"^(?s:{inner.replace('_', '.').replace('%', anything)})$"
        return own.str.contains(f"(?i){found}" if is_hex or symbol == "ILIKE" else found)

    def _hex(self, literal: _Term, wildcards: str) -> str:
        digits = "".join((literal.text or "").split()).upper()
        anything = "%|" if wildcards else ""
        if not re.fullmatch(f"(?:{anything}[0-9A-F{wildcards}]{{2}})*", digits):
            what, fix = "these are not whole bytes", "write two digits a byte"
            raise self._mistake(literal.start, what, fix)
        return digits

    # Values

    def _value(self, level: int = 0) -> _Term:
        if level == len(_ARITHMETIC):
            return self._primary()
        left = self._value(level + 1)
        while symbol := self._accept(*_ARITHMETIC[level]):
            right = self._value(level + 1)
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
            inner = self._within(self._primary)
            number = None if inner.number is None else -inner.number
            return _Term(-inner.expr, token.start, number=number)
        if self._accept("("):
            found = self._within(self._or)
            self._expect(")")
            return replace(found, start=token.start)
        self._index += 1
        name = token.text.lower()
        match token.kind:
            case "number":
                return self._number(token)
            case "text":
                return _Term(pl.lit(token.text), token.start, text=token.text)
            case "name" if name in COLUMN_BY_NAME:
                return self._field(COLUMN_BY_NAME[name], token.start)
            case "name" if name in COLUMN_OF_WORD:
                return _Term(pl.lit(name), token.start, text=name, is_word=True)
            case "name" if name in ("true", "false"):
                return _Term(pl.lit(name == "true"), token.start, is_condition=True)
            case "name" if name in FUNCTIONS:
                return self._call(name, token.start)
            case "name" if token.text.upper() not in KEYWORDS:
                near = nearest(name, [*COLUMN_BY_NAME, *COLUMN_OF_WORD, *FUNCTIONS])
                fix = near or _there_are(COLUMN_BY_NAME)
                raise self._mistake(token.start, f"unknown name '{printable(token.text)}'", fix)
        raise self._mistake(token.start, "here a field or a value is missing")

    def _field(self, column: Column, start: int) -> _Term:
        own = pl.col(column.name)
        return _Term(own.cast(pl.Int64) if column.type is ColumnType.TIME else own, start, column)

    def _number(self, token: _Token) -> _Term:
        is_whole = re.fullmatch(r"\d+|0[xb].*", token.text, re.IGNORECASE)
        value: float = float(token.text) if not is_whole else int(token.text, _base(token.text))
        if value >= 2**63 if is_whole else not isfinite(value):
            raise self._mistake(token.start, "this number is too large")
        number = pl.lit(value, pl.Int64 if is_whole else pl.Float64)
        return _Term(number, token.start, number=value)

    def _call(self, name: str, start: int) -> _Term:
        items = self._arguments()
        try:
            if name == "previous" and items[0].column is None:
                raise KeyError(name)
            expr = FUNCTIONS[name].of(*(one.expr for one in items))
        except (TypeError, KeyError):
            fix = f"write {FUNCTIONS[name].example}"
            raise self._mistake(start, f"{name} takes other values", fix) from None
        return _Term(expr, start)


def _base(number: str) -> int:
    return {"x": 16, "b": 2}.get(number[1:2].lower(), 10)


def _real(number: pl.Expr) -> pl.Expr:
    return number.cast(pl.Float64)


def _whole(number: pl.Expr) -> pl.Expr:
    """A number for operators of bits; null if it is larger than 64 bits."""
    return number.cast(pl.Int64, strict=False)


def _null_if_zero(divisor: pl.Expr) -> pl.Expr:
    """A divisor that is null for 0: polars' infinity and NaN are greater than any number."""
    return pl.when(divisor != 0).then(divisor)


def nearest(word: str, choices: Iterable[str]) -> str:
    """`did you mean x?`, or an empty text if no choice is similar.

    A role, such as `speed`, means the field of that role, here `rpm`.
    """
    names, typed = list(choices), word.strip().lower()
    near = [name for name in names if name == _FIELD_OF_ROLE.get(typed)]
    near += [name for name in names if len(typed) > 1 and name.startswith(typed)]
    near += get_close_matches(typed, names, n=1)
    return TranslatableText("did you mean {near}?", near=near[0]) if near else ""


def _there_are(names: Iterable[str]) -> str:
    return TranslatableText("there are {names}", names=listed(names))


_FIELD_OF_ROLE: Final = {str(role): name for role, name in NAME_OF_ROLE.items()}
"""What people call a field: `speed` is a kind of frame, and its field is `rpm`."""
