"""Owns walking through the words and signs of a filter, and what is said of one out of place.

It must not know in what order they may stand (`grammar` does), nor what they mean.
"""

from __future__ import annotations

from typing import Final

from fte_sniff.analysis.filter.tokens import Token, TokenType, complaint, tokens
from fte_sniff.errors import FilterError, Said

ONE_ROW: Final = Said("a filter looks at one row at a time; statistics are for the stats command")
"""The way out for who asks for more than a row tells."""

LEAVE_OUT: Final = Said("a filter is the condition alone, as in motor = 1 AND rpm > 500")
"""The way out for who writes a whole query, or nothing."""

REFUSED: Final = {
    **dict.fromkeys(["SELECT", "EXISTS", "OVER", "FROM", "UNION", "GROUP", "HAVING"], ONE_ROW),
    **dict.fromkeys(["WHERE", "ORDER", "LIMIT", "AS"], LEAVE_OUT),
    **dict.fromkeys(["CASE", "WHEN", "IF"], Said("join conditions with AND, OR and NOT")),
    **dict.fromkeys(
        ["CAST", "DATE", "TIMESTAMP", "INTERVAL"],
        Said("times are texts: time > '2026-01-31' or time > '12:00:05'"),
    ),
    "XOR": Said("write (one condition) != (the other)"),
    "ESCAPE": Said("leave it out"),
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
            return complaint(self._text, token.start, Said("the filter ends too soon"), way_out)
        return complaint(
            self._text,
            token.start,
            Said("{token} is out of place", token=self.shown(token)),
            REFUSED.get(token.word, way_out),
        )

    def shown(self, token: Token) -> str:
        """A token as it was typed, in quotes, for a complaint."""
        return f"'{self._text[token.start : token.end][:40]}'"
