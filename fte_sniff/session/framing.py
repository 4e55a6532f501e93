"""Chunks of several ports as rows in the order of time: logs, raw bytes.

Each port has its framer. A row waits until no other port can have an earlier one:

    tx  ──t1────────t3───────────      t3 waits: rx has undecided bytes from t2 on
    rx  ────────t2··

Rows without times come in the order of the chunks that hold their first bytes.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator
from contextlib import nullcontext
from pathlib import Path
from typing import BinaryIO, Final

import numpy as np

from fte_sniff.errors import FteSniffError, unreadable
from fte_sniff.protocol import (
    DEFAULT_BAUD,
    FRAME_LENGTH,
    HEADERS,
    Chunk,
    Direction,
    Fault,
    Framer,
    byte_time_ns,
)
from fte_sniff.protocol.rows import Ints, Rows

SPAN_BYTES: Final = 1 << 19
"""Bytes that are framed before their rows are yielded."""
_BLOCK: Final = 1 << 19
"""Bytes of one read at most; a pipe or terminal returns what is available."""
_MOST_HELD: Final = 1_000_000
"""Rows that wait for another port."""


def raw_chunks(
    source: Path | BinaryIO, port: str, start_ns: int | None = None, baud: int = DEFAULT_BAUD
) -> Iterator[Chunk]:
    """Read a file of raw bytes, or an open stream such as standard input, as chunks.

    If the first byte began at `start_ns`, chunks have the times that the baud gives. A chunk
    without bytes says that the next ones are not there yet. Raises FileError if the file cannot be
    read.
    """
    size, byte_ns = 0, byte_time_ns(baud)
    try:
        with source.open("rb") if isinstance(source, Path) else nullcontext(source) as stream:
            read = getattr(stream, "read1", stream.read)
            while block := read(_BLOCK):
                size += len(block)
                yield Chunk(port, None if start_ns is None else start_ns + size * byte_ns, block)
                yield Chunk(port, None, b"")
    except OSError as error:
        raise unreadable(port, error) from error


def rows_of_chunks(
    chunks: Iterable[Chunk], note: Callable[[str], None], baud: int = DEFAULT_BAUD
) -> Iterator[Rows]:
    """Frame chunks, and merge the rows of their ports by time.

    A chunk without bytes says that the next ones are not there yet: rows do not wait for them.

    Args:
        chunks: their times may fall, and are None for bytes without times.
        note: called at the end with what is remarkable about the bytes, such as that they end
            within a frame.
        baud: bits per second.

    Raises what the chunks raise, after the rows before it.
    """
    wires, held, size, failure = dict[str, _Wire](), _Held(), 0, None
    try:
        for number, chunk in enumerate(chunks):
            if chunk.data:
                if chunk.port not in wires:
                    wires[chunk.port] = _Wire(chunk.port, baud)
                wires[chunk.port].push(chunk, number)
                size += len(chunk.data)
            if size >= SPAN_BYTES or (size and not chunk.data):
                size = 0
                yield from held.released(wires.values())
    except FteSniffError as error:
        failure = error
    for wire in wires.values():
        wire.framer.end()
    yield from held.released(wires.values())
    if failure is not None:
        raise failure
    for text in _remarks([*wires.values()], baud):
        note(text)


_NO_KEYS: Final = np.empty((0, 2), np.int64)


class _Wire:
    """One port: its framer, and the chunks whose bytes are in no row yet."""

    def __init__(self, port: str, baud: int) -> None:
        self.port, self.framer = port, Framer(port, baud)
        self.size = 0
        self.span_ns: tuple[int, int] | None = None
        """The first and the last time."""
        self.frames = dict.fromkeys(Direction, 0)
        self.last: Rows | None = None
        """The rows that were decided last."""
        self._stops: list[int] = []
        self._keys: list[tuple[int, int]] = []
        """The offset after each chunk, its time, and its number."""

    def push(self, chunk: Chunk, number: int) -> None:
        """Frame a chunk."""
        self.framer.push(chunk)
        self.size += len(chunk.data)
        self._stops.append(self.size)
        if chunk.t_ns is not None:
            first, last = self.span_ns or (chunk.t_ns, chunk.t_ns)
            self.span_ns = first, max(last, chunk.t_ns)
        self._keys.append((self.span_ns[1] if self.span_ns else 0, number))

    def drain(self) -> tuple[Rows, Ints]:
        """The rows that were decided, and their keys; shape (rows, 2)."""
        rows = self.framer.drain()
        if not len(rows):
            return rows, _NO_KEYS
        self.last = rows
        for direction, header in HEADERS.items():
            self.frames[direction] += int((rows.framed & (rows.raw[:, 0] == header)).sum())
        own = np.searchsorted(self._stops, rows.offset, "right")
        keys = np.array(self._keys, np.int64)[own]
        decided = int(rows.offset[-1]) + int(rows.length[-1])
        done = int(np.searchsorted(self._stops, decided, "right"))
        del self._stops[:done], self._keys[:done]
        return rows, keys

    def share(self, baud: int) -> float:
        """The share of the time between the first and the last chunk that all bytes take."""
        first, last = self.span_ns or (0, 0)
        return self.size * byte_time_ns(baud) / (last - first) if last > first else 0

    @property
    def waits_from(self) -> tuple[int, int] | None:
        """The key of the first chunk with undecided bytes; None if all are decided."""
        return self._keys[0] if self._keys else None


class _Held:
    """Rows that wait for those of other ports."""

    def __init__(self) -> None:
        self._rows: list[Rows] = []
        self._keys: list[Ints] = []

    def released(self, wires: Collection[_Wire]) -> Iterator[Rows]:
        """The rows that are decided and in order, if there are any."""
        drained = [wire.drain() for wire in wires]
        rows = Rows.concat([*self._rows, *(one for one, _ in drained)])
        keys = np.concatenate([*self._keys, *(own for _, own in drained), _NO_KEYS])
        order = np.lexsort((keys[:, 1], keys[:, 0]))
        waiting = [wire.waits_from for wire in wires if wire.waits_from]
        count = len(order)
        if waiting and len(wires) > 1 and count <= _MOST_HELD:
            t_ns, number = min(waiting)
            times, numbers = keys[order].T
            count = int(((times < t_ns) | ((times == t_ns) & (numbers < number))).sum())
        self._rows, self._keys = [rows.select(order[count:])], [keys[order[count:]]]
        if count:
            yield rows.select(order[:count])


# What is remarkable

_LOW: Final = 0.5
"""Share of bytes in frames, from which on it is not low."""
_DENSE: Final = 2.0
"""Share of the time that bytes take, from which on their times are wrong."""
_MANY_BYTES: Final = 100
_SWAPPED: Final = 0.9
"""Of the frames of both directions, how many go the other way if the wires are swapped."""
_WAYS: Final = {"tx": ("sent", Direction.CONTROL), "rx": ("received", Direction.FEEDBACK)}
"""By the end of a port's name, what the host that writes a log does with the frames."""


