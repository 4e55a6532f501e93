"""Owns pasted text and logs of serial assistants: from lines to bytes, with what is said of them.

It must not know where the text came from. Line by line, and as they come:

    text_lines   text of whatever encoding, to lines
    line_head    a time and a direction in front
    code         words of source code around the bytes
    dumps        addresses, and text beside bytes, which are no bytes
    line_numbers nor are numbers of lines
    fronts       what stands before the bytes of every line, and may be none
    decimals     decimal numbers, where they are no hex
    hex_text     the digits

`#` and `//` begin a comment, `/*` and `*/` stand around one; fences of Markdown are passed over.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace

from fte_sniff.errors import InputTextError
from fte_sniff.formats.logs.code import ESCAPES, without_code
from fte_sniff.formats.logs.decimals import Numbers
from fte_sniff.formats.logs.dumps import Dumps
from fte_sniff.formats.logs.fronts import without_doubtful_fronts
from fte_sniff.formats.logs.headings import heading
from fte_sniff.formats.logs.hex_text import opened_literal, without_comments
from fte_sniff.formats.logs.line_head import Mark, head_of
from fte_sniff.formats.logs.line_time import Stamp
from fte_sniff.formats.logs.pasted_line import Line
from fte_sniff.formats.logs.text_lines import Piece

_FENCE = re.compile(r"\s*(?:(?:```|~~~)[\w-]*|[\u2500-\u257f]{3,})\s*")
_PAIRS = re.compile(r"[ \t]*(?:[0-9A-Fa-f]{2}[ \t]+)*[0-9A-Fa-f]{2}[ \t]*")
_WIDE: dict[int, int] = {
    **{wide: wide - 0xFEE0 for wide in range(0xFF01, 0xFF5F)},
    **dict(zip(map(ord, "【】「」『』、。"), map(ord, "[][][],."), strict=True)),
    **dict.fromkeys((0x201C, 0x201D, 0x2018, 0x2019), ord('"')),
    **dict.fromkeys((0x3000, 0xFEFF, 0x200B), ord(" ")),
}
"""What Chinese keyboards write, one for one, so that columns stay."""


@dataclass(frozen=True, slots=True)
class Logged:
    """The bytes of a line, and what the line says of them."""

    data: bytes
    line: int
    stamp: Stamp | None
    """The latest time, written on this line or before it."""
    mark: Mark | None


def bytes_of_text(text: str, note: Callable[[str], None] | None = None) -> bytes:
    """All the bytes that `text` writes.

    Args:
        text: as it was pasted.
        note: is told, in one line, what was doubtful.

    Raises:
        InputTextError: something cannot be read; the message names the line.
    """
    lines = enumerate(text.splitlines(), start=1)
    pieces = (Piece(line, number, 0) for number, line in lines)
    return b"".join(logged.data for logged in logged_bytes(pieces, note))


def logged_bytes(
    pieces: Iterable[Piece], note: Callable[[str], None] | None = None
) -> Iterator[Logged]:
    """The bytes of each line that has any.

    Raises:
        InputTextError: something cannot be read; the message names the line.
    """
    tell = note or _unheard
    bare = _uncommented(Dumps(tell).lines(_headed(_closed(pieces))))
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


def _headed(pieces: Iterable[Piece]) -> Iterator[Line]:
    """The lines behind their heads.

    A time holds up to the next one; a direction only where it stands on a line of its own.
    """
    stamp: Stamp | None = None
    mark: Mark | None = None
    for piece in pieces:
        text = piece.text if piece.text.isascii() else piece.text.translate(_WIDE)
        pairs = _PAIRS.fullmatch(text) is not None
        if piece.column or pairs:
            yield Line(piece, text, 0, stamp, mark, pairs)
            continue
        if _FENCE.fullmatch(text):
            continue
        if "\x1b" in text:
            text = ESCAPES.sub("", text)
            piece = replace(piece, text=text)
        text = without_code(text)
        head = heading(text) or head_of(text, timed=stamp is not None)
        if head.wrong_count:
            raise InputTextError(
                f"line {piece.line}: {head.wrong_count} may be a byte, or a count that the bytes"
                " beside it do not come to; delete it, or set it as far apart as they are"
            )
        stamp = head.stamp or stamp
        text = text[: head.stop]
        if text[head.end :].strip():
            pairs = _PAIRS.fullmatch(text, head.end) is not None
            yield Line(piece, text, head.end, stamp, head.mark or mark, pairs)
            mark = None if head.mark or head.stamp else mark
        elif head.mark or head.stamp:
            mark = head.mark


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
