"""Owns the rows of a recording side by side: one numpy array for each thing that a row tells.

It must not know files or messages, nor what the columns are used for. They hold what a row holds
and nothing derived from it: kind and values stand in the raw bytes.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from threading import Lock
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from fte_sniff.errors import FileError
from fte_sniff.protocol import FRAME_LENGTH, Damage, Fault, Frame, PortEvent, Row

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


class Room:
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