def _remarks(wires: list[_Wire], baud: int) -> Iterator[str]:
    """What is remarkable about all bytes, one line each."""
    size = sum(wire.size for wire in wires)
    in_frames = FRAME_LENGTH * sum(sum(wire.frames.values()) for wire in wires)
    ports = [wire.port for wire in wires]
    # The wires of a log are named by it, those of an MCAP file by their topics.
    name = (ports[0].rpartition(":")[0] if len(ports) > 1 else "") or ", ".join(ports)
    if size >= _MANY_BYTES and 0 < in_frames < _LOW * size:
        yield (
            f"{name}: only {in_frames / size:.0%} of the bytes are in frames; check the baud of the"
            " recording, or say with --input-regex where the bytes of a log are"
        )
    yield from _against(name, wires)
    share = max((wire.share(baud) for wire in wires if wire.size >= _MANY_BYTES), default=0)
    if share > _DENSE:
        yield (
            f"{name}: rows are too dense in time for {baud} baud ({share:,.0%}); its times may be"
            " days"
        )
    for wire in wires:
        row = wire.last[-1] if wire.last is not None else None
        if row is not None and Fault.TRUNCATED in row.faults:
            yield (
                f"{wire.port}: ends in the middle of a frame ({len(row.raw)} of"
                f" {FRAME_LENGTH} bytes)"
            )


def _against(name: str, wires: Iterable[_Wire]) -> Iterator[str]:
    """Which directions frames contradict."""
    known = [(wire, *_WAYS[way]) for wire in wires if (way := wire.port[-2:]) in _WAYS]
    against = [
        (count, f"{word}, header {HEADERS[direction]:02X} says {direction}")
        for wire, word, own in known
        for direction, count in wire.frames.items()
        if direction is not own and count
    ]
    wrong = sum(count for count, _ in against)
    total = sum(sum(wire.frames.values()) for wire, *_ in known)
    if against:
        is_swapped = len(known) > 1 and wrong > _SWAPPED * total
        otherwise = "the wires are swapped" if is_swapped else "a word names no direction"
        yield (
            f"{name}: {wrong:,} of {total:,} frames go the other way than the log says"
            f" ({against[0][1]}): this is normal in the log of a tap; otherwise {otherwise}"
        )
