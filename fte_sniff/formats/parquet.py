"""Write Parquet files, and read those that `decode` wrote; needs polars.

The rows are read from their raw bytes: the other columns only say where the bytes were.
"""

from __future__ import annotations

import errno
import os
import re
from collections.abc import Iterator, Sequence
from pathlib import Path

import polars as pl
from polars.exceptions import PolarsError
from polars.io.plugins import register_io_source

from fte_sniff.errors import FileError, unreadable
from fte_sniff.protocol import FRAME_LENGTH, HEADERS, TAIL, Fault
from fte_sniff.protocol.rows import MOST_BYTES, Row, Rows

_SYSTEM_ERROR = re.compile(r"\(os error ([0-9]+)\)")


def write_parquet(
    frames: Iterator[pl.DataFrame], path: Path, schema: dict[str, pl.DataType]
) -> None:
    """Write the frames in order, with only a few in memory at once.

    Raises OSError if the file cannot be written, and any exception of the iterator.
    """
    raised: list[Exception] = []

    def source(
        _names: list[str] | None, _wanted: pl.Expr | None, _limit: int | None, _size: int | None
    ) -> Iterator[pl.DataFrame]:
        try:
            yield from frames
        except Exception as error:  # noqa: BLE001 - polars would change its type
            raised.append(error)

    try:
        register_io_source(source, schema=schema).sink_parquet(path, engine="streaming")
    except PolarsError as error:
        if not raised:
            raise _system_error(error) from error
    if raised:
        raise raised[0]


def _system_error(error: PolarsError) -> OSError:
    """The system error in the text of a polars error; EIO if there is none."""
    found = _SYSTEM_ERROR.search(str(error))
    if found is None:
        return OSError(errno.EIO, f"a write failed ({' '.join(str(error).split())})")
    return OSError(int(found[1]), os.strerror(int(found[1])))


BATCH_ROWS = 65_536
"""Rows in memory at once."""

_NEEDED = {
    "time": pl.Datetime("ns", "UTC"),
    "port": pl.String(),
    "offset": pl.Int64(),
    "cmd": pl.UInt8(),
    "faults": pl.List(pl.Enum([fault.value for fault in Fault])),
    "raw": pl.String(),
}
"""The columns from which the rows are made; `cmd` is null in a row that is not a frame."""

_OURS = "only Parquet files that `fte-sniff decode` wrote can be read"

_HEADERS = frozenset(HEADERS.values())


class ParquetRows:
    """The rows of a Parquet file that `decode` wrote; read delays are not in it."""

    def __init__(self, path: Path) -> None:
        """Read the columns; raises FileError if the file is unreadable, or of another program."""
        self._path = path
        try:
            with path.open("rb"):
                pass
        except OSError as error:
            raise unreadable(path, error) from error
        try:
            self._table = pl.scan_parquet(path, glob=False)
            found = self._table.collect_schema()
            self.count: int = self._table.select(pl.len()).collect().item()
        except PolarsError as error:
            raise self._damaged(error) from error
        for name, wanted in _NEEDED.items():
            if name not in found:
                raise FileError(f"{path} has no column {name}; {_OURS}")
            # Polars may read the words of an Enum as other types of words.
            if name != "faults" and found[name] != wanted:
                raise FileError(f"{path}: its column {name} is {found[name]}; {_OURS}")

    def ports(self) -> list[str]:
        """The ports, in the order of their first rows."""
        names = pl.col("port").unique(maintain_order=True)
        return self._collected(self._table.select(names))["port"].to_list()

    def times(self) -> tuple[int, int] | None:
        """The first row's time and the latest one; None without rows, or if one has no time."""
        t_ns = pl.col("time").to_physical()
        wanted = (
            t_ns.first().alias("first"),
            t_ns.max().alias("last"),
            t_ns.null_count().alias("no"),
        )
        first, last, unknown = self._collected(self._table.select(*wanted)).row(0)
        return None if unknown or first is None else (first, last)

    def batches(self) -> Iterator[Rows]:
        """The rows in order; raises FileError for a value that no row has."""
        columns = self._table.select(*_NEEDED)
        for start in range(0, self.count, BATCH_ROWS):
            table = self._collected(columns.slice(start, BATCH_ROWS))
            yield self._rows(table, start)

    def _rows(self, table: pl.DataFrame, start: int) -> Rows:
        names = ("time", "port", "offset", "cmd", "raw")
        columns = [table[name].to_physical().to_list() for name in names]
        times, ports, offsets, cmds, _ = columns
        raws: list[bytes] = []
        for at, (port, offset, cmd, text) in enumerate(zip(*columns[1:], strict=True)):
            try:
                raw = bytes.fromhex(text)
                is_frame = len(raw) == FRAME_LENGTH and raw[0] in _HEADERS and raw[-1] == TAIL
                if not raw or port is None or offset is None or (cmd is not None and not is_frame):
                    raise ValueError(text)
            except (TypeError, ValueError):
                what = f"row {start + at} (raw {text}) is not a row of fte-sniff"
                raise FileError(f"{self._path}: {what}; {_OURS}") from None
            raws.append(raw)
        faults, framed = self._fault_sets(table["faults"]), [cmd is not None for cmd in cmds]
        parts = zip(ports, offsets, raws, times, faults, framed, strict=True)
        return Rows.of(one for part in parts for one in _cut(*part))

    def _fault_sets(self, column: pl.Series) -> Sequence[tuple[Fault, ...]]:
        texts = column.cast(pl.List(pl.String())).list.join(",").to_list()
        try:
            known = {
                text: tuple(map(Fault, (text or "").split(",") if text else ()))
                for text in set(texts)
            }
        except ValueError as error:
            raise FileError(f"{self._path}: {error}; {_OURS}") from None
        return [known[text] for text in texts]

    def _collected(self, table: pl.LazyFrame) -> pl.DataFrame:
        try:
            return table.collect()
        except PolarsError as error:
            raise self._damaged(error) from error

    def _damaged(self, error: PolarsError) -> FileError:
        reason = " ".join(str(error).split())
        return FileError(f"{self._path} cannot be read as Parquet: {reason}")


def _cut(
    port: str, offset: int, raw: bytes, t_ns: int | None, faults: tuple[Fault, ...], framed: bool
) -> Iterator[Row]:
    """The rows of one, which is longer than a row in files of earlier versions."""
    for at in range(0, len(raw), MOST_BYTES):
        yield Row(port, offset + at, raw[at : at + MOST_BYTES], t_ns, faults, framed)
