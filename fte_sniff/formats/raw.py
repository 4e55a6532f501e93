"""Owns reading files and streams of raw bytes as chunks.

It must not know what the bytes mean.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import IO, BinaryIO

from fte_sniff.errors import unreadable
from fte_sniff.protocol import Chunk

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
