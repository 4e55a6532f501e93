"""Owns the way from many bytes at once to numpy columns, at the machine's speed.

It must not decide what a frame is: the framer does. This module turns what it says into columns.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Final, TypeAlias

import numpy as np

from fte_sniff.analysis.fields import KIND_OF, NO_KIND
from fte_sniff.protocol import FRAME_LENGTH, KINDS, VALUE_FIELDS, Chunk, Fault, Framer
from fte_sniff.protocol.framer.tables import FAULT_SETS
from fte_sniff.row_batch import Array, tile_columns

_SLAB: Final = 100_000
"""Rows that one thread turns into columns at once."""

_BLOCK: Final = 1 << 14
"""Rows whose bytes and columns stay in the cache."""


@dataclass(frozen=True, slots=True)
class BulkColumns:
    """The rows of one port's stream as columns, all equally long, in stream order."""

    port: str
    offset: Array
    """Of the row's first byte, int64."""
    length: Array
    """Bytes, uint32."""
    framed: Array
    """Whether the row is a frame, bool."""
    kind: Array
    """Place of the kind in `KINDS`, `NO_KIND` where the row has none, uint8."""
    values: Mapping[str, Array]
    """By row name, the value in its own width; it means something only where `known` says so."""
    faults: Array
    """Place of the row's faults in `fault_sets`, uint16."""
    fault_sets: Sequence[tuple[Fault, ...]]
    """Every combination of faults; the first is none."""

    def known(self, name: str) -> Array:
        """Where the rows have a value of that name."""
        has = np.array([kind.field(name) is not None for kind in KINDS] + [False])
        return has[self.kind]


def bulk_columns(port: str, data: bytes) -> BulkColumns:
    """Frame the bytes of one port, which have no times, into columns."""
    with ThreadPoolExecutor(os.cpu_count(), "bulk") as threads:
        framer = Framer(port)
        framer.pour(Chunk(port, None, data))
        framer.end()
        rows = tile_columns(framer.take())
        kind, values = _decoded(rows.raw, threads)
    kind[~rows.framed] = NO_KIND
    return BulkColumns(
        port, rows.offset, rows.length, rows.framed, kind, values, rows.faults, FAULT_SETS
    )


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
    slabs = range(0, rows, _SLAB)
    for _ in threads.map(lambda at: _decode(frames, at, kinds, values), slabs):
        pass
    return kinds, MappingProxyType(values)


def _decode(frames: Array, first: int, kinds: Array, values: Mapping[str, Array]) -> None:
    """Fill one slab of the columns."""
    for at in range(first, min(first + _SLAB, len(frames)), _BLOCK):
        block = slice(at, min(at + _BLOCK, first + _SLAB))
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
