"""Recorder: rows in, files out. A disk error never stops the capture.

    NAME.mcap --rotation--> NAME_00002.mcap --disk full--> (gap) --space again--> NAME_00003.mcap

Rows reach the disk with a flush. When a file cannot be written, its unflushed rows and all that
follow are counted as a gap, a new file is tried every `RETRY_S`, and it begins with that gap.
"""

from __future__ import annotations

import shutil
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from mcap.records import Metadata

from fte_sniff.errors import FileError, TranslatableText, size_text
from fte_sniff.protocol import Gap, GapKind
from fte_sniff.protocol.rows import Rows
from fte_sniff.recording.metadata import GAP_NAME, NEXT_NAME, PortFacts, gap_to_metadata
from fte_sniff.recording.plain.writer import RecordingWriter

RETRY_S: Final = 5.0
MAX_PENDING: Final = 16_384
"""Rows that wait for a flush at most; then they are flushed."""


@dataclass(frozen=True, slots=True)
class RecordingOptions:
    """When rows reach the disk, when the next file begins, and when old files are deleted."""

    flush_every_s: float = 1.0
    rotate_bytes: int | None = None
    rotate_s: float | None = None
    keep_bytes: int | None = None
    """Total size of the capture's files; the oldest are deleted. None to delete none."""
    min_free_bytes: int = 1_000_000_000
    """Bytes to leave free on the disk: recording pauses below."""


class Recorder:
    """Records one capture. Only the constructor raises for disk errors."""

    def __init__(
        self,
        path: Path,
        ports: Sequence[PortFacts],
        facts: Mapping[str, str] | None = None,
        options: RecordingOptions | None = None,
    ) -> None:
        """Create the first file; raises FileError."""
        self._options, self._ports = options or RecordingOptions(), tuple(ports)
        self._first, self._facts, self._number = path, dict(facts or {}), 1
        self._closed: list[Path] = []
        self._gap: Gap | None = None
        """Rows that no file has; it grows while `_writer` is None."""
        self._retry_s = self._flush_ns = 0.0
        self._wants_rotation = False
        self.missed_rows = self.deleted_files = 0
        self.failure: FileError | None = None
        """Why rows were not recorded, the last time; None if all were."""
        self._writer: RecordingWriter | None = self._open(path)
        self.path = path
        """The current file, or the last one."""

    def write(self, rows: Rows) -> None:
        """Record rows and port events; `flush_if_due` stores them."""
        if self._writer is None:
            self._miss(rows)
            return
        self._writer.write(rows)
        if self._writer.unflushed.rows >= MAX_PENDING:
            self.flush()

    def flush_if_due(self, now_ns: int) -> None:
        """Flush if the interval between flushes has passed at this time, which never falls."""
        if now_ns >= self._flush_ns:
            self._flush_ns = now_ns + self._options.flush_every_s * 1e9
            self.flush()

    def flush(self) -> None:
        """Push all rows to the disk; begin another file if that is due."""
        writer = self._writer
        try:
            if writer is None:
                self._resume()
            elif self._has_space():
                writer.flush()
                if self._is_rotation_due(writer):
                    self._rotate(writer)
            else:
                free = size_text(self._options.min_free_bytes)
                raise FileError("{path}: less than {free} is free", path=self.path, free=free)
        except FileError as error:
            self._fail(error)

    def rotate(self) -> None:
        """Begin the next file at the next flush; from any thread."""
        self._wants_rotation = True

    def close(self) -> None:
        """Flush, and close the file."""
        writer, self._writer = self._writer, None
        if writer is not None:
            try:
                writer.close()
            except FileError as error:
                self._gap, self.failure = Gap(GapKind.WRITE_ERROR, reason=str(error)), error
                self._miss(writer.unflushed.all())

    def _open(self, path: Path) -> RecordingWriter:
        facts = self._facts | {"part": str(self._number)}
        return RecordingWriter(path, self._ports, facts)

    def _next_path(self) -> Path:
        self._number += 1
        return self._first.with_stem(f"{self._first.stem}_{self._number:05}")

    def _is_rotation_due(self, writer: RecordingWriter) -> bool:
        options = self._options
        return writer.rows > 0 and (
            self._wants_rotation
            or (options.rotate_bytes is not None and writer.size >= options.rotate_bytes)
            or (options.rotate_s is not None and writer.span_ns >= options.rotate_s * 1e9)
        )

    def _rotate(self, writer: RecordingWriter) -> None:
        following = self._open(self._next_path())
        writer.write_metadata(Metadata(NEXT_NAME, {"file": following.path.name}))
        writer.close()
        self._go_on(following)

    def _go_on(self, writer: RecordingWriter) -> None:
        self._closed.append(self.path)
        self._writer, self.path, self._wants_rotation = writer, writer.path, False
        limit = self._options.keep_bytes
        while limit is not None and self._closed and self.size > limit:
            with suppress(OSError):
                self._closed[0].unlink()
            del self._closed[0]
            self.deleted_files += 1

    @property
    def size(self) -> int:
        """Bytes in all files."""
        closed = sum(path.stat().st_size for path in self._closed if path.exists())
        return closed + (0 if self._writer is None else self._writer.size)

    def _has_space(self) -> bool:
        with suppress(OSError):
            return shutil.disk_usage(self._first.parent).free >= self._options.min_free_bytes
        return True

    def _fail(self, error: FileError) -> None:
        """Begin a gap; the file has what was flushed."""
        self._retry_s = time.monotonic() + RETRY_S
        writer, self._writer = self._writer, None
        if writer is not None:
            self.failure = error
            self._gap = Gap(GapKind.WRITE_ERROR, 0, reason=TranslatableText(str(error)))
            self._miss(writer.unflushed.all())
            writer.abandon()

    def _miss(self, rows: Rows) -> None:
        self.missed_rows += len(rows)
        if self._gap is not None and (span_ns := rows.span_ns) is not None:
            self._gap = self._gap.including(span_ns[0], len(rows)).including(span_ns[1], 0)

    def _resume(self) -> None:
        if time.monotonic() < self._retry_s or not self._has_space():
            return
        writer = self._open(self._next_path())
        if self._gap is not None and self._gap.start_ns is not None:
            writer.write_metadata(Metadata(GAP_NAME, gap_to_metadata(self._gap)))
        self._gap = None
        self._go_on(writer)
