"""What helps to write a filter: help text, completions, and the filters of a cell."""

from __future__ import annotations

import re
from collections.abc import Iterator
from textwrap import wrap
from typing import Final

from fte_sniff.analysis.filter.row_filter import COLUMN_OF_WORD, EXAMPLES, FUNCTIONS, LEVELS
from fte_sniff.protocol.columns import COLUMN_BY_NAME, COLUMNS, Value, iso_time, record
from fte_sniff.protocol.rows import Row


def quoted(text: str) -> str:
    """The text as a literal of a filter."""
    return "'" + text.replace("'", "''") + "'"


def _help() -> Iterator[str]:
    yield "A filter selects rows with an SQL expression: motor = 1 AND rpm > 500"
    yield ""
    yield "Fields"
    for column in COLUMNS:
        yield from _wrapped(f"  {column.name:<10} ", column.meaning)
        yield from _wrapped(" " * 13, ", ".join(column.words))
    yield ""
    yield "Examples"
    for example, meaning in EXAMPLES:
        yield f"  {example:<34} {meaning}"


def _wrapped(start: str, text: str) -> list[str]:
    return wrap(text, 79, initial_indent=start, subsequent_indent=" " * len(start))


FILTER_HELP: Final = "\n".join(_help())
"""The language on one screen, for `--filter help` and the filter prompt."""


# Completions

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


# The filters of a cell


def cell_filters(row: Row) -> dict[str, str]:
    """By the filter that keeps the rows with the value of a cell, the one that keeps all others.

    They are of all cells of the row, in the order of the screen's columns.
    """
    return {
        f"{name} {only}": f"{name} {without}"
        for name, value in record(row).items()
        for only, without in _of_cell(name, value)
    }


def _of_cell(name: str, value: Value) -> Iterator[tuple[str, str]]:
    """The conditions of a cell, and their opposites."""
    if value == [] or (value is None and name == "kind"):
        yield "IS NULL", "IS NOT NULL"
    elif isinstance(value, list):
        yield from ((f"= '{word}'", f"!= '{word}'") for word in value)
    elif name == "time" and isinstance(value, int):
        yield f">= '{iso_time(value)}'", f"< '{iso_time(value)}'"
    elif isinstance(value, str):
        if value.isprintable():  # a device's name may have bytes that no filter can contain
            yield f"= {quoted(value)}", f"IS DISTINCT FROM {quoted(value)}"
    elif value is not None:
        yield f"= {value}".upper(), f"IS DISTINCT FROM {value}".upper()


def both(current: str, added: str) -> str:
    """The conjunction of two filters; the current one may be empty."""
    if not current or current == added:
        return added
    if re.search(r"\bOR\b|\|\|", current, re.IGNORECASE):
        return f"({current}) AND {added}"
    return current if added in current.split(" AND ") else f"{current} AND {added}"
