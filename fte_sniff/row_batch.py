"""RowBatch: a batch of rows as numpy arrays; build, slice, concatenate, iterate.

t_ns  offset  delay_ns    nanoseconds since 1970 UTC, bytes, nanoseconds
length                    bytes of the row; where it is more than ten, the bytes stand aside
port  faults              numbers in a `Codebook`
raw                       the first ten bytes, zeros behind them
form                      which row type, which times there are, whether its order is certain
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from threading import Lock
from typing import Any, Final, Protocol, Self, overload

import numpy as np
import numpy.typing as npt

from fte_sniff.errors import FileError
from fte_sniff.protocol import FRAME_LENGTH, Damage, Fault, Frame, PortEvent, Row
from fte_sniff.protocol.framer.segments import DecidedSpan
from fte_sniff.protocol.framer.tables import FAULT_SETS
from fte_sniff.protocol.framer.timestamps import ArrivalTime

ROW_TYPE: Final = np.dtype(
    [
        ("t_ns", np.int64),
        ("offset", np.int64),
        ("delay_ns", np.int64),
        ("length", np.uint32),
        ("faults", np.uint32),
        ("port", np.uint16),
        ("raw", np.uint8, (FRAME_LENGTH,)),
        ("form", np.uint8),
    ],
    align=True,
)
"""One packed row."""

FRAMED: Final = 1
"""Bit of `form`: the row is a `Frame`, not a `Damage`."""
TIMED: Final = 2
"""Bit of `form`: `t_ns` holds a time; without it the row has none."""
DELAYED: Final = 4
"""Bit of `form`: `delay_ns` holds the read delay; without it the row has none."""
UNORDERED: Final = 8
"""Bit of `form`: the row's place among other ports' rows is not certain."""

_UNPACKED_AT_ONCE: Final = 4096

Packed = npt.NDArray[Any]
"""An array of `ROW_TYPE`."""


class Codebook:
    """The ports and the combinations of faults seen so far, each under a small number."""

    def __init__(self) -> None:
        self.ports: list[str] = []
        """Port names, by number."""
        self.faults: list[tuple[Fault, ...]] = []
        """Combinations of faults in the row's order, by number."""
        self._port_codes: dict[str, int] = {}
        self._fault_codes: dict[tuple[Fault, ...], int] = {}

    def port_code(self, port: str) -> int:
        """The number of a port; a new one where it was never seen."""
        code = self._port_codes.get(port)
        if code is None:
            code = self._port_codes[port] = len(self.ports)
            self.ports.append(port)
        return code

    def fault_code(self, faults: tuple[Fault, ...]) -> int:
        """The number of a combination of faults; a new one where it was never seen."""
        code = self._fault_codes.get(faults)
        if code is None:
            code = self._fault_codes[faults] = len(self.faults)
            self.faults.append(faults)
        return code


def pack(rows: Sequence[Row], codebook: Codebook) -> tuple[Packed, dict[int, bytes]]:
    """The rows as an array, and the bytes of those longer than ten, by place in `rows`."""
    if isinstance(rows, PackedRows):
        return rows.packed_for(codebook)
    packed: Packed = np.zeros(len(rows), ROW_TYPE)
    raws = [row.raw for row in rows]
    lengths = [len(raw) for raw in raws]
    times = [row.t_ns for row in rows]
    delays = [row.read_delay_ns for row in rows]
    packed["t_ns"] = [time or 0 for time in times]
    packed["offset"] = [row.offset for row in rows]
    packed["delay_ns"] = [delay or 0 for delay in delays]
    packed["length"] = lengths
    packed["faults"] = [codebook.fault_code(row.faults) for row in rows]
    packed["port"] = [codebook.port_code(row.port) for row in rows]
    inline = b"".join([raw[:FRAME_LENGTH].ljust(FRAME_LENGTH, b"\0") for raw in raws])
    packed["raw"] = np.frombuffer(inline, np.uint8).reshape(-1, FRAME_LENGTH)
    packed["form"] = [
        isinstance(row, Frame) * FRAMED
        + (time is not None) * TIMED
        + (delay is not None) * DELAYED
        + row.order_uncertain * UNORDERED
        for row, time, delay in zip(rows, times, delays, strict=True)
    ]
    long = {at: raws[at] for at, length in enumerate(lengths) if length > FRAME_LENGTH}
    return packed, long


