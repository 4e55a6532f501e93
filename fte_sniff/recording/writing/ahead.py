"""Owns the chunks that threads pack while the next ones are made: they come to the file in order.

It must not know rows. Compression and checksums let go of the interpreter, and are the larger part
of writing; a few chunks are under way at most, whatever is to be written.
"""

from __future__ import annotations

from collections import deque
from concurrent.futures import Future, ThreadPoolExecutor
from types import TracebackType
from typing import Self

from fte_sniff.recording.container.cores import cores
from fte_sniff.recording.container.mcap_file import McapFile
from fte_sniff.recording.container.packed_chunk import PackedChunk, packed
from fte_sniff.recording.encoding.batch import Batch


class PackingAhead:
    """Adds chunks to a file; when it is left all of them are there, unless an error ended it."""

    def __init__(self, file: McapFile) -> None:
        """Take the file, to which nobody else may add chunks meanwhile."""
        self._file = file
        self._threads = ThreadPoolExecutor(cores(), "packs chunks")
        self._under_way: deque[Future[PackedChunk]] = deque()
        self._most = cores() + 1

    def __enter__(self) -> Self:
        return self

    def add(self, batch: Batch) -> None:
        """Add a chunk; waits while enough of them are under way.

        Raises:
            OSError: this chunk or one before cannot be written; nothing more can be added then.
        """
        while len(self._under_way) >= self._most:
            self._write_first()
        definitions = self._file.definitions_for(batch)
        self._under_way.append(self._threads.submit(packed, definitions, batch))

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        try:
            while kind is None and self._under_way:
                self._write_first()
        finally:
            self._threads.shutdown(cancel_futures=True)

    def _write_first(self) -> None:
        self._file.add(self._under_way.popleft().result())
