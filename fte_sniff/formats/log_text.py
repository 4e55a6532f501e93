"""The text of a log as blocks of whole lines, from UTF-8, UTF-16 or GBK.

Colours and NUL are removed. A block of NUL, which a power cut leaves in a file, becomes
a line that says so.
"""

from __future__ import annotations

import codecs
import re
from collections.abc import Callable, Iterator
from contextlib import nullcontext
from pathlib import Path
from typing import BinaryIO, Final

from fte_sniff.errors import unreadable

_BLOCK: Final = 1 << 20
"""Bytes of one read at most; a pipe or terminal returns what is available."""
LONGEST_LINE: Final = 16 << 20
"""Bytes of a line; a longer one is cut at a space."""
_NULS: Final = re.compile(rb"\0{16,}")
_ESCAPE: Final = re.compile(r"\x1b(?:\[[0-9;?]*[ -/]*[@-~]|[@-Z\\-_])")
_CONTROL: Final = re.compile(r"[\x00-\x08\x0e-\x1a\x1c-\x1f]")
_PLAIN: Final = str.maketrans(
    {"\ufeff": None, "，": ",", "：": ":", "；": ";", "\u3000": " ", "\xa0": " ", "\0": None}
)
_MARKS: Final = {codecs.BOM_UTF16_LE: "utf-16-le", codecs.BOM_UTF16_BE: "utf-16-be"}


def text_blocks(source: BinaryIO | Path) -> Iterator[str]:
    """Blocks that end with a line; one that ends within a line is a part of a very long one.

    Raises FileError if a file cannot be read.
    """
    try:
        with source.open("rb") if isinstance(source, Path) else nullcontext(source) as stream:
            yield from map(_cleaned, _line_blocks(getattr(stream, "read1", stream.read)))
    except OSError as error:
        raise unreadable(source, error) from error


def _line_blocks(read: Callable[[int], bytes]) -> Iterator[bytes]:
    data, pending = read(_BLOCK), b""
    encoding = _MARKS.get(data[:2], "")
    decoder = codecs.getincrementaldecoder(encoding)("replace") if encoding else None
    while data:
        pending += data if decoder is None else decoder.decode(data).encode()
        end = pending.rfind(b"\n") + 1
        if not end and len(pending) > LONGEST_LINE:
            end = pending.rfind(b" ") + 1 or len(pending)
        if end:
            yield pending[:end]
            pending = pending[end:]
        data = read(_BLOCK)
    if pending:
        yield pending


def _cleaned(data: bytes) -> str:
    text = _decoded(_NULS.sub(b"\n# skipped NUL bytes, as a power cut leaves them\n", data))
    return _ESCAPE.sub("", text).translate(_PLAIN)


def _decoded(data: bytes) -> str:
    """UTF-8, else each line as GBK; bytes that are neither become U+FFFD."""
    try:
        return data.decode()
    except UnicodeDecodeError:
        lines = data.splitlines(keepends=True)
        if len(lines) > 1:
            return "".join(map(_decoded, lines))
        return data.decode("gb18030", "replace")


def is_text(first: bytes) -> bool:
    """Whether a stream that begins so is text; raw bytes of the wire always hold control codes."""
    first = _NULS.sub(b"", first)
    if first[:2] in _MARKS or not first:
        return True
    decoded = _decoded(first[:-4] if len(first) > 64 else first)
    return not _CONTROL.search(decoded) and "\ufffd" not in decoded
