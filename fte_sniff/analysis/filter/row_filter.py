"""The filter language: SQL conditions over the row columns.

    condition   operands joined by the operators of `LEVELS`, NOT and minus before one
    operand     number | 'text' | field | word | function(...) | (condition)

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
from dataclasses import dataclass, field
from datetime import UTC, tzinfo
from difflib import get_close_matches
from math import inf
from typing import Any, Final, NamedTuple

import numpy as np
import polars as pl

from fte_sniff.analysis.dataframe import table_frame
from fte_sniff.analysis.relations import last_of, row_before, runs_of, stream_keys
from fte_sniff.analysis.time_text import DAY_NS, clock_time, time_ns
from fte_sniff.errors import FilterError, TranslatableText, listed, printable
from fte_sniff.protocol.columns import (
    COLUMN_BY_NAME,
    COLUMNS,
    DERIVED,
    PREVIOUS,
    Column,
    ColumnType,
)
from fte_sniff.protocol.items import Change, PortEvent, PortEventKind
from fte_sniff.protocol.rows import MOST_BYTES, NO_FACT, NO_ROWS, Bools, Row, Rows
from fte_sniff.protocol.spec import KINDS, NAME_OF_ROLE, encode

COLUMN_OF_WORD: Final = {word: column for column in COLUMNS for word in column.words}

FUNCTIONS: Final[Mapping[str, Callable[..., pl.Expr]]] = {
    "abs": pl.Expr.abs,
    "coalesce": lambda first, second: first.fill_null(second),
    "lower": lambda text: _text(text).str.to_lowercase(),
    "upper": lambda text: _text(text).str.to_uppercase(),
    "previous": lambda one: pl.col(PREVIOUS[one.meta.output_name()].name).cast(pl.Int64),
}
"""The functions of the language, on the expressions of their arguments."""

EXAMPLES: Final = (
    ("motor = 1 AND rpm > 500", "AND OR NOT, also && || !"),
    ("kind IN ('speed', 'position')", "one of these words"),
    ("malformed OR noise", "a word alone: a kind, status or fault"),
    ("faults = 'noise'", "among the row's faults; IN: any of them"),
    ("faults IS NULL", "no fault at all"),
    ("error = 0x0F OR online & 0x01 = 0", "hex and single bits"),
    ("raw LIKE 'AA 01%'", "% any bytes, _ any digit; spaces are free"),
    ("time >= '2026-01-31T12:00:00Z'", "UTC, or with a zone as +08:00"),
    ("time > '12:00:05'", "a time of day, UTC, on any day"),
    ("rpm BETWEEN -10 AND 10", "both ends included; never rows without rpm"),
    ("kind IS DISTINCT FROM 'speed'", "any other, also rows that have no kind"),
    ("abs(rpm) > 500", "without the sign"),
    ("coalesce(rpm, 0) < 10", "the second value where the first is null"),
    ("lower(port) LIKE '%usb%'", "in lower case"),
    ("upper(port) LIKE '%USB%'", "in upper case"),
    ("abs(rpm - previous(rpm)) > 500", "value in the motor's frame before"),
)
"""Working filters, each with its meaning."""


def _text(value: pl.Expr) -> pl.Expr:
    return value.cast(pl.String)


def _real(number: pl.Expr) -> pl.Expr:
    return number.cast(pl.Float64)


def _whole(number: pl.Expr) -> pl.Expr:
    """A number for operators of bits; null if it is larger than 64 bits."""
    return number.cast(pl.Int64, strict=False)


def _divisor(number: pl.Expr) -> pl.Expr:
    """Null for 0: polars' infinity and NaN are greater than any number."""
    return _real(number).replace(0, None)


