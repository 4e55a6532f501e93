"""Owns the way back from a row's number to the recordings it came from, for a view that pages.

It must not know what a view does with rows, nor how a recording is read again. Batches are noted
while they are read, in a thread of their own; rows are asked for by the view, in another.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Mapping
from typing import Final

import numpy as np

from fte_sniff.row_batch import Codebook, Packed, RowColumns, packed_rows

MOST_HELD: Final = 4
"""Batches that stay unpacked: a filter works from the cursor up and down, and rows of one block
may stand in two batches."""

_Held = tuple[Packed, Mapping[int, bytes]]


class RecordedPages:
    """Gives the rows of recordings again; a `BlockSource`."""

    def __init__(self) -> None:
        """Nothing was read yet."""
        self._again: list[Callable[[], RowColumns]] = []
        self._starts: list[int] = []
        self._rows = 0
        self._held: dict[int, _Held] = {}
        self._codebook: Codebook | None = None

    def add(self, again: Callable[[], RowColumns], rows: int) -> None:
        """The next so many rows were read; `again` reads the same ones."""
        if rows:
            self._again.append(again)
            # Last, because it is here that a batch is looked up from another thread.
            self._starts.append(self._rows)
            self._rows += rows

    def load(
        self, start: int, count: int, codebook: Codebook
    ) -> tuple[Packed, Mapping[int, bytes]]:
        """The rows from index `start` on; see `BlockSource`.

        Raises:
            FileError: they cannot be read any more, or are others by now.
        """
        pieces: list[Packed] = []
        long: dict[int, bytes] = {}
        done = 0
        while done < count:
            number = bisect_right(self._starts, start + done) - 1
            packed, own = self._batch(number, codebook)
            first = start + done - self._starts[number]
            piece = packed[first : first + count - done]
            shift = done - first
            long.update(
                (at + shift, raw) for at, raw in own.items() if first <= at < first + len(piece)
            )
            pieces.append(piece)
            done += len(piece)
        # A copy, so that a block does not keep a whole batch alive.
        return np.concatenate(pieces), long

    def _batch(self, number: int, codebook: Codebook) -> _Held:
        if codebook is not self._codebook:
            self._codebook, self._held = codebook, {}
        held = self._held.pop(number, None)
        if held is None:
            held = packed_rows(self._again[number]()).packed_for(codebook)
        self._held[number] = held
        while len(self._held) > MOST_HELD:
            self._held.pop(next(iter(self._held)))
        return held
