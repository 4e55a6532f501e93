"""Recorder: rows in, files out, gaps on write errors, rotation.

A disk error never stops the capture. Rows that were not flushed go into the next file. While no
file can be made, rows are only counted, and the next file reports the gap:

    name_00001 --rotation--> name_00002 --disk full--> (gap) --space again--> name_00003

Rows reach the disk with a flush: when `RecordingOptions.flush_every_s` has passed
(`Recorder.flush_if_due`), when `MAX_PENDING` rows wait, before a rotation, and at the end. Each
flush ends a chunk of the file.
"""

from __future__ import annotations

import errno
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from math import inf
from pathlib import Path

from mcap.records import Metadata

from fte_sniff.errors import FileError
from fte_sniff.protocol import Gap, GapKind, iso_time
from fte_sniff.protocol.rows import NO_ROWS, Rows
from fte_sniff.recording.metadata import (
    END_NAME,
    GAP_NAME,
    LEFT_OUT_NAME,
    NEXT_NAME,
    PortFacts,
    gap_to_metadata,
)
from fte_sniff.recording.output_file import Existing, stopped_by_limit
from fte_sniff.recording.retention import FileRetention, OnFull, RecordingOptions, Select, Trigger
from fte_sniff.recording.writer import RecordingWriter

RETRY_S, MAX_RETRY_S = 3.0, 60.0
"""Seconds from a failure to the next attempt to record again: the first time, and at most."""

MAX_PENDING = 16_384
"""Rows that wait for a flush at most; then they are flushed."""

_FULL = (errno.ENOSPC, errno.EDQUOT)


def _is_disk_full(failure: FileError) -> bool:
    cause = failure.__cause__
    return isinstance(cause, OSError) and cause.errno in _FULL


class Backoff:
    """Exponential backoff: attempts are further apart if each succeeds but fails again soon."""

    def __init__(self) -> None:
        self._wait_s = RETRY_S
        self._due_s = self._failed_s = -inf

    @property
    def is_due(self) -> bool:
        """Whether the next attempt may be made."""
        return time.monotonic() >= self._due_s

    def failed(self) -> None:
        """Note that a file in use failed."""
        now_s = time.monotonic()
        was_calm = now_s - self._failed_s > MAX_RETRY_S
        self._wait_s = RETRY_S if was_calm else min(2 * self._wait_s, MAX_RETRY_S)
        self._failed_s = now_s
        self.tried()

    def tried(self) -> None:
        """Note an attempt."""
        self._due_s = time.monotonic() + self._wait_s


@dataclass(frozen=True, slots=True)
class Change:
    """The recording stopped, or goes on in another file."""

    path: Path | None
    """The file it goes on in; None if it stopped."""
    failure: FileError | None = None
    """Why it stopped; None if it goes on."""


