"""Recorder: rows in, files out, gaps on write errors, rotation.

Nothing that the disk does stops the capture. When a file cannot be written any more, what it holds
stays; what was not flushed goes into the next file, at once if that can be made, else what comes
until it can is counted, and the next file tells that gap:

    name_00001 --rotation--> name_00002 --disk full--> (gap) --room again--> name_00003
"""

from __future__ import annotations

import errno
import time
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from math import inf
from pathlib import Path

from mcap.records import Metadata

from fte_sniff.errors import FileError
from fte_sniff.protocol import Gap, GapKind, PortEvent, Row, iso_time
from fte_sniff.recording.metadata import (
    GAP_NAME,
    LEFT_OUT_NAME,
    PROGRAM,
    PortFacts,
    gap_to_metadata,
)
from fte_sniff.recording.output_file import Existing, bound_reached, not_recorded
from fte_sniff.recording.retention import FileRetention, OnFull, RecordingOptions, check_room
from fte_sniff.recording.trigger import Entry, Select, Trigger
from fte_sniff.recording.writer import RecordingWriter

AGAIN_S, AGAIN_MOST_S = 3.0, 60.0
"""Seconds from a failure to the next attempt to record again: usually, and after many failures."""


class Backoff:
    """When the next attempt to record is due.

    It is due every few seconds; later and later where each attempt succeeds but fails again soon.
    """

    def __init__(self) -> None:
        self._waits_s = AGAIN_S
        self._due_s = self._failed_s = -inf

    @property
    def over(self) -> bool:
        """Whether an attempt is due."""
        return time.monotonic() >= self._due_s

    def failed(self) -> None:
        """A recording that was under way failed."""
        now_s = time.monotonic()
        calm = now_s - self._failed_s > AGAIN_MOST_S
        self._waits_s = AGAIN_S if calm else min(2 * self._waits_s, AGAIN_MOST_S)
        self._failed_s = now_s
        self.tried()

    def tried(self) -> None:
        """An attempt was made."""
        self._due_s = time.monotonic() + self._waits_s


NEXT_NAME = f"{PROGRAM}.next"
"""The name of the metadata record that names the file that follows."""

_FULL = (errno.ENOSPC, errno.EDQUOT)


@dataclass(frozen=True, slots=True)
class Change:
    """What became of the recording."""

    path: Path | None
    """Where it goes on; None where it does not."""
    failure: FileError | None = None
    """Why it stopped; None where it goes on as it should."""


@dataclass(frozen=True, slots=True)
class Outcome:
    """What is there once a capture is over."""

    first: Path
    """The first of its files that were not deleted to make room."""
    last: Path
    deleted_files: int = 0
    deleted_rows: int = 0
    triggered: tuple[int, int, int] | None = None
    """Where a trigger chose: the rows recorded, all rows, and how often it fired."""


