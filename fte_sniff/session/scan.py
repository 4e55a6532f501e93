"""Recordings as polars tables: public scan() and read()."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Iterator
from datetime import UTC, datetime, timedelta
from typing import Final

import polars as pl
from polars.io.plugins import register_io_source

from fte_sniff.analysis.dataframe import TABLE_SCHEMA, table_frame
from fte_sniff.analysis.relations import DEADLINE_NS
from fte_sniff.errors import RecordingWarning, encodable, printable
from fte_sniff.protocol.columns import DERIVED
from fte_sniff.protocol.rows import Item, Rows
from fte_sniff.recording.reader import EVERYTHING, Recording, TimeRange
from fte_sniff.session.files import Paths, recordings_in
from fte_sniff.session.inputs import InputReading, recording_input

_FILE: Final = "file"
_EPOCH: Final = datetime(1970, 1, 1, tzinfo=UTC)


def scan(
    paths: Paths,
    *,
    start: datetime | None = None,
    end: datetime | None = None,
    file_column: bool = False,
) -> pl.LazyFrame:
    """Recordings as a lazy table with the columns of the row contract; see `read` for their types.

    Only what a query needs is read and decoded: its columns, its rows as they pass its filter, and
    no more rows than it asks for. A file is opened when the query reaches it. With `start` and
    `end`, the chunks outside of them are skipped, which a filter of `time` does not do.
    Rows come in batches of about 64 thousand, so a recording of any size needs bounded memory with
    `collect(engine="streaming")` and the `sink_` methods.

    Args:
        paths: a recording, a folder of them, a pattern such as `logs/*.mcap`, or several of these;
            rows come in the order of the recordings' first times.
        start: only rows from this time on; it has a zone.
        end: only rows before this time; it has a zone.
        file_column: whether to add the column `file`, the path as text.

    Raises:
        FileError: a file cannot be read or is not a recording, or there is none. An error found
            only during a query is raised by the query, as polars' ComputeError.

    Warns:
        RecordingWarning: a file is damaged, and rows may be missing; one line for each file says
            what is lost, as `decode` does. Chunks that are skipped are not checked.
    """
    files = [reader.path for reader in _in_order(paths)]
    schema = dict(TABLE_SCHEMA) | ({_FILE: pl.String()} if file_column else {})
    span = TimeRange(
        EVERYTHING.first_ns if start is None else _ns_of(start),
        EVERYTHING.end_ns if end is None else _ns_of(end),
    )

    def batches(
        names: list[str] | None, wanted: pl.Expr | None, limit: int | None, _size: int | None
    ) -> Iterator[pl.DataFrame]:
        needed = {*(names or schema), *(() if wanted is None else wanted.meta.root_names())}
        left = EVERYTHING.end_ns if limit is None else limit
        for path in files:
            if left <= 0:
                return
            for rows in _rows_of(Recording(path), span, facts=not DERIVED.isdisjoint(needed)):
                frame = table_frame(rows[:left], needed | {"offset"})
                left -= len(frame)
                if _FILE in needed:
                    frame = frame.with_columns(pl.lit(encodable(str(path))).alias(_FILE))
                passed = frame if wanted is None else frame.filter(wanted)
                yield passed.select(names or [*schema])
                if left <= 0:
                    break

    return register_io_source(batches, schema=schema, is_pure=True)


def _ns_of(time: datetime) -> int:
    return (time - _EPOCH) // timedelta(microseconds=1) * 1000


def read(paths: Paths) -> pl.DataFrame:
    """Recordings as a table with the columns of the row contract.

    `time` is Datetime("ns", "UTC"); `port` and `raw` String, `raw` in hex; `direction`, `kind` and
    `status` Enum; `faults` List(Enum), empty where nothing is wrong; `offset` Int64, `length`
    UInt32; `cmd` and the values are as wide as on the wire, and null where a row has none.
    Takes the `paths` of `scan`, and raises and warns as it does.
    """
    frames = [pl.DataFrame(schema=dict(TABLE_SCHEMA))]
    for reader in _in_order(paths):
        for rows in _rows_of(reader, EVERYTHING, facts=True):
            frames.append(table_frame(rows))
    return pl.concat(frames, rechunk=False)


def _in_order(paths: Paths) -> list[Recording]:
    """The recordings in the order of their first times."""
    readers = map(Recording, recordings_in(paths))
    return sorted(readers, key=lambda one: (one.times is None, one.times or ()))


def _rows_of(reader: Recording, span: TimeRange, *, facts: bool) -> Iterator[Rows]:
    """The rows in a span; warns of what is lost.

    Facts depend on rows before and after, and do not span a gap.
    """
    items: Iterable[Item] = reader.items(span)
    if facts:
        end_ns = min(span.end_ns, EVERYTHING.end_ns - DEADLINE_NS) + DEADLINE_NS
        wider = TimeRange(max(0, span.first_ns - DEADLINE_NS), end_ns)
        items = span.within(InputReading([recording_input(reader)], wider, has_facts=True))
    yield from (item for item in items if isinstance(item, Rows))
    if reader.losses:
        losses = printable(f"{reader.path}: {'; '.join(reader.losses)}")
        warnings.warn(losses, RecordingWarning, stacklevel=3)  # of the caller of `read`
