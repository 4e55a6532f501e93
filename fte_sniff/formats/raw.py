"""Owns reading files and streams that carry no times: raw bytes, and hex text, as chunks.

It must not know what the bytes mean.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import IO, BinaryIO

from fte_sniff.errors import FileError, InputTextError, unreadable
from fte_sniff.formats.hex_text import Piece, bytes_of_pieces
from fte_sniff.protocol import Chunk

_BLOCK = 1 << 16
_LONGEST_PIECE = 1 << 20


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
    while block := read(_BLOCK):
        yield Chunk(name, None, block)


def hex_chunks(path: Path) -> Iterator[Chunk]:
    """The chunks of a file of hex text, one a line.

    Raises:
        FileError: the file cannot be read, or is no text.
        InputTextError: something in it is not hex.
    """
    try:
        with path.open("rb") as file:
            yield from hex_stream_chunks(file, str(path))
    except OSError as error:
        raise unreadable(path, error) from error


def hex_stream_chunks(stream: BinaryIO | IO[bytes], name: str) -> Iterator[Chunk]:
    """The chunks of an open stream of hex text.

    Raises:
        FileError: it is no text.
        InputTextError: something in it is not hex.
    """
    try:
        for data in bytes_of_pieces(_pieces(stream, name)):
            yield Chunk(name, None, data)
    except InputTextError as error:
        raise InputTextError(f"{name}: {error}") from error


def _pieces(stream: BinaryIO | IO[bytes], name: str) -> Iterator[Piece]:
    """The lines of a stream, very long ones in several pieces, never cut within a word."""
    number, column, held = 1, 0, b""
    while read := stream.readline(_LONGEST_PIECE):
        if b"\0" in read:
            raise FileError(f"{name}: holds no text; if it holds raw bytes, decode it as raw")
        held += read
        whole = held.endswith(b"\n")
        cut = len(held) if whole else _cut(held)
        text = _text(held[:cut])
        yield Piece(text.rstrip("\r\n"), number, column)
        held = held[cut:]
        number, column = (number + 1, 0) if whole else (number, column + len(text))
    if held:
        yield Piece(_text(held), number, column)


def _cut(text: bytes) -> int:
    """Where a piece of a very long line can end: behind a space or comma, or else a whole byte."""
    if len(text) < _LONGEST_PIECE:
        return len(text)
    separated = max(text.rfind(b" "), text.rfind(b","), text.rfind(b"\t"))
    return separated + 1 if separated >= 0 else len(text) // 2 * 2


def _text(line: bytes) -> str:
    # Serial assistants on Chinese Windows write GBK; nothing but the words around the hex needs it.
    try:
        return line.decode("utf-8-sig")
    except UnicodeDecodeError:
        return line.decode("gb18030", errors="replace")
