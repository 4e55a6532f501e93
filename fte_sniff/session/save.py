"""Save rows of a session in any format."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from queue import Full, Queue
from threading import Thread
from types import MappingProxyType
from typing import TYPE_CHECKING, Final, Protocol

from mcap.records import Metadata

from fte_sniff.errors import FileError, FteSniffError, UsageError, reason_of
from fte_sniff.formats.writers import FORMAT_BY_SUFFIX, OutputFormat, row_writer
from fte_sniff.protocol import Gap, Row
from fte_sniff.recording.metadata import (
    LEFT_OUT_NAME,
    SELECTION_NAME,
    PortFacts,
    Selection,
    gap_to_metadata,
)
from fte_sniff.recording.output_file import Existing
from fte_sniff.recording.writer import RecordingWriter

if TYPE_CHECKING:
    import polars as pl


@dataclass(frozen=True, slots=True)
class ExportSource:
    """Where rows come from."""

    ports: Sequence[str] = ()
    """The ports that they may come from."""
    bauds: Mapping[str, int] = field(default_factory=dict)
    """Bits per second by port; a port whose baud nobody said is not in it."""
    gaps: Sequence[Gap] = ()
    """Gaps between the rows; more may be found while a file is read."""
    selections: Sequence[Selection] = ()
    """The filters that chose the rows."""

    def within(self, first_ns: int | None, last_ns: int | None) -> ExportSource:
        """The same for the rows between two times alone; None for no bound."""
        clipped = [gap.within(first_ns, last_ns) for gap in self.gaps]
        return replace(self, gaps=[gap for gap in clipped if gap is not None])


UNKNOWN = ExportSource()
"""Nobody said anything."""


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

    def __init__(self, form: OutputFormat, path: Path, origin: ExportSource) -> None:
        self._stream = path.open("w", encoding="utf-8", newline="", errors="backslashreplace")
        self._writer = row_writer(form, self._stream, ports=len(origin.ports) > 1)

    def write(self, rows: Sequence[Row]) -> None:
        """Write the rows' lines."""
        self._writer.write(rows)

    def end(self) -> None:
        """Write the head, if no row has brought it, and close."""
        self._writer.close()
        self._stream.close()

    def abandon(self) -> None:
        """Close."""
        self._stream.close()


class RawSink:
    """The bytes as they came."""

    def __init__(self, path: Path, _origin: ExportSource) -> None:
        self._stream = path.open("wb")
        self.ports: set[str] = set()
        """Where the rows came from; nothing in the file tells them apart."""

    def write(self, rows: Sequence[Row]) -> None:
        """Write the rows' bytes."""
        from fte_sniff.row_batch import RowBatch

        if isinstance(rows, RowBatch):
            self.ports.update(rows.codebook.ports[code] for code in set(rows.port.tolist()))
            self._stream.write(rows.tobytes())
            return
        self.ports.update(row.port for row in rows)
        self._stream.writelines(row.raw for row in rows)

    def end(self) -> None:
        """Close."""
        self._stream.close()

    abandon = end


def _parquet(path: Path, origin: ExportSource) -> Sink:
    # polars takes long to load, and a screen names the forms before anything is saved.

    return ParquetSink(path, origin)


def _recording(path: Path, origin: ExportSource) -> Sink:
    # The same holds for what writes recordings.

    return RecordingSink(path, origin)


def _text(form: OutputFormat) -> Callable[[Path, ExportSource], Sink]:
    return lambda path, origin: TextSink(form, path, origin)


def _sink_of(form: OutputFormat) -> Callable[[Path, ExportSource], Sink]:
    match form:
        case OutputFormat.PARQUET:
            return _parquet
        case OutputFormat.MCAP:
            return _recording
        case OutputFormat.RAW:
            return RawSink
        case _:
            return _text(form)


SINKS: Final[Mapping[str, Callable[[Path, ExportSource], Sink]]] = {
    end: _sink_of(form) for end, form in FORMAT_BY_SUFFIX.items()
}
"""By the end of a file's name, what takes rows for it."""


OVERWRITE: Final = "!"
"""What stands behind a name whose file may be replaced."""

EXAMPLE: Final = "rows.csv"
"""A name as one would type it."""

FORMS: Final = MappingProxyType(SINKS)
"""By the end of a file's name, what is written to it."""


@dataclass(frozen=True, slots=True)
class SaveTarget:
    """A file to save to."""

    path: Path
    replace: bool
    """Whether a file that is there may be replaced."""
    in_use: Sequence[str] = ()
    """Files that rows come from or are recorded to; none of them is ever replaced."""

    @classmethod
    def parse(cls, line: str, in_use: Sequence[str] = ()) -> SaveTarget:
        """The file that a line names; `!` behind the name lets a file be replaced.

        Args:
            line: as it was typed.
            in_use: files that may not be replaced in any case.

        Raises:
            UsageError: the name's end is none of `FORMS`.
            FileError: the file is there already or in use, or there is no such folder.
        """
        name = line.strip()
        replace = name.endswith(OVERWRITE)
        path = Path(name.removesuffix(OVERWRITE).rstrip())
        with suppress(RuntimeError):  # no such user
            path = path.expanduser()
        if path.suffix.lower() not in FORMS:
            raise UsageError("the name's end says what is written: {forms}", forms=" ".join(FORMS))
        target = cls(path, replace, in_use)
        target.check()
        return target

    def check(self) -> None:
        """See whether a file can be made there now.

        Raises:
            FileError: it cannot.
        """
        if self.path.is_dir():
            raise FileError("{path} is a folder; name a file in it", path=self.path)
        if not self.path.parent.is_dir():
            raise FileError(
                "{folder} does not exist; name a folder that does", folder=self.path.parent
            )
        if any(_same(self.path, one) for one in self.in_use):
            raise FileError(
                "{path} holds what is shown, and would be lost; name another", path=self.path
            )
        if os.path.lexists(self.path) and not self.replace:
            raise FileError(
                "{path} exists already; name another, or replace it with {name}{overwrite}",
                path=self.path,
                name=self.path.name,
                overwrite=OVERWRITE,
            )
        if self.replace and self.path.exists() and not self.path.is_file():
            raise FileError("{path} is no regular file; name another", path=self.path)