_OPERATORS: Final[Mapping[str, Callable[[Any, Any], pl.Expr]]] = {
    "OR": operator.or_,
    "AND": operator.and_,
    "=": operator.eq,
    "IS": pl.Expr.eq_missing,
    "<": operator.lt,
    "<=": operator.le,
    ">": operator.gt,
    ">=": operator.ge,
    "|": lambda left, right: _whole(left) | _whole(right),
    "&": lambda left, right: _whole(left) & _whole(right),
    "+": lambda left, right: _real(left) + right,
    "-": lambda left, right: _real(left) - right,
    "*": lambda left, right: _real(left) * right,
    "/": lambda left, right: left / _divisor(right),
    "%": lambda left, right: _real(left) % _divisor(right),
}
PATTERNS: Final = ("LIKE", "ILIKE", "~", "REGEXP", "RLIKE")
_COMPARISONS: Final = ("=", "!=", "<", "<=", ">", ">=", "IS", "NOT", "IN", "BETWEEN", *PATTERNS)
_PRECEDENCE: Final = (("OR",), ("AND",), _COMPARISONS, ("|",), ("&",), ("+", "-"), ("*", "/", "%"))
LEVELS: Final = {word: level for level, words in enumerate(_PRECEDENCE) for word in words}
"""The operators between operands, by rising precedence."""
_COMPARISON: Final = LEVELS["="]
_SAME: Final = {"==": "=", "<>": "!=", "&&": "AND", "||": "OR", "!": "NOT"}
_MIRRORED: Final = {"<": ">", ">": "<", "<=": ">=", ">=": "<="}
_TOKEN: Final = re.compile(
    r"""\s*(?: (?P<number> (?: 0x[0-9a-f]+ | 0b[01]+ | (?:\d+\.?\d*|\.\d+)(?:e[-+]?\d+)? )(?!\w) )
    | (?P<text> '(?:[^'\ud800-\udfff]|'')*' )
    | (?P<quoted> "[^"\ud800-\udfff]*" | `[^`\ud800-\udfff]*` )
    | (?P<name> [^\W\d]\w* ) | (?P<sign> && | \|\| | [=!<>]= | <> | [-=<>+*/%&|(),!~] )
    | (?P<end> $ ) | (?P<other> . ) )""",
    re.IGNORECASE | re.VERBOSE,
)
_WHOLE: Final = (ColumnType.TIME, ColumnType.INT)
"""Columns that are computed with 64 bits."""
_TEXTS: Final = pl.List(pl.String)
_TIME_FIX: Final = "write '2026-01-31T12:00:00Z', or '12:00:05Z' for that time of any day"
_MOST_TOKENS: Final = 600
_MOST_NESTED: Final = 26
"""Polars evaluates conditions by recursion: this bounds its stack."""


@dataclass(frozen=True, slots=True)
class RowFilter:
    """A compiled filter; made by `parse`."""

    text: str
    expression: pl.Expr = field(compare=False, repr=False)
    """True, false or null for every row of a `table_frame`."""

    @classmethod
    def parse(cls, text: str, zone: tzinfo | None = None) -> RowFilter:
        """Compile a filter; raises FilterError with the mistake, its position, and the fix.

        `zone` is that of times without one, by default UTC.
        """
        return cls(text, _Parser(text, zone or UTC).parse())

    @property
    def needs_facts(self) -> bool:
        """Whether it reads a column that depends on other rows."""
        return not DERIVED.isdisjoint(self.expression.meta.root_names())

    def matches(self, rows: Rows) -> Bools:
        """Whether each row passes; a null does not."""
        return _passes(self.expression, rows)

    def stream(self) -> StreamFilter:
        """This filter, for rows that come one after the other."""
        return StreamFilter(self)


def _passes(expression: pl.Expr, rows: Rows) -> Bools:
    frame = table_frame(rows, expression.meta.root_names() or ("offset",))
    # A constant would be one row.
    found = frame.select((pl.repeat(True, pl.len()) & expression).fill_null(False))
    return found.to_series().to_numpy()


class StreamFilter:
    """A filter of rows that come one after the other, and do not wait for later ones.

    What depends on later rows is null; `previous` is known.
    """

    def __init__(self, row_filter: RowFilter) -> None:
        self.filter = row_filter
        self._before = NO_ROWS
        """The last frame of every stream."""

    def select(self, rows: Rows, changes: Iterable[Change] = ()) -> Rows:
        """Those of the next rows that pass, in order; the gaps are between them."""
        if not self.filter.needs_facts:
            return rows.select(self.filter.matches(rows))
        count, joined = len(self._before), Rows.concat([self._before, rows])
        keys = stream_keys(joined)
        gaps = [Change(count + one.index, one.what) for one in changes]
        before = row_before(keys, runs_of(joined, gaps))
        previous = np.where(before < 0, NO_FACT, joined.payloads[before])
        self._before = joined.select(np.sort(last_of(keys)))
        return rows.select(self.filter.matches(joined.replace(previous=previous))[count:])


