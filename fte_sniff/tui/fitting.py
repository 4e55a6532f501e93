"""Owns how text is cut or padded to a width in cells, as terminals count them.

It must not know what the text means. Text from outside must have gone through `errors.shown`
before: a control character has no width.
"""

from __future__ import annotations

from rich.cells import cell_len, set_cell_size

ELLIPSIS = "…"
"""Stands where text was cut."""


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
