"""Owns words beside whole frames on a line: which are no bytes, because they cannot be hex.

It must not know the lines around it. A word is passed over only if what stands between words begins
with a header and ends with a tail, so that no byte that was mistyped is taken for a word.

    AA 01 01 00 64 00 00 00 00 EE 收到 55 01 01 00 64 00 00 00 0F EE
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

from fte_sniff.errors import InputTextError, quoted
from fte_sniff.formats.logs.hex_text import bytes_of_line, without_literals
from fte_sniff.formats.logs.pasted_line import Line
from fte_sniff.protocol import HEADERS, TAIL

_WORD = re.compile(
    r"(?:(?![0-9A-Za-z_])\w)++|(?<![\w\\$&%])(?=[A-Za-z]{3})(?=[A-Za-z]*[G-Zg-z])[A-Za-z]+(?!\w)"
)
"""Two letters may be a byte that was mistyped."""
_HEADERS = frozenset(HEADERS.values())


@dataclass(slots=True)
class WordsBeside:
    """Passes over words beside frames, and tells which."""

    note: Callable[[str], None]
    _told: str = ""
    _more: int = 0

    def without_words(self, line: Line) -> Line | None:
        """The line with blanks where words stand; None where what stands between is no frame."""
        words = list(_WORD.finditer(line.text, line.at))
        if not words or line.piece.column or without_literals(line.text) != line.text:
            return None
        places = [line.at, *(place for word in words for place in word.span()), len(line.text)]
        between = [line.text[start:stop] for start, stop in _two_by_two(places)]
        frames = [_frames(part, line) for part in between]
        if None in frames or not any(frames):
            return None
        self._see(line, " ".join(word.group() for word in words))
        return replace(line, text=_WORD.sub(_blank, line.text))

    def _see(self, line: Line, words: str) -> None:
        if self._told:
            self._more += 1
        else:
            self._told = f"line {line.piece.line}: {quoted(words)} beside frames"

    def tell(self) -> None:
        """Say what was passed over, once all lines are read."""
        if self._told:
            more = f", as words on {self._more:,} more lines are" if self._more else ""
            self.note(f"{self._told} is no hex, and is left out{more}")


def _two_by_two(places: Sequence[int]) -> Iterator[tuple[int, int]]:
    return zip(places[::2], places[1::2], strict=True)


def _blank(word: re.Match[str]) -> str:
    return " " * len(word.group())


def _frames(text: str, line: Line) -> bytes | None:
    """Bytes that begin and end as frames do, or none at all; None for any others."""
    try:
        data = bytes_of_line(text, 0, line.piece)
    except InputTextError:
        return None
    return data if not data or (data[0] in _HEADERS and data[-1] == TAIL) else None