ALERT_INTERVAL_S: Final = 1.0
"""Shortest time between two signals of an alert, seconds."""


class Alert:
    """Decides when to signal rows that match a filter, or silences of wires."""

    def __init__(self, row_filter: RowFilter | None, silence_s: float | None = None) -> None:
        """Begin without rows; without a filter, silences are signalled."""
        self._filter = None if row_filter is None else row_filter.stream()
        self.silence_s, self._due_s = silence_s, -inf
        self.count = 0
        """The rows that matched."""
        self.last: Row | None = None
        """The last of them."""

    def observe(self, rows: Rows, now_s: float, events: Sequence[PortEvent] = ()) -> bool:
        """Count the next rows; returns whether to signal now, by any monotonic clock, seconds."""
        if self._filter is None:
            return any(event.kind is PortEventKind.SILENT for event in events)
        matching = self._filter.select(rows)
        if not len(matching):
            return False
        self.count += len(matching)
        self.last = matching[-1]
        is_due = now_s >= self._due_s
        if is_due:
            self._due_s = now_s + ALERT_INTERVAL_S
        return is_due


_TEST_ROW: Final = Rows.blank(1, raw=[[*encode(KINDS[0], {}).ljust(MOST_BYTES, b"\0")]])
"""A frame: its texts and words have values, which polars tries to convert."""


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


class _Term(NamedTuple):
    """A part of a filter."""

    expr: pl.Expr
    start: int
    column: Column | None = None
    """The column, if it is just a field."""
    text: str | None = None
    """The text, if it is one in quotes or a word: the column decides its meaning."""
    is_condition: bool = False
    """A word alone, such as `noise`, is true for rows that have it."""

    @property
    def is_null(self) -> pl.Expr:
        """Whether it has no value; a list, whether it is empty."""
        is_list = self.column is not None and self.column.type is ColumnType.WORDS
        return self.expr.list.len() == 0 if is_list else self.expr.is_null()


