"""Owns the packed form of rows: 48 bytes each, side by side in one numpy array.

It must not know what a column means, who keeps the arrays, or how long they live. Packing loses
nothing: `unpack(pack(row))` is the row, whatever it holds.

    t_ns  offset  delay_ns    nanoseconds since 1970 UTC, bytes, nanoseconds
    length                    bytes of the row; where it is more than ten, the bytes stand aside
    port  faults              numbers in a `Codebook`
    raw                       the first ten bytes, zeros behind them
    form                      which row type, which times there are, whether its order is certain
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final, overload

import numpy as np
import numpy.typing as npt

from fte_sniff.protocol import FRAME_LENGTH, Damage, Fault, Frame, Row

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
