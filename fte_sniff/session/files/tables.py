"""Owns recordings as polars tables: `scan` and `read`, which the package hands out by these names.

It must not know how a recording is laid out, nor what a column means. Here the reader's columns
become the contract's, batch by batch.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Sequence
from os import PathLike
from pathlib import Path

import polars as pl
from polars.io.plugins import register_io_source

from fte_sniff.analysis.dataframe import TABLE_SCHEMA, table_frame
from fte_sniff.errors import RecordingWarning, shown
from fte_sniff.recording.passages import Span
from fte_sniff.recording.reader import RecordingReader, recordings_in, start_of
from fte_sniff.row_batch import RowColumns, Words
from fte_sniff.session.files.earliest import earliest_ns

_MOST_LOSSES = 5
"""Losses that the warning of a file lists; of more it gives the number."""

Paths = str | PathLike[str] | Sequence[str | PathLike[str]]


def scan(paths: Paths) -> pl.LazyFrame:
    """Recordings as a lazy table with the columns of the row contract; see `read` for their types.

    Only what a query needs is read and decoded: its columns, its rows as they pass its filter, and
    no more rows than it asks for. A filter such as `pl.col("time") >= start`, alone or joined by
    AND, passes over the chunks before it unread. Rows come by batches of some 64 thousand, so that
    a recording of any size takes bounded memory with `collect(engine="streaming")` and the `sink_`
    methods.

    Args:
        paths: a recording, a folder of them, a pattern such as `logs/*.mcap`, or several of these;
            rows come in the order of the recordings' first times.

    Raises:
        FileError: a file cannot be read or is no recording, or there is none. What is found only
            in the midst of a query is raised by the query, as polars' ComputeError.

    Warns:
        RecordingWarning: a file is damaged, and rows may be missing; one line a file says what is
            lost, as `decode` does. Of what a query passes over or does not come to, none is said.
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

    Args:
        paths: as for `scan`.

    Raises:
        FileError: a file cannot be read or is no recording, or there is none.

    Warns:
        RecordingWarning: a file is damaged, and rows may be missing; one line a file says what is
            lost, as `decode` does.
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
    span = Span(0 if wanted is None or limit is not None else earliest_ns(wanted))
    for columns in _first(_columns(readers, span), limit):
        yield make(columns)


def _columns(readers: Sequence[RecordingReader], span: Span) -> Iterator[RowColumns]:
    words = Words()
    for reader in readers:
        yield from (columns for columns in reader.batches(words, span) if len(columns))
        _warn_of(reader)


def _first(batches: Iterator[RowColumns], limit: int | None) -> Iterator[RowColumns]:
    """The first so many rows of all batches; nothing is read behind them."""
    if limit is None:
        yield from batches
        return
    left = limit
    while left > 0 and (columns := next(batches, None)) is not None:
        yield columns if len(columns) <= left else columns.parted(slice(left))
        left -= len(columns)


def _warn_of(reader: RecordingReader) -> None:
    """Say what a file that was read to its end lacks."""
    lost = [loss for loss in (*reader.losses, reader.ending) if loss]
    if len(lost) > _MOST_LOSSES:
        lost[_MOST_LOSSES:] = [f"{len(lost) - _MOST_LOSSES} more losses"]
    if lost:
        # Above are the generators and `read`: the line that called it is where the warning belongs.
        told = shown(f"{reader.path}: {'; '.join(lost)}")
        warnings.warn(told, RecordingWarning, stacklevel=6)


def _maker(names: list[str] | None, wanted: pl.Expr | None) -> Callable[[RowColumns], pl.DataFrame]:
    """What makes the frame of a batch: first the filter's columns, the others for what is left."""
    if wanted is None:
        return lambda columns: table_frame(columns, names).select(names or pl.all())
    asked = wanted.meta.root_names()

    def make(columns: RowColumns) -> pl.DataFrame:
        mask = table_frame(columns, asked or ["offset"]).select(wanted).to_series().fill_null(False)
        if len(mask) != len(columns):  # polars gives a constant as a single row
            mask = mask.new_from_index(0, len(columns))
        left = columns if mask.all() else columns.parted(mask.to_numpy())
        return table_frame(left, names).select(names or pl.all())

    return make