class _Parser:
    def __init__(self, text: str, zone: tzinfo) -> None:
        self._text, self._zone = text, zone
        self._index = self._nested = 0
        self._tokens = [*self._tokenized()]

    def _tokenized(self) -> Iterator[_Token]:
        for number, match in enumerate(_TOKEN.finditer(self._text)):
            kind, start = str(match.lastgroup), match.start(match.lastgroup or 0)
            if kind == "other" or number == _MOST_TOKENS:
                what = "this has no meaning in a filter" if kind == "other" else "too long"
                raise self._mistake(start, what)
            content = match[kind]
            if kind in ("text", "quoted"):
                content = content[1:-1].replace("''", "'")
                is_field = kind == "quoted" and content.lower() in COLUMN_BY_NAME
                kind = "name" if is_field else "text"
            yield _Token(kind, content, start)

    def _mistake(self, at: int, what: str, fix: str = "") -> FilterError:
        """A mistake with its position."""
        excerpt = f"{self._text[max(0, at - 24) : at]}-->{self._text[at : at + 24]}"
        return FilterError(
            'filter: {what} at character {at} of "{excerpt}"' + (f"; {fix}" if fix else ""),
            what=what,
            at=at + 1,
            excerpt=printable(excerpt),
        )

    @property
    def _token(self) -> _Token:
        return self._tokens[self._index]

    def _accept(self, *choices: str) -> str:
        found = self._token.word
        if found not in choices:
            return ""
        self._index += 1
        return found

    def _expect(self, choice: str) -> None:
        if not self._accept(choice):
            raise self._mistake(self._token.start, f"a '{choice}' is missing")

    def parse(self) -> pl.Expr:
        """The whole filter."""
        found = self._condition(self._joined())
        if self._token.kind != "end":
            fix = "join conditions with AND or OR"
            raise self._mistake(self._token.start, "this is out of place", fix)
        return found

    def _joined(self, level: int = 0) -> _Term:
        """Operands joined by operators of at least a level."""
        left, highest = self._operand(), len(LEVELS)
        while level <= (own := LEVELS.get(self._token.word, -1)) < highest:
            if own == _COMPARISON:
                left, highest = self._comparison(left), _COMPARISON
                continue
            symbol = self._accept(*LEVELS)
            terms = (left, self._joined(own + 1))
            is_condition = own < _COMPARISON
            values = (self._condition(one) if is_condition else one.expr for one in terms)
            left = _Term(_OPERATORS[symbol](*values), left.start, is_condition=is_condition)
        return left

    def _condition(self, term: _Term) -> pl.Expr:
        if not term.is_condition:
            raise self._mistake(term.start, "a condition is missing", "compare it, as in motor = 1")
        return term.expr

    # Comparisons

    def _comparison(self, left: _Term) -> _Term:
        found = self._compared(left)
        try:
            _passes(found, _TEST_ROW)
        except (pl.exceptions.PolarsError, pl.exceptions.PanicException) as error:
            why = printable(str(error).split("\n", 1)[0][:120])
            what = f"this cannot be compared ({why})"
            fix = "compare fields with values of their type"
            raise self._mistake(left.start, what, fix) from None
        return _Term(found, left.start, is_condition=True)

    def _compared(self, left: _Term) -> pl.Expr:
        symbol, negated = self._accept("IS"), bool(self._accept("NOT"))
        if symbol and self._accept("DISTINCT"):
            self._expect("FROM")
            negated = not negated
        symbol = symbol or self._accept(*_COMPARISONS)
        if symbol == "IS":
            is_null = self._accept("NULL")
            found = left.is_null if is_null else self._compare(left, symbol, self._value())
        elif symbol == "IN":
            found = pl.any_horizontal([self._compare(left, "=", one) for one in self._arguments()])
        elif symbol == "BETWEEN":
            low = self._value()
            self._expect("AND")
            found = self._compare(left, ">=", low) & self._compare(left, "<=", self._value())
        elif symbol in PATTERNS:
            found = self._like(left, symbol, self._value())
        elif symbol and not negated:
            negated = symbol == "!="
            found = self._compare(left, "=" if negated else symbol, self._value())
        else:
            raise self._mistake(self._token.start, "IN, BETWEEN or LIKE is missing after NOT")
        return ~found if negated else found

    def _compare(self, left: _Term, symbol: str, right: _Term) -> pl.Expr:
        if left.column is None and right.column is not None:
            left, right, symbol = right, left, _MIRRORED.get(symbol, symbol)
        return _OPERATORS[symbol](*self._comparable(left, symbol, right))

    def _comparable(self, left: _Term, symbol: str, right: _Term) -> tuple[pl.Expr, pl.Expr]:
        """Both sides, of which a text has the type of the column."""
        own, column, text = left.expr, left.column, right.text
        if column is None or text is None:
            if left.is_condition != right.is_condition:
                at = left.start if left.is_condition else right.start
                fix = "write it alone, or compare a field, as in rpm > 3"
                raise self._mistake(at, "a condition has no value to compare", fix)
            return own, right.expr
        match column.type:
            case ColumnType.TIME:
                return self._times(own, text, right.start)
            case ColumnType.HEX:
                return own, pl.lit(self._hex(right, ""))
            case ColumnType.TEXT:
                return own, pl.lit(text)
            case _ if column.words and symbol not in ("=", "IS"):
                raise self._mistake(right.start, f"{column.name} has no order", "use = or !=")
            case ColumnType.WORD:
                return own, pl.lit(self._word(column, right))
            case ColumnType.WORDS:
                has = own.list.contains(self._word(column, right)) if text else left.is_null
                return has, pl.lit(True)
        raise self._mistake(right.start, f"{column.name} is a number", "write it without quotes")

    def _word(self, column: Column, literal: _Term) -> str:
        word = (literal.text or "").strip().lower()
        if word not in column.words:
            what = f"{column.name} is never '{printable(word)}'"
            raise self._mistake(literal.start, what, nearest(word, column.words))
        return word

    def _times(self, own: pl.Expr, text: str, start: int) -> tuple[pl.Expr, pl.Expr]:
        """A column and a time; the time of day of both, if it has no date."""
        clock = clock_time(text)
        t_ns = clock.since_midnight_ns(self._zone) if clock else time_ns(text, self._zone)
        if t_ns is None or abs(t_ns) >= 2**63:
            raise self._mistake(start, "this is not a time", _TIME_FIX)
        return own % DAY_NS if clock else own, pl.lit(t_ns, pl.Int64)

    def _like(self, left: _Term, symbol: str, pattern: _Term) -> pl.Expr:
        of, own, found = left.column and left.column.type, left.expr, pattern.text
        if found is None:
            raise self._mistake(pattern.start, f"{symbol} needs a pattern in quotes")
        if of in (ColumnType.WORD, ColumnType.WORDS):
            own = _text(own) if of is ColumnType.WORD else own.cast(_TEXTS).list.join(",")
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

    # Operands

    def _value(self) -> _Term:
        return self._joined(_COMPARISON + 1)

    def _operand(self) -> _Term:
        self._nested += 1
        if self._nested > _MOST_NESTED:
            raise self._mistake(self._token.start, "nested too deeply", "simplify it")
        start = self._token.start
        if self._accept("NOT"):
            inner = self._condition(self._joined(_COMPARISON))
            found = _Term(~inner, start, is_condition=True)
        elif self._accept("-"):
            found = _Term(-self._operand().expr, start)
        elif self._accept("("):
            found = self._joined()._replace(start=start)
            self._expect(")")
        else:
            found = self._primary()
        self._nested -= 1
        return found

    def _arguments(self) -> list[_Term]:
        self._expect("(")
        found = [self._joined()]
        while self._accept(","):
            found.append(self._joined())
        self._expect(")")
        return found

    def _primary(self) -> _Term:
        token = self._token
        self._index += token.kind != "end"
        name, start = token.text.lower(), token.start
        match token.kind:
            case "number":
                return self._number(token)
            case "text":
                return _Term(pl.lit(token.text), start, text=token.text)
            case "name" if column := COLUMN_BY_NAME.get(name):
                own, is_condition = pl.col(name), column.type is ColumnType.BOOL
                own = own.cast(pl.Int64) if column.type in _WHOLE else own
                return _Term(own, start, column, is_condition=is_condition)
            case "name" if column := COLUMN_OF_WORD.get(name):
                own, is_list = pl.col(column.name), column.type is ColumnType.WORDS
                found = own.list.contains(name) if is_list else own.eq_missing(pl.lit(name))
                return _Term(found, start, text=name, is_condition=True)
            case "name" if name in ("true", "false"):
                return _Term(pl.lit(name == "true"), start, is_condition=True)
            case "name" if name in FUNCTIONS:
                return self._call(name, start)
            case "name" if name.upper() not in LEVELS:
                fix = nearest(name, COLUMN_BY_NAME, (*COLUMN_OF_WORD, *FUNCTIONS))
                fix = "write IS NULL or IS NOT NULL" if name == "null" else fix
                raise self._mistake(start, f"unknown name '{printable(token.text)}'", fix)
        raise self._mistake(start, "here a field or a value is missing")

    def _number(self, token: _Token) -> _Term:
        text = token.text.lower()
        base = 10 if text.isdecimal() else {"0x": 16, "0b": 2}.get(text[:2])
        value = int(text, base) if base else float(text)
        if value >= (2**63 if base else inf):
            raise self._mistake(token.start, "this number is too large")
        return _Term(pl.lit(value, pl.Int64 if base else pl.Float64), token.start)

    def _call(self, name: str, start: int) -> _Term:
        items = self._arguments()
        try:
            if name == "previous" and items[0].column is None:
                raise KeyError(name)
            return _Term(FUNCTIONS[name](*(one.expr for one in items)), start)
        except (TypeError, KeyError):
            example = next(text for text, _ in EXAMPLES if f"{name}(" in text)
            fix = f"write {example}"
            raise self._mistake(start, f"{name} takes other values", fix) from None


def nearest(word: str, choices: Iterable[str], further: Iterable[str] = ()) -> str:
    """`did you mean x?`, or the choices if neither these nor further names are similar."""
    names, typed = list(choices), word.strip().lower()
    near = [field for role, field in NAME_OF_ROLE.items() if typed == role and field in names]
    near += [name for name in names if len(typed) > 1 and name.startswith(typed)]
    if near := near or get_close_matches(typed, [*names, *further], n=1):
        return TranslatableText("did you mean {near}?", near=near[0])
    return TranslatableText("there are {names}", names=listed(names))
