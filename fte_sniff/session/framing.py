"""Chunks of several ports as rows in the order of the chunks: logs, raw bytes.

Each port has its framer. A row waits until no other port can have one of an earlier chunk:

    tx  ──1────────3───────────      3 waits: rx has undecided bytes from chunk 2 on
    rx  ────────2··
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import BinaryIO, Final

import numpy as np

from fte_sniff.errors import FteSniffError, InputTextError, unreadable
from fte_sniff.protocol.framer import Framer
from fte_sniff.protocol.items import Chunk
from fte_sniff.protocol.rows import END_NS, Rows
from fte_sniff.protocol.spec import DEFAULT_BAUD, FRAME_LENGTH, byte_time_ns
from fte_sniff.session.merge import EVER, Lane, Merge

SPAN_BYTES: Final = 1 << 19
"""Bytes that are framed before their rows are yielded."""
_BLOCK: Final = 1 << 19
"""Bytes of one read at most; a pipe or terminal returns what is available."""
_MOST_HELD: Final = 1_000_000
"""Rows that wait for another port."""


def raw_chunks(source: Path | BinaryIO, port: str) -> Iterator[Chunk]:
    """Read a file of raw bytes, or an open stream such as standard input, as chunks.

    A chunk without bytes says that the next ones are not there yet. Raises FileError if the file
    cannot be read.
    """
    try:
        with source.open("rb") if isinstance(source, Path) else nullcontext(source) as stream:
            read = getattr(stream, "read1", stream.read)
            while block := read(_BLOCK):
                yield Chunk(port, None, block)
                yield Chunk(port, None, b"")
    except OSError as error:
        raise unreadable(port, error) from error


def timed(chunks: Iterable[Chunk], start_ns: int | None, baud: int) -> Iterator[Chunk]:
    """Chunks; those without times follow each other at the baud from `start_ns` on, if given."""
    size = 0
    for chunk in chunks:
        size += len(chunk.data)
        if start_ns is not None and chunk.t_ns is None and chunk.data:
            yield chunk._replace(t_ns=start_ns + size * byte_time_ns(baud))
        else:
            yield chunk


def rows_of_chunks(
    chunks: Iterable[Chunk], note: Callable[[str], None], baud: int = DEFAULT_BAUD
) -> Iterator[Rows]:
    """Frame chunks; rows of several ports come in the order of the chunks that begin them.

    A chunk without bytes says that the next ones are not there yet: rows do not wait for them.

    Args:
        chunks: their times may fall, and are None for bytes without times.
        note: called at the end if few of the bytes are in frames, or if their times are too dense.
        baud: bits per second.

    Raises what the chunks raise, after the rows before it.
    """
    wires, merge, size, failure = dict[str, _Wire](), Merge(), 0, None
    try:
        for number, chunk in enumerate(chunks):
            if chunk.data:
                if (chunk.t_ns or 0) >= END_NS:
                    raise InputTextError(
                        f"{chunk.port}: at {baud} baud its bytes end after the year 2262, which no"
                        " row can name; check --start and --baud"
                    )
                wire = wires.get(chunk.port)
                if wire is None:
                    wires[chunk.port] = wire = _Wire(chunk.port, baud)
                    merge.lanes.append(wire.lane)
                wire.push(chunk, number)
                size += len(chunk.data)
            if size >= SPAN_BYTES or (size and not chunk.data):
                size = 0
                yield from _decided(merge, wires.values(), number)
    except FteSniffError as error:
        failure = error
    for wire in wires.values():
        wire.framer.end()
    yield from _decided(merge, wires.values(), EVER)
    if failure is not None:
        raise failure
    for text in _remarks([*wires.values()], baud):
        note(text)


def _decided(merge: Merge, wires: Iterable[_Wire], number: int) -> Iterator[Rows]:
    """The rows that are decided and in order, if there are any, after the chunk of this number."""
    for wire in wires:
        wire.drain(number)
    for rows in merge.take(final=number == EVER or merge.waiting > _MOST_HELD):
        assert isinstance(rows, Rows)
        yield rows


class _Wire:
    """One port: its framer, its rows, and the chunks whose bytes are in no row yet."""

    def __init__(self, port: str, baud: int) -> None:
        self.port, self.framer, self.lane = port, Framer(port, baud), Lane()
        self.size = self.frames = 0
        self._first_ns: int | None = None
        self._last_ns = 0
        """The latest time."""
        self._chunks: list[tuple[int, int]] = []
        """The offset after each chunk, and its number."""

    def push(self, chunk: Chunk, number: int) -> None:
        """Frame a chunk."""
        self.framer.push(chunk)
        self.size += len(chunk.data)
        self._chunks.append((self.size, number))
        if chunk.t_ns is not None:
            self._first_ns = chunk.t_ns if self._first_ns is None else self._first_ns
            self._last_ns = max(self._last_ns, chunk.t_ns)

    def drain(self, number: int) -> None:
        """Put the rows that were decided into the lane, by the numbers of their chunks."""
        if len(rows := self.framer.drain()):
            self.frames += int(rows.framed.sum())
            stops, numbers = np.array(self._chunks).T
            self.lane.put(rows, numbers[np.searchsorted(stops, rows.offset, "right")])
            decided = int(rows.offset[-1]) + int(rows.length[-1])
            del self._chunks[: int(np.searchsorted(stops, decided, "right"))]
        self.lane.reached = self._chunks[0][1] if self._chunks else number

    def use(self, baud: int) -> float:
        """The share of the time from the first to the last chunk that all bytes take; 0 without."""
        span_ns = self._last_ns - (self._first_ns or 0)
        return self.size * byte_time_ns(baud) / span_ns if span_ns else 0.0


_LOW: Final = 0.5
"""Share of bytes in frames, from which on it is not low."""
_DENSE: Final = 2.0
"""Share of the time that bytes take, from which on their times are wrong."""
_MANY_BYTES: Final = 100


def _remarks(wires: Sequence[_Wire], baud: int) -> Iterator[str]:
    """A line if few of all bytes are in frames, and one if their times are too dense."""
    size = sum(wire.size for wire in wires)
    if size < _MANY_BYTES:
        return
    in_frames = FRAME_LENGTH * sum(wire.frames for wire in wires)
    # The wires of a log are named by it, those of an MCAP file by their topics.
    ports = [wire.port for wire in wires]
    name = (ports[0].rpartition(":")[0] if len(ports) > 1 else "") or ", ".join(ports)
    if 0 < in_frames < _LOW * size:
        yield (
            f"{name}: only {in_frames / size:.0%} of the bytes are in frames; check the baud of the"
            " recording, or say with --input-regex where the bytes of a log are"
        )
    if (use := max(wire.use(baud) for wire in wires)) > _DENSE:
        yield (
            f"{name}: rows are too dense in time for {baud} baud ({use:,.0%}); its times may be"
            " days"
        )
