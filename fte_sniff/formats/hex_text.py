r"""Owns hex as people write and paste it: from text to bytes.

It must not know where the text came from, nor what the bytes mean, save those that begin a frame.

Accepted: digits in pairs, together or apart (`AA0202`, `AA 02 02`), a lone digit that stands by
itself (`AA 2 2`), `0x` and `\x` in front, any of `, ; : - |` and brackets and quotes between, a
Python bytes literal (`b"\xaa\x02..."`), upper or lower case, any number of lines; `#` and `//`
begin a comment. A line may start with what serial assistants put there: a time, and words or arrows
for the direction.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from fte_sniff.errors import InputTextError
from fte_sniff.protocol import HEADERS

_COMMENT = re.compile(r"#|//")
_DIRECTION = (
    r"(?:(?:RX|TX|RECV|RECEIVED?|SEND|SENT|IN|OUT)(?![A-Za-z0-9])|接收|发送|收|发"
    r"|[→←↑↓◆◇►◄▶◀>=＞＜<-]+)"
)
_HEADER = "|".join(f"{header:02X}" for header in HEADERS.values())
_CLOCK = r"\d{1,2}:\d{2}:\d{2}"
_DATE = r"\d{4}[-/]\d{1,2}[-/]\d{1,2}[T ]"
_TIME = (
    rf"(?:[\[(【]\s*(?:{_DATE})?{_CLOCK}(?:[.,:]\d+)?Z?\s*[\])】]"  # in brackets
    rf"|{_DATE}{_CLOCK}(?:[.,]\d+)?Z?(?![\w:])"  # with a date
    rf"|{_CLOCK}[.,]\d+(?![\w:])"  # with a fraction of a second
    rf"|{_CLOCK}(?=\s*{_DIRECTION})"  # before a direction
    rf"|{_CLOCK}(?=\s+(?:0x)?(?:{_HEADER})\b))"  # before what begins a frame
)
_LINE_START = re.compile(
    rf"\s*(?:{_TIME}\s*(?:#\s*(?={_DIRECTION}))?)?"
    rf"(?:[\[(【]?{_DIRECTION}[\])】]?\s*(?:HEX\b)?\s*)*[:：]?\s*"
    r"(?:[a-z_][\w\s*]*(?:\[\d*\])?\s*=\s*(?=[\[{(b]))?",
    re.IGNORECASE,
)
_BYTES_LITERAL = re.compile(
    r"""(?<![0-9a-z])b(?:'(?:[^'\\]|\\.)*'|"(?:[^"\\]|\\.)*")""", re.IGNORECASE
)
_WORD = re.compile(r"(?:0x|\\x)?([0-9a-f]+)(?:h(?![0-9a-z]))?", re.IGNORECASE)
_BETWEEN = re.compile(r"[\s,;:|\-\[\](){}\"'<>，；：、.□\u00a0\ufeff]+|bytearray(?=\()|bytes(?=\()")


def bytes_of_text(text: str) -> bytes:
    """All the bytes that `text` writes in hex.

    Raises:
        InputTextError: something is not hex; the message names line, column and the character.
    """
    lines = enumerate(text.splitlines(), start=1)
    return b"".join(bytes_of_pieces(Piece(line, number, 0) for number, line in lines))


@dataclass(frozen=True, slots=True)
class Piece:
    """A line of text, or a part of a very long one."""

    text: str
    line: int
    """Number of the line, from 1."""
    column: int
    """Characters of the line before this piece."""


def bytes_of_pieces(pieces: Iterable[Piece]) -> Iterator[bytes]:
    """The bytes of each piece, one item for each that has any.

    Raises:
        InputTextError: something is not hex; the message names line, column and the character.
    """
    commented = 0
    for piece in pieces:
        if piece.line == commented:
            continue
        found, ends_in_comment = _bytes_of_piece(piece)
        if ends_in_comment:
            commented = piece.line
        if found:
            yield found


def _bytes_of_piece(piece: Piece) -> tuple[bytes, bool]:
    """The bytes, and whether a comment goes on to the end of the line."""
    found = bytearray()
    line = piece.text
    start = _LINE_START.match(line) if piece.column == 0 else None
    at = start.end() if start else 0
    while at < len(line):
        if _COMMENT.match(line, at):
            return bytes(found), True
        if between := _BETWEEN.match(line, at):
            at = between.end()
        elif literal := _BYTES_LITERAL.match(line, at):
            found += _bytes_of_literal(literal.group(), piece, at)
            at = literal.end()
        elif word := _WORD.match(line, at):
            found += _bytes_of_word(word, piece)
            at = word.end()
        else:
            raise _not_hex(piece, at, "is no hex digit")
    return bytes(found), False


def _bytes_of_word(word: re.Match[str], piece: Piece) -> bytes:
    digits = word.group(1)
    if len(digits) == 1:
        after = word.string[word.end() : word.end() + 1]
        if not after or _BETWEEN.match(after):
            return bytes([int(digits, 16)])
    if len(digits) % 2:
        # An odd digit run may simply end in a character that is no digit: point at that one.
        after = word.string[word.end() : word.end() + 1]
        if after and not _BETWEEN.match(after):
            raise _not_hex(piece, word.end(), "is no hex digit")
        raise _not_hex(piece, word.end() - 1, "has no second digit to make a byte")
    return bytes.fromhex(digits)


def _bytes_of_literal(literal: str, piece: Piece, at: int) -> bytes:
    from ast import literal_eval

    try:
        value = literal_eval(literal)
    except (SyntaxError, ValueError) as error:
        raise _not_hex(piece, at, "starts a bytes literal that Python cannot read") from error
    return bytes(value)


def _not_hex(piece: Piece, at: int, why: str) -> InputTextError:
    line = piece.text
    before, here, after = line[max(0, at - 12) : at], line[at], line[at + 1 : at + 12]
    return InputTextError(
        f"not hex: {here!r} {why}, line {piece.line}, column {piece.column + at + 1}:"
        f" {before}>>{here}<<{after}"
        " (write bytes as hex digits, like AA 01 01 03 E8 00 00 00 00 EE; # starts a comment)"
    )
