"""Recordings as polars tables: public scan() and read()."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from typing import Final, Literal

import polars as pl
from polars.exceptions import PolarsError
from polars.io.plugins import register_io_source

from fte_sniff.analysis.dataframe import TABLE_SCHEMA, table_frame
from fte_sniff.analysis.relations import DEADLINE_NS
from fte_sniff.errors import RecordingWarning, printable
from fte_sniff.protocol.columns import DERIVED
from fte_sniff.protocol.rows import Rows
from fte_sniff.recording.reader import Recording, TimeRange
from fte_sniff.session.files import Paths, recordings_in
from fte_sniff.session.inputs import InputReading, recording_input

_NS: dict[Literal["ns", "us", "ms"], int] = {"ns": 1, "us": 10**3, "ms": 10**6}
_TIMES = (pl.col("time"), *(pl.col("time").cast(pl.Datetime(unit, "UTC")) for unit in _NS))
"""The column, and as polars rounds it down to compare it with times that are coarser."""
_CLOSED: tuple[Literal["both", "left", "right", "none"], ...] = ("both", "left", "right", "none")
_EVER: Final = 0, 2**63 - 1
_FILE: Final = "file"


def time_bounds(wanted: pl.Expr) -> tuple[int, int]:
    """Nanoseconds since 1970 UTC: no row with a `time` outside of them passes the filter.

    They are those of comparisons with a time that AND joins.
    """
    (left, *others), is_ = wanted.meta.pop()[::-1] or [wanted], wanted.meta.eq
    if len(others) == 1 and is_(left & others[0]):
        firsts, lasts = zip(time_bounds(left), time_bounds(others[0]), strict=True)
        return max(firsts), min(lasts)
    if len(others) == 2 and any(
        is_(left.is_between(others[0], others[1], closed)) for closed in _CLOSED
    ):
        return _time_of(left, others[0])[0], _time_of(left, others[1])[1]
    if len(others) == 1:
        for low, high in ((left, others[0]), (others[0], left)):
            if is_(low < high) or is_(low <= high) or is_(high > low) or is_(high >= low):
                return _time_of(high, low)[0], _time_of(low, high)[1]
    return _EVER


def _time_of(column: pl.Expr, bound: pl.Expr) -> tuple[int, int]:
    """The first and the last nanosecond of a bound of the time; `_EVER` if it bounds no time."""
    if not any(map(column.meta.eq, _TIMES)) or bound.meta.root_names():
        return _EVER
    try:
        found = pl.select(bound).to_series()
    except PolarsError:
        return _EVER
    kind, count = found.dtype, found.to_physical()
    if (
        not isinstance(kind, pl.Datetime)
        or not kind.time_zone
        or len(found) != 1
        or count[0] is None
    ):
        return _EVER
    unit = _NS[kind.time_unit]
    return max(0, count[0] * unit), min(count[0] * unit + unit - 1, _EVER[1])


def scan(paths: Paths, *, file_column: bool = False) -> pl.LazyFrame:
    """Recordings as a lazy table with the columns of the row contract; see `read` for their types.

    Only what a query needs is read and decoded: its columns, its rows as they pass its filter, and
    no more rows than it asks for. A filter such as `pl.col("time") >= start`, alone or joined by
    AND, skips the chunks before it, and `pl.col("time") < end` those after it. A file is opened
    when the query reaches it.
    Rows come in batches of about 64 thousand, so a recording of any size needs bounded memory with
    `collect(engine="streaming")` and the `sink_` methods.

    Args:
        paths: a recording, a folder of them, a pattern such as `logs/*.mcap`, or several of these;
            rows come in the order of the recordings' first times.
        file_column: whether to add the column `file`, the path as text.

    Raises:
        FileError: a file cannot be read or is not a recording, or there is none. An error found
            only during a query is raised by the query, as polars' ComputeError.

    Warns:
        RecordingWarning: a file is damaged, and rows may be missing; one line for each file says
            what is lost, as `decode` does. Chunks that the query skips are not checked.
    """
    files = [reader.path for reader in _in_order(paths)]
    schema = dict(TABLE_SCHEMA) | ({_FILE: pl.String()} if file_column else {})

    def batches(
        names: list[str] | None, wanted: pl.Expr | None, limit: int | None, _size: int | None
    ) -> Iterator[pl.DataFrame]:
        # Where rows are numbered, those that do not pass count too, so none may be passed over.
        bounds = _EVER if wanted is None or limit is not None else time_bounds(wanted)
        needed = {*(names or schema), *(() if wanted is None else wanted.meta.root_names())}
        left = _EVER[1] if limit is None else limit
        for path in files:
            if left <= 0:
                return
            for rows in _rows_of(Recording(path), *bounds, facts=not DERIVED.isdisjoint(needed)):
                frame = table_frame(rows[:left], needed | {"offset"})
                left -= len(frame)
                if _FILE in needed:
                    text = str(path).encode(errors="replace").decode()
                    frame = frame.with_columns(pl.lit(text).alias(_FILE))
                passed = frame if wanted is None else frame.filter(wanted)
                yield passed.select(names or [*schema])
                if left <= 0:
                    break

    return register_io_source(batches, schema=schema, is_pure=True)


def read(paths: Paths) -> pl.DataFrame:
    """Recordings as a table with the columns of the row contract.

    `time` is Datetime("ns", "UTC"); `port` and `raw` String, `raw` in hex; `direction`, `kind` and
    `status` Enum; `faults` List(Enum), empty where nothing is wrong; `offset` Int64, `length`
    UInt32; `cmd` and the values are as wide as on the wire, and null where a row has none.
    Takes the `paths` of `scan`, and raises and warns as it does.
    """
    frames = [pl.DataFrame(schema=dict(TABLE_SCHEMA))]
    for reader in _in_order(paths):
        for rows in _rows_of(reader, *_EVER, facts=True):
            frames.append(table_frame(rows))
    return pl.concat(frames, rechunk=False)


def _in_order(paths: Paths) -> list[Recording]:
    """The recordings in the order of their first times."""
    readers = map(Recording, recordings_in(paths))
    return sorted(readers, key=lambda one: (one.times is None, one.times or ()))


_MOST_LOSSES: Final = 5
"""Losses that the warning of a file lists; of more it gives the number."""


def _rows_of(reader: Recording, first_ns: int, last_ns: int, *, facts: bool) -> Iterator[Rows]:
    """The rows between two times, and perhaps more; warns of what is lost.

    Facts depend on rows before and after, and do not span a gap.
    """
    if facts:
        end_ns = min(last_ns, _EVER[1] - DEADLINE_NS - 1) + DEADLINE_NS + 1
        span = TimeRange(max(0, first_ns - DEADLINE_NS), end_ns)
        reading = InputReading([recording_input(reader)], span, facts=True)
        yield from (item for item in reading if isinstance(item, Rows) and len(item))
    else:
        span = TimeRange(first_ns, min(last_ns, _EVER[1] - 1) + 1)
        yield from (item for item in reader.items(span) if isinstance(item, Rows))
    lost = reader.losses
    if len(lost) > _MOST_LOSSES:
        lost[_MOST_LOSSES:] = [f"{len(lost) - _MOST_LOSSES} more losses"]
    if lost:
        losses = printable(f"{reader.path}: {'; '.join(lost)}")
        warnings.warn(losses, RecordingWarning, stacklevel=3)  # of the caller of `read`
