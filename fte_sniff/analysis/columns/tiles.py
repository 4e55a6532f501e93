"""Owns the way from what the framer decided to rows side by side.

It must not decide anything, nor know where the bytes come from. Runs of frames are taken in one
piece; only what is no part of a run is looked at row by row.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from fte_sniff.analysis.columns.fields import Array
from fte_sniff.analysis.columns.packing import (
    DELAYED,
    FRAMED,
    ROW_TYPE,
    TIMED,
    Codebook,
    PackedRows,
)
from fte_sniff.protocol import FRAME_LENGTH, Fault
from fte_sniff.protocol.framer.keeping import Decided
from fte_sniff.protocol.framer.timeline import Mark

_EMPTY: Final = bytes(FRAME_LENGTH)


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
    """Place of the row's faults in `fault_sets`, uint16."""
    fault_sets: tuple[tuple[Fault, ...], ...]
    """Every combination of faults that occurs; the first is none."""
    long: dict[int, bytes]
    """All bytes of the rows longer than ten, by place."""


class _Odd:
    """The rows that are no part of a run, and the bytes of all."""

    def __init__(self) -> None:
        self.parts: list[bytes | memoryview] = []
        """Ten bytes a row."""
        self.rows = 0
        self.places: list[int] = []
        """Which rows they are, and for each of them:"""
        self.lengths: list[int] = []
        self.framed: list[bool] = []
        self.faults: list[tuple[Fault, ...]] = []
        self.long: dict[int, bytes] = {}

    def take(self, raw: bytes, faults: tuple[Fault, ...], *, framed: bool) -> None:
        size = len(raw)
        self.places.append(self.rows)
        self.lengths.append(size)
        self.framed.append(framed)
        self.faults.append(faults)
        if size > FRAME_LENGTH:
            self.long[self.rows] = raw
        same = size == FRAME_LENGTH
        self.parts.append(raw if same else raw[:FRAME_LENGTH] + _EMPTY[size:])
        self.rows += 1


def tile_columns(decided: Decided) -> TileColumns:
    """The rows side by side."""
    odd = _Odd()
    for _, data, start, stop, faults, framed in decided.tiles:
        if faults is None:
            whole = stop - start == len(data)
            odd.parts.append(data if whole else memoryview(data)[start:stop])
            odd.rows += (stop - start) // FRAME_LENGTH
        else:
            odd.take(data, faults, framed=framed)
    rows, parts, places = odd.rows, odd.parts, np.array(odd.places, np.int64)
    raw = np.frombuffer(parts[0] if len(parts) == 1 else b"".join(parts), np.uint8)
    length = np.full(rows, FRAME_LENGTH, np.uint32)
    length[places] = odd.lengths
    sound = np.ones(rows, np.bool_)
    sound[places] = odd.framed
    faults_of = np.zeros(rows, np.uint16)
    faults_of[places], sets = _fault_codes(odd.faults)
    first = decided.tiles[0].offset if decided.tiles else 0
    offset = np.arange(first, first + rows * FRAME_LENGTH, FRAME_LENGTH)
    if len(places):
        excess = np.zeros(rows, np.int64)
        excess[places] = np.array(odd.lengths) - FRAME_LENGTH
        offset += np.cumsum(excess) - excess
    columns = raw.reshape(-1, FRAME_LENGTH)
    return TileColumns(columns, offset, length, sound, faults_of, sets, odd.long)


def packed_tiles(decided: Decided) -> PackedRows:
    """The rows packed, with their times."""
    columns, codebook = tile_columns(decided), Codebook()
    codes = np.array([codebook.fault_code(faults) for faults in columns.fault_sets], np.uint32)
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
    return PackedRows(packed, columns.long, codebook)


def _times(marks: Sequence[Mark], offset: Array) -> tuple[Array, Array, Array]:
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


def _fault_codes(
    rows: list[tuple[Fault, ...]],
) -> tuple[list[int], tuple[tuple[Fault, ...], ...]]:
    """A number for each row's faults, and what the numbers stand for."""
    numbers: dict[tuple[Fault, ...], int] = {(): 0}
    codes: list[int] = []
    last: tuple[Fault, ...] | None = None
    for faults in rows:
        if faults is not last:
            number, last = numbers.setdefault(faults, len(numbers)), faults
        codes.append(number)
    return codes, tuple(numbers)