@dataclass(frozen=True, slots=True)
class Outcome:
    """The files of a finished capture."""

    first: Path
    """The oldest file that was not deleted for space."""
    last: Path
    deleted_files: int = 0
    deleted_rows: int = 0
    triggered: tuple[int, int, int] | None = None
    """With a trigger: rows recorded, all rows, and how often it fired."""


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
        select: Select | None = None,
    ) -> None:
        """Create the first file.

        Args:
            path: the file, or the name from which the names of the sequence are made.
            ports: the ports whose rows will come.
            facts: further items for each file's metadata.
            existing: what to do if the file exists.
            options: by default those of a recording without options.
            select: selects the rows that trigger.

        Raises FileError if the file cannot be made, or the disk has too little space for it.
        """
        self._options = options or RecordingOptions()
        self._ports, self._facts = tuple(ports), dict(facts or {})
        window = self._options.trigger_window
        self._trigger = Trigger(select, window) if select and window else None
        self._files = FileRetention(path, self._options, existing)
        self._gaps: list[Gap] = []
        """What could not be written; the last gap grows while `_failure` is set."""
        self._missed_events = 0
        self._failure: FileError | None = None
        self._changes: list[Change] = []
        self._backoff = Backoff()
        self._is_disk_full = False
        self._is_closed = False
        self._wants_rotation = False
        self._flush_ns = 0
        """When the next flush is due, nanoseconds since 1970 UTC."""
        self._file_number = 1
        facts = {"part": "1"} if self._options.rotates else {}
        writer = self._open(self._files.first, self._files.existing, facts)
        self._files.opened(writer.path)
        self._writer: RecordingWriter | None = writer
        self.path = writer.path
        """The current file, or the last one."""
        self.waits_for_reader = writer.waits_for_reader
        """Whether the recording begins while its named pipe has no reader."""

    @property
    def failure(self) -> FileError | None:
        """What was not recorded and why; None if everything was."""
        gaps = [gap for gap in self._gaps if gap.start_ns is not None]
        if not gaps or gaps[0].start_ns is None:
            return self._failure
        entries = self._missed_rows + self._missed_events
        return FileError(
            "{what} were not recorded: {reason}",
            what=f"{entries:,} rows and port events from {iso_time(gaps[0].start_ns)} on",
            reason="; then ".join(dict.fromkeys(gap.reason for gap in gaps)),
        )

    @property
    def _missed_rows(self) -> int:
        return sum(gap.rows or 0 for gap in self._gaps)

    @property
    def unflushed_rows(self) -> int:
        """Rows that wait for the next flush."""
        writer = self._writer
        return 0 if writer is None else writer.rows - writer.flushed_rows

    @property
    def size(self) -> int:
        """Bytes in all files."""
        writer = self._writer
        return self._files.closed_bytes + (0 if writer is None else writer.size)

    @property
    def fired(self) -> int | None:
        """How often the trigger fired; None without one."""
        return None if self._trigger is None else self._trigger.events

    @property
    def outcome(self) -> Outcome:
        """The files so far."""
        files, trigger = self._files, self._trigger
        triggered = None
        if trigger is not None:
            recorded = trigger.seen - trigger.dropped - self._missed_rows
            triggered = recorded, trigger.seen, trigger.events
        first = files.oldest or self.path
        return Outcome(first, self.path, files.deleted_files, files.deleted_rows, triggered)

    def changes(self) -> list[Change]:
        """The changes since the previous call."""
        found, self._changes = self._changes, []
        return found

    def write(self, rows: Rows) -> None:
        """Record rows, each port's in the order of its stream, and port events."""
        self._put(rows if self._trigger is None else self._trigger.select(rows))

    def flush_if_due(self, now_ns: int) -> None:
        """Flush if the interval between flushes has passed at this time, which never falls."""
        if now_ns < self._flush_ns:
            return
        began_ns = time.monotonic_ns()
        self.flush()
        # On a slow disk, the next flush writes all that came during this one.
        took_ns = time.monotonic_ns() - began_ns
        self._flush_ns = now_ns + max(round(self._options.flush_every_s * 1e9), took_ns)

    def flush(self, *, is_rotation_due: bool = False) -> None:
        """Push all rows to the disk; begin another file if a limit or the caller demands it."""
        writer = self._writer
        if writer is None:
            if self._backoff.is_due:
                self._backoff.tried()
                self._resume(NO_ROWS)
            return
        self._write_trigger_gaps(writer)
        try:
            writer.flush()
        except FileError as failure:
            self._fail(writer, failure)
            return
        if self._files.are_regular:
            self._rotate_if_due(writer, is_due=is_rotation_due)
            self._check_limits()

    def rotate(self) -> None:
        """Begin the next file at the next flush, if the current one has rows; from any thread."""
        self._wants_rotation = True

    def close(self) -> None:
        """Flush, and close the file. Closing again does nothing."""
        if self._is_closed:
            return
        self._is_closed = True
        if self._trigger is not None:
            self._put(self._trigger.flush())
        for _ in range(2):  # another file may take what the first one refuses
            writer = self._writer
            if writer is None:
                return
            self._write_trigger_gaps(writer)
            try:
                writer.close()
            except FileError as failure:
                self._fail(writer, failure)
            else:
                return

    def _put(self, rows: Rows) -> None:
        if (limit_s := self._options.rotate_s) is not None:
            rows = self._rotate_within(rows, round(limit_s * 1e9))
        self._append(rows)

    def _rotate_within(self, rows: Rows, limit_ns: int) -> Rows:
        """Record rows up to the last rotation that is due between them; return the others."""
        while self._backoff.is_due and (writer := self._writer) is not None:
            if writer.span_ns is not None:
                first_ns = writer.span_ns[0]
            elif (begins_ns := rows.first_ns) is not None:
                first_ns = begins_ns
            else:
                break
            before, rows = rows.split_at(first_ns + limit_ns)
            self._append(before)
            if not (len(rows) or rows.events):
                break
            self.flush(is_rotation_due=self._writer is writer)
            if self._writer is writer:
                break
        return rows

    def _append(self, rows: Rows) -> None:
        while len(rows) or rows.events:
            writer = self._writer
            if writer is None:
                self._miss(rows)
                return
            part = rows[: MAX_PENDING - self.unflushed_rows].with_columns(events=rows.events)
            rows = rows[len(part) :]
            writer.write(part)
            if self.unflushed_rows >= MAX_PENDING:
                self.flush()

    def _miss(self, rows: Rows) -> None:
        if self._failure is None or rows.span_ns is None:
            return
        first_ns, last_ns = rows.span_ns
        self._missed_events += len(rows.events)
        self._gaps[-1] = self._gaps[-1].including(first_ns, len(rows)).including(last_ns, 0)

    def _open(self, path: Path, existing: Existing, facts: Mapping[str, str]) -> RecordingWriter:
        facts = self._facts | dict(facts)
        return RecordingWriter(path, self._ports, facts, existing=existing)

    def _open_next(self) -> RecordingWriter:
        path, existing = self._files.next_path()
        facts = {"part": str(self._file_number + 1), "previous": self.path.name}
        return self._open(path, existing, facts)

    def _fail(self, writer: RecordingWriter, failure: FileError) -> None:
        """Report that a file cannot be written any more, and try to go on with the next one."""
        with suppress(FileError):  # it failed already
            writer.close()
        self._writer = None
        self._files.closed(writer.path, writer.identity, writer.flushed_rows)
        self._is_disk_full = _is_disk_full(failure)
        self._note(writer, failure)
        unflushed = writer.unflushed
        is_due = self._backoff.is_due or (self._is_disk_full and self._deletes_oldest)
        if not (is_due and self._resume(unflushed)):
            self._miss(unflushed)
        self._backoff.failed()

    def _note(self, writer: RecordingWriter, failure: FileError) -> None:
        """Begin the gap after a file that failed."""
        self._failure = failure
        gap = Gap(GapKind.WRITE_ERROR, 0, reason=str(failure))
        if writer.is_gone and writer.flushed_rows + writer.flushed_events:
            assert writer.span_ns is not None
            gap = Gap(gap.kind, writer.flushed_rows, *writer.span_ns, gap.reason)
            self._missed_events += writer.flushed_events
        self._gaps.append(gap)
        self._changes.append(Change(None, failure))

    def _resume(self, unflushed: Rows) -> bool:
        """Go on in a new file that begins with `unflushed`; False if that fails."""
        while self._files.are_regular and self._has_space():
            try:
                writer = self._begin_next(unflushed)
            except FileError as failure:
                is_full = _is_disk_full(failure) and self._deletes_oldest
                if not (is_full and self._files.delete_oldest(keep=1)):
                    return False
            else:
                self._go_on(writer)
                return True
        return False

    def _begin_next(self, unflushed: Rows) -> RecordingWriter:
        """The next file, with the gap before it and these rows; if it fails, no file is left."""
        writer = self._open_next()
        try:
            if self._failure is not None and self._gaps[-1].start_ns is not None:
                writer.write_metadata(Metadata(GAP_NAME, gap_to_metadata(self._gaps[-1])))
            writer.write(unflushed)
            writer.flush()
        except FileError:
            with suppress(FileError, OSError):
                writer.close()
            with suppress(OSError):
                if writer.identity is not None:
                    writer.identity.delete(writer.path)
            raise
        return writer

    @property
    def _deletes_oldest(self) -> bool:
        return self._options.on_full is OnFull.ROTATE_OLDEST

    def _has_space(self) -> bool:
        """Whether another file may be begun; deletes the oldest files if the options allow it."""
        if not self._deletes_oldest:
            return not self._files.limit_reached(0)
        if self._is_disk_full:
            self._files.delete_oldest(keep=1)
        while self._files.limit_reached(0):
            if not self._files.delete_oldest(keep=1):
                return False
        return True

    def _go_on(self, writer: RecordingWriter) -> None:
        self._failure = None
        self._wants_rotation = False
        self._file_number += 1
        self._files.opened(writer.path)
        self._writer, self.path = writer, writer.path
        self._changes.append(Change(writer.path))

    def _rotate_if_due(self, writer: RecordingWriter, *, is_due: bool) -> None:
        self._wants_rotation = self._wants_rotation and writer.rows > 0
        if not ((is_due or self._is_rotation_due(writer)) and self._backoff.is_due):
            return
        try:
            following = self._open_next()
        except FileError:
            # The current file can still be written; it grows until the next attempt.
            self._backoff.tried()
            return
        writer.write_metadata(Metadata(NEXT_NAME, {"file": following.path.name}))
        try:
            writer.close()
        except FileError as failure:
            # Otherwise all rows are flushed, and the file is valid.
            if writer.is_gone:
                self._note(writer, failure)
        self._files.closed(writer.path, writer.identity, writer.flushed_rows)
        self._go_on(following)

    def _is_rotation_due(self, writer: RecordingWriter) -> bool:
        if writer.span_ns is None:
            return False
        if self._wants_rotation:
            return True
        first_ns, last_ns = writer.span_ns
        limits = (
            (writer.size, self._files.rotate_bytes),
            (writer.index_length, self._options.max_index_bytes),
            ((last_ns - first_ns) / 1e9, self._options.rotate_s),
        )
        return any(limit is not None and value >= limit for value, limit in limits)

    def _check_limits(self) -> None:
        """Delete the oldest files, or stop, while a limit is reached."""
        writer = self._writer
        while writer is not None and (limit := self._files.limit_reached(writer.size)):
            if self._deletes_oldest and self._files.delete_oldest():
                continue
            writer.write_metadata(Metadata(END_NAME, {"reason": str(limit)}))
            with suppress(FileError):  # all rows are flushed, and the file is valid
                writer.close()
            failure = stopped_by_limit(
                writer.path,
                limit,
                writer.flushed_rows,
                deletes_oldest=self._deletes_oldest,
                undeleted=self._files.undeleted or "",
            )
            self._fail(writer, failure)
            return

    def _write_trigger_gaps(self, writer: RecordingWriter) -> None:
        for gap in self._trigger.gaps() if self._trigger else ():
            writer.write_metadata(Metadata(LEFT_OUT_NAME, gap_to_metadata(gap)))
