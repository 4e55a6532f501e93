"""Tokens and token cursor."""

from __future__ import annotations

import re
from dataclasses import dataclass
from enum import Enum, auto
from typing import Final

from fte_sniff.errors import FilterError, TranslatableText, printable

MAX_LENGTH: Final = 8_000
"""Characters in a filter; more are an accident, not a question."""

MAX_TOKENS: Final = 600
"""Tokens in a filter. Polars walks a chain of conditions by recursion: this bounds its stack."""

_EXCERPT: Final = 24
_LONGEST: Final = 160
_LONGEST_NUMBER: Final = 64


class TokenType(Enum):
    """What a token is."""

    NUMBER = auto()
    TEXT = auto()
    """In single quotes."""
    QUOTED = auto()
    """In double quotes (or backticks): in SQL a name, in many heads a text."""
    NAME = auto()
    """A field, a word of the contract, or a word of SQL."""
    SYMBOL = auto()
    END = auto()


@dataclass(frozen=True, slots=True)
class Token:
    """One token, and where it stands in the filter."""

    type: TokenType
    text: str
    """As typed; for texts what stands between the quotes."""
    start: int
    end: int

    @property
    def word(self) -> str:
        """A name as SQL compares it: upper case; empty for any other token."""
        return self.text.upper() if self.type is TokenType.NAME else ""

    @property
    def number(self) -> int | float:
        """The value of a number token; hex and binary numbers keep their meaning."""
        if self.text[:2].lower() in ("0x", "0b"):
            return int(self.text, 0)
        return int(self.text) if self.text.isdigit() else float(self.text)


_TOKEN: Final = re.compile(
    r"""
      (?P<SPACE> \s+ )
    | (?P<NUMBER> 0[xX][0-9A-Fa-f]+ | 0[bB][01]+
                | (?: [0-9]+ (?: \.[0-9]* )? | \.[0-9]+ ) (?: [eE][+-]?[0-9]+ )? )
    | (?P<TEXT> '(?: [^'] | '' )*' )
    | (?P<QUOTED> "(?: [^"] | "" )*" | `[^`]*` )
    | (?P<NAME> [^\W\d]\w* )
    | (?P<SYMBOL> && | \|\| | == | != | <> | <= | >= | => | =< | !~ | [=<>+\-*/%&|(),!~] )
    """,
    re.VERBOSE,
)

_ADVICE: Final = {
    "'": TranslatableText(
        "this quote is never closed; a quote inside a text is written twice: 'it''s'"
    ),
    '"': TranslatableText("this quote is never closed"),
    "`": TranslatableText("this quote is never closed"),
    ";": TranslatableText("a filter is one expression; leave out the ';'"),
    "^": TranslatableText(
        "there is no '^'; bits are asked for with & and |, as in online & 0x01 = 1"
    ),
    ".": TranslatableText("names have no dots; write the field alone"),
    ":": TranslatableText("there is no ':'; times are texts, as in time > '12:00:05'"),
    **dict.fromkeys(
        "\u2018\u2019\u201c\u201d\u201e\u00ab\u00bb\uff07\uff02",
        TranslatableText("texts stand in plain single quotes, as in kind = 'speed'"),
    ),
    **dict.fromkeys(
        "\uff08\uff09\uff0c\uff1d\uff1e\uff1c\uff01",
        TranslatableText("this is a full-width character; type the ASCII one"),
    ),
}


def complaint(text: str, at: int, what: str, way_out: str = "") -> FilterError:
    """An error that names a place in a filter.

    Args:
        text: the whole filter.
        at: the place, counted from 0.
        what: what is wrong there.
        way_out: what to write instead.
    """
    before = text[max(0, at - _EXCERPT) : at]
    after = text[at : at + _EXCERPT]
    start = "..." if at > _EXCERPT else ""
    end = "..." if at + _EXCERPT < len(text) else ""
    where = TranslatableText(
        'filter: {what} at character {number} of "{excerpt}"',
        what=_short(what),
        number=at + 1,
        excerpt=f"{start}{printable(before)}-->{printable(after)}{end}",
    )
    if not way_out:
        return FilterError(where)
    return FilterError("{where}; {way_out}", where=where, way_out=_short(way_out))


def _short(text: str) -> str:
    line = printable(text)
    if len(line) > _LONGEST:
        return f"{line[:_LONGEST]}..."
    return text if line == text else line


def tokens(text: str) -> list[Token]:
    """The tokens of a filter; the last is of type END.

    Raises:
        FilterError: the text is too long, or holds what is in no filter.
    """
    if len(text) > MAX_LENGTH:
        raise FilterError(
            "filter: {count} characters are too many; the limit is {most}: ask for less",
            count=len(text),
            most=MAX_LENGTH,
        )
    found: list[Token] = []
    at = 0
    while at < len(text):
        token = _token_at(text, at)
        at = token.end if token else _space_end(text, at)
        if token:
            found.append(token)
    if len(found) > MAX_TOKENS:
        raise FilterError(
            "filter: {count} words and signs are too many; the limit is "
            "{most}: split it, or ask for a range with BETWEEN",
            count=len(found),
            most=MAX_TOKENS,
        )
    return [*found, Token(TokenType.END, "", len(text), len(text))]


