"""Owns the way from many bytes at once to numpy columns, at the machine's speed.

It must not decide what a frame is: the framer does. This module shows it where plain frames stand,
and turns what it says into columns.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Final, TypeAlias

import numpy as np

from fte_sniff.analysis.columns.fields import KIND_OF, NO_KIND, Array
from fte_sniff.analysis.columns.plain import SLAB, PlainRuns
from fte_sniff.protocol import FRAME_LENGTH, KINDS, VALUE_FIELDS, Chunk, Fault, Framer
from fte_sniff.protocol.framer.tiling import Tiles

_BLOCK: Final = 1 << 14
"""Rows whose bytes and columns stay in the cache."""


@dataclass(frozen=True, slots=True)
class BulkColumns:
    """The rows of one port's stream as columns, all equally long, in stream order."""

    port: str
    offset: Array
    """Of the row's first byte, int64."""
    length: Array
    """Bytes, uint16."""
    framed: Array
    """Whether the row is a frame, bool."""
    kind: Array
    """Place of the kind in `KINDS`, `NO_KIND` where the row has none, uint8."""
    values: Mapping[str, Array]
    """By row name, the value in its own width; it means something only where `known` says so."""
    faults: Array
    """Place of the row's faults in `fault_sets`, uint16."""
    fault_sets: tuple[tuple[Fault, ...], ...]
    """Every combination of faults that occurs; the first is none."""

    def known(self, name: str) -> Array:
        """Where the rows have a value of that name."""
        has = np.array([kind.field(name) is not None for kind in KINDS] + [False])
        return has[self.kind]


def bulk_columns(port: str, data: bytes) -> BulkColumns:
    """Frame the bytes of one port, which have no times, into columns."""
    rows = _Rows()
    with ThreadPoolExecutor(os.cpu_count(), "bulk") as threads:
        framer = Framer.of_bytes(rows, PlainRuns(data, threads))
        framer.pour(Chunk(port, None, data))
        framer.end()
        return rows.columns(port, threads)


_BLANK: Final = bytes(FRAME_LENGTH)


class _Rows(Tiles):
    """What the framer decides: runs as they come, and whatever else there is, row by row."""

    def __init__(self) -> None:
        super().__init__()
        self._parts: list[bytes | memoryview] = []
        """The bytes of the frames, and blank ones for damage: ten bytes a row."""
        self._count = 0
        self._odd: list[int] = []
        """Which rows are not part of a run, and for each of them:"""
        self._lengths: list[int] = []
        self._framed: list[bool] = []
        self._faults: list[tuple[Fault, ...]] = []

    def row(self, offset: int, raw: bytes, faults: tuple[Fault, ...], *, framed: bool) -> None:
        """One row that is not part of a run."""
        self._parts.append(raw if framed else _BLANK)
        self._odd.append(self._count)
        self._lengths.append(len(raw))
        self._framed.append(framed)
        self._faults.append(faults)
        self._count += 1

    def run(self, offset: int, data: bytes, start: int, stop: int) -> None:
        """Frames in step."""
        self._parts.append(memoryview(data)[start:stop])
        self._count += (stop - start) // FRAME_LENGTH

    def columns(self, port: str, threads: Executor) -> BulkColumns:
        """All rows as columns."""
        rows = self._count
        parts = self._parts
        raw = np.frombuffer(parts[0] if len(parts) == 1 else b"".join(parts), np.uint8)
        places = np.array(self._odd, np.int64)
        length = np.full(rows, FRAME_LENGTH, np.uint16)
        length[places] = self._lengths
        framed = np.ones(rows, np.bool_)
        framed[places] = self._framed
        faults = np.zeros(rows, np.uint16)
        faults[places], sets = _fault_codes(self._faults)
        offset = np.arange(0, rows * FRAME_LENGTH, FRAME_LENGTH)
        if len(places):
            excess = np.zeros(rows, np.int64)
            excess[places] = np.array(self._lengths) - FRAME_LENGTH
            offset += np.cumsum(excess) - excess
        kind, values = _decoded(raw.reshape(-1, FRAME_LENGTH), threads)
        return BulkColumns(port, offset, length, framed, kind, values, faults, sets)


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


_Places: TypeAlias = list[tuple[int, Array]]
"""Where a field stands, by its first byte, and which kinds have it there."""


def _field_places() -> dict[str, tuple[np.dtype[Any], _Places]]:
    """For every row name the field's form on the wire, and its places."""
    found: dict[str, tuple[np.dtype[Any], _Places]] = {}
    for first in VALUE_FIELDS:
        places: dict[int, Array] = {}
        for code, kind in enumerate(KINDS):
            field = kind.field(first.name)
            if field is not None:
                places.setdefault(field.start, np.zeros(NO_KIND + 1, np.bool_))[code] = True
        wire = np.dtype(f">{'i' if first.signed else 'u'}{first.size}")
        found[first.name] = wire, list(places.items())
    return found


_FIELD_PLACES: Final = _field_places()


def _decoded(frames: Array, threads: Executor) -> tuple[Array, Mapping[str, Array]]:
    """The kind of every row, and every field of the table, read where the row's kind has it."""
    rows = len(frames)
    kinds = np.empty(rows, np.uint8)
    values = {
        name: np.empty(rows, wire.newbyteorder("=")) for name, (wire, _) in _FIELD_PLACES.items()
    }
    slabs = range(0, rows, SLAB // FRAME_LENGTH)
    for _ in threads.map(lambda at: _decode(frames, at, kinds, values), slabs):
        pass
    return kinds, MappingProxyType(values)


def _decode(frames: Array, first: int, kinds: Array, values: Mapping[str, Array]) -> None:
    """Fill one slab of the columns."""
    for at in range(first, min(first + SLAB // FRAME_LENGTH, len(frames)), _BLOCK):
        block = slice(at, min(at + _BLOCK, first + SLAB // FRAME_LENGTH))
        own = frames[block]
        kind = KIND_OF.take(_read(own, 0, _HEADER_AND_CMD), mode="clip")
        kinds[block] = kind
        for name, (wire, ((start, _), *others)) in _FIELD_PLACES.items():
            column = values[name][block]
            column[:] = _read(own, start, wire)
            for other, has in others:
                np.copyto(column, _read(own, other, wire), where=has.take(kind, mode="clip"))


_HEADER_AND_CMD: Final = np.dtype("<u2")


def _read(frames: Array, start: int, wire: np.dtype[Any]) -> Array:
    """One field in every frame; fields are big-endian (PROTOCOL.md, "Framing")."""
    return np.ndarray((len(frames),), wire, frames, offset=start, strides=(FRAME_LENGTH,))
