"""Recordings as polars tables: public scan() and read()."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from operator import attrgetter
from pathlib import Path
from typing import Literal
from urllib.parse import unquote

import polars as pl
from polars.exceptions import PolarsError
from polars.io.plugins import register_io_source

from fte_sniff.analysis.dataframe import TABLE_SCHEMA, table_frame
from fte_sniff.analysis.relations import DEADLINE_NS
from fte_sniff.errors import RecordingWarning, UsageError, printable, unreadable
from fte_sniff.protocol.columns import DERIVED
from fte_sniff.protocol.rows import Rows
from fte_sniff.recording.reader import Recording, TimeRange
from fte_sniff.session.files import Paths, recordings_in
from fte_sniff.session.inputs import InputReading, recording_input

_TIME = "time"
_CLOSED: tuple[Literal["both", "left", "right", "none"], ...] = ("both", "left", "right", "none")
_NS: dict[Literal["ns", "us", "ms"], int] = {"ns": 1, "us": 10**3, "ms": 10**6}
_TIMES = (pl.col(_TIME), *(pl.col(_TIME).cast(pl.Datetime(unit, "UTC")) for unit in _NS))
"""The column, and as polars rounds it down to compare it with times that are coarser."""


_EVER = 0, 2**63 - 1


def time_bounds(wanted: pl.Expr) -> tuple[int, int]:
    """Nanoseconds since 1970 UTC: no row with a `time` outside of them passes the filter."""
    inputs = wanted.meta.pop()[::-1]
    if len(inputs) == 3 and _is_between(wanted, inputs):
        return _first_of(*inputs[:2]), _last_of(inputs[0], inputs[2])
    if len(inputs) != 2:
        return _EVER
    left, right = inputs
    is_ = wanted.meta.eq
    if is_(left & right) or is_(left | right):
        firsts, lasts = zip(time_bounds(left), time_bounds(right), strict=True)
        return (max(firsts), min(lasts)) if is_(left & right) else (min(firsts), max(lasts))
    if is_(left == right):
        return max(_first_of(left, right), _first_of(right, left)), min(
            _last_of(left, right), _last_of(right, left)
        )
    if is_(left > right) or is_(left >= right):
        return _first_of(left, right), _last_of(right, left)
    if is_(left < right) or is_(left <= right):
        return _first_of(right, left), _last_of(left, right)
    return _EVER


def _is_between(wanted: pl.Expr, inputs: list[pl.Expr]) -> bool:
    column, low, high = inputs
    return any(wanted.meta.eq(column.is_between(low, high, closed)) for closed in _CLOSED)


def _first_of(column: pl.Expr, bound: pl.Expr) -> int:
    """The first time that is not before a bound; that of all times if it bounds no time."""
    found = _time_of(column, bound)
    return _EVER[0] if found is None else max(_EVER[0], found[0])


def _last_of(column: pl.Expr, bound: pl.Expr) -> int:
    """The last time that is not after a bound: polars may compare the column rounded down."""
    found = _time_of(column, bound)
    return _EVER[1] if found is None else found[0] + found[1] - 1


def _time_of(column: pl.Expr, bound: pl.Expr) -> tuple[int, int] | None:
    """Nanoseconds since 1970 UTC of a bound of the time, and of its unit; None if it is none."""
    if not any(map(column.meta.eq, _TIMES)) or bound.meta.root_names():
        return None
    try:
        found = pl.select(bound).to_series()
    except PolarsError:
        return None
    kind = found.dtype
    if not isinstance(kind, pl.Datetime) or kind.time_zone is None or len(found) != 1:
        return None
    count = found.to_physical().item()
    return None if count is None else (count * _NS[kind.time_unit], _NS[kind.time_unit])


_MOST_LOSSES = 5
"""Losses that the warning of a file lists; of more it gives the number."""


def scan(paths: Paths, *, file_column: bool = False, hive: bool = False) -> pl.LazyFrame:
    """Recordings as a lazy table with the columns of the row contract; see `read` for their types.

    Only what a query needs is read and decoded: its columns, its rows as they pass its filter, and
    no more rows than it asks for. A filter such as `pl.col("time") >= start`, alone or joined by
    AND, skips the chunks before it, and `pl.col("time") < end` those after it. A file is opened
    when the query reaches it, and skipped if its summary, as it is then, shows that the filter
    holds for none of its times, or for none of its ports.
    Rows come in batches of about 64 thousand, so a recording of any size needs bounded memory with
    `collect(engine="streaming")` and the `sink_` methods.

    Args:
        paths: a recording, a folder of them, a pattern such as `logs/*.mcap`, or several of these;
            rows come in the order of the recordings' first times.
        file_column: whether to add the column `file`, the path as text.
        hive: whether to add a column for each folder such as `robot=7/` in the paths: Int64 if
            all its values are whole numbers, otherwise String; null for files without it.

    Raises:
        FileError: a file cannot be read or is not a recording, or there is none. An error found
            only during a query is raised by the query, as polars' ComputeError.
        UsageError: a folder has the name of a column.

    Warns:
        RecordingWarning: a file is damaged, and rows may be missing; one line for each file says
            what is lost, as `decode` does. Chunks and files that the query skips are not checked.
    """
    files = [_ScannedFile.of(reader) for reader in map(Recording, recordings_in(paths))]
    files.sort(key=attrgetter("start"))
    added = _added_columns([one.path for one in files], file_column=file_column, hive=hive)

    def batches(
        names: list[str] | None, wanted: pl.Expr | None, limit: int | None, _size: int | None
    ) -> Iterator[pl.DataFrame]:
        # Where rows are numbered, those that do not pass count too, so none may be passed over.
        first_ns, last_ns = _EVER if wanted is None or limit is not None else time_bounds(wanted)
        left = limit
        for number, one in enumerate(files):
            own = added[number : number + 1]
            may_skip = limit is None and wanted is not None
            if may_skip and one.current().is_skipped(wanted, first_ns, last_ns, own):
                continue
            make = _maker(names, wanted, own)
            needed = {
                *(names or TABLE_SCHEMA),
                *(() if wanted is None else wanted.meta.root_names()),
            }
            facts = not DERIVED.isdisjoint(needed)
            span = TimeRange(first_ns, min(last_ns, _EVER[1] - 1) + 1)
            if facts:  # they depend on rows before and after; the filter itself drops those
                end_ns = min(last_ns, _EVER[1] - DEADLINE_NS - 1) + DEADLINE_NS + 1
                span = TimeRange(max(_EVER[0], first_ns - DEADLINE_NS), end_ns)
            for columns in _first(_columns([Recording(one.path)], span, facts=facts), left):
                left = None if left is None else left - len(columns)
                yield make(columns)
            if left == 0:
                return

    return register_io_source(batches, schema=dict(TABLE_SCHEMA) | dict(added.schema), is_pure=True)


@dataclass(frozen=True, slots=True)
class _ScannedFile:
    """What a query needs to know of a file before it opens it."""

    path: Path
    start: tuple[bool, int]
    span_ns: tuple[int, int]
    """No row is before the first or after the second, nanoseconds since 1970 UTC."""
    ports: tuple[str, ...]
    """Empty if the summary does not show them."""
    version: tuple[int, int, int, int]
    """That of the file whose summary this is."""

    @classmethod
    def of(cls, reader: Recording) -> _ScannedFile:
        start, version = _start(reader), _version_of(reader.path)
        if reader.times is None or not reader.has_summary:
            return cls(reader.path, start, _EVER, (), version)
        ports = (one.name.encode(errors="replace").decode() for one in reader.ports)
        # A row that came late has an earlier time than its message.
        return cls(reader.path, start, (_EVER[0], reader.times[1]), tuple(ports), version)

    def current(self) -> _ScannedFile:
        """This file with the summary that it has now; raises FileError if it is not there."""
        try:
            if _version_of(self.path) == self.version:
                return self
        except OSError as error:
            raise unreadable(self.path, error) from error
        return _ScannedFile.of(Recording(self.path))

    def is_skipped(
        self, wanted: pl.Expr | None, first_ns: int, last_ns: int, added: pl.DataFrame
    ) -> bool:
        """Whether none of its rows can pass the filter; `added` are its further columns."""
        if wanted is None:
            return False
        if self.span_ns[1] < first_ns or last_ns < self.span_ns[0]:
            return True
        known = added
        if self.ports:
            ports = pl.DataFrame({"port": self.ports})
            known = ports if not added.width else ports.join(added, how="cross")
        return bool(known.width) and _excludes(wanted, known)


def _version_of(path: Path) -> tuple[int, int, int, int]:
    """Device, inode, size and time of the last change of a file."""
    found = path.stat()
    return found.st_dev, found.st_ino, found.st_size, found.st_mtime_ns


def _excludes(wanted: pl.Expr, known: pl.DataFrame) -> bool:
    """Whether a filter holds for no row that has these values in some columns."""
    names = set(wanted.meta.root_names())
    if names and names <= set(known.columns):
        try:
            return not known.select(wanted).to_series().any()
        except PolarsError:
            return False  # the query raises it
    inputs = wanted.meta.pop()[::-1]
    if len(inputs) != 2:
        return False
    left, right = inputs
    if wanted.meta.eq(left & right):
        return _excludes(left, known) or _excludes(right, known)
    return wanted.meta.eq(left | right) and _excludes(left, known) and _excludes(right, known)


def _added_columns(files: Sequence[Path], *, file_column: bool, hive: bool) -> pl.DataFrame:
    """The further columns, a row for each file."""
    columns: dict[str, pl.Series] = {}
    if hive:
        keys = [dict(_hive_keys(path)) for path in files]
        for name in dict.fromkeys(name for own in keys for name in own):
            values = pl.Series(name, [own.get(name) for own in keys], pl.String)
            numbers = values.cast(pl.Int64, strict=False)
            columns[name] = numbers if numbers.null_count() == values.null_count() else values
    if file_column:
        columns["file"] = pl.Series("file", [_text_of(path) for path in files], pl.String)
    for name in columns:
        if name in TABLE_SCHEMA or (hive and file_column and name == "file" and name in keys[0]):
            raise UsageError(f"a folder is named {name}=..., as a column is; rename it")
    return pl.DataFrame(list(columns.values()))


def _hive_keys(path: Path) -> Iterator[tuple[str, str]]:
    for folder in path.parts[:-1]:
        name, sign, value = folder.partition("=")
        if sign and name:
            yield name, unquote(value)


def _text_of(path: Path) -> str:
    return str(path).encode(errors="replace").decode()


def read(paths: Paths) -> pl.DataFrame:
    """Recordings as a table with the columns of the row contract.

    `time` is Datetime("ns", "UTC"); `port` and `raw` String, `raw` in hex; `direction`, `kind` and
    `status` Enum; `faults` List(Enum), empty where nothing is wrong; `offset` Int64, `length`
    UInt32; `cmd` and the values are as wide as on the wire, and null where a row has none.
    Takes the `paths` of `scan`, and raises and warns as it does.
    """
    readers = sorted(map(Recording, recordings_in(paths)), key=_start)
    frames = list(map(table_frame, _whole(readers)))
    if not frames:
        return pl.DataFrame(schema=dict(TABLE_SCHEMA))
    return pl.concat(frames, rechunk=False)


def _columns(readers: Sequence[Recording], span: TimeRange, *, facts: bool) -> Iterator[Rows]:
    for reader in readers:
        plain = (batch.rows for batch in reader.batches(span))
        batches = _with_facts(reader, span) if facts else plain
        yield from (columns for columns in batches if len(columns))
        _warn_of(reader)


def _with_facts(reader: Recording, span: TimeRange) -> Iterator[Rows]:
    """The rows with their facts, which do not span a gap."""
    reading = InputReading([recording_input(reader)], span, facts=True)
    return (item for item in reading if isinstance(item, Rows))


def _start(reader: Recording) -> tuple[bool, int]:
    """The sort key of recordings: their first times."""
    return reader.times is None, 0 if reader.times is None else reader.times[0]


def _whole(readers: Sequence[Recording]) -> Iterator[Rows]:
    yield from _first(_columns(readers, TimeRange(), facts=True), None)


def _first(batches: Iterator[Rows], limit: int | None) -> Iterator[Rows]:
    """The first `limit` rows of all batches; nothing is read after them."""
    if limit is None:
        yield from batches
        return
    left = limit
    while left > 0 and (columns := next(batches, None)) is not None:
        yield columns if len(columns) <= left else columns[:left]
        left -= len(columns)


def _warn_of(reader: Recording) -> None:
    lost = reader.losses
    if len(lost) > _MOST_LOSSES:
        lost[_MOST_LOSSES:] = [f"{len(lost) - _MOST_LOSSES} more losses"]
    if lost:
        # Above are the generators and `read`: the line that called it is where the warning belongs.
        losses = printable(f"{reader.path}: {'; '.join(lost)}")
        warnings.warn(losses, RecordingWarning, stacklevel=6)


def _maker(
    names: list[str] | None, wanted: pl.Expr | None, added: pl.DataFrame
) -> Callable[[Rows], pl.DataFrame]:
    """Makes the frame of a batch: first the filter's columns, then the others of the rows left.

    `added` is one row of further columns.
    """

    def frame(columns: Rows, needed: list[str] | None) -> pl.DataFrame:
        own = [one for one in added if needed is None or one.name in needed]
        if not own:
            return table_frame(columns, needed)
        known = table_frame(columns, None if needed is None else [*needed, "offset"])
        return known.with_columns(one.new_from_index(0, len(columns)) for one in own)

    if wanted is None:
        return lambda columns: frame(columns, names).select(names or pl.all())
    asked = wanted.meta.root_names()

    def make(columns: Rows) -> pl.DataFrame:
        mask = frame(columns, asked or ["offset"]).select(wanted).to_series().fill_null(False)
        if len(mask) != len(columns):  # polars gives a constant as a single row
            mask = mask.new_from_index(0, len(columns))
        left = columns if mask.all() else columns.select(mask.to_numpy())
        return frame(left, names).select(names or pl.all())

    return make
