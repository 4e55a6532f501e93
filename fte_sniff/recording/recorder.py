"""Recorder: rows in, files out. A disk error never stops the capture.

    NAME_00001 --rotation--> NAME_00002 --disk full--> (gap) --space again--> NAME_00003

A flush writes the rows that wait: once a second, when a view requests it, when `MOST_ROWS` rows
wait, and at the end. The flush of each second waits for the disk, too. Rows that were not flushed
go into the next file.
While no file can be made, the newest `MOST_WAITING` rows wait for the next file; older ones are
counted as a gap. `keep_bytes` deletes the oldest files of the capture, also where the disk is full;
each file reports the gaps of the files before it, too.
"""

from __future__ import annotations

import errno
import shutil
import time
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from math import inf
from pathlib import Path
from typing import Final

from mcap.records import Metadata

from fte_sniff.errors import FileError, TranslatableText, reason_of, size_text, unwritable
from fte_sniff.protocol.columns import iso_time
from fte_sniff.protocol.items import Gap, GapKind, PortEvent
from fte_sniff.recording.metadata import GAP_NAME, PortFacts, gap_to_metadata
from fte_sniff.recording.output_file import Existing, KnownFile
from fte_sniff.recording.writer import MOST_ROWS, Entry, RecordingWriter, portions, row_count

FLUSH_NS: Final = 1_000_000_000
"""Nanoseconds between two flushes that wait for the disk: a power cut costs the rows of this time.
"""

RETRY_S: Final = 5.0
"""Seconds from a failure to the next attempt to record again."""

MOST_WAITING: Final = 2**18
"""Rows that wait while no file can be made: two minutes of two full lines, 20 MB."""

DEFAULT_FREE_BYTES: Final = 1_000_000_000
"""Bytes to leave free on the disk, by default; at most half of what is free at the start."""

_FULL: Final = (errno.ENOSPC, errno.EDQUOT, 0)
"""The errors of a full disk; 0 is that of too little space."""
_ROTATE_BYTES: Final = 512_000_000
_FILES: Final = 8


