"""Save rows of a session in any format.

items ──► write of the format ──► standard output | a file without a name ──► its name
"""

from __future__ import annotations

import os
import pickle
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, suppress
from dataclasses import dataclass, field
from datetime import UTC, tzinfo
from functools import partial
from pathlib import Path
from tempfile import TemporaryFile
from typing import IO, TYPE_CHECKING, Any, BinaryIO, Final, TextIO, TypeAlias

from fte_sniff.ahead import ahead
from fte_sniff.errors import FileError, UsageError
from fte_sniff.formats.writers import (
    ALL_COLUMNS,
    FORMAT_BY_SUFFIX,
    OutputFormat,
    csv_lines,
    json_lines,
)
from fte_sniff.protocol.columns import spaced_hex
from fte_sniff.protocol.items import Gap, GapKind, PortEvent
from fte_sniff.protocol.rows import Item, Rows
from fte_sniff.recording.output_file import Existing, created, file_names

if TYPE_CHECKING:
    import polars as pl

    from fte_sniff.recording.metadata import Selection

Write: TypeAlias = Callable[[Item], object]
"""Writes rows, or what is between them; may raise OSError and FileError."""


@dataclass(frozen=True, slots=True)
class ExportSource:
    """What is known about the rows that are written."""

    ports: Sequence[str] = ()
    """The ports that the rows may come from."""
    bauds: Mapping[str, int] = field(default_factory=dict)
    """Bits per second by port; a port of unknown baud is not in it."""
    selections: list[Selection] = field(default_factory=list)
    """The filters that chose the rows; more may be added until the last row is written."""
    facts: Mapping[str, str] = field(default_factory=dict)
    """Metadata of the recordings that the rows come from."""
    columns: Sequence[str] = ALL_COLUMNS
    """The columns to write, in a format whose columns can be chosen."""
    zone: tzinfo = UTC
    """Zone of the times in a table or CSV."""


@contextmanager
def writing(form: OutputFormat, stream: IO[Any], source: ExportSource) -> Iterator[Write]:
    """Write items to a stream that stays open; what the format requires at its end comes last.

    Each batch is flushed, so that the reader of a pipe gets it at once. A recording, pcapng and raw
    bytes need a binary stream; Parquet one of a file with a name.
    """
    with _FORMS.get(form, partial(_text, form))(stream, source) as write:
        takes = (Rows, PortEvent, Gap) if form is OutputFormat.MCAP else Rows

        def write_and_flush(item: Item) -> None:
            if isinstance(item, takes):
                write(item)
                stream.flush()

        yield write_and_flush


@contextmanager
def exported(
    path: Path, form: OutputFormat, source: ExportSource, existing: Existing = Existing.REPLACE
) -> Iterator[Write]:
    """Write items to a file that has its name only once it is complete; an error leaves no file.

    Raises FileError if it cannot be written.
    """
    options: dict[str, Any] = {"mode": "wb"}
    if form not in _FORMS:
        options = {"mode": "w", "encoding": "utf-8", "newline": "", "errors": "backslashreplace"}
    with (
        created(path, existing) as file,
        file.made.open(**options) as stream,
        writing(form, stream, source) as write,
    ):
        yield write
    file.close()


def text_writer(
    form: OutputFormat | None, stream: TextIO, source: ExportSource
) -> Callable[[Rows], None]:
    """Create the writer of a text format or hex to a stream that stays open.

    Args:
        form: the format; None explains each row byte by byte.
        stream: the text stream; a table and explanations are coloured on a terminal. JSON lines
            need its `buffer`.
        source: its ports, columns and zone; a table has a column for the port if it has several.
    """
    from fte_sniff.formats.text_table import DissectionWriter, TableWriter

    if form is None:
        return DissectionWriter(stream)
    if form is OutputFormat.TABLE:
        return TableWriter(stream, ports=len(source.ports) > 1, zone=source.zone)
    if form is OutputFormat.HEX:
        return lambda rows: stream.writelines(f"{spaced_hex(row.raw)}\n" for row in rows)
    encode: Callable[[pl.DataFrame, Sequence[str]], str | bytes] = json_lines
    if form is OutputFormat.CSV:
        stream.write(",".join(source.columns) + "\n")
        encode = partial(csv_lines, zone=source.zone)

    def write(rows: Rows) -> None:
        from fte_sniff.analysis.dataframe import table_frame

        parts = (rows[start : start + _AT_ONCE] for start in range(0, len(rows), _AT_ONCE))
        then = ahead if len(rows) > _AT_ONCE else iter  # a thread costs more than few rows
        frames = then(table_frame(part) for part in parts)
        for lines in then(encode(frame, source.columns) for frame in frames):
            if isinstance(lines, str):
                stream.write(lines)
            else:
                stream.flush()
                stream.buffer.write(lines)

    return write


_AT_ONCE: Final = 1 << 14
"""Rows of JSON lines or CSV that are encoded together, some hundred bytes each."""


@contextmanager
def _text(
    form: OutputFormat, stream: TextIO, source: ExportSource
) -> Iterator[Callable[[Rows], None]]:
    yield text_writer(form, stream, source)


@contextmanager
def _raw(stream: BinaryIO, _source: ExportSource) -> Iterator[Callable[[Rows], object]]:
    yield lambda rows: stream.write(rows.tobytes())


@contextmanager
def _pcapng(stream: BinaryIO, source: ExportSource) -> Iterator[Callable[[Rows], None]]:
    from fte_sniff.formats.pcapng import PcapngWriter

    yield PcapngWriter(stream, source.bauds).write


