"""Compiler from filter terms to polars SQL: types, values, conditions.

Each function makes a term of smaller ones; any may raise MistakeError.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Final

import polars as pl

from fte_sniff.analysis.filter.terms import (
    COLUMN_OF_WORD,
    FUNCTIONS,
    UNTYPED,
    MistakeError,
    Term,
    TermType,
    how_to_compare,
    mismatch,
    nearest,
    quoted,
    unknown,
    wrong_type,
)
from fte_sniff.analysis.time_text import DAY_NS, SECOND_NS, clock_time, time_ns
from fte_sniff.errors import TranslatableText, listed
from fte_sniff.protocol import Column, ColumnType

MAX_DEPTH: Final = 18
"""Most brackets inside brackets in the SQL; polars' parser fails at 23."""

MAX_SQL: Final = 30_000
"""Most characters of SQL; a long list compared with a long expression grows fast."""

_GROUP: Final = 8
"""Conditions in one bracket of a chain: polars needs quadratic time for more."""

_INT64: Final = range(-(2**63) + 1, 2**63)
"""Whole numbers that polars reads as such; it reads -2**63 as a decimal fraction."""

_YEAR_2000_NS: Final = 946_684_800 * SECOND_NS
_HOW_TO_WRITE_TIMES: Final = TranslatableText(
    "write UTC as '2026-01-31T12:00:00.5Z' or '2026-01-31 12:00', or "
    "'12:00:05' for that time of any day"
)
_MIRRORED: Final = {"<": ">", ">": "<", "<=": ">=", ">=": "<="}
_HEX_DIGITS: Final = frozenset("0123456789ABCDEF")
_WHOLE_BYTES: Final = re.compile(r"%*(?:[0-9A-F_]{2}%*)*")
_FAULT_SEPARATORS: Final = re.compile(r"[\s,]+")

_TERM_TYPE: Final = {
    ColumnType.TIME: TermType.TIME,
    ColumnType.TEXT: TermType.TEXT,
    ColumnType.WORD: TermType.WORD,
    ColumnType.WORDS: TermType.WORDS,
    ColumnType.INT: TermType.NUMBER,
    ColumnType.HEX: TermType.HEX,
}


def combine(
    sql: str,
    terms: Sequence[Term],
    names: Iterable[str] = (),
    of_type: TermType = TermType.TRUTH,
) -> Term:
    """A term whose SQL, in brackets or a call, contains that of other terms, at least one.

    `names` are columns that it reads besides theirs.
    """
    depth = 1 + max(term.depth for term in terms)
    first = min(terms, key=lambda term: term.start)
    if depth > MAX_DEPTH or len(sql) > MAX_SQL:
        what = TranslatableText("the filter is too deep or too large")
        raise MistakeError(first.start, what, TranslatableText("take it apart"))
    label = TranslatableText("this value")
    if of_type is TermType.TRUTH:
        label = TranslatableText("this condition")
    read = frozenset(names).union(*(term.names for term in terms))
    return Term(of_type, sql, first.start, label, depth, names=read)


# Values


def column(column: Column, start: int) -> Term:
    """A field of the row."""
    sql = f'"{column.name}"'
    if column.type is ColumnType.TIME:
        sql = f"CAST({sql} AS BIGINT)"
    names = frozenset([column.name])
    return Term(_TERM_TYPE[column.type], sql, start, column.name, column=column, names=names)


def number(value: int | float, start: int, label: str) -> Term:
    """A number as typed; whole numbers have 64 bits."""
    sql = repr(value)
    if isinstance(value, float) and "e" not in sql:
        sql = f"{sql}e0"
    term = Term(TermType.NUMBER, sql, start, label)
    fits = value in _INT64 if isinstance(value, int) else math.isfinite(value)
    if not fits:
        what = TranslatableText("{shown} is too large", shown=label)
        fix = TranslatableText("no field has more than 64 bits")
        raise MistakeError(term.start, what, fix)
    return term


def arithmetic(terms: Sequence[Term], signs: Sequence[str]) -> Term:
    """Numbers joined by + - * / % & |, all of one precedence, from the left.

    A quotient keeps its fraction; a division by 0 is null.
    """
    for term in terms:
        why = TranslatableText("'{sign}' joins numbers", sign=signs[0])
        _expect(term, TermType.NUMBER, why)
    operands = [
        _null_if_zero(term) if sign in ("/", "%") else term
        for sign, term in zip(["", *signs], terms, strict=True)
    ]
    tail = "".join(f" {sign} {term.sql}" for sign, term in zip(signs, operands[1:], strict=True))
    return combine(f"({terms[0].sql}{tail})", operands, of_type=TermType.NUMBER)


