"""Text of any encoding as lines of UTF-8 bytes that end in a newline.

UTF-16 and GBK become UTF-8; lines that are neither stay as they are. Colours and NUL are removed. A
line of more than 16 MB comes in segments, so that memory does not depend on the length of lines.
"""

from __future__ import annotations

import codecs
import re
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from typing import IO, BinaryIO, Final

BLOCK_BYTES: Final = 1 << 20
"""Bytes of one read at most; a pipe or terminal returns what is available."""

LONGEST_LINE: Final = 16 << 20
"""Bytes of a line that is read as a whole; a longer one comes in segments."""

_SNIFFED: Final = 4096
_BY_MARK: Final = {
    codecs.BOM_UTF16_LE: "utf-16-le",
    codecs.BOM_UTF16_BE: "utf-16-be",
}
_INVISIBLE: Final = rb"\x1b(?:\[[0-9;?]*[ -/]*[@-~]|[@-Z\\-_])|\0"
"""Colours and other escape sequences, and NUL."""
_CONTROL: Final = rb"[\x00-\x08\x0e-\x1a\x1c-\x1f]"
_FULL_WIDTH: Final = {"，": ",", "：": ":", "；": ";", "\u3000": " ", "\xa0": " "}


@dataclass
class TextBlock:
    """Consecutive lines."""

    text: bytes
    first: int = 1
    """The number of the first line, from 1."""
    column: int = 0
    """Bytes of the first line before this block; it is then a segment of a very long line."""
    unfinished: bool = False
    """Whether the last line goes on in the next block."""

    @cached_property
    def count(self) -> int:
        """How many lines end in it."""
        return self.text.count(b"\n")

    @cached_property
    def lines(self) -> list[bytes]:
        """The lines without their ends."""
        return self.text.removesuffix(b"\n").split(b"\n") if self.text else []


def looks_like_text(first: bytes) -> bool:
    """Whether a stream that begins so is text; raw bytes of the wire always hold control codes."""
    if encoding_of(first) != "utf-8" or first.startswith(codecs.BOM_UTF8):
        return True
    has_pair = re.search(rb"[0-9A-Fa-f]{2}", first) is not None
    encodings = ("utf-8", "gb18030") if has_pair else ("utf-8",)
    return not re.search(_CONTROL, first) and any(_decodes(first, one) for one in encodings)


def encoding_of(first: bytes) -> str:
    """The encoding by its mark, or of UTF-16 by the zeros between its letters; else utf-8."""
    for mark, encoding in _BY_MARK.items():
        if first.startswith(mark):
            return encoding
    zeros = [2 * first[start::2].count(0) >= max(len(first[start::2]), 1) for start in (0, 1)]
    if zeros == [False, True] and 0 not in first[::2]:
        return "utf-16-le"
    return "utf-16-be" if zeros == [True, False] and 0 not in first[1::2] else "utf-8"


def _decodes(data: bytes, encoding: str) -> bool:
    with suppress(UnicodeDecodeError):
        return codecs.getincrementaldecoder(encoding)().decode(data) is not None
    return False


def lines_of(data: bytes, encoding: str) -> list[bytes]:
    """The lines of a part of a text; the first and the last may be cut."""
    text = data if encoding == "utf-8" else data.decode(encoding, "replace").encode()
    return TextBlock(_clean(text)).lines


def _clean(data: bytes) -> bytes:
    """Lines as UTF-8, without colours and NUL, with plain commas, colons and line ends."""
    if b"\r" in data:
        data = data.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    if b"\x1b" in data or b"\0" in data:
        data = re.sub(_INVISIBLE, b"", data)
    if data.isascii():
        return data
    data = data.replace(codecs.BOM_UTF8, b"")
    if not _decodes(data, "utf-8"):
        data = b"".join(map(_utf8, data.splitlines(keepends=True)))
    for wide, plain in _FULL_WIDTH.items():
        data = data.replace(wide.encode(), plain.encode())
    return data


def _utf8(line: bytes) -> bytes:
    for encoding in ("utf-8", "gb18030"):
        with suppress(UnicodeDecodeError):
            return line.decode(encoding).encode()
    return line


class TextBlocks:
    """The lines of a stream, in blocks."""

    def __init__(self, stream: BinaryIO | IO[bytes]) -> None:
        self._read = getattr(stream, "read1", stream.read)

    def __iter__(self) -> Iterator[TextBlock]:
        """The blocks, once."""
        data = self._read(BLOCK_BYTES)
        while 0 < len(data) < 4 and (more := self._read(BLOCK_BYTES)):
            data += more
        encoding = encoding_of(data[:_SNIFFED])
        decoder = None if encoding == "utf-8" else codecs.getincrementaldecoder(encoding)("replace")
        number, column, pending = 1, 0, b""
        while True:
            pending += data if decoder is None else decoder.decode(data, not data).encode()
            end = _end_of_lines(pending) if data else len(pending)
            if column and end:  # the rest of a very long line is a block
                end = pending.find(b"\n") + 1 or end
            unfinished = bool(data) and not end and len(pending) >= LONGEST_LINE
            if unfinished:
                end = _end_of_words(pending)
            if end:
                text = _clean(pending[:end])
                if not unfinished and not text.endswith(b"\n"):
                    text += b"\n"
                block = TextBlock(text, number, column, unfinished)
                yield block
                column = column + end if unfinished else 0
                number += block.count
                pending = pending[end:]
            if data:
                data = self._read(BLOCK_BYTES)
            elif not pending:
                return


def _end_of_lines(data: bytes) -> int:
    """Where the last complete line ends; a carriage return at the end may be half of a line end."""
    return max(data.rfind(b"\n"), data.rfind(b"\r", 0, len(data) - 1)) + 1


def _end_of_words(data: bytes) -> int:
    """Where a very long line can be cut: between two words, or two pairs of digits."""
    word = re.search(rb"[0-9A-Za-z]*\Z", data[-64:])
    size = len(word[0]) if word else 0
    return len(data) - size if size < 64 else len(data) & ~1
