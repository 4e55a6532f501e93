"""Owns pasted text and logs of serial assistants: from lines to bytes, with what is said of them.

It must not know where the text came from. Line by line, and as they come:

    text_lines   text of whatever encoding, to lines
    headed_lines what stands in front of the bytes and above them
    dumps        addresses, and text beside bytes, which are no bytes
    line_numbers neither are numbers of lines
    fronts       what stands before the bytes of every line, and may be none
    decimals     decimal numbers, where they are no hex
    words        words beside frames
    hex_text     the digits

`#` and `//` begin a comment, `/*` and `*/` stand around one; fences of Markdown are passed over.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace

from fte_sniff.formats.logs.decimals import Numbers
from fte_sniff.formats.logs.dumps import Dumps
from fte_sniff.formats.logs.fronts import without_doubtful_fronts
from fte_sniff.formats.logs.headed_lines import HeadedLines
from fte_sniff.formats.logs.hex_text import opened_literal, without_comments
from fte_sniff.formats.logs.line_head import Mark
from fte_sniff.formats.logs.line_time import Stamp
from fte_sniff.formats.logs.pasted_line import Line
from fte_sniff.formats.logs.text_lines import Piece


@dataclass(frozen=True, slots=True)
class Logged:
    """The bytes of a line, and what the line says of them."""

    data: bytes
    line: int
    stamp: Stamp | None
    """The latest time, written on this line or before it."""
    mark: Mark | None


def logged_bytes(
    pieces: Iterable[Piece], note: Callable[[str], None] | None = None
) -> Iterator[Logged]:
    """The bytes of each line that has any.

    Raises:
        InputTextError: something cannot be read; the message names the line.
    """
    tell = note or _unheard
    bare = _uncommented(Dumps(tell).lines(HeadedLines(tell).of(_closed(pieces))))
    read = Numbers(tell).bytes_of(without_doubtful_fronts(bare, tell))
    for line, data in read:
        if data:
            yield Logged(data, line.piece.line, line.stamp, line.mark)


_MAY_OPEN = re.compile(r"['\"]|/\*")
"""A literal or a comment may begin here that goes on behind the piece."""


def _unheard(_line: str) -> None:
    pass


def _closed(pieces: Iterable[Piece]) -> Iterator[Piece]:
    """The pieces, Python's bytes literals that go on in the next piece of their line as two."""
    held: Piece | None = None
    quote = None
    inside, ended = False, 0
    for piece in pieces:
        if held is not None and quote is not None and piece.column:
            yield replace(held, text=held.text + quote)
            reopened = f"b{quote}"
            piece = Piece(reopened + piece.text, piece.line, piece.column - len(reopened))
        elif held is not None:
            yield held
        quote = None
        if piece.line != ended and (inside or _MAY_OPEN.search(piece.text)):
            bare, inside, ends = without_comments(piece.text, 0, inside=inside)
            ended = piece.line if ends else ended
            quote = opened_literal(bare)
        held = piece if quote is not None else None
        if held is None:
            yield piece
    if held is not None:
        yield held


def _uncommented(lines: Iterable[Line]) -> Iterator[Line]:
    """The same lines, with blanks where comments stood."""
    ended = 0
    inside = False
    for line in lines:
        if line.data is not None or (line.pairs and not inside and line.piece.line != ended):
            yield line
        elif line.piece.line != ended:
            text, inside, ends = without_comments(line.text, line.at, inside=inside)
            ended = line.piece.line if ends else ended
            yield replace(line, text=text)
