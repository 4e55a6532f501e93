"""Owns rows on their way to a Parquet file.

It must not know how the file came to be or what it will be called.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Final

import polars as pl

from fte_sniff.analysis.columns.table import TABLE_SCHEMA, rows_table
from fte_sniff.errors import FileError
from fte_sniff.protocol import Row
from fte_sniff.session.saving.origin import Origin

PIECE_ROWS: Final = 262_144
"""Rows of the file that are kept in memory at most."""


class ParquetSink:
    """Rows as `analysis.table` has their columns; many rows wait in files beside the one to be."""

    def __init__(self, path: Path, _origin: Origin) -> None:
        self._path = path
        self._pieces: list[Path] = []
        self._frames: list[pl.DataFrame] = []
        self._waiting = 0

    def write(self, rows: Sequence[Row]) -> None:
        """Take the rows."""
        if rows:
            self._frames.append(rows_table(rows))
            self._waiting += len(rows)
        if self._waiting >= PIECE_ROWS:
            piece = self._path.with_name(f"{self._path.name}.{len(self._pieces)}")
            self._pieces.append(piece)
            self._write(pl.concat(self._frames), piece)
            self._frames, self._waiting = [], 0

    def end(self) -> None:
        """Put all pieces together."""
        rest = pl.concat([pl.DataFrame(schema=dict(TABLE_SCHEMA)), *self._frames])
        if not self._pieces:
            self._write(rest, self._path)
            return
        whole = pl.concat([*map(pl.scan_parquet, self._pieces), rest.lazy()])
        try:
            whole.sink_parquet(self._path)
        except pl.exceptions.PolarsError as error:
            raise FileError(f"{self._path.stem} cannot be written: {error}") from error
        self.abandon()

    def abandon(self) -> None:
        """Take the pieces away."""
        for piece in self._pieces:
            with suppress(OSError):
                piece.unlink(missing_ok=True)

    def _write(self, frame: pl.DataFrame, path: Path) -> None:
        try:
            frame.write_parquet(path)
        except pl.exceptions.PolarsError as error:
            raise FileError(f"{self._path.stem} cannot be written: {error}") from error
