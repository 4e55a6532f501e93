"""Save rows of a session in any format."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from datetime import UTC, tzinfo
from pathlib import Path
from queue import Queue
from secrets import token_hex
from threading import Thread
from typing import TYPE_CHECKING, Final, Protocol, TextIO

from fte_sniff.errors import FileError, FteSniffError, UsageError, reason_of
from fte_sniff.formats.writers import (
    ALL_COLUMNS,
    FORMAT_BY_SUFFIX,
    OutputFormat,
    RowWriter,
    row_writer,
)
from fte_sniff.platform import open_flags
from fte_sniff.protocol import Gap, PortEvent
from fte_sniff.protocol.rows import Item, Rows

if TYPE_CHECKING:
    import polars as pl

    from fte_sniff.recording.metadata import Selection


@dataclass(frozen=True, slots=True)
class ExportSource:
    """What is known about the rows that are written."""

    ports: Sequence[str] = ()
    """The ports that the rows may come from."""
    bauds: Mapping[str, int] = field(default_factory=dict)
    """Bits per second by port; a port of unknown baud is not in it."""
    gaps: Sequence[Gap] = ()
    """Gaps between the rows; more may be found while a file is read."""
    selections: Sequence[Selection] = ()
    """The filters that chose the rows."""
    facts: Mapping[str, str] = field(default_factory=dict)
    """Metadata of the recordings that the rows come from."""
    columns: Sequence[str] = ALL_COLUMNS
    """The columns to write, in a format whose columns can be chosen."""
    zone: tzinfo = UTC
    """Zone of the times in a table or CSV."""

    def within(self, first_ns: int | None, last_ns: int | None) -> ExportSource:
        """What is known about the rows between two times; None for no bound."""
        clipped = [gap.within(first_ns, last_ns) for gap in self.gaps]
        return replace(self, gaps=[gap for gap in clipped if gap is not None])


UNKNOWN = ExportSource()


class Sink(Protocol):
    """Writes rows in one format. Each method may raise OSError or FileError."""

    def write(self, item: Item) -> None:
        """Write rows; a recording also holds the port events between them."""

    def close(self) -> None:
        """Write what the format requires at its end, and close the file."""

    def abandon(self) -> None:
        """Close the file as it is."""


def open_sink(form: OutputFormat, path: Path | int | None, source: ExportSource) -> Sink:
    """Create the file, or replace it; None is standard output, for text formats.

    Raw bytes, recordings and pcapng can go to an open descriptor, which is not closed.

    Gaps and selections of the source are read on closing. Raises OSError if the file cannot be
    created.
    """
    match form:
        case OutputFormat.PARQUET if isinstance(path, Path):
            return ParquetSink(path)
        case OutputFormat.MCAP if path is not None:
            return _RecordingSink(path, source)
        case OutputFormat.PCAPNG if path is not None:
            return PcapngSink(path, source)
        case OutputFormat.RAW if path is not None:
            return RawSink(path)
        case _:
            assert not isinstance(path, int)
            return _TextSink(form, path, source)


def text_writer(
    form: OutputFormat,
    stream: TextIO,
    *,
    ports: bool,
    columns: Sequence[str] = ALL_COLUMNS,
    zone: tzinfo = UTC,
) -> RowWriter:
    """Create the writer of a text format or hex; see `row_writer`."""

    def frame_of(rows: Rows) -> pl.DataFrame:
        from fte_sniff.analysis.dataframe import table_frame

        return table_frame(rows)

    return row_writer(form, stream, frame_of, ports=ports, columns=columns, zone=zone)


class _TextSink:
    """Writes rows as text; each batch is flushed, so that the reader of a pipe gets it at once."""

    def __init__(self, form: OutputFormat, path: Path | None, source: ExportSource) -> None:
        self._stream: TextIO = (
            sys.stdout
            if path is None
            else path.open("w", encoding="utf-8", newline="", errors="backslashreplace")
        )
        self._writer = text_writer(
            form,
            self._stream,
            ports=len(source.ports) > 1,
            columns=source.columns,
            zone=source.zone,
        )

    def write(self, item: Item) -> None:
        if isinstance(item, Rows):
            self._writer.write(item)
            self._stream.flush()

    def close(self) -> None:
        self._writer.close()
        self.abandon()

    def abandon(self) -> None:
        if self._stream is not sys.stdout:
            self._stream.close()


class _BytesSink:
    """Writes bytes to a file, or to an open descriptor."""

    def __init__(self, path: Path | int) -> None:
        self._stream = open(path, "wb", closefd=not isinstance(path, int))  # noqa: SIM115

    def close(self) -> None:
        """See `Sink`."""
        self._stream.close()

    abandon = close


class RawSink(_BytesSink):
    """Writes the bytes of the rows."""

    def __init__(self, path: Path | int) -> None:
        super().__init__(path)
        self.ports: set[str] = set()
        """The ports of the rows; nothing in the file separates them."""

    def write(self, item: Item) -> None:
        """See `Sink`."""
        if isinstance(item, Rows):
            self.ports.update(item.used_ports)
            self._stream.write(item.tobytes())


class PcapngSink(_BytesSink):
    """Writes pcapng; each batch is flushed, so that Wireshark at a pipe gets it at once."""

    def __init__(self, path: Path | int, source: ExportSource) -> None:
        from fte_sniff.formats.pcapng import PcapngWriter

        super().__init__(path)
        self._writer = PcapngWriter(self._stream, source.bauds)

    def write(self, item: Item) -> None:
        """See `Sink`."""
        if isinstance(item, Rows):
            self._writer.write(item)
            self._stream.flush()


OVERWRITE: Final = "!"
"""After a file name, it allows the file to be replaced."""

DEFAULT_NAME: Final = "rows.csv"


def free_path(name: str) -> Path:
    """The path, or the first of `rows-2.csv`, `rows-3.csv`, ... that does not exist."""
    from fte_sniff.recording.output_file import file_names

    return next(path for path in file_names(Path(name)) if not os.path.lexists(path))


@dataclass(frozen=True, slots=True)
class SaveTarget:
    """A file to save to."""

    path: Path
    replace: bool
    """Whether an existing file may be replaced."""
    in_use: Sequence[str] = ()
    """Files that rows come from or are recorded to; they are never replaced."""

    @classmethod
    def parse(cls, line: str, in_use: Sequence[str] = ()) -> SaveTarget:
        """The file that a typed line names; `!` after the name allows an existing file.

        Raises:
            UsageError: no format has the suffix.
            FileError: see `check`.
        """
        name = line.strip()
        replace = name.endswith(OVERWRITE)
        path = Path(name.removesuffix(OVERWRITE).rstrip())
        with suppress(RuntimeError):  # no such user
            path = path.expanduser()
        if path.suffix.lower() not in FORMAT_BY_SUFFIX:
            forms = " ".join(FORMAT_BY_SUFFIX)
            raise UsageError("the extension selects the format; use one of {forms}", forms=forms)
        target = cls(path, replace, in_use)
        target.check()
        return target

    @property
    def form(self) -> OutputFormat:
        """The format, by the suffix."""
        return FORMAT_BY_SUFFIX[self.path.suffix.lower()]

    def check(self) -> None:
        """Check that the file can be created now.

        Raises FileError if it exists or is in use, or its folder does not exist.
        """
        if self.path.is_dir():
            raise FileError("{path} is a folder; name a file in it", path=self.path)
        if not self.path.parent.is_dir():
            raise FileError(
                "{folder} does not exist; name a folder that does", folder=self.path.parent
            )
        if any(is_same_file(self.path, one) for one in self.in_use):
            raise FileError("{path} is the file shown here; name another", path=self.path)
        if os.path.lexists(self.path) and not self.replace:
            raise FileError(
                "{path} exists already; name another, or replace it with {name}{overwrite}",
                path=self.path,
                name=self.path.name,
                overwrite=OVERWRITE,
            )
        _check_replaceable(self.path)


def is_same_file(path: Path, other: Path | str) -> bool:
    """Whether both paths lead to one existing file."""
    try:
        return path.samefile(other)
    except OSError:
        return False


class Replacement:
    """A file that has a temporary name until it is complete; an old one is locked meanwhile."""

    def __init__(self, path: Path, mode: int = 0o666) -> None:
        """Create the temporary file, which has a fresh name in the same folder.

        Raises FileError if another program records to `path`, or it is a link, or not a regular
        file; and OSError if the file cannot be created.
        """
        _check_replaceable(path)
        self._target = path
        self._lock = _locked(path)
        try:
            self.temporary = _fresh_file(path, mode)
        except OSError:
            self._unlock()
            raise

    def commit(self) -> None:
        """Give the closed file its name; a file of that name is replaced."""
        self._lock = _locked(self._target) if self._lock is None else self._lock
        _check_replaceable(self._target)
        self.temporary.replace(self._target)
        self._unlock()

    def discard(self) -> None:
        """Delete the temporary file, if it is there."""
        with suppress(OSError):
            self.temporary.unlink(missing_ok=True)
        self._unlock()

    def _unlock(self) -> None:
        if self._lock is not None:
            os.close(self._lock)
            self._lock = None


class FileExport(Replacement):
    """A sink whose file has a temporary name until it is complete."""

    def __init__(self, path: Path, form: OutputFormat, source: ExportSource) -> None:
        """Create the temporary file; raises FileError and OSError as `Replacement`."""
        if form is OutputFormat.PARQUET:  # loading takes long, and Ctrl-C may end it at once
            import fte_sniff.formats.parquet  # noqa: F401
        super().__init__(path)
        try:
            self.sink = open_sink(form, self.temporary, source)
        except BaseException:
            self.discard()
            raise

    def abandon(self) -> None:
        """Close and delete the temporary file."""
        with suppress(OSError, FteSniffError):
            self.sink.abandon()
        self.discard()


def _check_replaceable(path: Path) -> None:
    """Raise FileError if a path leads to a link, a pipe, a device or a folder."""
    if path.is_symlink():
        raise FileError("{path} is a link; name the file itself, or remove the link", path=path)
    if path.exists() and not path.is_file():
        raise FileError("{path} is not a regular file; name another", path=path)


def _locked(path: Path) -> int | None:
    """The lock of an existing file; raises FileError if another program records to it."""
    if not path.exists():
        return None
    from fte_sniff.recording.output_file import lock_replaced

    return lock_replaced(path)


def _fresh_file(path: Path, mode: int) -> Path:
    """Create an empty file of a name that nobody can foresee, beside a file; raises OSError."""
    fresh = path.with_name(f".{path.name}.{token_hex(8)}.part")
    os.close(os.open(fresh, open_flags("O_WRONLY", "O_CREAT", "O_EXCL"), mode))
    return fresh


def replace_file(path: Path, content: bytes, mode: int = 0o666) -> None:
    """Write a file that has its name only when it is complete.

    Raises FileError and OSError as `Replacement`.
    """
    replacement = Replacement(path, mode)
    try:
        replacement.temporary.write_bytes(content)
        replacement.commit()
    finally:
        replacement.discard()


def replace_text(path: Path, text: str, mode: int = 0o600) -> None:
    """Replace a small file, and make its folder; by default, only the user may read it.

    Raises FileError and OSError as `Replacement`.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    replace_file(path, text.encode(), mode)