def unpack(
    packed: Packed, long: Mapping[int, bytes], codebook: Codebook, start: int = 0
) -> list[Row]:
    """The rows of an array; `start` is the place in `long` at which the array begins."""
    raws = packed["raw"].tobytes()
    scalars = zip(
        *(packed[name].tolist() for name in ROW_TYPE.names or () if name != "raw"), strict=True
    )
    rows: list[Row] = []
    for at, (t_ns, offset, delay_ns, length, faults, port, form) in enumerate(scalars):
        first = at * FRAME_LENGTH
        raw = long[start + at] if length > FRAME_LENGTH else raws[first : first + length]
        row = Frame if form & FRAMED else Damage
        rows.append(
            row(
                codebook.ports[port],
                offset,
                raw,
                t_ns if form & TIMED else None,
                codebook.faults[faults],
                delay_ns if form & DELAYED else None,
                bool(form & UNORDERED),
            )
        )
    return rows


def _counts_up(codes: npt.NDArray[np.integer]) -> bool:
    """Whether every number stands for itself."""
    return bool((codes == np.arange(len(codes))).all())


class PackedRows(Sequence[Row]):
    """Rows that are packed already, in place of a list of them.

    Whoever asks for rows gets them made anew; whoever knows better takes the arrays.
    """

    def __init__(self, packed: Packed, long: Mapping[int, bytes], codebook: Codebook) -> None:
        self._packed = packed
        self.long = long
        """The bytes of rows longer than ten, by place."""
        self.words = codebook
        """What the numbers of `port` and `faults` stand for."""

    def __len__(self) -> int:
        return len(self._packed)

    @overload
    def __getitem__(self, at: int) -> Row: ...
    @overload
    def __getitem__(self, at: slice) -> list[Row]: ...
    def __getitem__(self, at: int | slice) -> Row | list[Row]:
        places = range(len(self))[at]
        if isinstance(places, int):
            return unpack(self._packed[places : places + 1], self.long, self.words, places)[0]
        return [self[place] for place in places]

    def __iter__(self) -> Iterator[Row]:
        for start in range(0, len(self), _UNPACKED_AT_ONCE):
            part = self._packed[start : start + _UNPACKED_AT_ONCE]
            yield from unpack(part, self.long, self.words, start)

    @property
    def t_ns(self) -> Packed:
        """Nanoseconds since 1970 UTC; 0 where there is no time."""
        return self._packed["t_ns"]

    @property
    def timed(self) -> Packed:
        """Whether the row has a time."""
        return self._has(TIMED)

    @property
    def delay_ns(self) -> Packed:
        """Read delay, nanoseconds; 0 where there is none."""
        return self._packed["delay_ns"]

    @property
    def offset(self) -> Packed:
        """Of the first byte."""
        return self._packed["offset"]

    @property
    def length(self) -> Packed:
        """Bytes of the row."""
        return self._packed["length"]

    @property
    def port(self) -> Packed:
        """Number of the port."""
        return self._packed["port"]

    @property
    def faults(self) -> Packed:
        """Number of the faults."""
        return self._packed["faults"]

    @property
    def framed(self) -> Packed:
        """Whether the row is a Frame."""
        return self._has(FRAMED)

    @property
    def delayed(self) -> Packed:
        """Whether the row has a read delay."""
        return self._has(DELAYED)

    @property
    def unordered(self) -> Packed:
        """Whether the row's place among other ports' rows is not certain."""
        return self._has(UNORDERED)

    def _has(self, bit: int) -> Packed:
        return (self._packed["form"] & bit).astype(np.bool_)

    @property
    def raw(self) -> Packed:
        """The first ten bytes."""
        return self._packed["raw"]

    def tobytes(self) -> bytes:
        """All bytes of the rows, one row behind the other."""
        inline = np.ascontiguousarray(self.raw)
        length = np.minimum(self.length, FRAME_LENGTH)
        if (length < FRAME_LENGTH).any():
            inline = inline[np.arange(FRAME_LENGTH) < length[:, None]]
        inline, ends = inline.reshape(-1), np.cumsum(length, dtype=np.int64)
        parts, start = list[bytes](), 0
        for place, raw in sorted(self.long.items()):
            parts += [inline[start : ends[place]].tobytes(), raw[FRAME_LENGTH:]]
            start = ends[place]
        return b"".join([*parts, inline[start:].tobytes()])

    def packed_for(self, codebook: Codebook) -> tuple[Packed, dict[int, bytes]]:
        """The same as `pack` gives, with the numbers of another codebook."""
        if codebook is self.words:
            return self._packed, dict(self.long)
        ports = np.array([codebook.port_code(port) for port in self.words.ports], np.uint16)
        faults = np.array([codebook.fault_code(found) for found in self.words.faults], np.uint32)
        if _counts_up(ports) and _counts_up(faults):
            return self._packed, dict(self.long)
        packed = self._packed.copy()
        packed["port"] = ports[packed["port"]]
        packed["faults"] = faults[packed["faults"]]
        return packed, dict(self.long)

    def parted(self, rows: slice | npt.NDArray[np.bool_]) -> PackedRows:
        """Only these rows: a slice, or a mask."""
        long: dict[int, bytes] = {}
        if self.long:
            kept = np.arange(len(self))[rows].tolist()
            long = {at: self.long[old] for at, old in enumerate(kept) if old in self.long}
        return PackedRows(self._packed[rows], long, self.words)

    @classmethod
    def joined(cls, parts: Sequence[PackedRows]) -> PackedRows:
        """One behind the other; one at least."""
        if len(parts) == 1:
            return parts[0]
        codebook, long, start = parts[0].words, dict[int, bytes](), 0
        arrays = []
        for part in parts:
            packed, own = part.packed_for(codebook)
            arrays.append(packed)
            long.update((start + at, raw) for at, raw in own.items())
            start += len(part)
        return cls(np.concatenate(arrays), long, codebook)