@dataclass(frozen=True, slots=True)
class RecordingOptions:
    """When the next file begins, and when old files are deleted."""

    rotate_bytes: int | None = None
    """Size at which the next file begins; None for no limit."""
    rotate_s: float | None = None
    """Seconds of rows after which the next file begins; None for no limit."""
    keep_bytes: int | None = None
    """Total size of the capture's files: beyond it, the oldest are deleted. None to delete none."""
    min_free_bytes: int | None = None
    """Bytes to leave free on the disk: recording stops below until there is space again. None for
    the default."""

    @property
    def rotates(self) -> bool:
        """Whether the recording is a sequence of numbered files from the beginning."""
        return (self.rotate_bytes, self.rotate_s, self.keep_bytes) != (None, None, None)

    @property
    def next_file_bytes(self) -> int | None:
        """Size at which the next file begins: a fraction of what is kept, if not given."""
        if self.rotate_bytes is not None or self.rotate_s is not None or self.keep_bytes is None:
            return self.rotate_bytes
        return min(_ROTATE_BYTES, self.keep_bytes // _FILES)


class Recorder:
    """Records one capture. Only the constructor raises for disk errors."""

    def __init__(
        self,
        path: Path,
        ports: Sequence[PortFacts],
        facts: Mapping[str, str] | None = None,
        *,
        existing: Existing = Existing.REFUSE,
        options: RecordingOptions | None = None,
    ) -> None:
        """Create the first file.

        Args:
            path: the file, or the name from which the names of the sequence are made.
            ports: the ports whose rows will come.
            facts: further items for each file's metadata.
            existing: what to do if the file exists.
            options: by default those of a recording without options.

        Raises FileError if the file cannot be made, or the disk has too little space for it.
        """
        self._options = options or RecordingOptions()
        self._ports, self._facts, self._base = tuple(ports), dict(facts or {}), path
        self._existing = existing if existing is Existing.REPLACE else Existing.NUMBER
        """What to do if a file after the first one exists."""
        self.files: list[Path] = []
        """All files, in order; the last one is written, unless the recorder `is_stopped`."""
        self.is_stopped = False
        """Whether no file can be made, so that rows wait; the last file stays locked meanwhile."""
        self._closed: list[KnownFile] = []
        """The files that are complete; the oldest may be deleted."""
        self._gaps: list[Gap] = []
        """What could not be written; the last gap grows until a file can be written again."""
        self._waiting: list[Entry] = []
        """What waits until a file can be written again."""
        self.trouble: FileError | None = None
        """Why a file ended before its time, the latest; None if that never happened."""
        self._due_s = -inf
        """When the next file may be tried, in seconds of the monotonic clock."""
        self._flush_ns = 0
        wanted = self._options.min_free_bytes
        self._min_free = min(DEFAULT_FREE_BYTES, self._free // 2) if wanted is None else wanted
        first = self._name(1) if self._options.rotates else path
        self._writer = self._opened(first, existing)
        self.files.append(self._writer.path)
        if not self._options.rotates:
            self._base = self._writer.path

    # What was recorded

    @property
    def path(self) -> Path:
        """The current file, or the last one."""
        return self.files[-1]

    @property
    def failure(self) -> FileError | None:
        """What was not recorded and why; None if everything was."""
        gaps = self._known_gaps
        if not gaps:
            return self.trouble if self.is_stopped else None
        count = sum(gap.rows or 0 for gap in gaps)
        return FileError(
            "{what} were not recorded: {reason}",
            what=f"{count:,} rows from {iso_time(gaps[0].start_ns or 0)} on",
            reason="; then ".join(dict.fromkeys(gap.reason for gap in gaps)),
        )

    @property
    def _known_gaps(self) -> list[Gap]:
        """The gaps in which something was missed."""
        return [gap for gap in self._gaps if gap.start_ns is not None]

    @property
    def unflushed_rows(self) -> int:
        """Rows that wait for the next flush, or the next file."""
        return row_count(self._waiting if self.is_stopped else self._writer.unflushed)

    @property
    def size(self) -> int:
        """Bytes in all files."""
        return self._writer.size + sum(file.size for file in tuple(self._closed))

    # What is recorded

    def write(self, *entries: Entry) -> None:
        """Record rows, each port's in the order of its stream, and port events."""
        for entry in portions(entries):
            if self.is_stopped:
                self._wait([entry])
                continue
            self._writer.write(entry)
            if self.unflushed_rows >= MOST_ROWS:
                self.flush(waits=False)

    def flush_if_due(self, now_ns: int, *, at_once: bool = False) -> None:
        """Flush and wait for the disk if a second has passed at this time, which never falls.

        With `at_once`, flush at other times too, without waiting for the disk.
        """
        if now_ns < self._flush_ns:
            if at_once:
                self.flush(waits=False)
            return
        began_ns = time.monotonic_ns()
        self.flush()
        # On a slow disk, the next flush writes all that came during this one.
        self._flush_ns = now_ns + max(FLUSH_NS, time.monotonic_ns() - began_ns)

    def flush(self, *, waits: bool = True) -> None:
        """Push all rows into the file, and onto the disk; begin another file if that is due."""
        if self.is_stopped:
            if time.monotonic() >= self._due_s:
                self._begin_next()
            return
        try:
            self._writer.flush(waits=waits)
        except FileError as failure:
            self._fail(failure)
            return
        if self._is_rotation_due(self._writer):
            self._begin_next()
        keep = self._options.keep_bytes
        while self._closed and keep and (self.size > keep or self._space_error):
            self._closed.pop(0).delete()
        if (error := self._space_error) is not None:
            self._fail(self._writer.stopped_by(error))

    def close(self) -> None:
        """Flush, and close the file. Closing again does nothing."""
        if self.is_stopped and self._waiting:
            self._begin_next()
        for _ in range(2):  # another file may take what the first one refuses
            try:
                self._writer.close()
            except FileError as failure:
                self._fail(failure)
        self._miss(self._waiting)
        self._waiting = []

    # Files

    def _name(self, number: int) -> Path:
        return self._base.with_stem(f"{self._base.stem}_{number:05}")

    def _opened(self, path: Path, existing: Existing) -> RecordingWriter:
        """The next file of the capture; raises FileError if it cannot be made now."""
        if (error := self._space_error) is not None:
            raise unwritable(path, error)
        part = len(self.files) + 1
        own = {"part": str(part)} if part > 1 or self._options.rotates else {}
        own |= {"previous": self.path.name} if part > 1 else {}
        return RecordingWriter(path, self._ports, self._facts | own, existing=existing)

    def _begin_next(self) -> None:
        """Go on in a new file; with `keep_bytes`, the oldest ones make room for it on a full disk.

        If that fails, no file is left, and the next attempt is made later.
        """
        self._due_s = time.monotonic() + RETRY_S
        while True:
            try:
                writer = self._next_writer()
            except FileError as failure:
                is_full = getattr(failure.__cause__, "errno", None) in _FULL
                # The last file, which stays, reports the gaps until there is another.
                if not (is_full and self._options.keep_bytes and self._closed):
                    return
                self._closed.pop(0).delete()
            else:
                self._put_away(self._writer)
                self._writer, self._waiting = writer, []
                self._due_s, self.is_stopped = -inf, False
                self.files.append(writer.path)
                return

    def _next_writer(self) -> RecordingWriter:
        """A new file that reports all gaps and begins with what waits; raises FileError."""
        writer = self._opened(self._name(len(self.files) + 1), self._existing)
        try:
            for gap in self._known_gaps:
                writer.write_metadata(Metadata(GAP_NAME, gap_to_metadata(gap)))
            writer.write(*self._waiting)
            writer.flush()
        except FileError:
            writer.output.close()
            if writer.output.identity is not None:
                writer.output.identity.delete()
            raise
        return writer

    def _is_rotation_due(self, writer: RecordingWriter) -> bool:
        if writer.span_ns is None or time.monotonic() < self._due_s:
            return False
        seconds = (writer.span_ns[1] - writer.span_ns[0]) / 1e9
        size, age = self._options.next_file_bytes or inf, self._options.rotate_s or inf
        return writer.size >= size or seconds >= age

    def _put_away(self, writer: RecordingWriter) -> None:
        """Close a file, and keep account of it if it is still there."""
        with suppress(FileError):  # what was flushed is in a valid file
            writer.close()
        if writer.output.identity is not None and not writer.is_gone:
            self._closed.append(writer.output.identity)

    # Errors and gaps

    def _fail(self, failure: FileError) -> None:
        """Report that the file cannot be written any more, and try to go on with the next one."""
        self.is_stopped, self.trouble = True, failure
        writer, error = self._writer, failure.__cause__
        assert isinstance(error, OSError)
        rows, span = (writer.flushed_rows, writer.span_ns) if writer.is_gone else (0, None)
        first_ns, last_ns = span or (None, None)
        self._gaps.append(Gap(GapKind.WRITE_ERROR, rows, first_ns, last_ns, reason_of(error)))
        self._wait(writer.unflushed)
        if time.monotonic() >= self._due_s:
            self._begin_next()
        self._due_s = time.monotonic() + RETRY_S

    def _wait(self, entries: Iterable[Entry]) -> None:
        """Store what waits for the next file; the oldest of too many rows are not recorded."""
        self._waiting += entries
        while row_count(self._waiting) > MOST_WAITING:
            self._miss([self._waiting.pop(0)])

    def _miss(self, entries: Iterable[Entry]) -> None:
        """Count what is not recorded."""
        for entry in entries:
            gap = self._gaps[-1]
            if isinstance(entry, PortEvent):
                self._gaps[-1] = gap.including(entry.t_ns, 0)
            elif (span_ns := entry.span_ns) is not None:
                self._gaps[-1] = gap.including(span_ns[0], len(entry)).including(span_ns[1], 0)

    # Space

    @property
    def _space_error(self) -> OSError | None:
        """The error of a disk that has too little space; None if it has enough."""
        if (free := self._free) >= self._min_free:
            return None
        left, least = size_text(free), size_text(self._min_free)
        form = "the disk has only {left} free (--min-free {free})"
        return OSError(0, TranslatableText(form, left=left, free=least))

    @property
    def _free(self) -> int:
        """Free bytes of the disk; very many if that is unknown."""
        try:
            return shutil.disk_usage(self._base.parent).free
        except OSError:
            return 1 << 62