@contextmanager
def _recording(
    stream: BinaryIO, source: ExportSource
) -> Iterator[Callable[[Rows | PortEvent | Gap], None]]:
    """A recording; each row must have a time.

    A gap of unknown times is between the rows before and after it.
    """
    from mcap.records import Metadata

    from fte_sniff.recording import metadata
    from fte_sniff.recording.writer import BulkWriter

    ports = [metadata.PortFacts(port, source.bauds.get(port)) for port in source.ports]
    facts = {k: v for k, v in source.facts.items() if not k.startswith(_OF_ONE_FILE)}
    writer = BulkWriter(stream.fileno(), ports, facts)
    gaps, last_ns = list[Gap](), 0
    open_gap: Gap | None = None

    def write(item: Rows | PortEvent | Gap) -> None:
        nonlocal last_ns, open_gap
        if isinstance(item, Gap):
            if item.kind in (GapKind.WRITE_ERROR, GapKind.LEFT_OUT):
                gaps.append(item)
            elif item.kind in _BETWEEN_ROWS:
                open_gap = item
            return
        if isinstance(item, Rows):
            for row in item.select(item.t_ns < 0)[:1]:
                raise FileError(
                    f"{row.port!r}, offset {row.offset}, has no time since 1970, and a recording"
                    " needs one; write another format"
                )
            if (span := item.span_ns) is not None:
                if open_gap is not None and last_ns and span[0] - last_ns > 1:
                    gaps.append(open_gap._replace(start_ns=last_ns + 1, end_ns=span[0] - 1))
                open_gap, last_ns = None, max(last_ns, span[1])
        writer.write(item)

    yield write
    left_out = [(metadata.LEFT_OUT_NAME, metadata.gap_to_metadata(gap)) for gap in gaps]
    chosen = [(metadata.SELECTION_NAME, one.to_metadata()) for one in source.selections]
    writer.close(Metadata(*record) for record in [*left_out, *chosen])


_OF_ONE_FILE: Final = ("library", "port.", "part", "previous")
"""The first words of facts that hold for one file of a capture, or are written anew."""
_BETWEEN_ROWS: Final = (GapKind.DAMAGE, GapKind.OTHER_RECORDING, GapKind.NOT_SHOWN)


@contextmanager
def _parquet(stream: BinaryIO, _source: ExportSource) -> Iterator[Callable[[Rows], None]]:
    """The columns of `analysis.dataframe`.

    polars writes a file as a whole, so rows wait in one without a name until the end.
    """
    from fte_sniff.analysis.dataframe import TABLE_SCHEMA, table_frame
    from fte_sniff.formats.parquet import write_parquet

    path = Path(stream.name)
    with TemporaryFile(dir=path.parent) as waiting:

        def frames() -> Iterator[pl.DataFrame]:
            with suppress(EOFError):
                while True:
                    yield table_frame(pickle.load(waiting))

        yield lambda rows: pickle.dump(rows, waiting, pickle.HIGHEST_PROTOCOL)
        waiting.seek(0)
        write_parquet(frames(), path, dict(TABLE_SCHEMA))


Form: TypeAlias = Callable[[Any, ExportSource], AbstractContextManager[Callable[[Any], object]]]
"""Writes one format to a stream."""

_FORMS: Final[Mapping[OutputFormat, Form]] = {
    OutputFormat.MCAP: _recording,
    OutputFormat.PARQUET: _parquet,
    OutputFormat.PCAPNG: _pcapng,
    OutputFormat.RAW: _raw,
}
"""The formats that are not text."""


def replace_file(path: Path, content: bytes, mode: int = 0o666) -> None:
    """Write a file that has its name only when it is complete.

    Raises FileError.
    """
    with created(path, Existing.REPLACE, mode) as file:
        file.made.write_bytes(content)
    file.close()


def replace_text(path: Path, text: str) -> None:
    """Replace a small file that only the user may read, and make its folder.

    Raises FileError, and OSError for the folder.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    replace_file(path, text.encode(), 0o600)


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


def format_of(path: Path) -> OutputFormat:
    """The format that the extension of a file selects; raises UsageError if it selects none."""
    form = FORMAT_BY_SUFFIX.get(path.suffix.lower())
    if form is None:
        forms = " ".join(FORMAT_BY_SUFFIX)
        text = "{path}: the extension selects the format; use one of {forms}"
        raise UsageError(text, path=path, forms=forms)
    return form


def typed_path(line: str, in_use: Sequence[str] = ()) -> tuple[Path, Existing]:
    """The file that a typed line names; `!` after the name allows an existing file.

    Raises:
        UsageError: no format has the suffix.
        FileError: the file exists, or is one of those `in_use`.
    """
    name = line.strip()
    existing = Existing.REPLACE if name.endswith(OVERWRITE) else Existing.REFUSE
    path = Path(name.removesuffix(OVERWRITE).rstrip())
    with suppress(RuntimeError):  # no such user
        path = path.expanduser()
    format_of(path)
    if any(is_same_file(path, one) for one in in_use):
        raise FileError("{path} is the file shown here; name another", path=path)
    if os.path.lexists(path) and existing is Existing.REFUSE:
        raise FileError(
            "{path} exists already; name another, or replace it with {name}{overwrite}",
            path=path,
            name=path.name,
            overwrite=OVERWRITE,
        )
    return path, existing
