"""Owns rows as a Parquet file, with the contract's columns in the types of the frames that come.

It must not know where the rows come from.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import polars as pl
from polars.io.plugins import register_io_source

from fte_sniff.errors import FteSniffError


def write_parquet(
    frames: Iterator[pl.DataFrame], path: Path, schema: dict[str, pl.DataType]
) -> None:
    """Write the frames one behind the other; no more than a few are held at once.

    Raises:
        OSError: the file cannot be written.
        FteSniffError: what the frames raise.
    """
    raised: list[FteSniffError] = []

    def source(
        _names: list[str] | None, _wanted: pl.Expr | None, _limit: int | None, _size: int | None
    ) -> Iterator[pl.DataFrame]:
        try:
            yield from frames
        except FteSniffError as error:
            raised.append(error)

    register_io_source(source, schema=schema).sink_parquet(path, engine="streaming")
    if raised:
        raise raised[0]
