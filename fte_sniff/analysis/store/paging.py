"""Owns which blocks of a store lie in memory where their rows can be read again.

It must not know a file: whoever brings a `BlockSource` does. A block that is full can be dropped,
and comes back when it is asked for; of those that were asked for last, so many stay.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final, Protocol

from fte_sniff.analysis.columns.packing import Codebook, Packed
from fte_sniff.analysis.store.block import Block

MOST_BLOCKS: Final = 128
"""Full blocks that stay in memory where nobody says otherwise: some 200 megabytes."""


class BlockSource(Protocol):
    """Gives rows again that a store has seen before."""

    def load(
        self, start: int, count: int, codebook: Codebook
    ) -> tuple[Packed, Mapping[int, bytes]]:
        """The rows from index `start` on, exactly `count`, as `pack` gives them.

        Args:
            start: index of the first: how many rows came before it since the store began.
            count: how many.
            codebook: the store's; ports and faults get their numbers from it.

        Raises:
            FileError: they cannot be read any more.
        """
        ...


class Pages:
    """The blocks that may be dropped, those that were asked for last at the end."""

    def __init__(self, source: BlockSource | None, most: int, codebook: Codebook) -> None:
        """None has been dropped.

        Args:
            source: gives rows again; without one every block stays.
            most: full blocks in memory at most, at least 1.
            codebook: the store's.
        """
        self._source = source
        self._most = most
        self._codebook = codebook
        self._held: dict[int, Block] = {}

    @property
    def most_blocks(self) -> int | None:
        """Full blocks in memory at most; None where every block stays."""
        return None if self._source is None else self._most

    def bring(self, block: Block) -> Block:
        """The same block, with its rows in memory.

        Raises:
            FileError: they cannot be read any more.
        """
        if self._source is None:
            return block
        if block.dropped:
            rows, long = self._source.load(block.start, block.count, self._codebook)
            block.restore(rows, long)
        if not block.room:
            self._held.pop(block.start, None)
            self._held[block.start] = block
            self._make_room()
        return block

    def forget(self, block: Block) -> None:
        """The block has left the store."""
        self._held.pop(block.start, None)

    def _make_room(self) -> None:
        while len(self._held) > self._most:
            self._held.pop(next(iter(self._held))).drop()
