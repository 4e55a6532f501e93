"""Grammar.

or          and { (OR | ||) and }
and         not { (AND | &&) not }
not         [NOT | !] predicate
predicate   value [ sign value | [NOT] IN list | [NOT] IN faults | [NOT] BETWEEN value AND value
                  | [NOT] (LIKE | ILIKE | ~ | REGEXP | RLIKE) 'pattern'
                  | IS [NOT] (NULL | TRUE | FALSE | DISTINCT FROM value) ]
value       numbers joined by + - * / % and the bit signs & and |
primary     number | 'text' | field | word | function(...) | ( or )
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from fte_sniff.analysis.filter.lexer import (
    AGGREGATES,
    LEAVE_OUT,
    ONE_ROW,
    REFUSED,
    Cursor,
    Token,
    TokenType,
    complaint,
)
from fte_sniff.analysis.filter.operands import Expressions
from fte_sniff.analysis.filter.predicates import Predicates
from fte_sniff.analysis.filter.terms import COLUMN_OF_WORD, FUNCTIONS, Term, TermType, quoted
from fte_sniff.errors import FilterError, TranslatableText
from fte_sniff.protocol import COLUMN_BY_NAME

_MAX_NESTING: Final = 25
_SQL_SIGNS: Final = ("=", "!=", "<", ">", "<=", ">=")
COMPARISONS: Final = dict(zip(["==", "<>", *_SQL_SIGNS], ["=", "!=", *_SQL_SIGNS], strict=True))
"""The signs that compare, with what SQL writes for each."""

PATTERN_WORDS: Final = ("LIKE", "ILIKE", "REGEXP", "RLIKE")
"""The words that ask for a pattern."""

_LEVELS: Final = (("|",), ("&",), ("+", "-"), ("*", "/", "%"))
"""The signs that join numbers, the loosest first."""

OPERATOR_WORDS: Final = frozenset(
    ["AND", "OR", "NOT", "IN", "IS", "BETWEEN", "DISTINCT", "ANY", *PATTERN_WORDS]
)
"""The words that join the parts of a filter, and so are no names."""


def condition(text: str) -> Term:
    """The whole filter as one condition.

    Raises:
        FilterError: with the place and the way out.
    """
    return _Parser(text).whole()


class _Parser:
    def __init__(self, text: str) -> None:
        self._text = text
        self._cursor = Cursor(text)
        self._nesting = 0
        self._expressions = Expressions(text)
        self._predicates = Predicates(text)

    def whole(self) -> Term:
        if self._cursor.peek().type is TokenType.END:
            raise FilterError("filter: it is empty; {way_out}", way_out=LEAVE_OUT)
        term = self._or()
        if self._cursor.peek().type is not TokenType.END:
            raise self._cursor.unexpected(TranslatableText("join conditions with AND or OR"))
        return self._predicates.truth(term)

    def _deeper(self, read: Callable[[], Term]) -> Term:
        self._nesting += 1
        if self._nesting > _MAX_NESTING:
            raise complaint(
                self._text,
                self._cursor.peek().start,
                TranslatableText("nested too deeply"),
                TranslatableText("take it apart"),
            )
        term = read()
        self._nesting -= 1
        return term

    # Conditions

    def _or(self) -> Term:
        terms = [self._and()]
        while self._cursor.take("OR", "||"):
            terms.append(self._and())
        return terms[0] if len(terms) == 1 else self._predicates.chain(terms, "OR")

    def _and(self) -> Term:
        terms = [self._not()]
        while self._cursor.take("AND", "&&"):
            terms.append(self._not())
        return terms[0] if len(terms) == 1 else self._predicates.chain(terms, "AND")

    def _not(self) -> Term:
        if self._cursor.take("NOT", "!"):
            return self._predicates.negated(self._deeper(self._not))
        return self._predicate()

    def _predicate(self) -> Term:
        left = self._value()
        token = self._cursor.peek()
        sign = self._cursor.take(*COMPARISONS, "=>", "=<")
        if sign:
            return self._comparison(left, sign, token)
        if self._cursor.take("IS"):
            return self._is(left)
        start = self._cursor.place
        negated = self._cursor.take("NOT", "!~")
        if negated == "!~":
            return self._predicates.negated(self._predicates.regexp(left, self._value()))
        found = self._worded(left)
        if found is None:
            self._cursor.place = start
            return left
        return self._predicates.negated(found) if negated else found

    def _comparison(self, left: Term, sign: str, token: Token) -> Term:
        if sign not in COMPARISONS:
            raise complaint(
                self._text,
                token.start,
                TranslatableText("'{sign}' is no sign", sign=sign),
                TranslatableText("write {second}{first}", second=sign[1], first=sign[0]),
            )
        if self._cursor.take("ANY"):
            right = self._bracketed()
            if right.type is not TermType.WORDS:
                raise complaint(
                    self._text,
                    right.start,
                    TranslatableText("ANY wants a list"),
                    TranslatableText("as in 'noise' = ANY(faults)"),
                )
        else:
            right = self._value()
        found = self._predicates.compared(left, COMPARISONS[sign], right)
        if self._cursor.stands(*COMPARISONS):
            raise self._cursor.unexpected(
                TranslatableText("join comparisons with AND; a single & joins bits")
            )
        return found

    def _bracketed(self) -> Term:
        self._cursor.need("(", TranslatableText("a '(' is missing"))
        term = self._deeper(self._or)
        self._cursor.need(")", TranslatableText("a ')' is missing"))
        return term

    def _is(self, left: Term) -> Term:
        negated = self._cursor.take("NOT")
        if self._cursor.take("DISTINCT"):
            self._cursor.need("FROM", TranslatableText("write IS DISTINCT FROM"))
            joint = "IS NOT DISTINCT FROM" if negated else "IS DISTINCT FROM"
            return self._predicates.distinct(left, self._value(), joint)
        word = self._cursor.take("NULL", "TRUE", "FALSE")
        if word is None:
            raise self._cursor.unexpected(
                TranslatableText("after IS stands NULL, TRUE, FALSE; a value is asked for with =")
            )
        if word == "NULL":
            found = self._predicates.is_null(left)
        else:
            found = self._predicates.is_truth(left, word)
        return self._predicates.negated(found) if negated else found

    def _worded(self, left: Term) -> Term | None:
        word = self._cursor.take("IN", "BETWEEN", "~", *PATTERN_WORDS)
        if word is None:
            return None
        if word == "IN":
            return self._in(left)
        if word == "BETWEEN":
            low = self._value()
            self._cursor.need("AND", TranslatableText("write BETWEEN low AND high"))
            return self._predicates.between(left, low, self._value())
        pattern = self._value()
        if word in ("LIKE", "ILIKE"):
            return self._predicates.like(left, word, pattern)
        return self._predicates.regexp(left, pattern)

    def _in(self, left: Term) -> Term:
        if not self._cursor.stands("("):
            right = self._value()
            if right.type is not TermType.WORDS:
                raise complaint(
                    self._text,
                    right.start,
                    TranslatableText("IN wants a list"),
                    TranslatableText("write it in brackets: IN (1, 2)"),
                )
            return self._predicates.compared(right, "=", left)
        items = self._arguments()
        if not items:
            raise complaint(
                self._text,
                left.start,
                TranslatableText("the list after IN is empty"),
                TranslatableText("write IN (1, 2)"),
            )
        return self._predicates.among(left, items)

    def _arguments(self) -> list[Term]:
        self._cursor.need("(", TranslatableText("a '(' is missing"))
        if self._cursor.take(")"):
            return []
        items = [self._deeper(self._or)]
        while self._cursor.take(","):
            items.append(self._deeper(self._or))
        self._cursor.need(")", TranslatableText("a ')' or a ',' is missing"))
        return items

    # Values

    def _value(self, level: int = 0) -> Term:
        if level == len(_LEVELS):
            return self._unary()
        terms, signs = [self._value(level + 1)], []
        while sign := self._cursor.take(*_LEVELS[level]):
            signs.append(sign)
            terms.append(self._value(level + 1))
        return self._expressions.arithmetic(terms, signs) if signs else terms[0]

    def _unary(self) -> Term:
        token = self._cursor.peek()
        sign = self._cursor.take("-", "+")
        if sign is None:
            return self._primary()
        if self._cursor.peek().type is TokenType.NUMBER and sign == "-":
            number = self._cursor.advance()
            return self._expressions.number(-number.number, token.start, f"-{number.text}")
        term = self._deeper(self._unary)
        return self._expressions.minus(term, token.start) if sign == "-" else term

    def _primary(self) -> Term:
        token = self._cursor.peek()
        if self._cursor.stands("("):
            return self._bracketed()
        if token.type in (TokenType.END, TokenType.SYMBOL):
            raise self._cursor.unexpected(TranslatableText("here a field or a value is missing"))
        self._cursor.advance()
        if token.type is TokenType.NUMBER:
            return self._expressions.number(token.number, token.start, token.text)
        if token.type is TokenType.TEXT:
            return _literal(token)
        return self._named(token)

    def _named(self, token: Token) -> Term:
        column = COLUMN_BY_NAME.get(token.text.lower())
        called = self._cursor.stands("(")
        if token.type is TokenType.NAME and called and token.word not in OPERATOR_WORDS:
            return self._call(token)
        if column:
            return self._expressions.column(column, token.start)
        if token.type is TokenType.QUOTED:
            return _literal(token)
        if token.word in ("TRUE", "FALSE"):
            return Term(TermType.TRUTH, token.word, token.start, token.word)
        if token.word == "NULL":
            return Term(TermType.NULL, "NULL", token.start, "NULL")
        if token.word in REFUSED or token.word in OPERATOR_WORDS:
            self._cursor.place -= 1
            raise self._cursor.unexpected(TranslatableText("here a field or a value is missing"))
        return Term(TermType.NAME, "", token.start, token.text)

    def _call(self, token: Token) -> Term:
        name = token.text.lower()
        if name in FUNCTIONS:
            return self._expressions.called(name, self._arguments(), token.start)
        if name in COLUMN_BY_NAME or name in COLUMN_OF_WORD:
            way_out = TranslatableText("a sign is missing between them: = or IN")
        elif token.word in AGGREGATES:
            way_out = ONE_ROW
        else:
            way_out = REFUSED.get(
                token.word, TranslatableText("there are {names}", names=", ".join(FUNCTIONS))
            )
        raise complaint(
            self._text,
            token.start,
            TranslatableText("{token} is no function of a filter", token=self._cursor.shown(token)),
            way_out,
        )


def _literal(token: Token) -> Term:
    return Term(TermType.LITERAL, quoted(token.text), token.start, token.text)