def minus(term: Term, start: int) -> Term:
    """The negative of a number."""
    _expect(term, TermType.NUMBER, TranslatableText("'-' needs a number"))
    made = combine(f"(- {term.sql})", (term,), of_type=TermType.NUMBER)
    return replace(made, start=start, label=f"-{term.label}")


def call(name: str, arguments: Sequence[Term], start: int) -> Term:
    """A call of one of `FUNCTIONS`."""
    function = FUNCTIONS[name]
    if len(arguments) != len(function.takes):
        what = TranslatableText("{name} takes another number of values", name=name)
        fix = TranslatableText("write {example}", example=function.example)
        raise MistakeError(start, what, fix)
    sqls = [
        _argument(name, wanted, term)
        for wanted, term in zip(function.takes, arguments, strict=True)
    ]
    made = combine(f"{name}({', '.join(sqls)})", arguments, of_type=function.gives)
    return replace(made, start=start, label=f"{name}(...)")


def _argument(name: str, wanted: TermType, term: Term) -> str:
    if wanted is TermType.TEXT:
        return _as_text(term, name)
    type_name = TranslatableText(wanted.value)
    why = TranslatableText("{name} needs {type}", name=name, type=type_name)
    _expect(term, wanted, why)
    return term.sql


def _expect(term: Term, wanted: TermType, why: str) -> None:
    if term.type is TermType.NAME:
        raise unknown(term)
    if term.type is not wanted:
        raise wrong_type(term, why)


# Conditions


def condition(term: Term) -> Term:
    """The term as a condition; a word such as `noise` or `malformed` becomes one."""
    if term.type is TermType.TRUTH:
        return term
    if term.type is not TermType.NAME:
        what = TranslatableText(
            "{term} is {type}, no condition",
            term=term.label,
            type=TranslatableText(term.type.value),
        )
        raise MistakeError(term.start, what, how_to_compare(term))
    word = term.label.lower()
    column = COLUMN_OF_WORD.get(word)
    if column is None:
        raise unknown(term)
    if column.type is ColumnType.WORDS:
        sql = f"array_contains(\"{column.name}\", '{word}')"
    else:
        sql = f"(\"{column.name}\" IS NOT DISTINCT FROM '{word}')"
    return combine(sql, (term,), [column.name])


def negate(term: Term) -> Term:
    """NOT."""
    truth = condition(term)
    return combine(f"(NOT {truth.sql})", (truth,))


def chain(terms: Sequence[Term], operator: str) -> Term:
    """Conditions joined by AND or OR; many of them in nested groups."""
    level = [condition(term) for term in terms]
    while len(level) > 1:
        groups = [level[at : at + _GROUP] for at in range(0, len(level), _GROUP)]
        level = [
            combine(f"({f' {operator} '.join(term.sql for term in group)})", group)
            if len(group) > 1
            else group[0]
            for group in groups
        ]
    return level[0]


def compare(left: Term, sign: str, right: Term) -> Term:
    """`left sign right`, with one of = != < > <= >=."""
    if left.type in UNTYPED or (left.column is None and right.column is not None):
        left, right, sign = right, left, _MIRRORED.get(sign, sign)
    if TermType.NULL in (left.type, right.type):
        null = left if left.type is TermType.NULL else right
        what = TranslatableText("nothing equals NULL")
        raise MistakeError(null.start, what, TranslatableText("write IS NULL or IS NOT NULL"))
    if left.type is TermType.WORDS:
        return _has_fault(left, sign, right)
    if left.type is TermType.TRUTH:
        right = condition(right)
    if left.type in (TermType.WORD, TermType.TRUTH) and sign not in ("=", "!="):
        what = TranslatableText("{left} has no order", left=left.label)
        fix = TranslatableText("use =, !=, IN or LIKE instead")
        raise MistakeError(left.start, what, fix)
    field, value = _operands(left, right)
    return combine(f"({field} {sign} {value})", (left, right))


def distinct(left: Term, right: Term, operator: str) -> Term:
    """`left IS [NOT] DISTINCT FROM right`: != and =, but never null."""
    if left.type in (*UNTYPED, TermType.NULL):
        left, right = right, left
    if left.type is TermType.TRUTH:
        right = condition(right)
    if left.type is TermType.WORDS:
        return _has_fault(left, "=" if "NOT" in operator else "!=", right)
    field, value = left.sql, "NULL"
    if right.type is not TermType.NULL:
        field, value = _operands(left, right)
    return combine(f"({field} {operator} {value})", (left, right))


def any_of(left: Term, items: Sequence[Term]) -> Term:
    """`left IN (items)`; for faults, whether the row has any of them."""
    equal = [compare(left, "=", item) for item in items]
    plain = left.column is not None and left.type not in (TermType.WORDS, TermType.TIME)
    if not plain or any(item.names for item in items):
        return chain(equal, "OR")
    values = ", ".join(_value(left, item) for item in items)
    return combine(f"({left.sql} IN ({values}))", (left, *items))