class CodebookLike(Protocol):
    """What the numbers in columns stand for."""

    @property
    def ports(self) -> Sequence[str]:
        """Port names, by number."""
        ...

    @property
    def faults(self) -> Sequence[tuple[Fault, ...]]:
        """Combinations of faults, by number."""
        ...


class SideBySide(Protocol):
    """Rows as arrays, all equally long: what each row tells that cannot be derived."""

    @property
    def words(self) -> CodebookLike:
        """What the numbers of `port` and `faults` stand for."""
        ...

    @property
    def t_ns(self) -> Array:
        """Nanoseconds since 1970 UTC, int64; it means something where `timed`."""
        ...

    @property
    def timed(self) -> Array:
        """Whether the row has a time, bool."""
        ...

    @property
    def offset(self) -> Array:
        """Of the first byte, int64."""
        ...

    @property
    def length(self) -> Array:
        """Bytes of the row, uint32."""
        ...

    @property
    def port(self) -> Array:
        """Number of the port."""
        ...

    @property
    def faults(self) -> Array:
        """Number of the faults."""
        ...

    @property
    def framed(self) -> Array:
        """Whether the row is a Frame, bool."""
        ...

    @property
    def raw(self) -> Array:
        """The first ten bytes, zeros behind them; uint8, ten for each row."""
        ...

    @property
    def long(self) -> Mapping[int, bytes]:
        """All bytes of the rows longer than ten, by place."""
        ...


_TEN: Final = np.dtype(f"V{FRAME_LENGTH}")
"""The first ten bytes of a row, as one thing."""

_SOUND_FRAME: Final = 1
"""The code of tiles that are frames with nothing wrong."""

_KEPT: Final = np.tri(FRAME_LENGTH, k=-1, dtype=np.uint8) * np.uint8(0xFF)
"""By length of a short row: which bits of ten bytes are its own."""


@dataclass(frozen=True, slots=True)
class TileColumns:
    """The rows that tiles stand for, in stream order: all but their times and their port."""

    raw: Array
    """The first ten bytes, zeros behind them; uint8, ten for each row."""
    offset: Array
    """Of the row's first byte, int64."""
    length: Array
    """Bytes, uint32."""
    framed: Array
    """Whether the row is a frame, bool."""
    faults: Array
    """Place of the row's faults in `FAULT_SETS`, uint16."""


