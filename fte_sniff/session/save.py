"""Save rows of a session in any format."""

from __future__ import annotations

import os
import pickle
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from datetime import UTC, tzinfo
from pathlib import Path
from tempfile import TemporaryFile
from typing import TYPE_CHECKING, Final, Protocol, TextIO

from fte_sniff.errors import FileError, FteSniffError, UsageError, unwritable
from fte_sniff.formats.writers import (
    ALL_COLUMNS,
    FORMAT_BY_SUFFIX,
    OutputFormat,
    RowWriter,
    row_writer,
)
from fte_sniff.protocol import Gap, PortEvent
from fte_sniff.protocol.rows import Item, Rows
from fte_sniff.recording.output_file import Existing, OutputFile, file_names

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
            return _ParquetSink(path)
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


_AT_ONCE: Final = 1 << 14
"""Rows whose text is in memory at once, some hundred bytes each."""


class _TextSink:
    """Writes rows as text; each batch is flushed, so that the reader of a pipe gets it at once."""

    def __init__(self, form: OutputFormat, path: Path | None, source: ExportSource) -> None:
        self._stream: TextIO = (
            sys.stdout
            if path is None
            else path.open("w", encoding="utf-8", newline="", errors="backslashreplace")
        )
        self._write = text_writer(
            form,
            self._stream,
            ports=len(source.ports) > 1,
            columns=source.columns,
            zone=source.zone,
        )

    def write(self, item: Item) -> None:
        if isinstance(item, Rows):
            for start in range(0, len(item), _AT_ONCE):
                self._write(item[start : start + _AT_ONCE])
            self._stream.flush()

    def close(self) -> None:
        """See `Sink`."""
        if self._stream is not sys.stdout:
            self._stream.close()

    abandon = close


class _BytesSink:
    """Writes bytes to a file, or to an open descriptor."""

    def __init__(self, path: Path | int, buffering: int = -1) -> None:
        closes = not isinstance(path, int)
        self._stream = open(path, "wb", buffering, closefd=closes)  # noqa: SIM115

    def close(self) -> None:
        """See `Sink`."""
        self._stream.close()

    def abandon(self) -> None:
        """See `Sink`."""
        self._stream.close()


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


class _RecordingSink(_BytesSink):
    """Writes a recording; each row must have a time."""

    def __init__(self, path: Path | int, source: ExportSource) -> None:
        from fte_sniff.recording.metadata import PART_FACTS, PortFacts
        from fte_sniff.recording.writer import BulkWriter

        super().__init__(path, buffering=0)
        ports = [PortFacts(port, source.bauds.get(port)) for port in source.ports]
        facts = {name: fact for name, fact in source.facts.items() if name not in PART_FACTS}
        self._source = source
        self._writer = BulkWriter(self._stream.fileno(), ports, facts)

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
        super().close()


class _ParquetSink:
    """Writes the columns of `analysis.dataframe`.

    polars writes a file as a whole, so rows wait in one without a name until the end.
    """

    def __init__(self, path: Path) -> None:
        self._path, self._waiting = path, TemporaryFile(dir=path.parent)  # noqa: SIM115

    def write(self, item: Item) -> None:
        if isinstance(item, Rows) and len(item):
            pickle.dump(item, self._waiting, pickle.HIGHEST_PROTOCOL)

    def close(self) -> None:
        from fte_sniff.analysis.dataframe import TABLE_SCHEMA
        from fte_sniff.formats.parquet import write_parquet

        self._waiting.seek(0)
        write_parquet(self._frames(), self._path, dict(TABLE_SCHEMA))
        self.abandon()

    def abandon(self) -> None:
        self._waiting.close()

    def _frames(self) -> Iterator[pl.DataFrame]:
        from fte_sniff.analysis.dataframe import table_frame

        with suppress(EOFError):
            while True:
                yield table_frame(pickle.load(self._waiting))


# Files that have their names only once they are complete


