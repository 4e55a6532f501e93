"""Lexer and recursive-descent parser of filters.

or          and { (OR | ||) and }
and         not { (AND | &&) not }
not         [NOT | !] predicate
predicate   value [ sign value | [NOT] IN list | [NOT] BETWEEN value AND value
                  | [NOT] (LIKE | ILIKE | ~ | REGEXP | RLIKE) 'pattern'
                  | IS [NOT] (NULL | TRUE | FALSE | DISTINCT FROM value) ]
value       numbers joined by + - * / % and the bit operators & and |
primary     number | 'text' | field | word | function(...) | ( or )
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import tzinfo
from enum import Enum, auto
from typing import Final

import polars as pl

from fte_sniff.analysis.filter import compiler
from fte_sniff.analysis.filter.terms import (
    COLUMN_OF_WORD,
    FUNCTIONS,
    MistakeError,
    Term,
    TermType,
    mistakes_in,
)
from fte_sniff.analysis.time_text import with_offset
from fte_sniff.errors import FilterError, TranslatableText, listed, printable
from fte_sniff.protocol import COLUMN_BY_NAME

MAX_LENGTH: Final = 8_000

MAX_TOKENS: Final = 600
"""Most tokens in a filter. Polars evaluates conditions by recursion: this bounds its stack."""

_MAX_NESTING: Final = 25
_MAX_DIGITS: Final = 64

_SQL_SIGNS: Final = ("=", "!=", "<", ">", "<=", ">=")
COMPARISONS: Final = dict(zip(["==", "<>", *_SQL_SIGNS], ["=", "!=", *_SQL_SIGNS], strict=True))
"""The comparison operators, each with its form in SQL."""

PATTERN_WORDS: Final = ("LIKE", "ILIKE", "REGEXP", "RLIKE")

OPERATOR_WORDS: Final = frozenset(
    ["AND", "OR", "NOT", "IN", "IS", "BETWEEN", "DISTINCT", *PATTERN_WORDS]
)
"""The operators that are words; no name can be one of them."""

_ARITHMETIC: Final = (("|",), ("&",), ("+", "-"), ("*", "/", "%"))
"""The arithmetic operators by precedence, lowest first."""

_ONE_ROW: Final = TranslatableText(
    "a filter looks at one row at a time; statistics are for the stats command"
)
_CONDITION_ALONE: Final = TranslatableText(
    "a filter is the condition alone, as in motor = 1 AND rpm > 500"
)
_NO_VALUE: Final = TranslatableText("here a field or a value is missing")
_NO_BRACKET: Final = TranslatableText("a '(' is missing")

_UNSUPPORTED: Final = {
    **dict.fromkeys(["SELECT", "EXISTS", "OVER", "FROM", "UNION", "GROUP", "HAVING"], _ONE_ROW),
    **dict.fromkeys(["WHERE", "ORDER", "LIMIT", "AS"], _CONDITION_ALONE),
    **dict.fromkeys(
        ["CASE", "WHEN", "IF"], TranslatableText("join conditions with AND, OR and NOT")
    ),
    **dict.fromkeys(
        ["CAST", "DATE", "TIMESTAMP", "INTERVAL"],
        TranslatableText("times are texts: time > '2026-01-31' or time > '12:00:05'"),
    ),
    "XOR": TranslatableText("write (one condition) != (the other)"),
    "ESCAPE": TranslatableText("leave it out"),
    "ANY": TranslatableText("name one, as in faults = 'noise'"),
}
"""SQL keywords that filters do not support, each with the fix."""

_AGGREGATES: Final = frozenset(
    ["AVG", "COUNT", "FIRST", "LAST", "MAX", "MEAN", "MEDIAN", "MIN", "RANK", "ROW_NUMBER", "SUM"]
)

_BAD_CHARACTERS: Final = {
    "'": TranslatableText(
        "this quote is never closed; a quote inside a text is written twice: 'it''s'"
    ),
    '"': TranslatableText("this quote is never closed"),
    "`": TranslatableText("this quote is never closed"),
    ";": TranslatableText("a filter is one expression; leave out the ';'"),
    "^": TranslatableText("there is no '^'; use & and | for bits, as in online & 0x01 = 1"),
    ".": TranslatableText("names have no dots; write the field alone"),
    ":": TranslatableText("there is no ':'; times are texts, as in time > '12:00:05'"),
    **dict.fromkeys(
        "\u2018\u2019\u201c\u201d\u201e\u00ab\u00bb\uff07\uff02",
        TranslatableText("write texts in plain single quotes, as in kind = 'speed'"),
    ),
    **dict.fromkeys(
        "\uff08\uff09\uff0c\uff1d\uff1e\uff1c\uff01",
        TranslatableText("this is a full-width character; type the ASCII one"),
    ),
}
"""Fixes for characters that start no token."""


class TokenType(Enum):
    """Kind of token."""

    NUMBER = auto()
    TEXT = auto()
    """In single quotes."""
    QUOTED = auto()
    """In double quotes or backticks: a field name, otherwise a text."""
    NAME = auto()
    """A field, a word of the contract, or a keyword."""
    SYMBOL = auto()
    END = auto()


@dataclass(frozen=True, slots=True)
class Token:
    """One token and its position in the filter."""

    type: TokenType
    text: str
    """As typed; for texts the content of the quotes."""
    start: int
    end: int

    @property
    def word(self) -> str:
        """A name in upper case; empty for any other token."""
        return self.text.upper() if self.type is TokenType.NAME else ""

    @property
    def operator(self) -> str:
        """A word as above, or a symbol; empty for any other token."""
        return self.text if self.type is TokenType.SYMBOL else self.word

    @property
    def number(self) -> int | float:
        """The value of a number token, decimal, hex or binary."""
        if self.text[:2].lower() in ("0x", "0b"):
            return int(self.text, 0)
        return int(self.text) if self.text.isdigit() else float(self.text)


_TOKEN: Final = re.compile(
    r"""
      (?P<NUMBER> 0[xX][0-9A-Fa-f]+ | 0[bB][01]+
                | (?: [0-9]+ (?: \.[0-9]* )? | \.[0-9]+ ) (?: [eE][+-]?[0-9]+ )? )
    | (?P<TEXT> '(?: [^'] | '' )*' )
    | (?P<QUOTED> "(?: [^"] | "" )*" | `[^`]*` )
    | (?P<NAME> [^\W\d]\w* )
    | (?P<SYMBOL> && | \|\| | == | != | <> | <= | >= | => | =< | !~ | [=<>+\-*/%&|(),!~] )
    """,
    re.VERBOSE,
)
_SPACE: Final = re.compile(r"\s*")
_REST_OF_NUMBER: Final = re.compile(r"[\w.]+")


def tokens(text: str) -> list[Token]:
    """The tokens of a filter; the last has type END.

    Raises FilterError if the text is too long, or contains a character that starts no token.
    """
    if len(text) > MAX_LENGTH:
        raise FilterError(
            "filter: {count} characters are too many; the limit is {most}; shorten it",
            count=len(text),
            most=MAX_LENGTH,
        )
    found: list[Token] = []
    at = _skip_space(text, 0)
    with mistakes_in(text):
        while at < len(text):
            found.append(_token_at(text, at))
            at = _skip_space(text, found[-1].end)
    if len(found) > MAX_TOKENS:
        raise FilterError(
            "filter: {count} words and signs are too many; the limit is {most}; split it, or "
            "use a range with BETWEEN",
            count=len(found),
            most=MAX_TOKENS,
        )
    return [*found, Token(TokenType.END, "", len(text), len(text))]


def _skip_space(text: str, at: int) -> int:
    space = _SPACE.match(text, at)
    return space.end() if space else at


def _token_at(text: str, at: int) -> Token:
    match = _TOKEN.match(text, at)
    if match is None:
        what = TranslatableText("'{char}' has no meaning in a filter", char=printable(text[at]))
        raise MistakeError(at, what, _BAD_CHARACTERS.get(text[at], ""))
    token_type, content = TokenType[str(match.lastgroup)], match.group()
    if token_type is TokenType.NUMBER:
        _check_number(text, match)
    elif token_type in (TokenType.TEXT, TokenType.QUOTED):
        _check_unicode(text, match)
        content = content[1:-1].replace(content[0] * 2, content[0])
    return Token(token_type, content, at, match.end())


def _check_number(text: str, match: re.Match[str]) -> None:
    number, start = match.group(), match.start()
    if len(number) > _MAX_DIGITS:
        what = TranslatableText("this number is too long")
        raise MistakeError(start, what, TranslatableText("no field is as large"))
    rest = _REST_OF_NUMBER.match(text, match.end())
    if rest:
        what = TranslatableText(
            "'{number}{rest}' is not a number", number=number, rest=rest.group()
        )
        fix = TranslatableText("write plain digits or hex as 0x0F, without a unit")
        raise MistakeError(start, what, fix)


def _check_unicode(text: str, match: re.Match[str]) -> None:
    try:
        match.group().encode()
    except UnicodeEncodeError as error:
        what = TranslatableText("this text is not valid Unicode")
        fix = TranslatableText("type it again")
        raise MistakeError(match.start() + error.start, what, fix) from None


def in_zone(text: str, zone: tzinfo) -> str:
    """A filter whose times have the offset of a zone where they had none.

    Raises FilterError for a time of any day, if the offset depends on the season.
    """
    parts, at = list[str](), 0
    with mistakes_in(text):
        for token in tokens(text):
            if token.type in (TokenType.TEXT, TokenType.QUOTED):
                parts += [text[at : token.start + 1], _in_zone(token, zone)]
                at = token.end - 1
    return "".join([*parts, text[at:]])


def _in_zone(token: Token, zone: tzinfo) -> str:
    try:
        return with_offset(token.text, zone)
    except ValueError:
        what = TranslatableText("the offset of '{time}' depends on the season", time=token.text)
        fix = TranslatableText("write it, as in '12:00:05+01:00'")
        raise MistakeError(token.start, what, fix) from None


def parse(text: str, start: int = 0, end: int | None = None) -> Term:
    """The filter from `start` to `end` of a text as one condition.

    Raises FilterError with the position in the text, and the fix.
    """
    end = len(text) if end is None else end
    inside = [token for token in tokens(text) if start <= token.start < end]
    with mistakes_in(text):
        return _FilterParser(text, [*inside, Token(TokenType.END, "", end, end)]).parse()


class TokenReader:
    """Reads the tokens of a text one after the other."""

    def __init__(self, text: str, found: Sequence[Token]) -> None:
        self._text = text
        self._tokens = found
        self._index = 0

    def _peek(self) -> Token:
        return self._tokens[self._index]

    def _advance(self) -> Token:
        self._index += 1
        return self._tokens[self._index - 1]

    def _at(self, *choices: str) -> str | None:
        found = self._peek().operator
        return found if found in choices else None

    def _accept(self, *choices: str) -> str | None:
        found = self._at(*choices)
        self._index += found is not None
        return found


class _FilterParser(TokenReader):
    _nesting = 0

    def parse(self) -> Term:
        if self._peek().type is TokenType.END:
            raise FilterError("filter: it is empty; {fix}", fix=_CONDITION_ALONE)
        term = self._or()
        if self._peek().type is not TokenType.END:
            raise self._unexpected(TranslatableText("join conditions with AND or OR"))
        return compiler.condition(term)

    def _expect(self, choice: str, fix: str) -> None:
        if self._accept(choice) is None:
            raise self._unexpected(fix)

    def _unexpected(self, fix: str) -> MistakeError:
        token = self._peek()
        if token.type is TokenType.END:
            what = TranslatableText("the filter ends too soon")
            return MistakeError(token.start, what, fix)
        what = TranslatableText("{token} is out of place", token=self._typed(token))
        return MistakeError(token.start, what, _UNSUPPORTED.get(token.word, fix))

    def _typed(self, token: Token) -> str:
        return f"'{self._text[token.start : token.end][:40]}'"

    def _nested(self, read: Callable[[], Term]) -> Term:
        self._nesting += 1
        if self._nesting > _MAX_NESTING:
            what = TranslatableText("nested too deeply")
            fix = TranslatableText("simplify it")
            raise MistakeError(self._peek().start, what, fix)
        term = read()
        self._nesting -= 1
        return term

    # Conditions

    def _or(self) -> Term:
        terms = [self._and()]
        while self._accept("OR", "||"):
            terms.append(self._and())
        return terms[0] if len(terms) == 1 else compiler.chain(terms, "OR")

    def _and(self) -> Term:
        terms = [self._not()]
        while self._accept("AND", "&&"):
            terms.append(self._not())
        return terms[0] if len(terms) == 1 else compiler.chain(terms, "AND")

    def _not(self) -> Term:
        if self._accept("NOT", "!"):
            return compiler.negate(self._nested(self._not))
        return self._predicate()

    def _predicate(self) -> Term:
        left = self._value()
        token = self._peek()
        sign = self._accept(*COMPARISONS, "=>", "=<")
        if sign:
            return self._comparison(left, sign, token)
        if self._accept("IS"):
            return self._is(left)
        start = self._index
        negated = self._accept("NOT", "!~")
        if negated == "!~":
            return compiler.negate(compiler.regexp(left, self._value()))
        found = self._word_operator(left)
        if found is None:
            self._index = start
            return left
        return compiler.negate(found) if negated else found

    def _comparison(self, left: Term, sign: str, token: Token) -> Term:
        if sign not in COMPARISONS:
            what = TranslatableText("'{sign}' is not an operator", sign=sign)
            fix = TranslatableText("write {second}{first}", second=sign[1], first=sign[0])
            raise MistakeError(token.start, what, fix)
        found = compiler.compare(left, COMPARISONS[sign], self._value())
        if self._at(*COMPARISONS):
            raise self._unexpected(
                TranslatableText("join comparisons with AND; a single & joins bits")
            )
        return found

    def _brackets(self) -> Term:
        self._expect("(", _NO_BRACKET)
        term = self._nested(self._or)
        self._expect(")", TranslatableText("a ')' is missing"))
        return term

    def _is(self, left: Term) -> Term:
        negated = self._accept("NOT")
        if self._accept("DISTINCT"):
            self._expect("FROM", TranslatableText("write IS DISTINCT FROM"))
            operator = "IS NOT DISTINCT FROM" if negated else "IS DISTINCT FROM"
            return compiler.distinct(left, self._value(), operator)
        word = self._accept("NULL", "TRUE", "FALSE")
        if word is None:
            raise self._unexpected(
                TranslatableText("write NULL, TRUE or FALSE after IS; compare a value with =")
            )
        found = compiler.is_null(left) if word == "NULL" else compiler.is_truth(left, word)
        return compiler.negate(found) if negated else found

    def _word_operator(self, left: Term) -> Term | None:
        word = self._accept("IN", "BETWEEN", "~", *PATTERN_WORDS)
        if word is None:
            return None
        if word == "IN":
            return self._in(left)
        if word == "BETWEEN":
            low = self._value()
            self._expect("AND", TranslatableText("write BETWEEN low AND high"))
            return compiler.between(left, low, self._value())
        pattern = self._value()
        if word in ("LIKE", "ILIKE"):
            return compiler.like(left, word, pattern)
        return compiler.regexp(left, pattern)

    def _in(self, left: Term) -> Term:
        if not self._at("("):
            what = TranslatableText("IN needs a list")
            fix = TranslatableText("write it in brackets: IN (1, 2)")
            raise MistakeError(self._peek().start, what, fix)
        items = self._arguments()
        if not items:
            what = TranslatableText("the list after IN is empty")
            raise MistakeError(left.start, what, TranslatableText("write IN (1, 2)"))
        return compiler.any_of(left, items)

    def _arguments(self) -> list[Term]:
        self._expect("(", _NO_BRACKET)
        if self._accept(")"):
            return []
        items = [self._nested(self._or)]
        while self._accept(","):
            items.append(self._nested(self._or))
        self._expect(")", TranslatableText("a ')' or a ',' is missing"))
        return items

    # Values

    def _value(self, level: int = 0) -> Term:
        if level == len(_ARITHMETIC):
            return self._unary()
        terms, signs = [self._value(level + 1)], []
        while sign := self._accept(*_ARITHMETIC[level]):
            signs.append(sign)
            terms.append(self._value(level + 1))
        return compiler.arithmetic(terms, signs) if signs else terms[0]

    def _unary(self) -> Term:
        token = self._peek()
        sign = self._accept("-", "+")
        if sign is None:
            return self._primary()
        if self._peek().type is TokenType.NUMBER and sign == "-":
            number = self._advance()
            return compiler.number(-number.number, token.start, f"-{number.text}")
        term = self._nested(self._unary)
        return compiler.minus(term, token.start) if sign == "-" else term

    def _primary(self) -> Term:
        token = self._peek()
        if self._at("("):
            return self._brackets()
        if token.type in (TokenType.END, TokenType.SYMBOL):
            raise self._unexpected(_NO_VALUE)
        self._advance()
        if token.type is TokenType.NUMBER:
            return compiler.number(token.number, token.start, token.text)
        if token.type is TokenType.TEXT:
            return _text(TermType.LITERAL, token)
        return self._name(token)

    def _name(self, token: Token) -> Term:
        word = token.word
        if word and word not in OPERATOR_WORDS and self._at("("):
            return self._call(token)
        column = COLUMN_BY_NAME.get(token.text.lower())
        if column:
            return compiler.column(column, token.start)
        if token.type is TokenType.QUOTED:
            return _text(TermType.LITERAL, token)
        if word in ("TRUE", "FALSE"):
            return compiler.truth(word == "TRUE", token.start, word)
        if word == "NULL":
            return Term(TermType.NULL, token.start, word, pl.lit(None))
        if word in _UNSUPPORTED or word in OPERATOR_WORDS:
            self._index -= 1
            raise self._unexpected(_NO_VALUE)
        return _text(TermType.NAME, token)

    def _call(self, token: Token) -> Term:
        name = token.text.lower()
        if name in FUNCTIONS:
            return compiler.call(name, self._arguments(), token.start)
        if name in COLUMN_BY_NAME or name in COLUMN_OF_WORD:
            fix = TranslatableText("a sign is missing between them: = or IN")
        elif token.word in _AGGREGATES:
            fix = _ONE_ROW
        else:
            names = TranslatableText("there are {names}", names=listed(FUNCTIONS))
            fix = _UNSUPPORTED.get(token.word, names)
        what = TranslatableText("{token} is not a function of a filter", token=self._typed(token))
        raise MistakeError(token.start, what, fix)


def _text(of_type: TermType, token: Token) -> Term:
    return Term(of_type, token.start, token.text, pl.lit(token.text))