class Recorder:
    """Records one capture. After it was made no method raises for what the disk does."""

    def __init__(
        self,
        path: Path,
        ports: Sequence[PortFacts],
        facts: Mapping[str, str] | None = None,
        *,
        existing: Existing = Existing.REFUSE,
        keeping: RecordingOptions | None = None,
        select: Select | None = None,
    ) -> None:
        """Create the first file.

        Args:
            path: the file, or what the files of the sequence are named after.
            ports: the ports whose rows will come.
            facts: what else each file is to say about itself.
            existing: what to do if the file is there already.
            keeping: what to keep; all of it by default.
            select: picks the rows of the trigger, where `keeping` asks for their surroundings.

        Raises:
            FileError: the file cannot be made, or there is no room for it.
        """
        self._keeping = keeping or RecordingOptions()
        self._ports, self._facts = tuple(ports), dict(facts or {})
        around = self._keeping.around
        self._trigger = Trigger(select, around) if select and around else None
        self._shelf = FileRetention(path, self._keeping, existing)
        check_room(self._shelf)
        self._part = 1
        self._gaps: list[Gap] = []
        """What could not be written; while nothing can be, the last one grows."""
        self._missed_events = 0
        self._failure: FileError | None = None
        """Why nothing is written at present."""
        self._changes: list[Change] = []
        self._patience = Backoff()
        self._is_full = False
        self._closed = False
        part = {"part": "1"} if self._keeping.rotates else {}
        writer = self._made(self._shelf.first, self._shelf.existing, part)
        self._shelf.began(writer.path)
        self._writer: RecordingWriter | None = writer
        self._last = writer.path

    @property
    def path(self) -> Path:
        """The file that is written to, or was last."""
        return self._last

    @property
    def failure(self) -> FileError | None:
        """What was not recorded, and why; None where all that was to be recorded was."""
        gaps = [gap for gap in self._gaps if gap.start_ns is not None]
        if not gaps or gaps[0].start_ns is None:
            return self._failure
        entries = self._missed_rows + self._missed_events
        what = f"{entries} rows and port events from {iso_time(gaps[0].start_ns)} on"
        return not_recorded(what, "; then ".join(dict.fromkeys(gap.reason for gap in gaps)))

    @property
    def _missed_rows(self) -> int:
        return sum(gap.rows or 0 for gap in self._gaps)

    @property
    def outcome(self) -> Outcome:
        """What is there by now."""
        shelf, trigger = self._shelf, self._trigger
        triggered = None
        if trigger is not None:
            recorded = trigger.taken - trigger.dropped - self._missed_rows
            triggered = recorded, trigger.taken, trigger.events
        first = shelf.oldest or self._last
        return Outcome(first, self._last, shelf.deleted_files, shelf.deleted_rows, triggered)

    def changes(self) -> list[Change]:
        """What became of the recording since this was asked before."""
        found, self._changes = self._changes, []
        return found

    def write(self, rows: Sequence[Row]) -> None:
        """Take rows, each port's in the order of its stream."""
        self._put(rows if self._trigger is None else self._trigger.rows(rows))

    def write_event(self, event: PortEvent) -> None:
        """Take a port event."""
        self._put([event] if self._trigger is None else self._trigger.event(event))

    def flush(self) -> None:
        """Push what was taken to the disk; go on with another file where that is due."""
        if self._writer is None:
            self._try_again()
            return
        self._note_gaps(self._writer)
        try:
            self._writer.flush()
        except FileError as failure:
            self._fail(self._writer, failure)
            return
        if self._shelf.seeks:
            self._rotate_when_due(self._writer)
            self._keep_bounds()

    def close(self) -> None:
        """Push what was taken to the disk, and close the file. Closing again does nothing."""
        if self._closed:
            return
        self._closed = True
        if self._trigger is not None:
            self._put(self._trigger.end())
        for _ in range(2):  # what the first file refuses may go into another
            writer = self._writer
            if writer is None:
                return
            self._note_gaps(writer)
            try:
                writer.close()
            except FileError as failure:
                self._fail(writer, failure)
            else:
                return

    def _put(self, entries: Sequence[Entry]) -> None:
        writer = self._writer
        if writer is None:
            self._miss(entries)
            return
        try:
            writer.write(entries)
        except FileError as failure:
            if writer.failure is None:
                raise
            self._fail(writer, failure)

    def _made(self, path: Path, existing: Existing, facts: Mapping[str, str]) -> RecordingWriter:
        return RecordingWriter(path, self._ports, self._facts | dict(facts), existing=existing)

    def _next(self) -> RecordingWriter:
        """The writer of the next file; raises FileError."""
        path, existing = self._shelf.next()
        part = {"part": str(self._part + 1), "previous": self._last.name}
        return self._made(path, existing, part)

    def _fail(self, writer: RecordingWriter, failure: FileError) -> None:
        """A file cannot be written any more: tell, and go on with the next one if that works."""
        with suppress(FileError):  # it failed already, and that is told
            writer.close()
        self._writer = None
        self._shelf.finished(writer.path, writer.flushed_rows)
        cause = failure.__cause__
        self._is_full = isinstance(cause, OSError) and cause.errno in _FULL
        self._failure = failure
        gap = Gap(GapKind.WRITE_ERROR, 0, reason=str(failure))
        if writer.gone and writer.flushed_rows and writer.span_ns is not None:
            gap = replace(gap, rows=writer.flushed_rows)
            gap = gap.including(writer.span_ns[0], 0).including(writer.span_ns[1], 0)
        self._gaps.append(gap)
        self._changes.append(Change(None, failure))
        left = writer.unflushed
        if not (self._patience.over and self._resumes(left)):
            self._miss(left)
        self._patience.failed()

    def _try_again(self) -> None:
        if self._patience.over:
            self._patience.tried()
            self._resumes([])

    def _resumes(self, left: Sequence[Entry]) -> bool:
        """Go on in a new file, beginning with what was `left`; False where that cannot be done."""
        if not self._shelf.seeks or not self._has_room():
            return False
        try:
            writer = self._next()
        except FileError:
            return False
        try:
            if self._failure is not None and self._gaps[-1].start_ns is not None:
                writer.note(Metadata(GAP_NAME, gap_to_metadata(self._gaps[-1])))
            writer.write(left)
            writer.flush()
        except FileError:
            with suppress(FileError, OSError):
                writer.close()
                writer.path.unlink()
            return False
        self._go_on(writer)
        return True

    def _has_room(self) -> bool:
        """Whether another file may be begun; makes room where that was asked for."""
        if self._keeping.on_full is OnFull.STOP:
            return not self._shelf.over(0)
        if self._is_full:
            self._shelf.remove_oldest(keep=1)
        while self._shelf.over(0):
            if not self._shelf.remove_oldest(keep=1):
                return False
        return True

    def _go_on(self, writer: RecordingWriter) -> None:
        self._failure = None
        self._part += 1
        self._shelf.began(writer.path)
        self._writer, self._last = writer, writer.path
        self._changes.append(Change(writer.path))

    def _miss(self, entries: Iterable[Entry]) -> None:
        if self._failure is None:
            return
        for entry in entries:
            is_event = isinstance(entry, PortEvent)
            self._missed_events += is_event
            self._gaps[-1] = self._gaps[-1].including(entry.t_ns or 0, not is_event)

    def _rotate_when_due(self, writer: RecordingWriter) -> None:
        size, span = self._shelf.rotate_bytes, writer.span_ns
        seconds = 0.0 if span is None else (span[1] - span[0]) / 1e9
        most = self._keeping.most_index
        full = (size is not None and writer.size >= size) or (
            most is not None and writer.index_length >= most
        )
        old = self._keeping.rotate_s is not None and seconds >= self._keeping.rotate_s
        if span is None or not (full or old) or not self._patience.over:
            return
        try:
            following = self._next()
        except FileError:
            # The file at hand can still be written to; it goes on growing until the next attempt.
            self._patience.tried()
            return
        writer.note(Metadata(NEXT_NAME, {"file": following.path.name}))
        with suppress(FileError):  # all rows are flushed, and the file is whole
            writer.close()
        self._shelf.finished(writer.path, writer.flushed_rows)
        self._go_on(following)

    def _keep_bounds(self) -> None:
        writer = self._writer
        while writer is not None and (bound := self._shelf.over(writer.size)):
            if self._keeping.on_full is OnFull.ROTATE_OLDEST and self._shelf.remove_oldest():
                continue
            with suppress(FileError):  # all rows are flushed, and the file is whole
                writer.close()
            self._fail(writer, bound_reached(writer.path, bound, writer.flushed_rows))
            return

    def _note_gaps(self, writer: RecordingWriter) -> None:
        for gap in self._trigger.gaps() if self._trigger else ():
            writer.note(Metadata(LEFT_OUT_NAME, gap_to_metadata(gap)))
