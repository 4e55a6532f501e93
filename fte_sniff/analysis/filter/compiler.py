"""Compiler from filter terms to polars expressions: types, values, conditions.

Each function makes a term of smaller ones; any may raise MistakeError.
"""

from __future__ import annotations

import math
import operator
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Final

import polars as pl

from fte_sniff.analysis.filter.terms import (
    COLUMN_OF_WORD,
    FUNCTIONS,
    UNTYPED,
    Function,
    MistakeError,
    Term,
    TermType,
    how_to_compare,
    mismatch,
    nearest,
    unknown,
    wrong_type,
)
from fte_sniff.analysis.time_text import DAY_NS, SECOND_NS, clock_time, time_ns
from fte_sniff.errors import TranslatableText, listed
from fte_sniff.protocol import Column, ColumnType
from fte_sniff.protocol.columns import PREVIOUS

_INT64: Final = range(-(2**63), 2**63)

_YEAR_2000_NS: Final = 946_684_800 * SECOND_NS
_HOW_TO_WRITE_TIMES: Final = TranslatableText(
    "write UTC as '2026-01-31T12:00:00.5Z' or '2026-01-31 12:00', or "
    "'12:00:05' for that time of any day"
)
_MIRRORED: Final = {"<": ">", ">": "<", "<=": ">=", ">=": "<="}
_HEX_DIGITS: Final = frozenset("0123456789ABCDEF")
_WHOLE_BYTES: Final = re.compile(r"%*(?:[0-9A-F_]{2}%*)*")
_FAULT_SEPARATORS: Final = re.compile(r"[\s,]+")

_OPERATORS: Final[Mapping[str, Callable[[pl.Expr, pl.Expr], pl.Expr]]] = {
    "=": operator.eq,
    "!=": operator.ne,
    "<": operator.lt,
    "<=": operator.le,
    ">": operator.gt,
    ">=": operator.ge,
    "+": operator.add,
    "-": operator.sub,
    "*": operator.mul,
    "/": operator.truediv,
    "%": operator.mod,
    "&": operator.and_,
    "|": operator.or_,
    "AND": operator.and_,
    "OR": operator.or_,
    "IS NOT DISTINCT FROM": pl.Expr.eq_missing,
    "IS DISTINCT FROM": pl.Expr.ne_missing,
}

_TERM_TYPE: Final = {
    ColumnType.TIME: TermType.TIME,
    ColumnType.TEXT: TermType.TEXT,
    ColumnType.WORD: TermType.WORD,
    ColumnType.WORDS: TermType.WORDS,
    ColumnType.INT: TermType.NUMBER,
    ColumnType.REAL: TermType.NUMBER,
    ColumnType.BOOL: TermType.TRUTH,
    ColumnType.HEX: TermType.HEX,
}


def combine(
    expr: pl.Expr,
    terms: Sequence[Term],
    names: Iterable[str] = (),
    of_type: TermType = TermType.TRUTH,
) -> Term:
    """A term whose expression contains those of other terms, at least one.

    `names` are columns that it reads besides theirs.
    """
    label = TranslatableText("this value")
    if of_type is TermType.TRUTH:
        label = TranslatableText("this condition")
    read = frozenset(names).union(*(term.names for term in terms))
    return Term(of_type, min(term.start for term in terms), label, expr, names=read)


# Values


def column(column: Column, start: int) -> Term:
    """A field of the row."""
    expr = pl.col(column.name)
    if column.type is ColumnType.TIME:
        expr = expr.cast(pl.Int64)
    names = frozenset([column.name])
    return Term(_TERM_TYPE[column.type], start, column.name, expr, column=column, names=names)


def number(value: int | float, start: int, label: str) -> Term:
    """A number as typed; whole numbers have 64 bits."""
    fits = value in _INT64 if isinstance(value, int) else math.isfinite(value)
    if not fits:
        what = TranslatableText("{shown} is too large", shown=label)
        fix = TranslatableText("no field has more than 64 bits")
        raise MistakeError(start, what, fix)
    dtype = pl.Int64 if isinstance(value, int) else pl.Float64
    return Term(TermType.NUMBER, start, label, pl.lit(value, dtype), constant=value)


def truth(value: bool, start: int, label: str) -> Term:
    """TRUE or FALSE."""
    return Term(TermType.TRUTH, start, label, pl.lit(value))


def arithmetic(terms: Sequence[Term], operators: Sequence[str]) -> Term:
    """Numbers joined by + - * / % & |, all of one precedence, from the left.

    A quotient keeps its fraction; a division by 0 is null.
    """
    for term in terms:
        why = TranslatableText("'{sign}' joins numbers", sign=operators[0])
        _expect(term, TermType.NUMBER, why)
    expr = terms[0].expr
    for symbol, term in zip(operators, terms[1:], strict=True):
        right = _null_if_zero(term.expr) if symbol in ("/", "%") else term.expr
        expr = _OPERATORS[symbol](expr, right)
    return combine(expr, terms, of_type=TermType.NUMBER)


