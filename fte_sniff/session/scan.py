"""Recordings as polars tables: public scan() and read()."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Sequence
from os import PathLike
from pathlib import Path
from typing import Literal

import polars as pl
from polars.exceptions import PolarsError
from polars.io.plugins import register_io_source

from fte_sniff.analysis.dataframe import TABLE_SCHEMA, table_frame
from fte_sniff.errors import RecordingWarning, printable
from fte_sniff.recording.batch_reader import TimeRange
from fte_sniff.recording.reader import RecordingReader, recordings_in, start_of
from fte_sniff.row_batch import Codebook, RowBatch

_TIME = "time"
_CLOSED: tuple[Literal["both", "left", "right", "none"], ...] = ("both", "left", "right", "none")
_NS: dict[Literal["ns", "us", "ms"], int] = {"ns": 1, "us": 10**3, "ms": 10**6}
_TIMES = (pl.col(_TIME), *(pl.col(_TIME).cast(pl.Datetime(unit, "UTC")) for unit in _NS))
"""The column, and as polars rounds it down to compare it with times that are coarser."""


def earliest_ns(wanted: pl.Expr) -> int:
    """Nanoseconds since 1970 UTC: no row of an earlier `time` passes the filter; 0 for no bound."""
    inputs = wanted.meta.pop()[::-1]
    if len(inputs) == 3:
        return _since(inputs[0], inputs[1]) if _is_between(wanted, inputs) else 0
    if len(inputs) != 2:
        return 0
    left, right = inputs
    if wanted.meta.eq(left & right):
        return max(earliest_ns(left), earliest_ns(right))
    if wanted.meta.eq(left | right):
        return min(earliest_ns(left), earliest_ns(right))
    if any(map(wanted.meta.eq, (left > right, left >= right, left == right))):
        return _since(left, right)
    if any(map(wanted.meta.eq, (left < right, left <= right))):
        return _since(right, left)
    return 0


def _is_between(wanted: pl.Expr, inputs: list[pl.Expr]) -> bool:
    column, low, high = inputs
    return any(wanted.meta.eq(column.is_between(low, high, closed)) for closed in _CLOSED)


def _since(column: pl.Expr, bound: pl.Expr) -> int:
    if not any(map(column.meta.eq, _TIMES)) or bound.meta.root_names():
        return 0
    try:
        found = pl.select(bound).to_series()
    except PolarsError:
        return 0
    kind = found.dtype
    if not isinstance(kind, pl.Datetime) or kind.time_zone is None or len(found) != 1:
        return 0
    count = found.to_physical().item()
    return 0 if count is None else max(0, count * _NS[kind.time_unit])


_MOST_LOSSES = 5
"""Losses that the warning of a file lists; of more it gives the number."""

Paths = str | PathLike[str] | Sequence[str | PathLike[str]]


def scan(paths: Paths) -> pl.LazyFrame:
    """Recordings as a lazy table with the columns of the row contract; see `read` for their types.

    Only what a query needs is read and decoded: its columns, its rows as they pass its filter, and
    no more rows than it asks for. A filter such as `pl.col("time") >= start`, alone or joined by
    AND, skips the chunks before it. Rows come in batches of about 64 thousand, so a recording of
    any size needs bounded memory with `collect(engine="streaming")` and the `sink_` methods.

    Args:
        paths: a recording, a folder of them, a pattern such as `logs/*.mcap`, or several of these;
            rows come in the order of the recordings' first times.

    Raises:
        FileError: a file cannot be read or is no recording, or there is none. An error found only
            during a query is raised by the query, as polars' ComputeError.

    Warns:
        RecordingWarning: a file is damaged, and rows may be missing; one line for each file says
            what is lost, as `decode` does. Chunks that the query skips are not checked.
    """
    readers = _opened(paths)

    def batches(
        names: list[str] | None, wanted: pl.Expr | None, limit: int | None, _size: int | None
    ) -> Iterator[pl.DataFrame]:
        return _frames(readers, names, wanted, limit)

    return register_io_source(batches, schema=dict(TABLE_SCHEMA), is_pure=True)


def read(paths: Paths) -> pl.DataFrame:
    """Recordings as a table with the columns of the row contract.

    `time` is Datetime("ns", "UTC"); `port` and `raw` String, `raw` in hex; `direction`, `kind` and
    `status` Enum; `faults` List(Enum), empty where nothing is wrong; `offset` Int64, `length`
    UInt32; `cmd` and the values are as wide as on the wire, and null where a row has none.
    Takes the `paths` of `scan`, and raises and warns as it does.
    """
    readers = _opened(paths)
    frames = list(_frames(readers, None, None, None))
    if not frames:
        return pl.DataFrame(schema=dict(TABLE_SCHEMA))
    return pl.concat(frames, rechunk=False)


def _opened(paths: Paths) -> list[RecordingReader]:
    listed = [paths] if isinstance(paths, str | PathLike) else paths
    found = recordings_in(Path(path) for path in listed)
    return sorted(map(RecordingReader, found), key=start_of)


def _frames(
    readers: Sequence[RecordingReader],
    names: list[str] | None,
    wanted: pl.Expr | None,
    limit: int | None,
) -> Iterator[pl.DataFrame]:
    """The frames of a query: of the first `limit` rows, those that pass the filter."""
    make = _maker(names, wanted)
    # A row's time is never later than its log time, so no chunk that ends before can hold one. It
    # may be earlier by any time, so chunks that begin after the last time must be looked through.
    # Where rows are numbered, those that do not pass count too, so none may be passed over.
    span = TimeRange(0 if wanted is None or limit is not None else earliest_ns(wanted))
    for columns in _first(_columns(readers, span), limit):
        yield make(columns)


def _columns(readers: Sequence[RecordingReader], span: TimeRange) -> Iterator[RowBatch]:
    codebook = Codebook()
    for reader in readers:
        yield from (columns for columns in reader.batches(codebook, span) if len(columns))
        _warn_of(reader)


def _first(batches: Iterator[RowBatch], limit: int | None) -> Iterator[RowBatch]:
    """The first `limit` rows of all batches; nothing is read after them."""
    if limit is None:
        yield from batches
        return
    left = limit
    while left > 0 and (columns := next(batches, None)) is not None:
        yield columns if len(columns) <= left else columns[:left]
        left -= len(columns)


def _warn_of(reader: RecordingReader) -> None:
    lost = [loss for loss in (*reader.losses, reader.ending) if loss]
    if len(lost) > _MOST_LOSSES:
        lost[_MOST_LOSSES:] = [f"{len(lost) - _MOST_LOSSES} more losses"]
    if lost:
        # Above are the generators and `read`: the line that called it is where the warning belongs.
        losses = printable(f"{reader.path}: {'; '.join(lost)}")
        warnings.warn(losses, RecordingWarning, stacklevel=6)


def _maker(names: list[str] | None, wanted: pl.Expr | None) -> Callable[[RowBatch], pl.DataFrame]:
    """Makes the frame of a batch: first the filter's columns, then the others of the rows left."""
    if wanted is None:
        return lambda columns: table_frame(columns, names).select(names or pl.all())
    asked = wanted.meta.root_names()

    def make(columns: RowBatch) -> pl.DataFrame:
        mask = table_frame(columns, asked or ["offset"]).select(wanted).to_series().fill_null(False)
        if len(mask) != len(columns):  # polars gives a constant as a single row
            mask = mask.new_from_index(0, len(columns))
        left = columns if mask.all() else columns.select(mask.to_numpy())
        return table_frame(left, names).select(names or pl.all())

    return make