def tile_columns(decided: DecidedSpan) -> TileColumns:
    """The rows side by side."""
    tiles = decided.tiles
    if not tiles.starts:
        return TileColumns(
            np.zeros((0, FRAME_LENGTH), np.uint8),
            np.zeros(0, np.int64),
            np.zeros(0, np.uint32),
            np.zeros(0, np.bool_),
            np.zeros(0, np.uint16),
        )
    starts, counts, codes = (
        np.frombuffer(memoryview(numbers), np.int64)
        for numbers in (tiles.starts, tiles.counts, tiles.codes)
    )
    firsts = np.cumsum(counts)
    rows = int(firsts[-1])
    odd = (codes != _SOUND_FRAME).nonzero()[0]
    places, codes = firsts[odd] - 1, codes[odd]
    sizes = np.diff(starts, append=np.int64(tiles.end))[odd]
    length, framed, faults = (
        np.full(rows, FRAME_LENGTH, np.uint32),
        np.ones(rows, np.bool_),
        np.zeros(rows, np.uint16),
    )
    length[places], framed[places], faults[places] = sizes, codes & 1, codes >> 1
    offset = np.arange(starts[0], starts[0] + rows * FRAME_LENGTH, FRAME_LENGTH)
    data, at = decided.data, int(starts[0]) - decided.start
    if (sizes == FRAME_LENGTH).all():
        raw = np.frombuffer(data, np.uint8, rows * FRAME_LENGTH, at).reshape(-1, FRAME_LENGTH)
    else:
        excess = np.zeros(rows, np.int64)
        excess[places] = sizes - FRAME_LENGTH
        offset += np.cumsum(excess) - excess
        raw = _first_bytes(data, offset - decided.start, length)
    return TileColumns(raw, offset, length, framed, faults)


def _first_bytes(data: bytes, places: Array, length: Array) -> Array:
    """The first ten bytes of every row, zeros behind shorter ones."""
    rows = np.empty(len(places), _TEN)
    reach = len(data) - FRAME_LENGTH + 1
    whole = len(places) if reach > places[-1] else int(np.searchsorted(places, max(reach, 0)))
    if whole:
        rows[:whole] = np.ndarray((reach,), _TEN, data, 0, (1,))[places[:whole]]
    raw = rows.view(np.uint8).reshape(-1, FRAME_LENGTH)
    for row in range(whole, len(places)):
        last = data[places[row] :].ljust(FRAME_LENGTH, b"\0")
        raw[row] = np.frombuffer(last, np.uint8, FRAME_LENGTH)
    short = (length < FRAME_LENGTH).nonzero()[0]
    if len(short):
        raw[short] &= _KEPT[length[short]]
    return raw


def packed_tiles(decided: DecidedSpan) -> PackedRows:
    """The rows packed, with their times."""
    columns, codebook = tile_columns(decided), Codebook()
    codes = np.zeros(len(FAULT_SETS), np.uint32)
    for number in np.unique(columns.faults).tolist():
        codes[number] = codebook.fault_code(FAULT_SETS[number])
    packed = np.zeros(len(columns.offset), ROW_TYPE)
    packed["offset"] = columns.offset
    packed["length"] = columns.length
    packed["faults"] = codes[columns.faults]
    packed["port"] = codebook.port_code(decided.port)
    packed["raw"] = columns.raw
    packed["form"] = columns.framed * np.uint8(FRAMED)
    if any(mark.t_ns is not None for mark in decided.marks):
        times = _times(decided.marks, columns.offset)
        packed["t_ns"], packed["delay_ns"], known = times
        packed["form"] |= known * np.uint8(TIMED | DELAYED)
    return PackedRows(packed, _long_rows(decided, columns), codebook)


def _long_rows(decided: DecidedSpan, columns: TileColumns) -> dict[int, bytes]:
    """All bytes of the rows longer than ten, by place."""
    long = (columns.length > FRAME_LENGTH).nonzero()[0]
    places = columns.offset[long] - decided.start
    stops = places + columns.length[long]
    return {
        row: decided.data[place:stop]
        for row, place, stop in zip(long.tolist(), places.tolist(), stops.tolist(), strict=True)
    }


def _times(marks: Sequence[ArrivalTime], offset: Array) -> tuple[Array, Array, Array]:
    """Of every row time and read delay, as `Mark.time_and_delay`, and whether it has any."""
    stop, floor, byte = (
        np.array([getattr(mark, name) for mark in marks], np.int64)
        for name in ("stop", "floor_ns", "byte_ns")
    )
    read = np.array([mark.t_ns or 0 for mark in marks], np.int64)
    known = np.array([mark.t_ns is not None for mark in marks])
    own = np.searchsorted(stop, offset, side="right")
    delay = (stop[own] - offset) * byte[own]
    t_ns, floor = read[own] - delay, floor[own]
    early = t_ns < floor
    t_ns[early] = floor[early]
    delay[early] = np.maximum(read[own][early] - floor[early], 0)
    t_ns[~known[own]] = delay[~known[own]] = 0
    return t_ns, delay, known[own]


Array = npt.NDArray[Any]

_TIMES = range(2**63)

ARRAYS = (
    "t_ns",
    "offset",
    "delay_ns",
    "length",
    "port",
    "faults",
    "framed",
    "delayed",
    "unordered",
    "raw",
)
"""The names of the arrays of `RowColumns`."""


