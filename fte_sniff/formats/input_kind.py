"""The format of an input, by its name or its first bytes; chunks of raw bytes."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from enum import StrEnum
from pathlib import Path
from types import MappingProxyType
from typing import IO, BinaryIO

from fte_sniff.errors import UsageError, unreadable
from fte_sniff.protocol import DEFAULT_BAUD, Chunk, byte_time_ns

MCAP_MAGIC = b"\x89MCAP0\r\n"
"""The first bytes of an MCAP file."""

PARQUET_MAGIC = b"PAR1"
"""The first bytes of a Parquet file."""


_FIRST = 4096
"""Bytes that show the format of a file."""


class InputKind(StrEnum):
    """The format of an input."""

    MCAP = "mcap"
    RAW = "raw"
    HEX = "hex"
    PARQUET = "parquet"


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
        ".parquet": InputKind.PARQUET,
    }
)
"""By file name suffix, in lower case."""


def kind_of_file(path: Path) -> InputKind:
    """Return the format of a file by its suffix, or by its first bytes if it is MCAP or text.

    Raises FileError if it cannot be read, UsageError if its format is unknown.
    """
    named = KIND_OF_SUFFIX.get(path.suffix.lower())
    if named is not None:
        return named
    try:
        with path.open("rb") as file:
            first = file.read(_FIRST)
    except OSError as error:
        raise unreadable(path, error) from error
    found = kind_of_content(first)
    if first and found is not InputKind.RAW:
        return found
    names = ", ".join(KIND_OF_SUFFIX)
    raise UsageError(
        f"{path}: its name does not show its format ({names}); use --input {'|'.join(InputKind)}"
    )


def kind_of_content(first: bytes) -> InputKind:
    """Guess the format of a stream by its first bytes: text is hex, anything else raw bytes."""
    if first.startswith(MCAP_MAGIC):
        return InputKind.MCAP
    if first.startswith(PARQUET_MAGIC):
        return InputKind.PARQUET
    from fte_sniff.formats.logs.text import is_text

    return InputKind.HEX if is_text(first) else InputKind.RAW


_BLOCK = 1 << 19
"""Bytes of one read at most; a pipe or terminal returns what is available."""


def raw_chunks(path: Path) -> Iterator[Chunk]:
    """Read a file of raw bytes as chunks; raises FileError if it cannot be read."""
    try:
        with path.open("rb") as file:
            yield from raw_stream_chunks(file, str(path))
    except OSError as error:
        raise unreadable(path, error) from error


def raw_stream_chunks(stream: BinaryIO | IO[bytes], name: str) -> Iterator[Chunk]:
    """Read an open stream of raw bytes as chunks, for example standard input."""
    read = getattr(stream, "read1", stream.read)
    while block := read(_BLOCK):
        yield Chunk(name, None, block)


def clocked(
    chunks: Iterable[Chunk], start_ns: int | None, baud: int | None = None
) -> Iterator[Chunk]:
    """The chunks at the times that the baud gives, if the first byte began at `start_ns`."""
    size, byte_ns = 0, byte_time_ns(baud or DEFAULT_BAUD)
    for chunk in chunks:
        size += len(chunk.data)
        t_ns = None if start_ns is None else start_ns + size * byte_ns
        yield Chunk(chunk.port, t_ns, chunk.data)
