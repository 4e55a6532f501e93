"""Owns what takes rows for a file, one class a form.

It must not know how the file came to be or what it will be called.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Final, Protocol

import polars as pl

from fte_sniff.analysis.columns import SCHEMA, row_frame
from fte_sniff.errors import FileError
from fte_sniff.formats.writers import FORM_BY_END, OutputFormat, row_writer
from fte_sniff.protocol import Row, spaced_hex
from fte_sniff.recording.facts import PortFacts
from fte_sniff.recording.place import Existing
from fte_sniff.recording.writer import RecordingWriter

PIECE_ROWS: Final = 262_144
"""Rows of a Parquet file that are kept in memory at most."""


class Sink(Protocol):
    """Takes rows. Each method may raise OSError or FileError."""

    def write(self, rows: Sequence[Row]) -> None:
        """Take the next rows."""
        ...

    def end(self) -> None:
        """Write what is still owed, and close the file."""
        ...

    def abandon(self) -> None:
        """Close the file as it is, and take away what lies beside it."""
        ...


class TextSink:
    """Rows as the lines of one of the text formats."""

    def __init__(self, form: OutputFormat, path: Path, ports: Sequence[str]) -> None:
        self._stream = path.open("w", encoding="utf-8", newline="", errors="backslashreplace")
        self._writer = row_writer(form, self._stream, ports=len(ports) > 1)

    def write(self, rows: Sequence[Row]) -> None:
        """Write the rows' lines."""
        self._writer.write(rows)

    def end(self) -> None:
        """Write the head, if no row has brought it, and close."""
        self._writer.end()
        self._stream.close()

    def abandon(self) -> None:
        """Close."""
        self._stream.close()


class HexSink:
    """The bytes alone as hex, a line a row; what the program reads back as hex text."""

    def __init__(self, path: Path, ports: Sequence[str]) -> None:
        self._stream = path.open("w", encoding="ascii")

    def write(self, rows: Sequence[Row]) -> None:
        """Write the rows' bytes."""
        self._stream.writelines(f"{spaced_hex(row.raw)}\n" for row in rows)

    def end(self) -> None:
        """Close."""
        self._stream.close()

    abandon = end


class RawSink:
    """The bytes as they came."""

    def __init__(self, path: Path, ports: Sequence[str]) -> None:
        self._stream = path.open("wb")

    def write(self, rows: Sequence[Row]) -> None:
        """Write the rows' bytes."""
        self._stream.writelines(row.raw for row in rows)

    def end(self) -> None:
        """Close."""
        self._stream.close()

    abandon = end


class ParquetSink:
    """Rows as the columns of the contract; many rows wait in files beside the one to be."""

    def __init__(self, path: Path, ports: Sequence[str]) -> None:
        self._path = path
        self._pieces: list[Path] = []
        self._frames: list[pl.DataFrame] = []
        self._waiting = 0

    def write(self, rows: Sequence[Row]) -> None:
        """Take the rows."""
        if rows:
            self._frames.append(row_frame(rows))
            self._waiting += len(rows)
        if self._waiting >= PIECE_ROWS:
            piece = self._path.with_name(f"{self._path.name}.{len(self._pieces)}")
            self._pieces.append(piece)
            self._write(pl.concat(self._frames), piece)
            self._frames, self._waiting = [], 0

    def end(self) -> None:
        """Put all pieces together."""
        rest = pl.concat([pl.DataFrame(schema=SCHEMA), *self._frames])
        if not self._pieces:
            self._write(rest, self._path)
            return
        whole = pl.concat([*map(pl.scan_parquet, self._pieces), rest.lazy()])
        try:
            whole.sink_parquet(self._path)
        except pl.exceptions.PolarsError as error:
            raise FileError(f"{self._path.stem} cannot be written: {error}") from error
        self.abandon()

    def abandon(self) -> None:
        """Take the pieces away."""
        for piece in self._pieces:
            with suppress(OSError):
                piece.unlink(missing_ok=True)

    def _write(self, frame: pl.DataFrame, path: Path) -> None:
        try:
            frame.write_parquet(path)
        except pl.exceptions.PolarsError as error:
            raise FileError(f"{self._path.stem} cannot be written: {error}") from error


class RecordingSink:
    """Rows as a recording; each must have a time."""

    def __init__(self, path: Path, ports: Sequence[str]) -> None:
        facts = [PortFacts(port) for port in ports]
        self._writer = RecordingWriter(path, facts, existing=Existing.REPLACE)

    def write(self, rows: Sequence[Row]) -> None:
        """Record the rows."""
        with _plainly():
            self._writer.write(rows)

    def end(self) -> None:
        """Write the index, and close."""
        with _plainly():
            self._writer.close()

    abandon = end


@contextmanager
def _plainly() -> Iterator[None]:
    """Give the system's own word: what a recording says of it speaks of a capture."""
    try:
        yield
    except FileError as error:
        if isinstance(error.__cause__, OSError):
            raise error.__cause__ from None
        raise


def _text(form: OutputFormat) -> Callable[[Path, Sequence[str]], Sink]:
    return lambda path, ports: TextSink(form, path, ports)


def _sink_of(form: OutputFormat) -> Callable[[Path, Sequence[str]], Sink]:
    match form:
        case OutputFormat.PARQUET:
            return ParquetSink
        case OutputFormat.MCAP:
            return RecordingSink
        case _:
            return _text(form)


SINKS: Final[Mapping[str, Callable[[Path, Sequence[str]], Sink]]] = {
    **{end: _sink_of(form) for end, form in FORM_BY_END.items()},
    ".hex": HexSink,
    ".raw": RawSink,
    ".bin": RawSink,
}
"""By the end of a file's name, what takes rows for it."""
