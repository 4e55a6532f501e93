"""Completions of the last word of a filter."""

from __future__ import annotations

import re
from typing import Final

from fte_sniff.analysis.filter.row_filter import COLUMN_OF_WORD, FUNCTIONS, LEVELS
from fte_sniff.analysis.filter.terms import quoted
from fte_sniff.protocol.columns import COLUMN_BY_NAME

_LAST_WORD: Final = re.compile(r"(?P<quote>['\"]?)(?P<word>(?<=['\"])[\w:.-]*|\w*)$")
_COMPARED: Final = re.compile(
    r"(\w+)\s*(?:[=!<>]+|\b(?:NOT\s+)?IN\s*\((?:[^(),]*,)*)\s*$", re.IGNORECASE
)
"""A field that the next word is compared with."""
_AFTER_OPERATOR: Final = re.compile(
    rf"(?:^|[-+*/%&|=<>~!(,]|\b(?:{'|'.join(filter(str.isalpha, LEVELS))}))\s*$", re.IGNORECASE
)
_OPERANDS: Final = (*COLUMN_BY_NAME, "NOT", *COLUMN_OF_WORD, *(f"{name}(" for name in FUNCTIONS))
_OPERATORS: Final = (*filter(str.isalpha, LEVELS), "IS NULL", "IS NOT NULL")


def completions(text: str) -> list[str]:
    """The filters that complete the last word of a text, the likeliest first."""
    match = _LAST_WORD.search(text)
    if match is None or text.count("'", 0, match.start()) % 2:
        return []
    before, word = text[: match.start()], match["word"].lower()
    compared = _COMPARED.search(before)
    column = COLUMN_BY_NAME.get(compared[1].lower()) if compared else None
    found = [quoted(one) for one in column.words] if column else []
    if not found and not match["quote"]:
        found += _OPERANDS if _AFTER_OPERATOR.search(before) else _OPERATORS
    choices = (one for one in found if one.strip("'").lower().startswith(word))
    return [before + one for one in choices if one.lower() != word]