class Words:
    """The ports and the combinations of faults seen so far, each under a small number.

    Several threads may ask at once.
    """

    def __init__(self) -> None:
        self.ports: list[str] = []
        """Port names, by number."""
        self.faults: list[tuple[Fault, ...]] = []
        """Combinations of faults in the row's order, by number; the first is none."""
        self._port_codes: dict[str, int] = {}
        self._fault_codes: dict[tuple[Fault, ...], int] = {}
        self._lock = Lock()
        self.fault_code(())

    def port_code(self, port: str) -> int:
        """The number of a port; a new one where it was never seen."""
        with self._lock:
            if port not in self._port_codes:
                self._port_codes[port] = len(self.ports)
                self.ports.append(port)
            return self._port_codes[port]

    def fault_code(self, faults: tuple[Fault, ...]) -> int:
        """The number of a combination of faults; a new one where it was never seen."""
        with self._lock:
            if faults not in self._fault_codes:
                self._fault_codes[faults] = len(self.faults)
                self.faults.append(faults)
            return self._fault_codes[faults]


@dataclass(frozen=True, slots=True)
class RowColumns:
    """So many rows in file order, and the port events that stand among them."""

    words: Words
    t_ns: Array
    """Nanoseconds since 1970 UTC, int64."""
    offset: Array
    """Of the row's first byte in its port's stream, int64."""
    delay_ns: Array
    """Read delay, nanoseconds, int64; it means something where `delayed`."""
    length: Array
    """Bytes of the row, uint32."""
    port: Array
    """Number of the port in `words`, uint16."""
    faults: Array
    """Number of the row's faults in `words`, uint16."""
    framed: Array
    """Whether the row is a Frame, bool; otherwise it is a Damage."""
    delayed: Array
    """Whether the row tells its read delay, bool."""
    unordered: Array
    """Whether the row's place among other ports' rows is not certain, bool."""
    raw: Array
    """The first ten bytes, zeros behind them; uint8, one row of ten for each."""
    long: dict[int, bytes] = field(default_factory=dict)
    """All bytes of the rows longer than ten, by their place."""
    events: tuple[PortEvent, ...] = ()
    """In file order."""

    def __len__(self) -> int:
        return len(self.t_ns)

    @property
    def timed(self) -> Array:
        """Whether the row has a time: each has."""
        return np.broadcast_to(np.True_, len(self))

    def ends(self) -> dict[str, int]:
        """By port, the offset behind the last byte of its last row here."""
        found = {}
        for code in np.flatnonzero(np.bincount(self.port)):
            last = np.flatnonzero(self.port == code)[-1]
            found[self.words.ports[code]] = int(self.offset[last]) + int(self.length[last])
        return found

    @classmethod
    def blank(cls, words: Words, rows: int) -> Self:
        """Room for so many rows, to be filled in; nothing in it means anything yet."""
        return cls(
            words,
            np.empty(rows, np.int64),
            np.empty(rows, np.int64),
            np.zeros(rows, np.int64),
            np.full(rows, FRAME_LENGTH, np.uint32),
            np.empty(rows, np.uint16),
            np.zeros(rows, np.uint16),
            np.ones(rows, np.bool_),
            np.ones(rows, np.bool_),
            np.zeros(rows, np.bool_),
            np.zeros((rows, FRAME_LENGTH), np.uint8),
        )

    @classmethod
    def of_rows(cls, words: Words, rows: Sequence[Row], events: Sequence[PortEvent] = ()) -> Self:
        """The columns of rows that are there already.

        Raises:
            FileError: a row has no time that a recording can hold.
        """
        columns = cls.blank(words, len(rows))
        for place, row in enumerate(rows):
            if row.t_ns is None or row.t_ns not in _TIMES:
                raise FileError(
                    f"{row.port!r}, offset {row.offset}, has no time since 1970, and a recording "
                    "needs one; write another format"
                )
            columns.put(place, row)
        return columns.parted(slice(None), tuple(events))

    def put(self, place: int, row: Row) -> None:
        """Fill in one row, which must have a time."""
        assert row.t_ns is not None
        self.t_ns[place] = row.t_ns
        self.offset[place] = row.offset
        self.delayed[place] = row.read_delay_ns is not None
        self.delay_ns[place] = row.read_delay_ns or 0
        self.unordered[place] = row.order_uncertain
        self.length[place] = len(row.raw)
        self.port[place] = self.words.port_code(row.port)
        self.faults[place] = self.words.fault_code(row.faults)
        self.framed[place] = isinstance(row, Frame)
        first = row.raw[:FRAME_LENGTH].ljust(FRAME_LENGTH, b"\0")
        self.raw[place] = np.frombuffer(first, np.uint8)
        if len(row.raw) > FRAME_LENGTH:
            self.long[place] = row.raw

    def parted(self, rows: slice | Array, events: tuple[PortEvent, ...] = ()) -> Self:
        """Only these rows: a slice, or a mask."""
        long: dict[int, bytes] = {}
        if self.long:
            kept = np.arange(len(self))[rows].tolist()
            long = {at: self.long[old] for at, old in enumerate(kept) if old in self.long}
        arrays = {name: getattr(self, name)[rows] for name in ARRAYS}
        return type(self)(words=self.words, long=long, events=events, **arrays)

    @classmethod
    def joined(cls, parts: Sequence[RowColumns]) -> RowColumns:
        """One behind the other; all of the same words, one at least."""
        if len(parts) == 1:
            return parts[0]
        long: dict[int, bytes] = {}
        start = 0
        for part in parts:
            long.update((start + at, raw) for at, raw in part.long.items())
            start += len(part)
        arrays = {name: np.concatenate([getattr(part, name) for part in parts]) for name in ARRAYS}
        events = tuple(event for part in parts for event in part.events)
        return cls(words=parts[0].words, long=long, events=events, **arrays)

    def rows(self) -> Iterator[Row]:
        """The rows one by one, as they were recorded."""
        raws = self.raw.tobytes()
        scalars = zip(*(getattr(self, name).tolist() for name in ARRAYS[:-1]), strict=True)
        for place, scalar in enumerate(scalars):
            t_ns, offset, delay, length, port, faults, framed, delayed, unordered = scalar
            first = place * FRAME_LENGTH
            long = length > FRAME_LENGTH
            yield (Frame if framed else Damage)(
                self.words.ports[port],
                offset,
                self.long[place] if long else raws[first : first + length],
                t_ns,
                self.words.faults[faults],
                delay if delayed else None,
                unordered,
            )


