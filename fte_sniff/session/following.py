"""Follow a recording that another program writes, from file to file of its capture.

The file is polled, which also works on network file systems. Following ends when the writer
releases its lock; if no lock was ever seen, when the file has not grown for some time.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Final

from fte_sniff.errors import FileError, Joint, TranslatableText, listed
from fte_sniff.protocol import Gap, PortEvent, PortEventKind
from fte_sniff.session.inputs import InputBatch, Note, RecordingInput

if TYPE_CHECKING:
    from fte_sniff.recording.chunks import ChunkRef
    from fte_sniff.recording.reader import Recording, TimeRange

POLL_S: Final = 0.1

_RELEASE_S: Final = 5.0
"""How long the lock of a file that names its next file is waited for, or the next file."""

IDLE_S: Final = 10.0
"""How long a file without a lock may stay as it is."""


class Following:
    """The state of following the files of one capture."""

    def __init__(self) -> None:
        """Follow nothing yet."""
        self.name = ""
        """The file that is read."""
        self.has_lock = False
        """Whether locks work: one was seen."""
        self.open_ports: set[str] = set()
        """The ports that were opened, and neither closed nor lost."""
        self.is_up_to_date = False
        """Whether the file was read up to its end once."""
        self.stopped = False
        self.ended: str | None = None
        """Why following ended, one line; None while it goes on."""

    def open(self, path: Path) -> FollowedInput:
        """The recording as an input, whose successors are the next files.

        Raises FileError if it cannot be read, or is not a recording.
        """
        from fte_sniff.recording.reader import Recording

        found = FollowedInput(Recording(path, is_growing=True), self)
        self.name = found.name
        return found

    def observe(self, events: Iterable[PortEvent]) -> None:
        """Update the open ports."""
        for event in events:
            if event.kind in (PortEventKind.OPENED, PortEventKind.FOUND_AGAIN):
                self.open_ports.add(event.port)
            elif event.kind in (PortEventKind.CLOSED, PortEventKind.LOST):
                self.open_ports.discard(event.port)

    def end(self, name: str, limit: str) -> TranslatableText:
        """Why following ended with a file that has no next one; `limit` is what it names."""
        if limit:
            return TranslatableText(
                "{path}: the recording ended because {reason}", path=name, reason=limit
            )
        if not self.has_lock:
            return TranslatableText(
                "{path}: nothing was written to it for {seconds:g} s",
                path=name,
                seconds=IDLE_S,
            )
        if self.open_ports:
            return TranslatableText(
                "{path}: the program that recorded it ended without closing {ports}; it was killed"
                " or could not write, and its last rows may be missing",
                path=name,
                ports=listed(sorted(self.open_ports), Joint.AND),
            )
        return TranslatableText("{path}: the program that recorded it has ended", path=name)

    def stop(self) -> None:
        """Request the end of following; may be called in a signal handler."""
        self.stopped = True


class FollowedInput(RecordingInput):
    """A recording that another program writes; its batches come as they are flushed."""

    def __init__(self, reader: Recording, following: Following) -> None:
        super().__init__(reader)
        self._growing, self._following = reader, following
        self._gaps_known = 0
        self._troubles: Counter[PortEventKind] = Counter()
        self._has_rows = False

    def batches(
        self, span: TimeRange | None, note: Note, open_inputs: int = 0
    ) -> Iterator[InputBatch]:
        """Read its rows, and wait for more; see `Input`.

        The first batch may be empty, so that a reader knows that the file could be opened.
        """
        self._gaps_known = len(self.gaps(span))
        try:
            yield from self._until_end(span)
        except FileError as error:
            self._fail(error)
            return
        following = self._following
        if not following.stopped and following.ended is None:
            self._find_successor()
        self._note_end(span, note, self._troubles, some=self._has_rows)
        if self.failure is None:
            self.failure = self._growing.nothing_read
        if self.successor is None and self.failure is None and following.ended is not None:
            note(following.ended)

    def _until_end(self, span: TimeRange | None) -> Iterator[InputBatch]:
        """The rows up to the end of following this file."""
        from fte_sniff.recording.reader import EVERYTHING

        following, reader = self._following, self._growing
        wanted = span or EVERYTHING
        changed_s, named_s = time.monotonic(), None
        yield InputBatch()
        added = list(reader.contents.chunks)
        while True:
            # Before `grow`: what was flushed before the lock was released is then complete.
            has_writer = reader.has_writer
            following.has_lock |= has_writer
            now_s = time.monotonic()
            added += reader.grow()
            if added:
                changed_s = now_s
                yield from self._new(added, wanted)
                added = []
            if reader.times and reader.times[1] >= wanted.end_ns:
                following.ended = TranslatableText("{path}: --to is reached", path=self.name)
                return
            if following.stopped:
                return
            if reader.next_path is not None and named_s is None:
                named_s = now_s
            if self._is_finished(has_writer, now_s, changed_s, named_s):
                break
            following.is_up_to_date = True
            time.sleep(POLL_S)
        if not has_writer:
            yield from self._new(reader.settle(), wanted)

    def _is_finished(
        self, has_writer: bool, now_s: float, changed_s: float, named_s: float | None
    ) -> bool:
        following = self._following
        if has_writer:
            return named_s is not None and now_s >= named_s + _RELEASE_S
        if named_s is not None or following.has_lock or self._growing.limit:
            return True
        return now_s >= changed_s + IDLE_S

    def _new(self, chunks: list[ChunkRef], span: TimeRange) -> Iterator[InputBatch]:
        """The batches of new chunks, with the gaps that the file reports since the last ones."""
        for own in self._growing.batches(span, chunks):
            batch = self._batch_of(own, span)
            if batch is None:
                continue
            self._troubles.update(event.kind for event in batch.rows.events)
            self._following.observe(batch.rows.events)
            self._has_rows |= bool(len(batch.rows))
            yield replace(batch, gaps=self._new_gaps(span))
            if self._following.stopped:
                return
        if gaps := self._new_gaps(span):  # after the last row
            yield InputBatch(gaps=gaps)

    def _new_gaps(self, span: TimeRange | None) -> Sequence[Gap]:
        gaps = self.gaps(span)[self._gaps_known :]
        self._gaps_known += len(gaps)
        return gaps

    def _find_successor(self) -> None:
        """Open the next file of the capture, or state how the last one ended."""
        following = self._following
        until_s = time.monotonic() + _RELEASE_S
        while (path := self._growing.find_next()) is None:
            # A writer with open ports may begin the next file soon, for example after a disk error.
            waits = following.open_ports and self.part and time.monotonic() < until_s
            if not waits or following.stopped:
                following.ended = following.end(self.name, self._growing.limit)
                return
            time.sleep(POLL_S)
        try:
            self.successor = following.open(path)
        except FileError as error:
            self._fail(error)

    def _fail(self, error: FileError) -> None:
        self.failure = error
        self._following.ended = error.message
