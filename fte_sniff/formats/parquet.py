"""Write Parquet files; needs polars."""

from __future__ import annotations

import errno
import os
import re
from collections.abc import Iterator
from pathlib import Path

import polars as pl
from polars.exceptions import PolarsError
from polars.io.plugins import register_io_source

_SYSTEM_ERROR = re.compile(r"\(os error ([0-9]+)\)")


def write_parquet(
    frames: Iterator[pl.DataFrame], path: Path, schema: dict[str, pl.DataType]
) -> None:
    """Write the frames in order, with only a few in memory at once.

    Raises OSError if the file cannot be written.
    """
    try:
        source = register_io_source(lambda *_wanted: frames, schema=schema)
        source.sink_parquet(path, engine="streaming")
    except PolarsError as error:
        raise _system_error(error) from error


def _system_error(error: PolarsError) -> OSError:
    """The system error in the text of a polars error; EIO if there is none."""
    found = _SYSTEM_ERROR.search(str(error))
    if found is None:
        return OSError(errno.EIO, f"a write failed ({' '.join(str(error).split())})")
    return OSError(int(found[1]), os.strerror(int(found[1])))