class SaveJob:
    """One file that is being saved; an error is a FileError, and leaves no file."""

    def __init__(self, target: SaveTarget, source: ExportSource) -> None:
        """Create the file under its temporary name."""
        target.check()
        self._target, self.path, self.rows = target, target.path, 0
        self._export: FileExport | None = None
        with self._abandoned_on_error():
            self._export = FileExport(target.path, target.form, source)
        self._sink = self._export.sink

    def write(self, rows: Rows) -> None:
        """Write the next rows."""
        with self._abandoned_on_error():
            self._sink.write(rows)
        self.rows += len(rows)

    def close(self) -> None:
        """Complete the file, and give it its name, unless a file of that name exists now."""
        with self._abandoned_on_error():
            self._sink.close()
            self._target.check()
            assert self._export is not None
            self._export.commit()

    def abandon(self) -> None:
        """Leave no file."""
        if self._export is not None:
            self._export.abandon()

    @contextmanager
    def _abandoned_on_error(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            self.abandon()
            raise FileError(
                "{path} cannot be written: {reason}; name another place",
                path=self.path,
                reason=reason_of(error),
            ) from error
        except FteSniffError:
            self.abandon()
            raise


MOST_WAITING: Final = 8
"""Largest number of DataFrames that wait to be written."""


class _AbandonedError(Exception):
    """The file is not wanted any more."""


class ParquetSink:
    """Writes the columns of `analysis.dataframe`; a thread writes the file."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._waiting: Queue[pl.DataFrame | None] = Queue(MOST_WAITING)
        self._error: BaseException | None = None
        self._abandoned = self._ended = False
        self._thread = Thread(target=self._run, name="writes Parquet", daemon=True)
        self._thread.start()

    def write(self, item: Item) -> None:
        """See `Sink`."""
        from fte_sniff.analysis.dataframe import table_frame

        if self._error is not None:
            raise self._error
        if isinstance(item, Rows) and len(item):
            self._waiting.put(table_frame(item))

    def close(self) -> None:
        """See `Sink`."""
        self._waiting.put(None)
        self._thread.join()
        if self._error is not None:
            raise self._error

    def abandon(self) -> None:
        """See `Sink`."""
        self._abandoned = True
        if self._thread.is_alive():
            self._waiting.put(None)
            self._thread.join()

    def _run(self) -> None:
        try:
            from fte_sniff.analysis.dataframe import TABLE_SCHEMA
            from fte_sniff.formats.parquet import write_parquet

            write_parquet(self._frames(), self._path, dict(TABLE_SCHEMA))
        except BaseException as error:  # noqa: BLE001 - `write` and `close` raise it
            # polars raises KeyboardInterrupt in the thread that runs the query.
            self._error = error
            while not self._ended:
                self._ended = self._waiting.get() is None

    def _frames(self) -> Iterator[pl.DataFrame]:
        while (frame := self._waiting.get()) is not None:
            yield frame
        self._ended = True
        if self._abandoned:
            raise _AbandonedError


class _RecordingSink:
    """Writes a recording; each row must have a time."""

    def __init__(self, path: Path | int, source: ExportSource) -> None:
        from fte_sniff.recording.metadata import PART_FACTS, PortFacts
        from fte_sniff.recording.writer import BulkWriter

        ports = [PortFacts(port, source.bauds.get(port)) for port in source.ports]
        facts = {name: fact for name, fact in source.facts.items() if name not in PART_FACTS}
        self._source = source
        self._file = open(path, "wb", buffering=0, closefd=not isinstance(path, int))  # noqa: SIM115
        try:
            self._writer = BulkWriter(self._file.fileno(), ports, facts)
        except OSError:
            self._file.close()
            raise

    def write(self, item: Item) -> None:
        for row in item.select(item.t_ns < 0)[:1] if isinstance(item, Rows) else ():
            raise FileError(
                f"{row.port!r}, offset {row.offset}, has no time since 1970, and a recording needs"
                " one; write another format"
            )
        if isinstance(item, Rows | PortEvent):
            self._writer.write(item)

    def close(self) -> None:
        from mcap.records import Metadata

        from fte_sniff.recording.metadata import LEFT_OUT_NAME, SELECTION_NAME, gap_to_metadata

        gaps = [Metadata(LEFT_OUT_NAME, gap_to_metadata(gap)) for gap in self._source.gaps]
        selections = [
            Metadata(SELECTION_NAME, one.to_metadata()) for one in self._source.selections
        ]
        self._writer.close([*gaps, *selections])
        self._file.close()

    def abandon(self) -> None:
        self._file.close()