def minus(term: Term, start: int) -> Term:
    """The negative of a number."""
    _expect(term, TermType.NUMBER, TranslatableText("'-' needs a number"))
    made = combine(-term.expr, (term,), of_type=TermType.NUMBER)
    return replace(made, start=start, label=f"-{term.label}")


def call(name: str, arguments: Sequence[Term], start: int) -> Term:
    """A call of one of `FUNCTIONS`."""
    function = FUNCTIONS[name]
    if len(arguments) != len(function.takes):
        what = TranslatableText("{name} takes another number of values", name=name)
        fix = TranslatableText("write {example}", example=function.example)
        raise MistakeError(start, what, fix)
    values = [
        _argument(name, wanted, term)
        for wanted, term in zip(function.takes, arguments, strict=True)
    ]
    if function.of_field:
        _expect_field(name, function, arguments[0])
    expr: pl.Expr = function.expression(*values)
    made = combine(expr, arguments, of_type=function.gives)
    names = frozenset(expr.meta.root_names())
    return replace(made, start=start, label=f"{name}(...)", names=names)


def _expect_field(name: str, function: Function, term: Term) -> None:
    if term.column is None or term.column.name not in PREVIOUS:
        what = TranslatableText("{name} takes one field of a frame", name=name)
        fix = TranslatableText(
            "write one of {names}, as in {example}",
            names=listed(PREVIOUS),
            example=function.example,
        )
        raise MistakeError(term.start, what, fix)


def _argument(name: str, wanted: TermType, term: Term) -> pl.Expr:
    if wanted is TermType.TEXT:
        return _as_text(term, name)
    type_name = TranslatableText(wanted.value)
    why = TranslatableText("{name} needs {type}", name=name, type=type_name)
    _expect(term, wanted, why)
    return term.expr


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
    field = pl.col(column.name)
    is_list = column.type is ColumnType.WORDS
    expr = field.list.contains(word) if is_list else field.eq_missing(pl.lit(word))
    return combine(expr, (term,), [column.name])


def negate(term: Term) -> Term:
    """NOT."""
    truth = condition(term)
    return combine(~truth.expr, (truth,))


def chain(terms: Sequence[Term], operator: str) -> Term:
    """Conditions joined by AND or OR, in pairs of pairs: polars evaluates by recursion."""
    conditions = [condition(term) for term in terms]
    level = [term.expr for term in conditions]
    while len(level) > 1:
        joined = map(_OPERATORS[operator], level[::2], level[1::2])
        level = [*joined, *(level[-1:] if len(level) % 2 else ())]
    return combine(level[0], conditions)


def compare(left: Term, operator: str, right: Term) -> Term:
    """`left operator right`, with one of = != < > <= >=."""
    if left.type in UNTYPED or (left.column is None and right.column is not None):
        left, right, operator = right, left, _MIRRORED.get(operator, operator)
    if TermType.NULL in (left.type, right.type):
        null = left if left.type is TermType.NULL else right
        what = TranslatableText("nothing equals NULL")
        raise MistakeError(null.start, what, TranslatableText("write IS NULL or IS NOT NULL"))
    if left.type is TermType.WORDS:
        return _has_fault(left, operator, right)
    if left.type is TermType.TRUTH:
        right = condition(right)
    if left.type in (TermType.WORD, TermType.TRUTH) and operator not in ("=", "!="):
        what = TranslatableText("{left} has no order", left=left.label)
        fix = TranslatableText("use =, !=, IN or LIKE instead")
        raise MistakeError(left.start, what, fix)
    return combine(_OPERATORS[operator](*_operands(left, right)), (left, right))


def distinct(left: Term, right: Term, operator: str) -> Term:
    """`left IS [NOT] DISTINCT FROM right`: != and =, but never null."""
    if left.type in (*UNTYPED, TermType.NULL):
        left, right = right, left
    if left.type is TermType.TRUTH:
        right = condition(right)
    if left.type is TermType.WORDS:
        return _has_fault(left, "=" if "NOT" in operator else "!=", right)
    if right.type is TermType.NULL:
        found = is_null(left)
        return found if "NOT" in operator else negate(found)
    return combine(_OPERATORS[operator](*_operands(left, right)), (left, right))


def any_of(left: Term, items: Sequence[Term]) -> Term:
    """`left IN (items)`; for faults, whether the row has any of them."""
    equal = [compare(left, "=", item) for item in items]
    if left.type is not TermType.NUMBER or left.column is None:
        return chain(equal, "OR")
    # A long list of numbers is looked up in a set.
    numbers = [item.constant for item in items if isinstance(item.constant, int)]
    if len(numbers) < len(items):
        return chain(equal, "OR")
    return combine(left.expr.is_in(numbers), (left, *items))


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
        return combine(left.expr.list.len() == 0, (left,))
    return combine(left.expr.is_null(), (left,))


