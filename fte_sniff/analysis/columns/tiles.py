"""Owns the way from what the framer decided to rows side by side.

It must not decide anything, nor know where the bytes come from.
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
from fte_sniff.protocol import FRAME_LENGTH
from fte_sniff.protocol.framer.segments import Decided
from fte_sniff.protocol.framer.tables import FAULT_SETS
from fte_sniff.protocol.framer.timestamps import Mark

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


def tile_columns(decided: Decided) -> TileColumns:
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


def packed_tiles(decided: Decided) -> PackedRows:
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


def _long_rows(decided: Decided, columns: TileColumns) -> dict[int, bytes]:
    """All bytes of the rows longer than ten, by place."""
    long = (columns.length > FRAME_LENGTH).nonzero()[0]
    places = columns.offset[long] - decided.start
    stops = places + columns.length[long]
    return {
        row: decided.data[place:stop]
        for row, place, stop in zip(long.tolist(), places.tolist(), stops.tolist(), strict=True)
    }


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
