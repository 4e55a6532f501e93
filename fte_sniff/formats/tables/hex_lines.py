"""Owns the bytes of rows as hex, a line a row: what the program reads back as hex text.

It must not know where the rows come from.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, TextIO

from fte_sniff.protocol import Row, spaced_hex

if TYPE_CHECKING:
    import polars as pl


class HexWriter:
    """Writes `AA 01 01 03 E8 00 00 00 00 EE`, and nothing else of a row."""

    tells_order = False

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def write(self, rows: Sequence[Row]) -> None:
        """Write the rows' bytes."""
        self._stream.writelines(f"{spaced_hex(row.raw)}\n" for row in rows)

    def write_frame(self, frame: pl.DataFrame) -> None:
        """Write the bytes of the rows of a frame that has the contract's columns."""
        spaced = frame.get_column("raw").str.replace_all("(..)", "$1 ").str.strip_suffix(" ")
        self._stream.writelines(f"{line}\n" for line in spaced)

    def end(self) -> None:
        """Nothing is held back."""
