"""Which format a file has; raw bytes.

It must not read a file beyond its first bytes.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from enum import StrEnum
from pathlib import Path
from types import MappingProxyType
from typing import IO, BinaryIO

from fte_sniff.errors import UsageError, unreadable
from fte_sniff.formats.logs.text_lines import looks_like_text
from fte_sniff.protocol import Chunk

MCAP_MAGIC = b"\x89MCAP0\r\n"
"""The first bytes of every MCAP file."""


class InputKind(StrEnum):
    """What a file holds."""

    MCAP = "mcap"
    RAW = "raw"
    HEX = "hex"


KIND_OF_SUFFIX: Mapping[str, InputKind] = MappingProxyType(
    {
        ".mcap": InputKind.MCAP,
        ".bin": InputKind.RAW,
        ".raw": InputKind.RAW,
        ".hex": InputKind.HEX,
        ".txt": InputKind.HEX,
        ".log": InputKind.HEX,
        ".csv": InputKind.HEX,
        ".jsonl": InputKind.HEX,
    }
)
"""The kind that a file's name promises."""


def kind_of_file(path: Path) -> InputKind:
    """What the file holds, by the end of its name, or else by the magic of an MCAP.

    Raises:
        FileError: the file cannot be read.
        UsageError: neither name nor content tells.
    """
    named = KIND_OF_SUFFIX.get(path.suffix.lower())
    if named is not None:
        return named
    try:
        with path.open("rb") as file:
            first = file.read(len(MCAP_MAGIC))
    except OSError as error:
        raise unreadable(path, error) from error
    if first == MCAP_MAGIC:
        return InputKind.MCAP
    names = ", ".join(KIND_OF_SUFFIX)
    raise UsageError(
        f"{path}: the name does not tell what is in it ({names}); say --input {'|'.join(InputKind)}"
    )


def kind_of_content(first: bytes) -> InputKind:
    """What a stream most likely holds, by its first bytes: text is hex, all else is raw bytes."""
    if first.startswith(MCAP_MAGIC):
        return InputKind.MCAP
    return InputKind.HEX if looks_like_text(first) else InputKind.RAW


_PIECE = 1 << 19
"""Bytes that are read at once, at most; of a pipe or a terminal come those that are there."""


def raw_chunks(path: Path) -> Iterator[Chunk]:
    """The chunks of a file of raw bytes.

    Raises:
        FileError: the file cannot be read.
    """
    try:
        with path.open("rb") as file:
            yield from raw_stream_chunks(file, str(path))
    except OSError as error:
        raise unreadable(path, error) from error


def raw_stream_chunks(stream: BinaryIO | IO[bytes], name: str) -> Iterator[Chunk]:
    """The chunks of an open stream of raw bytes, for example standard input."""
    read = getattr(stream, "read1", stream.read)
    while block := read(_PIECE):
        yield Chunk(name, None, block)