class FileExport:
    """A sink whose file has a temporary name until it is complete; an error leaves no file."""

    def __init__(
        self,
        path: Path,
        form: OutputFormat,
        source: ExportSource,
        existing: Existing = Existing.REPLACE,
    ) -> None:
        """Create the temporary file; raises FileError."""
        if form is OutputFormat.PARQUET:  # loading takes long, and Ctrl-C may end it at once
            import fte_sniff.formats.parquet  # noqa: F401
        self.path, self.rows = path, 0
        self._file: OutputFile | None = None
        self.sink: Sink | None = None
        with self._abandoned_on_error():
            self._file = OutputFile(path, existing, is_hidden=True)
            self._file.create()
            self.sink = open_sink(form, self._file.made, source)

    def write(self, item: Item) -> None:
        """Write the next rows, or what is between them; raises FileError."""
        assert self.sink is not None
        with self._abandoned_on_error():
            self.sink.write(item)
        self.rows += len(item) if isinstance(item, Rows) else 0

    def close(self) -> None:
        """Complete the file, and give it its name; raises FileError."""
        assert self.sink is not None
        assert self._file is not None
        with self._abandoned_on_error():
            self.sink.close()
            self._file.close()  # Windows renames no open file
            self._file.commit()

    def abandon(self) -> None:
        """Close the file, and delete it unless it has its name."""
        if self._file is None:
            return
        self._file.discard()  # at once: a second Ctrl-C ends the program
        if self.sink is not None:
            with suppress(OSError, FteSniffError):
                self.sink.abandon()
        self._file.discard()  # Windows deletes no open file

    @contextmanager
    def _abandoned_on_error(self) -> Iterator[None]:
        try:
            yield
        except BaseException as error:
            self.abandon()
            if isinstance(error, OSError):
                raise unwritable(self.path, error) from error
            raise


def replace_file(path: Path, content: bytes, mode: int = 0o666) -> None:
    """Write a file that has its name only when it is complete.

    Raises FileError and OSError as `OutputFile`.
    """
    file = OutputFile(path, Existing.REPLACE, mode, is_hidden=True)
    try:
        file.create()
        file.made.write_bytes(content)
        file.close()
        file.commit()
    finally:
        file.discard()


def replace_text(path: Path, text: str, mode: int = 0o600) -> None:
    """Replace a small file, and make its folder; by default, only the user may read it.

    Raises FileError and OSError as `OutputFile`.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    replace_file(path, text.encode(), mode)


# Saving from the screen

OVERWRITE: Final = "!"
"""After a file name, it allows the file to be replaced."""

DEFAULT_NAME: Final = "rows.csv"


def free_path(name: str) -> Path:
    """The path, or the first of `rows-2.csv`, `rows-3.csv`, ... that does not exist."""
    return next(path for path in file_names(Path(name)) if not os.path.lexists(path))


def is_same_file(path: Path, other: Path | str) -> bool:
    """Whether both paths lead to one existing file."""
    try:
        return path.samefile(other)
    except OSError:
        return False


@dataclass(frozen=True, slots=True)
class SaveTarget:
    """A file to save to."""

    path: Path
    existing: Existing

    @classmethod
    def parse(cls, line: str, in_use: Sequence[str] = ()) -> SaveTarget:
        """The file that a typed line names; `!` after the name allows an existing file.

        Raises:
            UsageError: no format has the suffix.
            FileError: the file exists, or is one of those `in_use`, or has no folder.
        """
        name = line.strip()
        existing = Existing.REPLACE if name.endswith(OVERWRITE) else Existing.REFUSE
        path = Path(name.removesuffix(OVERWRITE).rstrip())
        with suppress(RuntimeError):  # no such user
            path = path.expanduser()
        if path.suffix.lower() not in FORMAT_BY_SUFFIX:
            forms = " ".join(FORMAT_BY_SUFFIX)
            raise UsageError("the extension selects the format; use one of {forms}", forms=forms)
        if not path.parent.is_dir():
            folder = path.parent
            raise FileError("{folder} does not exist; name a folder that does", folder=folder)
        if any(is_same_file(path, one) for one in in_use):
            raise FileError("{path} is the file shown here; name another", path=path)
        if os.path.lexists(path) and existing is Existing.REFUSE:
            raise FileError(
                "{path} exists already; name another, or replace it with {name}{overwrite}",
                path=path,
                name=path.name,
                overwrite=OVERWRITE,
            )
        return cls(path, existing)

    def open(self, source: ExportSource) -> FileExport:
        """Create the file under its temporary name; raises FileError."""
        form = FORMAT_BY_SUFFIX[self.path.suffix.lower()]
        return FileExport(self.path, form, source, self.existing)
