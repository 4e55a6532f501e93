"""Owns reading text of whatever encoding as lines: UTF-8, UTF-16, and GBK as on Chinese Windows.

It must not know what the lines say.
"""

from __future__ import annotations

import codecs
import re
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import chain
from typing import IO, BinaryIO

from fte_sniff.errors import FileError

LONGEST_PIECE = 1 << 20
"""Bytes of a line that are handed on at once, at most."""

_BLOCK = 1 << 18
_SNIFFED = 4
_MARKS = (
    (codecs.BOM_UTF32_LE, "utf-32-le"),
    (codecs.BOM_UTF8, "utf-8"),
    (codecs.BOM_UTF16_LE, "utf-16-le"),
    (codecs.BOM_UTF16_BE, "utf-16-be"),
)
_LINE_END = re.compile(rb"\r\n|\n|\r(?!\Z)")
_LAST_BETWEEN = re.compile(
    r".*(?:[^\w\\$&%#/*.+=\-\uFF04\uFF06\uFF05\uFF0B\uFF0D]|(?<=\w)-|(?<=\w)\.(?=\w))",
    re.DOTALL,
)
"""Up to the last character that is no part of a word, an escape, a signed number or a comment."""
_UNITS = re.compile(
    r"(?:(?=.{6})(?:\\x[0-9A-Fa-f]{2}|\\u[0-9A-Fa-f]{4}|\\[0-7]{1,3}|\\."
    r"|&[hH][0-9A-Fa-f]{2}|[$%]?\w{2}|.))*+",
    re.DOTALL,
)
"""Escapes and pairs of digits, up to a few characters before the end: none is seen in part."""
_CONTROL = re.compile(rb"[\x00-\x08\x0e-\x1a\x1c-\x1f]")
_PAIR = re.compile(rb"[0-9A-Fa-f]")
_PLAIN_LINES = re.compile(rb"(?:[0-9A-Fa-f]{2}(?:[ \t][0-9A-Fa-f]{2})*+[ \t]?\r?\n){2,}+")


@dataclass(frozen=True, slots=True)
class Piece:
    """A line of text, a part of a very long one, or several plain lines.

    Those that hold nothing but pairs of digits, one character between two, need not be looked at
    one by one: none of them says how another is to be read.
    """

    text: str
    line: int
    """Number of the line, from 1; of the first of several."""
    column: int
    """Characters of the line before this piece."""
    lines: int = 1
    """How many they are, each then with its end."""

    def each(self) -> Iterator[Piece]:
        """The lines one by one."""
        if self.lines == 1:
            yield self
            return
        for number, text in enumerate(self.text.splitlines(), self.line):
            yield Piece(text, number, 0)


def looks_like_text(first: bytes) -> bool:
    """Whether a stream that begins so is text; raw bytes of the wire always hold control codes."""
    if encoding_of(first) != "utf-8" or first.startswith(codecs.BOM_UTF8):
        return True
    if _CONTROL.search(first):
        return False
    if _decodes(first, "utf-8"):
        return True
    return bool(_PAIR.search(first)) and _decodes(first, "gb18030")


def encoding_of(first: bytes) -> str:
    """The encoding by its mark, or of UTF-16 by the zeros between its letters; else utf-8."""
    for mark, encoding in _MARKS:
        if first.startswith(mark):
            return encoding
    even, odd = first[::2], first[1::2]
    if not first or len(first) < 2:
        return "utf-8"
    if 0 not in even and 2 * odd.count(0) >= len(odd) and _prints(first, "utf-16-le"):
        return "utf-16-le"
    if 0 not in odd and 2 * even.count(0) >= len(even) and _prints(first, "utf-16-be"):
        return "utf-16-be"
    return "utf-8"


def _decodes(data: bytes, encoding: str) -> bool:
    try:
        codecs.getincrementaldecoder(encoding)().decode(data)
    except UnicodeDecodeError:
        return False
    return True


def _prints(data: bytes, encoding: str) -> bool:
    """Whether it is text in this encoding, and nothing but what is printed and line ends."""
    try:
        text = codecs.getincrementaldecoder(encoding)().decode(data)
    except UnicodeDecodeError:
        return False
    return all(letter.isprintable() or letter.isspace() for letter in text)


