"""Owns the marking of rows around which a UART reported errors.

It must not know how errors are found out, nor how rows are framed: the chunks of a port tell where,
and the framer's rows are marked afterwards, each that shares a byte with a stretch of errors.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import replace

from fte_sniff.protocol.rows import Chunk, Fault, Row


class LineErrorMarker:
    """Marks the rows of one port; give it each chunk before the rows that the chunk completes."""

    def __init__(self) -> None:
        self._offset = 0
        """In the port's stream, of the next chunk."""
        self._errors: deque[tuple[int, int]] = deque()
        """Stretches of the stream with errors in them that rows may yet come for, rising."""

    def heed(self, chunk: Chunk) -> None:
        """Take in where errors were reported."""
        self._errors.extend(
            (self._offset + start, self._offset + stop) for start, stop in chunk.line_errors
        )
        self._offset += len(chunk.data)

    def mark(self, rows: Sequence[Row]) -> list[Row]:
        """These rows, which must follow those marked before, with `line_error` where it is due."""
        return [self._marked(row) for row in rows] if self._errors else list(rows)

    def _marked(self, row: Row) -> Row:
        while self._errors and self._errors[0][1] <= row.offset:
            self._errors.popleft()
        if not self._errors or self._errors[0][0] >= row.offset + len(row.raw):
            return row
        return replace(row, faults=(*row.faults, Fault.LINE_ERROR))
