"""Owns rows on their way to a Parquet file, handed over piece by piece.

It must not know how the file came to be or what it will be called, nor how Parquet is written:
`formats` does, and asks for rows, so it does that in a thread of its own.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from queue import Full, Queue
from threading import Thread
from typing import Final

import polars as pl

from fte_sniff.analysis.dataframe import TABLE_SCHEMA, rows_table
from fte_sniff.formats.parquet import write_parquet
from fte_sniff.protocol import Row
from fte_sniff.session.saving.origin import Origin

MOST_WAITING: Final = 8
"""Pieces that wait to be written at most."""

_LOOK_S: Final = 0.1
"""How long a piece waits before it is seen whether anybody still writes."""


class _AbandonedError(Exception):
    """The file is not wanted any more."""


class ParquetSink:
    """Rows as `analysis.table` has their columns."""

    def __init__(self, path: Path, _origin: Origin) -> None:
        self._path = path
        self._waiting: Queue[pl.DataFrame | None] = Queue(MOST_WAITING)
        self._error: Exception | None = None
        self._abandoned = False
        self._thread = Thread(target=self._write, name="writes Parquet", daemon=True)
        self._thread.start()

    def write(self, rows: Sequence[Row]) -> None:
        """Take the rows."""
        if rows:
            self._put(rows_table(rows))

    def end(self) -> None:
        """Wait until all is written."""
        self._put(None)
        self._thread.join()
        if self._error is not None:
            raise self._error

    def abandon(self) -> None:
        """Write no more."""
        self._abandoned = True
        if self._thread.is_alive():
            try:
                self._put(None)
            finally:
                self._thread.join()

    def _put(self, frame: pl.DataFrame | None) -> None:
        while self._error is None:
            try:
                self._waiting.put(frame, timeout=_LOOK_S)
            except Full:
                continue
            return
        if not self._abandoned:
            raise self._error

    def _write(self) -> None:
        try:
            write_parquet(self._frames(), self._path, dict(TABLE_SCHEMA))
        except (OSError, _AbandonedError) as error:
            self._error = error

    def _frames(self) -> Iterator[pl.DataFrame]:
        while not self._abandoned and (frame := self._waiting.get()) is not None:
            yield frame
        if self._abandoned:
            raise _AbandonedError