def _space_end(text: str, at: int) -> int:
    space = _TOKEN.match(text, at)
    return space.end() if space else at + 1


def _token_at(text: str, at: int) -> Token | None:
    """The token that begins there, or None where white space does."""
    match = _TOKEN.match(text, at)
    if match is None:
        char = text[at]
        raise complaint(
            text,
            at,
            TranslatableText("'{char}' is in no filter", char=printable(char)),
            _ADVICE.get(char, ""),
        )
    name, content = str(match.lastgroup), match.group()
    if name == "SPACE":
        return None
    token_type = TokenType[name]
    if token_type is TokenType.NUMBER:
        _check_number(text, match)
    elif token_type in (TokenType.TEXT, TokenType.QUOTED):
        _check_unicode(text, match)
        quote = content[0]
        content = content[1:-1].replace(quote * 2, quote)
    return Token(token_type, content, at, match.end())


def _check_number(text: str, match: re.Match[str]) -> None:
    if len(match.group()) > _LONGEST_NUMBER:
        raise complaint(
            text,
            match.start(),
            TranslatableText("this number is too long"),
            TranslatableText("no field is as large"),
        )
    rest = re.compile(r"[\w.]+").match(text, match.end())
    if rest:
        raise complaint(
            text,
            match.start(),
            TranslatableText(
                "'{number}{rest}' is no number", number=match.group(), rest=rest.group()
            ),
            TranslatableText("write plain digits or hex as 0x0F, without a unit"),
        )


def _check_unicode(text: str, match: re.Match[str]) -> None:
    try:
        match.group().encode()
    except UnicodeEncodeError as error:
        raise complaint(
            text,
            match.start() + error.start,
            TranslatableText("this text is not valid Unicode"),
            TranslatableText("type it again"),
        ) from None


ONE_ROW: Final = TranslatableText(
    "a filter looks at one row at a time; statistics are for the stats command"
)
"""The way out for who asks for more than a row tells."""

LEAVE_OUT: Final = TranslatableText(
    "a filter is the condition alone, as in motor = 1 AND rpm > 500"
)
"""The way out for who writes a whole query, or nothing."""

REFUSED: Final = {
    **dict.fromkeys(["SELECT", "EXISTS", "OVER", "FROM", "UNION", "GROUP", "HAVING"], ONE_ROW),
    **dict.fromkeys(["WHERE", "ORDER", "LIMIT", "AS"], LEAVE_OUT),
    **dict.fromkeys(
        ["CASE", "WHEN", "IF"], TranslatableText("join conditions with AND, OR and NOT")
    ),
    **dict.fromkeys(
        ["CAST", "DATE", "TIMESTAMP", "INTERVAL"],
        TranslatableText("times are texts: time > '2026-01-31' or time > '12:00:05'"),
    ),
    "XOR": TranslatableText("write (one condition) != (the other)"),
    "ESCAPE": TranslatableText("leave it out"),
}
"""Words of SQL that are in no filter, with the way out for each."""

AGGREGATES: Final = frozenset(
    ["AVG", "COUNT", "FIRST", "LAST", "MAX", "MEAN", "MEDIAN", "MIN", "RANK", "ROW_NUMBER", "SUM"]
)
"""Functions of SQL that look at many rows."""


class Cursor:
    """A place among the tokens of one filter."""

    def __init__(self, text: str) -> None:
        """Before the first token.

        Raises:
            FilterError: the text is too long, or holds what is in no filter.
        """
        self._text = text
        self._tokens = tokens(text)
        self.place = 0
        """Which token is next; may be set back to where it was."""

    def peek(self) -> Token:
        """The next token; the last is of type END."""
        return self._tokens[self.place]

    def advance(self) -> Token:
        """Take the next token, whatever it is."""
        self.place += 1
        return self._tokens[self.place - 1]

    def stands(self, *choices: str) -> str | None:
        """The next token's word or sign, where it is one of the choices."""
        token = self.peek()
        found = token.word or (token.text if token.type is TokenType.SYMBOL else "")
        return found if found in choices else None

    def take(self, *choices: str) -> str | None:
        """The same, and take the token then."""
        found = self.stands(*choices)
        self.place += found is not None
        return found

    def need(self, choice: str, why: str) -> None:
        """Take the word or sign that must stand here.

        Raises:
            FilterError: it does not; `why` is the way out.
        """
        if self.take(choice) is None:
            raise self.unexpected(why)

    def unexpected(self, way_out: str) -> FilterError:
        """What is said of the next token, which cannot stand here."""
        token = self.peek()
        if token.type is TokenType.END:
            return complaint(
                self._text, token.start, TranslatableText("the filter ends too soon"), way_out
            )
        return complaint(
            self._text,
            token.start,
            TranslatableText("{token} is out of place", token=self.shown(token)),
            REFUSED.get(token.word, way_out),
        )

    def shown(self, token: Token) -> str:
        """A token as it was typed, in quotes, for a complaint."""
        return f"'{self._text[token.start : token.end][:40]}'"
