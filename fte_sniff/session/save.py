"""Save rows of a session in any format."""

from __future__ import annotations

import os
import pickle
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from datetime import UTC, tzinfo
from pathlib import Path
from tempfile import TemporaryFile
from typing import IO, TYPE_CHECKING, Any, BinaryIO, Final, NamedTuple, TextIO

from fte_sniff.errors import FileError, FteSniffError, UsageError, unwritable
from fte_sniff.formats.writers import (
    ALL_COLUMNS,
    FORMAT_BY_SUFFIX,
    OutputFormat,
    write_csv,
    write_jsonl,
)
from fte_sniff.protocol.columns import spaced_hex
from fte_sniff.protocol.items import Gap, PortEvent
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


class Sink:
    """Writes rows to a file in one format. Each method may raise OSError or FileError."""

    def __init__(
        self,
        stream: IO[Any],
        write: Callable[[Any], object],
        finish: Callable[[], None] = lambda: None,
        kinds: tuple[type, ...] = (Rows,),
    ) -> None:
        """Write items of these kinds; `finish` writes what the format requires at the end."""
        self._stream, self._write, self._finish, self._kinds = stream, write, finish, kinds

    def write(self, item: Item) -> None:
        """Write rows; a recording also holds the port events between them."""
        if isinstance(item, self._kinds):
            self._write(item)

    def close(self) -> None:
        """Write what the format requires at its end, and close the file."""
        self._finish()
        self.abandon()

    def abandon(self) -> None:
        """Close the file as it is."""
        if self._stream is not sys.stdout:
            self._stream.close()


def open_sink(form: OutputFormat, path: Path | int | None, source: ExportSource) -> Sink:
    """Create the file, or replace it; None is standard output, for text formats.

    Raw bytes, recordings and pcapng can go to an open descriptor, which is not closed.

    Gaps and selections of the source are read on closing. Raises OSError if the file cannot be
    created.
    """
    if path is None:
        return _text_sink(sys.stdout, form, source)
    if form is OutputFormat.PARQUET:
        assert isinstance(path, Path)
        return _parquet_sink(path)
    if form in _BINARY:
        buffering = 0 if form is OutputFormat.MCAP else -1
        stream = open(path, "wb", buffering, closefd=isinstance(path, Path))  # noqa: SIM115
        return _BINARY[form](stream, source)
    assert isinstance(path, Path)
    text = path.open("w", encoding="utf-8", newline="", errors="backslashreplace")
    return _text_sink(text, form, source)


def text_writer(
    form: OutputFormat | None,
    stream: TextIO,
    *,
    ports: bool,
    columns: Sequence[str] = ALL_COLUMNS,
    zone: tzinfo = UTC,
) -> Callable[[Rows], None]:
    """Create the writer of a text format or hex to a stream that stays open.

    Args:
        form: the format; None explains each row byte by byte.
        stream: the text stream; a table and explanations are coloured on a terminal.
        ports: whether a table has a column for the port.
        columns: those of CSV and JSON lines.
        zone: that of the times in a table or CSV; JSON lines have UTC.
    """
    from fte_sniff.formats.text_table import DissectionWriter, TableWriter

    if form is None:
        return DissectionWriter(stream)
    if form is OutputFormat.TABLE:
        return TableWriter(stream, ports=ports, zone=zone)
    if form is OutputFormat.HEX:
        return lambda rows: stream.writelines(f"{spaced_hex(row.raw)}\n" for row in rows)
    if form is OutputFormat.CSV:
        stream.write(",".join(columns) + "\n")

    def write(rows: Rows) -> None:
        from fte_sniff.analysis.dataframe import table_frame

        if form is OutputFormat.CSV and len(rows):
            write_csv(stream, table_frame(rows), columns, zone)
        elif len(rows):
            write_jsonl(stream, table_frame(rows), columns)

    return write


_AT_ONCE: Final = 1 << 14
"""Rows whose text is in memory at once, some hundred bytes each."""