class TextPieces:
    """The lines of a stream, very long ones in several pieces, never cut within a word."""

    def __init__(self, stream: BinaryIO | IO[bytes], name: str) -> None:
        self._stream = stream
        self._name = name
        self.drained = False
        """Whether the piece behind the latest has to be read first."""

    def __iter__(self) -> Iterator[Piece]:
        """The pieces, once.

        Raises:
            FileError: it is no text.
        """
        number, column, name = 1, 0, self._name
        for part, whole, lines in self._parts(_utf8_blocks(self._stream, name)):
            if b"\0" in part:
                raise FileError(
                    f"{name}: holds no text (a zero byte in line {number}); if it holds raw bytes,"
                    " add --input raw"
                )
            text = _text(part, name, number)
            yield Piece(text, number, column, lines)
            number, column = (number + lines, 0) if whole else (number, column + len(text))

    def _parts(self, blocks: Iterator[bytes]) -> Iterator[tuple[bytes, bool, int]]:
        """Lines without their ends, several plain ones at once, and pieces of those that are too
        long; whether it ends a line, and how many lines it is.
        """
        held = b""
        for block in blocks:
            begun = len(held)
            held += block
            start = 0
            for part, stop, lines in _lines(held, max(0, begun - 1)):
                self.drained = stop == len(held)
                yield part, True, lines
                start = stop
            held = held[start:]
            self.drained = False
            while len(held) > LONGEST_PIECE:
                cut = _cut(held[:LONGEST_PIECE])
                yield held[:cut], False, 1
                held = held[cut:]
        if held.endswith(b"\r"):
            yield held[:-1], True, 1
        elif held:
            yield held, True, 1


def _lines(held: bytes, seen: int) -> Iterator[tuple[bytes, int, int]]:
    """The whole lines of some bytes, before `seen` of which none ends: each without its end, where
    the next one begins, and 1; or several plain ones, and how many they are.
    """
    start = 0
    while True:
        if plain := _PLAIN_LINES.match(held, start):
            lines = plain.group()
            start = seen = plain.end()
            yield lines, start, lines.count(b"\n")
            continue
        end = _LINE_END.search(held, max(start, seen))
        if end is None:
            return
        yield held[start : end.start()], end.end(), 1
        start = end.end()


def _utf8_blocks(stream: BinaryIO | IO[bytes], name: str) -> Iterator[bytes]:
    """The stream's bytes, those in UTF-16 as UTF-8, without a mark in front.

    Raises:
        FileError: it ends within a character of UTF-16.
    """
    read = getattr(stream, "read1", stream.read)
    first, block = b"", b"?"
    while len(first) < _SNIFFED and (block := read(_BLOCK)):
        first += block
    encoding = encoding_of(first)
    # What has ended is not read again: a terminal would ask for another Ctrl-D.
    blocks = chain([first], iter(lambda: read(_BLOCK), b"") if block else ())
    if encoding == "utf-8":
        yield next(blocks).removeprefix(codecs.BOM_UTF8)
        yield from blocks
        return
    decoder = codecs.getincrementaldecoder(encoding)(errors="replace")
    for block in blocks:
        yield decoder.decode(block).removeprefix("\ufeff").encode("utf-8", "replace")
    if decoder.getstate()[0]:
        raise FileError(
            f"{name}: ends within a character ({encoding.upper()[:6]}), so it is cut short; save or"
            " copy it again, or save what there is as UTF-8"
        )


def _cut(window: bytes) -> int:
    """Where a piece of a very long line can end, so that nothing which is read as one is split.

    That is behind what stands between words; in a word that is as long, behind a whole escape, or
    an even count of digits.
    """
    text, encoding = _begun(window)
    between = _LAST_BETWEEN.match(text)
    units = between or _UNITS.match(text)
    cut = units.end() if units and units.end() else len(text)
    return len(text[:cut].encode(encoding))


def _begun(window: bytes) -> tuple[str, str]:
    """The whole characters of bytes that end anywhere, and their encoding."""
    for encoding in ("utf-8", "gb18030"):
        try:
            return codecs.getincrementaldecoder(encoding)().decode(window), encoding
        except UnicodeDecodeError:
            continue
    return window.decode("latin-1"), "latin-1"


def _text(line: bytes, name: str, number: int) -> str:
    # Serial assistants on Chinese Windows write GBK; nothing but the words around the hex needs it.
    for encoding in ("utf-8", "gb18030"):
        try:
            return line.decode(encoding)
        except UnicodeDecodeError as error:
            wrong = error.object[error.start]
    raise FileError(
        f"{name}: line {number} is text in neither UTF-8, UTF-16 nor GBK (byte {wrong:02X});"
        " save the log as UTF-8, or add --input raw if it holds raw bytes"
    )
