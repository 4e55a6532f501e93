"""Owns what stands at the front of every line and is of another shape than what follows it.

It must not know what it is: a time, an address, a count, a sensor's number. It may be bytes too, so
two lines that begin so are refused, and one alone is told.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator

from fte_sniff.errors import InputTextError
from fte_sniff.formats.logs.pasted_line import Line
from fte_sniff.protocol import HEADERS

_FRONT = re.compile(
    r"[\s\[({<\"']*(?P<front>[0-9A-Za-z][0-9A-Za-z:.\-]*)[\])}>\"',;:|]*\s+"
    r"(?:(?P<prefix>0x)?[0-9A-Fa-f]{2}[,;]?\s+)(?:(?(prefix)0x)[0-9A-Fa-f]{2}[,;]?\s+)*"
    r"(?(prefix)0x)[0-9A-Fa-f]{2}[,;]?[\s\])}>;]*"
)
_HEADER = re.compile(
    rf"(?:0x)?(?:{'|'.join(f'{header:02X}' for header in HEADERS.values())})", re.IGNORECASE
)
"""What begins with one begins a frame, however its digits are grouped."""


def without_doubtful_fronts(lines: Iterable[Line], note: Callable[[str], None]) -> Iterator[Line]:
    """The same lines, unless the first two that hold anything have such a front.

    Raises:
        InputTextError: they have.
    """
    rest = iter(lines)
    held: Line | None = None
    for line in rest:
        if line.data is None and not line.text[line.at :].strip():
            yield line
            continue
        front = _front_of(line)
        if front is None:
            break
        if held is not None:
            raise InputTextError(
                f"line {held.piece.line}: {_front_of(held)} stands before the bytes, and may be"
                " bytes or none; delete it, or write its bytes apart"
            )
        held = line
    else:
        if held is not None:
            note(f"line {held.piece.line}: {_front_of(held)} at its front is read as bytes")
            yield held
        return
    if held is not None:
        yield held
    yield line
    yield from rest


def _front_of(line: Line) -> str | None:
    """What stands in front of pairs of digits and is none; None where nothing does."""
    if line.data is not None or line.pairs or line.piece.column:
        return None
    found = _FRONT.fullmatch(line.text, line.at)
    if found is None or _HEADER.match(found["front"]):
        return None
    pair = len(found["front"]) == (4 if found["prefix"] else 2)
    return None if pair else found["front"]