def between(left: Term, low: Term, high: Term) -> Term:
    """`left BETWEEN low AND high`, both ends included."""
    first, last = _time_of_day(left, low), _time_of_day(left, high)
    if first is not None and last is not None and first > last:
        values = {"low": low.label, "high": high.label}
        what = TranslatableText("'{low}' is later in the day than '{high}'", **values)
        fix = TranslatableText(
            "over midnight write {left} >= '{low}' OR {left} <= '{high}'",
            left=left.label,
            **values,
        )
        raise MistakeError(low.start, what, fix)
    ends = [compare(left, ">=", low), compare(left, "<=", high)]
    return chain(ends, "AND")


def is_null(left: Term) -> Term:
    """`left IS NULL`; for faults, whether the row has none."""
    if left.type in UNTYPED:
        left = condition(left)
    if left.type is TermType.WORDS:
        return combine(f"(array_length({left.sql}) = 0)", (left,))
    return combine(f"({left.sql} IS NULL)", (left,))


def is_truth(left: Term, word: str) -> Term:
    """`left IS TRUE` or `left IS FALSE`, never null."""
    truth = condition(left)
    other = "FALSE" if word == "TRUE" else "TRUE"
    found = combine(f"coalesce({truth.sql}, {other})", (truth,))
    return found if word == "TRUE" else negate(found)


def _has_fault(faults: Term, sign: str, right: Term) -> Term:
    if sign not in ("=", "!="):
        what = TranslatableText("{faults} has no order", faults=faults.label)
        fix = TranslatableText("name one, as in faults = 'noise'")
        raise MistakeError(faults.start, what, fix)
    if right.type is TermType.LITERAL and not right.label:
        found = is_null(faults)
    else:
        word = _word(faults, right)
        found = combine(f"array_contains({faults.sql}, {word})", (faults,))
    return negate(found) if sign == "!=" else found


# Patterns


def like(left: Term, operator: str, pattern: Term) -> Term:
    """`left LIKE pattern` (or ILIKE): % is any text, _ any one character.

    In bytes % is any number of whole bytes and _ any one hex digit.
    """
    text = _as_text(left, operator)
    _expect_pattern(pattern, operator)
    sql = pattern.sql
    if left.type is TermType.HEX:
        operator, found = _bytes_pattern(_whole_bytes(pattern))
        sql = quoted(found)
    return combine(f"({text} {operator} {sql})", (left, pattern))


def regexp(left: Term, pattern: Term) -> Term:
    """`left ~ pattern` (or REGEXP, RLIKE): a regular expression that matches anywhere."""
    text = _as_text(left, "~")
    _expect_pattern(pattern, "~")
    found = f"(?i){pattern.label}" if left.type is TermType.HEX else pattern.label
    try:
        pl.Series([""]).str.contains(found)
    except pl.exceptions.PolarsError as error:
        why = str(error).split("error: ")[-1].splitlines()[0]
        what = TranslatableText("no regular expression ({why})", why=why)
        fix = TranslatableText("use LIKE, or escape signs with \\")
        raise MistakeError(pattern.start, what, fix) from None
    return combine(f"({text} ~ {quoted(found)})", (left, pattern))


def _expect_pattern(pattern: Term, operator: str) -> None:
    if pattern.type is not TermType.LITERAL:
        what = TranslatableText("{sign} needs a pattern in quotes", sign=operator)
        fix = TranslatableText("as in port {sign} '%USB%'", sign=operator)
        raise MistakeError(pattern.start, what, fix)


# Operands: the type of one side decides how the other is read


def _operands(left: Term, right: Term) -> tuple[str, str]:
    """The SQL of both sides; a time of day is compared with the time since midnight."""
    clock = _time_of_day(left, right)
    if clock is not None:
        return f"({left.sql} % {DAY_NS})", str(clock)
    return left.sql, _value(left, right)


def _value(left: Term, right: Term) -> str:
    _refuse_early_time(left, right)
    if left.type is TermType.WORD:
        return _word(left, right)
    if right.type is TermType.NAME:
        raise _not_a_value(left, right)
    if right.type is TermType.LITERAL:
        if left.type is TermType.TIME:
            return _time(right)
        if left.type is TermType.HEX:
            return quoted(_hex_digits(right))
        if left.type is TermType.TEXT:
            return right.sql
    elif left.type is right.type or {left.type, right.type} == {TermType.TIME, TermType.NUMBER}:
        return right.sql
    raise mismatch(left, right)


