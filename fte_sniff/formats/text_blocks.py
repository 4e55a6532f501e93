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
from pathlib import Path
from typing import IO, BinaryIO, Final

BLOCK_BYTES: Final = 1 << 20
"""Bytes of one read at most; a pipe or terminal returns what is available."""
LONGEST_LINE: Final = 16 << 20
"""Bytes of a line that is read as a whole; a longer one comes in segments."""
_SAMPLE_BYTES: Final = 10 << 10
"""Bytes of each of the four blocks of a sample of a file."""
_LONGEST_SAMPLED: Final = 4096
_SNIFFED: Final = 4096
"""Bytes that show the encoding."""
_INVISIBLE: Final = rb"\x1b(?:\[[0-9;?]*[ -/]*[@-~]|[@-Z\\-_])|\0"
"""Colours and other escape sequences, and NUL."""
_CONTROL: Final = rb"[\x00-\x08\x0e-\x1a\x1c-\x1f]"
_PLAIN: Final = {"\ufeff": "", "，": ",", "：": ":", "；": ";", "\u3000": " ", "\xa0": " "}


@dataclass
class TextBlock:
    """Consecutive lines, or a segment of a very long line."""

    text: bytes
    first: int = 1
    """The number of the first line, from 1."""
    column: int | None = None
    """Of a segment: bytes of the line before it."""

    @cached_property
    def count(self) -> int:
        """How many lines end in it."""
        return self.text.count(b"\n")

    @cached_property
    def lines(self) -> list[bytes]:
        """The lines without their ends."""
        return self.text.removesuffix(b"\n").split(b"\n") if self.text else []


def is_text(first: bytes) -> bool:
    """Whether a stream that begins so is text; raw bytes of the wire always hold control codes."""
    if _encoding_of(first) != "utf-8" or first.startswith(codecs.BOM_UTF8):
        return True
    with_digits = re.search(rb"[0-9A-Fa-f]{2}", first) and _decoded(first, "gb18030")
    return not re.search(_CONTROL, first) and bool(with_digits or _decoded(first, "utf-8"))


def _encoding_of(first: bytes) -> str:
    """The encoding: UTF-16 by its mark, or by the zeros between its letters; else utf-8."""
    for encoding, mark, low in (
        ("utf-16-le", codecs.BOM_UTF16_LE, 0),
        ("utf-16-be", codecs.BOM_UTF16_BE, 1),
    ):
        letters, high = first[low::2], first[1 - low :: 2]
        zeros = 0 not in letters and 2 * high.count(0) >= max(len(high), 1)
        if zeros or first.startswith(mark):
            return encoding
    return "utf-8"


def _lines_of(data: bytes, encoding: str) -> list[bytes]:
    """The lines of a part of a text; the first and the last may be cut."""
    text = data if encoding == "utf-8" else data.decode(encoding, "replace").encode()
    return TextBlock(_clean(text)).lines


def text_blocks(stream: BinaryIO | IO[bytes]) -> Iterator[TextBlock]:
    """The lines of a stream."""
    read = getattr(stream, "read1", stream.read)
    data = read(BLOCK_BYTES)
    while 0 < len(data) < 4 and (more := read(BLOCK_BYTES)):
        data += more
    encoding = _encoding_of(data[:_SNIFFED])
    decoder = None if encoding == "utf-8" else codecs.getincrementaldecoder(encoding)("replace")
    number, column, pending = 1, None, b""
    while data or pending:
        pending += data if decoder is None else decoder.decode(data, not data).encode()
        end = _end_of_lines(pending) if data else len(pending)
        is_cut = not end and len(pending) >= LONGEST_LINE
        if is_cut:
            end, column = _end_of_words(pending), column or 0
        elif end and column is not None:  # the end of a very long line is a segment too
            end = pending.find(b"\n") + 1 or end
        if end:
            text = _clean(pending[:end])
            text += b"" if is_cut or text.endswith(b"\n") else b"\n"
            yield (block := TextBlock(text, number, column))
            number += block.count
            column = column + end if is_cut and column is not None else None
            pending = pending[end:]
        data = data and read(BLOCK_BYTES)


def sample(path: Path) -> list[bytes]:
    """Lines of four blocks of a file, without what is cut; all of a small one."""
    found, size = list[bytes](), path.stat().st_size
    with path.open("rb") as file:
        encoding = _encoding_of(file.read(_SNIFFED))
        file.seek(0)
        if size <= 4 * _SAMPLE_BYTES:
            return _lines_of(file.read(), encoding)
        for number in range(4):
            file.seek((size - _SAMPLE_BYTES) * number // 3 & ~1)  # even, for UTF-16
            lines = _lines_of(file.read(_SAMPLE_BYTES), encoding)
            if len(lines) > 2:
                lines = lines[number > 0 : len(lines) - (number < 3)]
            elif number and lines:  # within a very long line
                lines[:1] = lines[0].split(None, 1)[-1:]
            found += map(first_words, lines)
    return found


def first_words(line: bytes) -> bytes:
    """The first words of a long line."""
    end = line.rfind(b" ", 0, _LONGEST_SAMPLED) if len(line) > _LONGEST_SAMPLED else -1
    return line[: end if end > 0 else _LONGEST_SAMPLED]


def _decoded(data: bytes, encoding: str) -> bytes | None:
    """The text as UTF-8, whose end may be cut; None if it has another encoding."""
    with suppress(UnicodeDecodeError):
        return codecs.getincrementaldecoder(encoding)().decode(data).encode()
    return None


def _clean(data: bytes) -> bytes:
    """Lines as UTF-8, without colours and NUL, with plain commas, colons and line ends."""
    if b"\r" in data:
        data = data.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    if b"\x1b" in data or b"\0" in data:
        data = re.sub(_INVISIBLE, b"", data)
    if data.isascii():
        return data
    if _decoded(data, "utf-8") is None:
        lines = data.splitlines(keepends=True)
        data = b"".join(_decoded(x, "utf-8") or _decoded(x, "gb18030") or x for x in lines)
    for character, plain in _PLAIN.items():
        data = data.replace(character.encode(), plain.encode())
    return data


def _end_of_lines(data: bytes) -> int:
    """Where the last complete line ends; a carriage return at the end may be half of a line end."""
    return max(data.rfind(b"\n"), data.rfind(b"\r", 0, len(data) - 1)) + 1


def _end_of_words(data: bytes) -> int:
    """Where a very long line can be cut: between two words, or two pairs of digits."""
    word = re.search(rb"[0-9A-Za-z]*\Z", data[-64:])
    size = len(word[0]) if word else 0
    return len(data) - size if size < 64 else len(data) & ~1