def _text_sink(stream: TextIO, form: OutputFormat, source: ExportSource) -> Sink:
    """Text; each batch is flushed, so that the reader of a pipe gets it at once."""
    several, columns = len(source.ports) > 1, source.columns
    write_rows = text_writer(form, stream, ports=several, columns=columns, zone=source.zone)

    def write(rows: Rows) -> None:
        for start in range(0, len(rows), _AT_ONCE):
            write_rows(rows[start : start + _AT_ONCE])
        stream.flush()

    return Sink(stream, write)


def _raw_sink(stream: BinaryIO, _source: ExportSource) -> Sink:
    return Sink(stream, lambda rows: stream.write(rows.tobytes()))


def _pcapng_sink(stream: BinaryIO, source: ExportSource) -> Sink:
    """pcapng; each batch is flushed, so that Wireshark at a pipe gets it at once."""
    from fte_sniff.formats.pcapng import PcapngWriter

    writer = PcapngWriter(stream, source.bauds)

    def write(rows: Rows) -> None:
        writer.write(rows)
        stream.flush()

    return Sink(stream, write)


def _recording_sink(stream: BinaryIO, source: ExportSource) -> Sink:
    """A recording; each row must have a time."""
    from mcap.records import Metadata

    from fte_sniff.recording import metadata
    from fte_sniff.recording.writer import BulkWriter

    ports = [metadata.PortFacts(port, source.bauds.get(port)) for port in source.ports]
    facts = {name: fact for name, fact in source.facts.items() if name not in metadata.PART_FACTS}
    writer = BulkWriter(stream.fileno(), ports, facts)

    def write(item: Rows | PortEvent) -> None:
        for row in item.select(item.t_ns < 0)[:1] if isinstance(item, Rows) else ():
            raise FileError(
                f"{row.port!r}, offset {row.offset}, has no time since 1970, and a recording needs"
                " one; write another format"
            )
        writer.write(item)

    def finish() -> None:
        gaps = [(metadata.LEFT_OUT_NAME, metadata.gap_to_metadata(gap)) for gap in source.gaps]
        chosen = [(metadata.SELECTION_NAME, one.to_metadata()) for one in source.selections]
        writer.close(Metadata(*record) for record in [*gaps, *chosen])

    return Sink(stream, write, finish, (Rows, PortEvent))


_BINARY: Final = {
    OutputFormat.MCAP: _recording_sink,
    OutputFormat.PCAPNG: _pcapng_sink,
    OutputFormat.RAW: _raw_sink,
}


def _parquet_sink(path: Path) -> Sink:
    """The columns of `analysis.dataframe`.

    polars writes a file as a whole, so rows wait in one without a name until the end.
    """
    from fte_sniff.analysis.dataframe import TABLE_SCHEMA, table_frame
    from fte_sniff.formats.parquet import write_parquet

    waiting = TemporaryFile(dir=path.parent)  # noqa: SIM115

    def frames() -> Iterator[pl.DataFrame]:
        with suppress(EOFError):
            while True:
                yield table_frame(pickle.load(waiting))

    def finish() -> None:
        waiting.seek(0)
        write_parquet(frames(), path, dict(TABLE_SCHEMA))

    return Sink(waiting, lambda rows: pickle.dump(rows, waiting, pickle.HIGHEST_PROTOCOL), finish)


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
        self.path, self.rows = path, 0
        self._file = OutputFile(path, existing)
        self.sink: Sink | None = None
        with self._abandoned_on_error():
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
        with self._abandoned_on_error():
            self.sink.close()
            self._file.commit()
            self._file.close()

    def abandon(self) -> None:
        """Close the file, and delete it unless it has its name."""
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
    file = OutputFile(path, Existing.REPLACE, mode)
    try:
        file.create()
        file.made.write_bytes(content)
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


class SaveTarget(NamedTuple):
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
