"""Owns one block of packed rows, and the places of those that a filter wants.

It must not know the other blocks, nor which rows have left.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
import numpy.typing as npt

from fte_sniff.analysis.columns.packing import ROW_TYPE, Codebook, Packed

if TYPE_CHECKING:
    from fte_sniff.analysis.filter.row_filter import RowFilter

Places: TypeAlias = npt.NDArray[np.int64]
"""Where rows stand in a block."""


class Block:
    """So many rows in sequence; `start` is the index of the first."""

    def __init__(self, start: int, room: int) -> None:
        self.start = start
        self.capacity = room
        """Rows that fit into it."""
        self.rows: Packed = np.empty(room, ROW_TYPE)
        self.dropped = False
        """Whether its rows are not in memory; all else of it stays."""
        self.count = 0
        self.faulty = False
        """Whether any of its rows has a fault; known also while they are not in memory."""
        self.raised = False
        """The same of a flag byte that tells something else than that all is in order."""
        self.long: dict[int, bytes] = {}
        """The bytes of rows longer than ten, by place in the block."""
        self.judged = 0
        """Rows that the filter has seen, from the start."""
        self.places: npt.NDArray[np.uint16] = np.empty(0, np.uint16)
        self.wanted = 0
        """How many of `places` are in use: those of wanted rows, rising."""

    @property
    def room(self) -> int:
        """Rows that still fit."""
        return self.capacity - self.count

    @property
    def end(self) -> int:
        """Index behind the last row."""
        return self.start + self.count

    def append(self, packed: Packed, long: dict[int, bytes], skipped: int) -> None:
        """Take rows; `long` counts places from `skipped` before them."""
        end = self.count + len(packed)
        self.rows[self.count : end] = packed
        shift = self.count - skipped
        self.long.update(
            (at + shift, raw) for at, raw in long.items() if self.count <= at + shift < end
        )
        self.count = end

    def drop(self) -> None:
        """Let go of the rows; their number and what the filter said of them stays."""
        self.rows, self.long, self.dropped = np.empty(0, ROW_TYPE), {}, True

    def restore(self, rows: Packed, long: Mapping[int, bytes]) -> None:
        """Take the rows back.

        Raises:
            ValueError: they are not so many as there were.
        """
        if len(rows) != self.count:
            raise ValueError(f"{len(rows)} rows came back of {self.count}")
        self.rows, self.long, self.dropped = rows, dict(long), False

    def forget(self) -> None:
        """No row has been judged."""
        self.judged = self.wanted = 0

    def judge(self, row_filter: RowFilter, codebook: Codebook) -> int:
        """Let the filter see the rows that it has not seen; how many those were."""
        start, end = self.judged, self.count
        long = {at - start: raw for at, raw in self.long.items() if at >= start}
        found = np.flatnonzero(row_filter.of_packed(self.rows[start:end], long, codebook)) + start
        if len(self.places) < self.capacity:
            self.places = np.empty(self.capacity, np.uint16)
        self.places[self.wanted : self.wanted + len(found)] = found
        self.wanted += len(found)
        self.judged = end
        if not self.room:
            self.places = self.places[: self.wanted].copy()
        return end - start

    def part(self, places: Places) -> tuple[Packed, dict[int, bytes]]:
        """The rows at these places, which rise, as `pack` gives them."""
        long = {}
        for place, raw in self.long.items() if len(places) else ():
            at = int(np.searchsorted(places, place))
            if at < len(places) and places[at] == place:
                long[at] = raw
        return self.rows[places], long

    def wanted_before(self, place: int) -> int:
        """How many wanted rows stand before a place of the block."""
        return int(np.searchsorted(self.places[: self.wanted], place))