def _refuse_early_time(left: Term, right: Term) -> None:
    """Refuse a small number compared with a time: it is hardly meant as ns since 1970."""
    for time, number in ((left, right), (right, left)):
        if time.type is not TermType.TIME or number.type is not TermType.NUMBER:
            continue
        value = None if number.names else pl.select(pl.sql_expr(number.sql)).item()
        if value is not None and value < _YEAR_2000_NS:
            what = TranslatableText(
                "{number} would be a time before the year 2000: "
                "a number counts nanoseconds since 1970",
                number=number.label,
            )
            raise MistakeError(number.start, what, _HOW_TO_WRITE_TIMES)


def _not_a_value(left: Term, name: Term) -> MistakeError:
    if left.type in (TermType.TEXT, TermType.HEX):
        what = TranslatableText("unknown name '{term}'", term=name.label)
        fix = TranslatableText("write a text in quotes: '{name}'", name=name.label)
        return MistakeError(name.start, what, fix)
    if name.label.lower() in COLUMN_OF_WORD:
        return mismatch(left, name)
    return unknown(name)


def _word(left: Term, right: Term) -> str:
    column = left.column
    if column is None or right.type not in UNTYPED:
        raise mismatch(left, right)
    word = right.label.strip().lower()
    if word in column.words:
        return quoted(word)
    several = _FAULT_SEPARATORS.split(word)
    if column.type is ColumnType.WORDS and {*several} <= {*column.words}:
        example = f"faults = '{several[0]}' AND faults = '{several[1]}'"
        what = TranslatableText("several faults in one text")
        fix = TranslatableText("name each: {example}", example=example)
        raise MistakeError(right.start, what, fix)
    what = TranslatableText("{column} is never '{right}'", column=column.name, right=right.label)
    other = COLUMN_OF_WORD.get(word)
    words = TranslatableText("it is one of {words}", words=listed(column.words))
    hint: str = nearest(word, column.words) or words
    if other:
        hint = TranslatableText(
            "it is a word of {other}: {other} = '{word}'", other=other.name, word=word
        )
    raise MistakeError(right.start, what, hint)


def _time(literal: Term) -> str:
    found = time_ns(literal.label)
    if found is None or found not in _INT64:
        what = TranslatableText("'{literal}' is no time", literal=literal.label)
        raise MistakeError(literal.start, what, _HOW_TO_WRITE_TIMES)
    return f"({found})" if found < 0 else str(found)


def _as_text(term: Term, operator: str) -> str:
    if term.type is TermType.NAME:
        raise unknown(term)
    if term.type is TermType.WORDS:
        return f"array_to_string({term.sql}, ',')"
    if term.type is TermType.WORD:
        return f"CAST({term.sql} AS VARCHAR)"
    if term.type in (TermType.TEXT, TermType.HEX):
        return term.sql
    why = TranslatableText("{sign} needs a text", sign=operator)
    raise wrong_type(term, why)


def _hex_digits(literal: Term, wildcards: str = "") -> str:
    digits = "".join(literal.label.split()).upper()
    if not set(digits) <= _HEX_DIGITS.union(wildcards):
        what = TranslatableText("'{literal}' is not hex", literal=literal.label)
        fix = TranslatableText("write the bytes as in raw LIKE 'AA01%'")
        raise MistakeError(literal.start, what, fix)
    return digits


def _whole_bytes(literal: Term) -> str:
    """A text as a pattern with two digits a byte."""
    pattern = _hex_digits(literal, "%_")
    if not _WHOLE_BYTES.fullmatch(pattern):
        what = TranslatableText("'{literal}' has half a byte", literal=literal.label)
        fix = TranslatableText(
            "write two digits a byte, _ for any digit, % for any bytes: '%A_ 01%'"
        )
        raise MistakeError(literal.start, what, fix)
    return pattern


def _time_of_day(left: Term, right: Term) -> int | None:
    """Nanoseconds since midnight, if a time is compared with a time of day."""
    if left.type is not TermType.TIME or right.type is not TermType.LITERAL:
        return None
    clock = clock_time(right.label)
    return None if clock is None else clock.since_midnight_ns


def _bytes_pattern(pattern: str) -> tuple[str, str]:
    """The SQL operator and pattern that match whole bytes only.

    LIKE does, unless text stands between two %: then it could match from the middle of a byte.
    """
    parts = re.split("%+", pattern)
    if not any(parts[1:-1]):
        return "LIKE", pattern
    return "~", f"^{'(?:..)*'.join(parts).replace('_', '.')}$"


def _null_if_zero(term: Term) -> Term:
    """A divisor that is null for 0: polars' infinity and NaN are greater than any number."""
    return replace(term, sql=f"NULLIF({term.sql}, 0)", depth=term.depth + 1)