def _same(path: Path, other: str) -> bool:
    """Whether both are one file, by whatever names; a file that is gone is none."""
    try:
        return path.samefile(other)
    except OSError:
        return False


class SaveJob:
    """One file under way."""

    def __init__(self, target: SaveTarget, origin: ExportSource) -> None:
        """Begin the file.

        Args:
            target: where it is to lie.
            origin: where the rows come from.

        Raises:
            FileError: it cannot be made there.
        """
        target.check()
        self._target = target
        self._part = target.path.with_name(f"{target.path.name}.part")
        self.rows = 0
        """Rows written so far."""
        try:
            with self._part.open("xb"):
                pass
        except FileExistsError as error:
            raise FileError(
                "{path} is in the way; delete it, or name another", path=self._part
            ) from error
        except OSError as error:
            raise self._refused(error) from error
        try:
            self._sink = self._made(origin)
        except (OSError, FteSniffError):
            self._part.unlink(missing_ok=True)
            raise

    def _made(self, origin: ExportSource) -> Sink:
        try:
            return FORMS[self._target.path.suffix.lower()](self._part, origin)
        except OSError as error:
            raise self._refused(error) from error

    @property
    def path(self) -> Path:
        """Where the file will lie."""
        return self._target.path

    def write(self, rows: Sequence[Row]) -> None:
        """Write the next rows.

        Raises:
            FileError: they cannot be written, or the form cannot hold them; nothing is left.
        """
        with self._all_or_nothing():
            self._sink.write(rows)
        self.rows += len(rows)

    def finish(self) -> None:
        """End the file, and give it its name.

        Raises:
            FileError: it cannot be ended, or a file of that name has come meanwhile; nothing is
                left.
        """
        with self._all_or_nothing():
            self._sink.end()
            self._target.check()
            self._part.replace(self._target.path)

    def abandon(self) -> None:
        """Leave nothing."""
        with suppress(OSError, FteSniffError):
            self._sink.abandon()
        with suppress(OSError):
            self._part.unlink(missing_ok=True)

    @contextmanager
    def _all_or_nothing(self) -> Iterator[None]:
        """What fails leaves nothing, and its error is one of ours."""
        try:
            yield
        except OSError as error:
            self.abandon()
            raise self._refused(error) from error
        except FteSniffError:
            self.abandon()
            raise

    def _refused(self, error: OSError) -> FileError:
        return FileError(
            "{path} cannot be written: {reason}; name another place",
            path=self.path,
            reason=reason_of(error),
        )


MOST_WAITING: Final = 8
"""Pieces that wait to be written at most."""

_LOOK_S: Final = 0.1
"""How long a piece waits before it is seen whether anybody still writes."""


class _AbandonedError(Exception):
    """The file is not wanted any more."""


class ParquetSink:
    """Rows as `analysis.table` has their columns."""

    def __init__(self, path: Path, _origin: ExportSource) -> None:
        self._path = path
        self._waiting: Queue[pl.DataFrame | None] = Queue(MOST_WAITING)
        self._error: Exception | None = None
        self._abandoned = False
        self._thread = Thread(target=self._write, name="writes Parquet", daemon=True)
        self._thread.start()

    def write(self, rows: Sequence[Row]) -> None:
        """Take the rows."""
        from fte_sniff.analysis.dataframe import table_frame

        if rows:
            self._put(table_frame(rows))

    def end(self) -> None:
        """Wait until all is written."""
        self._put(None)
        self._thread.join()
        if self._error is not None:
            raise self._error

    def abandon(self) -> None:
        """Write no more."""
        self._abandoned = True
        if self._thread.is_alive():
            try:
                self._put(None)
            finally:
                self._thread.join()

    def _put(self, frame: pl.DataFrame | None) -> None:
        while self._error is None:
            try:
                self._waiting.put(frame, timeout=_LOOK_S)
            except Full:
                continue
            return
        if not self._abandoned:
            raise self._error

    def _write(self) -> None:
        from fte_sniff.analysis.dataframe import TABLE_SCHEMA
        from fte_sniff.formats.parquet import write_parquet

        try:
            write_parquet(self._frames(), self._path, dict(TABLE_SCHEMA))
        except (OSError, _AbandonedError) as error:
            self._error = error

    def _frames(self) -> Iterator[pl.DataFrame]:
        while not self._abandoned and (frame := self._waiting.get()) is not None:
            yield frame
        if self._abandoned:
            raise _AbandonedError


class RecordingSink:
    """Rows as a recording; each must have a time."""

    def __init__(self, path: Path, origin: ExportSource) -> None:
        facts = [PortFacts(port, origin.bauds.get(port)) for port in origin.ports]
        self._writer = RecordingWriter(path, facts, existing=Existing.REPLACE)
        for gap in origin.gaps:
            self._writer.write_metadata(Metadata(LEFT_OUT_NAME, gap_to_metadata(gap)))
        for selection in origin.selections:
            self._writer.write_metadata(Metadata(SELECTION_NAME, selection.to_metadata()))

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