def is_truth(left: Term, word: str) -> Term:
    """`left IS TRUE` or `left IS FALSE`, never null."""
    truth = condition(left)
    found = combine(truth.expr.fill_null(word != "TRUE"), (truth,))
    return found if word == "TRUE" else negate(found)


def _has_fault(faults: Term, operator: str, right: Term) -> Term:
    if operator not in ("=", "!="):
        what = TranslatableText("{faults} has no order", faults=faults.label)
        fix = TranslatableText("name one, as in faults = 'noise'")
        raise MistakeError(faults.start, what, fix)
    if right.type is TermType.LITERAL and not right.label:
        found = is_null(faults)
    else:
        found = combine(faults.expr.list.contains(_word(faults, right)), (faults,))
    return negate(found) if operator == "!=" else found


# Patterns


def like(left: Term, operator: str, pattern: Term) -> Term:
    """`left LIKE pattern` (or ILIKE): % is any text, _ any one character.

    In bytes % is any number of whole bytes and _ any one hex digit.
    """
    text = _as_text(left, operator)
    _expect_pattern(pattern, operator)
    found = pattern.label
    is_hex = left.type is TermType.HEX
    if is_hex:
        found = _whole_bytes(pattern)
    ignores_case = operator == "ILIKE" and not is_hex
    return combine(_like(text, found, "(?:..)*" if is_hex else ".*", ignores_case), (left, pattern))


def _like(text: pl.Expr, pattern: str, anything: str, ignores_case: bool) -> pl.Expr:
    """Whether a text is like a pattern, where % is the regular expression `anything`.

    A prefix, a suffix and an equal text are found four times as fast without a regular expression.
    """
    literals = re.split("%+", pattern)
    if "_" not in pattern and not ignores_case and not any(literals[1:-1]):
        first, last = literals[0], literals[-1]
        if len(literals) == 1:
            return text == first
        if not first or not last:
            return text.str.ends_with(last) if last else text.str.starts_with(first)
    inner = anything.join(re.escape(literal).replace("_", ".") for literal in literals)
    return text.str.contains(f"^(?{'i' if ignores_case else ''}s:{inner})$")


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
    return combine(text.str.contains(found), (left, pattern))


def _expect_pattern(pattern: Term, operator: str) -> None:
    if pattern.type is not TermType.LITERAL:
        what = TranslatableText("{sign} needs a pattern in quotes", sign=operator)
        fix = TranslatableText("as in port {sign} '%USB%'", sign=operator)
        raise MistakeError(pattern.start, what, fix)


# Operands: the type of one side decides how the other is read


def _operands(left: Term, right: Term) -> tuple[pl.Expr, pl.Expr]:
    """The expressions of both sides; a time of day is compared with the time since midnight."""
    clock = _time_of_day(left, right)
    if clock is not None:
        return left.expr % DAY_NS, pl.lit(clock, pl.Int64)
    return left.expr, _value(left, right)


def _value(left: Term, right: Term) -> pl.Expr:
    _refuse_early_time(left, right)
    if left.type is TermType.WORD:
        return pl.lit(_word(left, right))
    if right.type is TermType.NAME:
        raise _not_a_value(left, right)
    if right.type is TermType.LITERAL:
        if left.type is TermType.TIME:
            return pl.lit(_time(right), pl.Int64)
        if left.type is TermType.HEX:
            return pl.lit(_hex_digits(right))
        if left.type is TermType.TEXT:
            return right.expr
    elif left.type is right.type or {left.type, right.type} == {TermType.TIME, TermType.NUMBER}:
        return right.expr
    raise mismatch(left, right)


def _refuse_early_time(left: Term, right: Term) -> None:
    """Refuse a small number compared with a time: it is hardly meant as ns since 1970."""
    for time, number in ((left, right), (right, left)):
        if time.type is not TermType.TIME or number.type is not TermType.NUMBER:
            continue
        value = None if number.names else pl.select(number.expr).item()
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
        return word
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


def _time(literal: Term) -> int:
    found = time_ns(literal.label)
    if found is None or found not in _INT64:
        what = TranslatableText("'{literal}' is not a time", literal=literal.label)
        raise MistakeError(literal.start, what, _HOW_TO_WRITE_TIMES)
    return found


def _as_text(term: Term, operator: str) -> pl.Expr:
    if term.type is TermType.NAME:
        raise unknown(term)
    if term.type is TermType.WORDS:
        return term.expr.list.join(",")
    if term.type is TermType.WORD:
        return term.expr.cast(pl.String)
    if term.type in (TermType.TEXT, TermType.HEX):
        return term.expr
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


def _null_if_zero(divisor: pl.Expr) -> pl.Expr:
    """A divisor that is null for 0: polars' infinity and NaN are greater than any number."""
    return pl.when(divisor != 0).then(divisor)
