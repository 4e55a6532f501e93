"""Text of any encoding as lines of UTF-8 bytes; very long lines in segments.

UTF-16 and GBK become UTF-8; lines that are neither stay as they are. Colours and NUL are removed.
"""

from __future__ import annotations

import codecs
import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import IO, BinaryIO, Final

BLOCK_BYTES: Final = 1 << 20
"""Bytes of one read at most; a pipe or terminal returns what is available."""

LONGEST_LINE: Final = 16 << 20
"""Bytes of a line that is read as a whole; a longer one comes in segments."""

_SNIFFED: Final = 4096
_MARKS: Final = (
    (codecs.BOM_UTF32_LE, "utf-32-le"),
    (codecs.BOM_UTF8, "utf-8"),
    (codecs.BOM_UTF16_LE, "utf-16-le"),
    (codecs.BOM_UTF16_BE, "utf-16-be"),
)
_COLOUR: Final = re.compile(rb"\x1b(?:\[[0-9;?]*[ -/]*[@-~]|[@-Z\\-_])")
_CONTROL: Final = re.compile(rb"[\x00-\x08\x0e-\x1a\x1c-\x1f]")
_HEX_PAIR: Final = re.compile(rb"[0-9A-Fa-f]{2}")
_FULL_WIDTH: Final = {ord("，"): ",", ord("："): ":", ord("；"): ";", ord("　"): " ", 0xA0: " "}


@dataclass(slots=True)
class TextBlock:
    """Consecutive lines."""

    text: bytes
    first: int
    """The number of the first line, from 1."""
    column: int = 0
    """Bytes of the first line before this block; it is then a segment of a very long line."""
    unfinished: bool = False
    """Whether the last line goes on in the next block."""
    _lines: list[bytes] | None = None

    @property
    def lines(self) -> list[bytes]:
        """The lines without their ends."""
        if self._lines is None:
            self._lines = self.text.splitlines()
        return self._lines


def looks_like_text(first: bytes) -> bool:
    """Whether a stream that begins so is text; raw bytes of the wire always hold control codes."""
    if encoding_of(first) != "utf-8" or first.startswith(codecs.BOM_UTF8):
        return True
    if _CONTROL.search(first):
        return False
    if _decodes(first, "utf-8"):
        return True
    return _HEX_PAIR.search(first) is not None and _decodes(first, "gb18030")


def encoding_of(first: bytes) -> str:
    """The encoding by its mark, or of UTF-16 by the zeros between its letters; else utf-8."""
    for mark, encoding in _MARKS:
        if first.startswith(mark):
            return encoding
    even, odd = first[::2], first[1::2]
    if len(first) > 1 and 0 not in even and 2 * odd.count(0) >= len(odd):
        return "utf-16-le"
    if len(first) > 1 and 0 not in odd and 2 * even.count(0) >= len(even):
        return "utf-16-be"
    return "utf-8"


def _decodes(data: bytes, encoding: str) -> bool:
    try:
        codecs.getincrementaldecoder(encoding)().decode(data)
    except UnicodeDecodeError:
        return False
    return True


def lines_of(data: bytes, encoding: str = "utf-8") -> list[bytes]:
    """The lines of a block of text; a line that is cut at the start of the block stays cut."""
    if encoding != "utf-8":
        data = data.decode(encoding, "replace").lstrip("\ufeff").encode()
    return _clean(data.removeprefix(codecs.BOM_UTF8)).splitlines()


def _clean(data: bytes) -> bytes:
    """The same as UTF-8, without colours and NUL, with plain commas and colons."""
    if b"\x1b" in data:
        data = _COLOUR.sub(b"", data)
    if b"\0" in data:
        data = data.replace(b"\0", b"")
    if data.isascii():
        return data
    if not _decodes(data, "utf-8"):
        data = b"".join(map(_utf8, data.splitlines(keepends=True)))
    if any(mark in data for mark in (b"\xef\xbc", b"\xe3\x80\x80", b"\xc2\xa0")):
        data = (
            data.decode("utf-8", "surrogateescape")
            .translate(_FULL_WIDTH)
            .encode("utf-8", "surrogateescape")
        )
    return data


def _utf8(line: bytes) -> bytes:
    for encoding in ("utf-8", "gb18030"):
        try:
            return line.decode(encoding).encode()
        except UnicodeDecodeError:
            continue
    return line


class TextBlocks:
    """The lines of a stream, in blocks."""

    def __init__(self, stream: BinaryIO | IO[bytes]) -> None:
        self._read = getattr(stream, "read1", stream.read)

    def __iter__(self) -> Iterator[TextBlock]:
        """The blocks, once."""
        first = self._read(BLOCK_BYTES)
        while 0 < len(first) < 4 and (more := self._read(BLOCK_BYTES)):
            first += more
        encoding = encoding_of(first[:_SNIFFED])
        mark = next((m for m, e in _MARKS if e == encoding and first.startswith(m)), b"")
        decoder = None if encoding == "utf-8" else codecs.getincrementaldecoder(encoding)("replace")
        data, number, column, pending = first[len(mark) :], 1, 0, b""
        while True:
            text = data if decoder is None else decoder.decode(data, not data).encode()
            pending += text
            end = len(pending) if not data else _end_of_lines(pending)
            unfinished = data and end == 0 and len(pending) >= LONGEST_LINE
            if unfinished:
                end = _end_of_words(pending)
            if end:
                block = TextBlock(_clean(pending[:end]), number, column, bool(unfinished))
                pending = pending[end:]
                if unfinished:
                    column += end
                else:
                    number, column = number + _line_ends(block.text), 0
                yield block
            if not data:
                return
            data = self._read(BLOCK_BYTES)


def _end_of_lines(data: bytes) -> int:
    """Where the last complete line ends; a carriage return at the end may be half of a line end."""
    newline = data.rfind(b"\n") + 1
    carriage = data.rfind(b"\r", newline, len(data) - 1) + 1
    return max(newline, carriage)


def _line_ends(text: bytes) -> int:
    lone = text.count(b"\r") - text.count(b"\r\n") if b"\r" in text else 0
    return text.count(b"\n") + lone


def _end_of_words(data: bytes) -> int:
    """Where a very long line can be cut: between two words, or two pairs of digits."""
    tail = re.search(rb"[0-9A-Za-z]*\Z", data[-64:])
    end = len(data) - (len(tail[0]) if tail else 0)
    return end if end > len(data) - 64 else len(data) & ~1
