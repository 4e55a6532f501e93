"""Owns what is said of a part of a filter that does not fit where it stands, and the way out.

It must not know what would fit: whoever joins the parts decides that.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable
from dataclasses import dataclass

from fte_sniff.analysis.filter.terms import COLUMN_OF_WORD, UNTYPED, Term, TermType
from fte_sniff.analysis.filter.tokens import complaint
from fte_sniff.errors import FilterError, Said
from fte_sniff.protocol import COLUMN_BY_NAME


@dataclass(frozen=True, slots=True)
class Complaints:
    """What is said of the terms of one filter; each points at the term's place in the text."""

    text: str

    def about(self, term: Term, what: str, way_out: str = "") -> FilterError:
        """That something is wrong with a term."""
        return complaint(self.text, term.start, what, way_out)

    def unknown(self, term: Term) -> FilterError:
        """That nothing has that name."""
        choices = [*COLUMN_BY_NAME, *COLUMN_OF_WORD]
        return self.about(
            term,
            Said("unknown name '{term}'", term=term.shown),
            (
                nearest(term.shown, choices)
                or Said("the fields are {names}", names=", ".join(COLUMN_BY_NAME))
            ),
        )

    def other_type(self, term: Term, why: str) -> FilterError:
        """That a term has another type than is wanted; `why` says what wants which."""
        told = Said(
            "{why}, and {term} is {type}",
            why=why,
            term=term.shown,
            type=Said(term.type.value),
        )
        return self.about(term, told, how_to_ask(term))

    def mismatch(self, left: Term, right: Term) -> FilterError:
        """That two terms are of types that cannot stand beside each other."""
        if left.type in UNTYPED and right.type in UNTYPED:
            return self.about(
                left,
                Said("two texts are compared"),
                Said("a field's name stands without single quotes"),
            )
        if left.column is None and right.type is TermType.LITERAL:
            near = nearest(right.shown, COLUMN_BY_NAME) or "name a field"
            return self.about(
                right,
                Said("'{right}' is a text, no field", right=right.shown),
                Said("{near} (no quotes)", near=near),
            )
        what = Said(
            "{left} is {left_is}, {right} is {right_is}",
            left=left.shown,
            left_is=Said(left.type.value),
            right=right.shown,
            right_is=Said(right.type.value),
        )
        if left.type is TermType.NUMBER and right.type is TermType.LITERAL:
            return self.about(right, what, Said("write a number, without quotes"))
        if left.type is TermType.HEX and right.type is TermType.NUMBER:
            return self.about(
                right, what, Said("write the bytes as a text, as in raw LIKE 'AA01%'")
            )
        return self.about(right, what, how_to_ask(left))


def nearest(word: str, choices: Iterable[str]) -> str:
    """`did you mean x?`, or nothing where the word is short for no choice, nor like one."""
    names, asked = list(choices), word.lower()
    begun = [name for name in names if len(word) > 1 and name.startswith(asked)]
    near = (
        begun
        or [name for name in names if _is_short_for(asked, name)]
        or difflib.get_close_matches(asked, names, n=1)
    )
    return Said("did you mean {near}?", near=near[0]) if near else ""


def _is_short_for(text: str, name: str) -> bool:
    """Whether each of a text's words leaves letters out of the name's one, as in `speed fb`."""
    words, parts = re.split(r"[\s_.-]+", text), name.split("_")
    return len(words) == len(parts) > 1 and all(
        re.fullmatch(".*".join(map(re.escape, word)) + ".*", part)
        for word, part in zip(words, parts, strict=True)
    )


def how_to_ask(term: Term) -> str:
    """How a term of that type is asked about."""
    name = term.shown if term.column else "motor"
    return {
        TermType.NUMBER: Said("compare it, as in {name} = 1", name=name),
        TermType.TIME: Said("compare it, as in time > '2026-01-31T12:00:00Z'"),
        TermType.TEXT: Said("compare it, as in port LIKE '%USB%'"),
        TermType.HEX: Said("compare it, as in raw LIKE 'AA01%'"),
        TermType.WORDS: Said("ask for one, as in faults = 'noise', or for any: faults IS NOT NULL"),
        TermType.WORD: Said(
            "compare it, as in {name} = '{word}'", name=name, word=_first_word(term)
        ),
        TermType.LITERAL: Said("compare a field with it, as in kind = 'speed'"),
        TermType.NULL: Said("write IS NULL or IS NOT NULL"),
        TermType.TRUTH: Said("join conditions with AND or OR"),
        TermType.NAME: Said("compare it with a field"),
    }[term.type]


def _first_word(term: Term) -> str:
    return term.column.words[0] if term.column and term.column.words else "speed"