class Capacity:
    """Columns for rows that come piece by piece, so that they need not be joined by copying."""

    def __init__(self, words: Words, rows: int) -> None:
        """Room for so many rows; more can be taken."""
        self._columns = RowColumns.blank(words, rows)
        self._taken = 0

    def take(self, rows: int) -> RowColumns:
        """Blank columns: behind those before, where there is room."""
        start = self._taken
        self._taken += rows
        if self._taken > len(self._columns):
            return RowColumns.blank(self._columns.words, rows)
        return self._columns.parted(slice(start, self._taken))

    def taken(self) -> RowColumns | None:
        """All that was taken, as one; None where there was no room for all."""
        fits = self._taken <= len(self._columns)
        return self._columns.parted(slice(0, self._taken)) if fits else None


def packed_rows(columns: RowColumns) -> PackedRows:
    """The same rows, packed."""
    codebook = Codebook()
    for port in tuple(columns.words.ports):
        codebook.port_code(port)
    for faults in tuple(columns.words.faults):
        codebook.fault_code(faults)
    packed = np.empty(len(columns), ROW_TYPE)
    for name in ("t_ns", "offset", "delay_ns", "length", "port", "faults", "raw"):
        packed[name] = getattr(columns, name)
    packed["form"] = columns.framed * np.uint8(FRAMED) | np.uint8(TIMED)
    packed["form"] |= columns.delayed * np.uint8(DELAYED)
    packed["form"] |= columns.unordered * np.uint8(UNORDERED)
    return PackedRows(packed, columns.long, codebook)


def row_columns(words: Words, rows: PackedRows) -> RowColumns:
    """Packed rows as the columns of a recording, with these words.

    Raises:
        FileError: a row has no time that a recording can hold.
    """
    if not rows.timed.all() or (rows.t_ns < 0).any():
        return RowColumns.of_rows(words, rows)
    ports = np.array([words.port_code(port) for port in rows.words.ports], np.uint16)
    faults = np.array([words.fault_code(found) for found in rows.words.faults], np.uint16)
    return RowColumns(
        words,
        t_ns=rows.t_ns,
        offset=rows.offset,
        delay_ns=rows.delay_ns,
        length=rows.length,
        port=ports[rows.port],
        faults=faults[rows.faults],
        framed=rows.framed,
        delayed=rows.delayed,
        unordered=rows.unordered,
        raw=rows.raw,
        long=dict(rows.long),
    )
