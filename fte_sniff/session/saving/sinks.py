"""Owns what takes rows for a file, by form; those that need much are loaded when they are wanted.

It must not know how the file came to be or what it will be called.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Final, Protocol

from fte_sniff.formats.writers import FORM_BY_END, OutputFormat, row_writer
from fte_sniff.protocol import Row
from fte_sniff.session.saving.origin import Origin


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

    def __init__(self, form: OutputFormat, path: Path, origin: Origin) -> None:
        self._stream = path.open("w", encoding="utf-8", newline="", errors="backslashreplace")
        self._writer = row_writer(form, self._stream, ports=len(origin.ports) > 1)

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


class RawSink:
    """The bytes as they came."""

    def __init__(self, path: Path, _origin: Origin) -> None:
        self._stream = path.open("wb")
        self.ports: set[str] = set()
        """Where the rows came from; nothing in the file tells them apart."""

    def write(self, rows: Sequence[Row]) -> None:
        """Write the rows' bytes."""
        from fte_sniff.row_batch import PackedRows

        if isinstance(rows, PackedRows):
            self.ports.update(rows.words.ports[code] for code in set(rows.port.tolist()))
            self._stream.write(rows.tobytes())
            return
        self.ports.update(row.port for row in rows)
        self._stream.writelines(row.raw for row in rows)

    def end(self) -> None:
        """Close."""
        self._stream.close()

    abandon = end


def _parquet(path: Path, origin: Origin) -> Sink:
    # polars takes long to load, and a screen names the forms before anything is saved.
    from fte_sniff.session.saving.parquet_sink import ParquetSink

    return ParquetSink(path, origin)


def _recording(path: Path, origin: Origin) -> Sink:
    # The same holds for what writes recordings.
    from fte_sniff.session.saving.recording_sink import RecordingSink

    return RecordingSink(path, origin)


def _text(form: OutputFormat) -> Callable[[Path, Origin], Sink]:
    return lambda path, origin: TextSink(form, path, origin)


def _sink_of(form: OutputFormat) -> Callable[[Path, Origin], Sink]:
    match form:
        case OutputFormat.PARQUET:
            return _parquet
        case OutputFormat.MCAP:
            return _recording
        case OutputFormat.RAW:
            return RawSink
        case _:
            return _text(form)


SINKS: Final[Mapping[str, Callable[[Path, Origin], Sink]]] = {
    end: _sink_of(form) for end, form in FORM_BY_END.items()
}
"""By the end of a file's name, what takes rows for it."""
