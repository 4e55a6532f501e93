"""Owns how text is cut or padded to a width in cells, as terminals count them.

It must not know what the text means. Text from outside must have gone through `errors.shown`
before: a control character has no width.
"""

from __future__ import annotations

import re
from textwrap import wrap as wrap_ascii

from rich.cells import cell_len, chop_cells, set_cell_size

ELLIPSIS = "…"
"""Stands where text was cut."""

_WIDE = "\u2e80-\u9fff\uff00-\uffef"
_CLOSING = "，。；：、）”！？"
_UNITS = re.compile(rf"\s+|[（“]*[{_WIDE}][{_CLOSING}]*|[^\s{_WIDE}]+[{_CLOSING}]*")
"""What a line is not broken in; between two characters of two cells it may be."""


def fit(text: str, width: int) -> str:
    """The text in exactly `width` cells: padded at the right, or cut with an ellipsis."""
    if text.isascii():
        room = width - len(text)
        if room >= 0:
            return text + " " * room
        return text[: width - 1] + ELLIPSIS if width > 0 else ""
    if cell_len(text) <= width:
        return set_cell_size(text, width)
    return set_cell_size(text, width - 1) + ELLIPSIS if width > 0 else ""


def fit_right(text: str, width: int) -> str:
    """The text in exactly `width` cells: padded at the left, or cut with an ellipsis."""
    room = width - cell_len(text)
    return " " * room + text if room >= 0 else fit(text, width)


def fit_path(path: str, width: int) -> str:
    """A path in at most `width` cells: its end is kept, for that is what tells files apart."""
    if cell_len(path) <= width:
        return path
    kept = ""
    for character in reversed(path):
        if cell_len(kept) + cell_len(character) > width - 1:
            break
        kept = character + kept
    return ELLIPSIS + kept if width > 0 else ""


def wrap(text: str, width: int) -> list[str]:
    """The text in lines of at most `width` cells; none where there is no text."""
    width = max(1, width)
    if text.isascii():
        return wrap_ascii(text, width, break_on_hyphens=False)
    lines, line = [], ""
    for unit in _UNITS.findall(text):
        if cell_len(line + unit.rstrip()) <= width:
            line += unit
            continue
        if line.strip():
            lines.append(line.rstrip())
        *whole, line = chop_cells(unit.lstrip(), width) or [""]
        lines += whole
    return [*lines, line.rstrip()] if line.strip() else lines


def padded(text: str, width: int) -> str:
    """The text with spaces behind it up to `width` cells; as it is where it has more."""
    return text + " " * (width - cell_len(text))
