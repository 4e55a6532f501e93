"""Follow a recording that another program writes, from file to file of its capture.

    poll ── grow ── items of the new chunks ── has the writer gone? ── next file, or the end

The file is polled, which also works on network file systems. Following ends when the writer
releases its lock; if no lock was ever seen, when the file has not grown for some time.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from typing import Final

from fte_sniff.errors import FileError, Joint, TranslatableText, listed
from fte_sniff.protocol.items import Gap, PortEvent, PortEventKind
from fte_sniff.protocol.rows import NO_ROWS, Item
from fte_sniff.recording.chunks import ChunkRef
from fte_sniff.recording.reader import EVERYTHING, Recording, TimeRange
from fte_sniff.session.inputs import Input, Note, beginning_of, note_losses, recording_input

POLL_S: Final = 0.1
"""Interval at which a file is polled by commands that only follow."""

RELEASE_S: Final = 5.0
"""How long the next file is waited for."""

IDLE_S: Final = 10.0
"""How long a file without a lock may stay as it is."""

MOST_BYTES: Final = 4 << 20
"""Unpacked bytes of the chunks that one poll reads; of one chunk at least."""


class Follower:
    """Reads the files of a capture while they are written; `poll` never waits."""

    def __init__(self, reader: Recording, goes_on: Callable[[], bool] | None = None) -> None:
        """Begin with a file that was opened as growing.

        `goes_on` is whether the writer runs, so that a next file can come; None if nobody knows.
        """
        self._goes_on = goes_on
        self._has_lock = False
        """Whether locks work: one was seen."""
        self._open_ports = set[str]()
        """The ports that were opened, and neither closed nor lost."""
        self._gaps = list[Gap]()
        """The gaps that were reported; each file reports those of the files before it, too."""
        self.span = EVERYTHING
        """Only rows in it are read."""
        self.note: Note = lambda _note: None
        """Is called with what is wrong with a file, after its last row."""
        self.stopped = False
        self.ended: str | None = None
        """Why following ended, one line; None while it goes on."""
        self._begin(reader)

    def stop(self) -> None:
        """Request the end of following; may be called in a signal handler."""
        self.stopped = True

    def _begin(self, reader: Recording) -> None:
        self.reader, self._seen = reader, 0
        self._changed_s = time.monotonic()
        self._waits_until_s: float | None = None
        """Until when a next file is waited for."""
        self._new: list[Gap] = beginning_of(reader)

    @property
    def is_up_to_date(self) -> bool:
        """Whether the file was read up to its present end."""
        return self._seen == len(self.reader.contents.chunks)

    def poll(self) -> list[Item]:
        """What came since the last poll; empty if nothing did.

        Raises FileError if the file was deleted, replaced or cut off, or nothing of it can be read.
        """
        if self.ended is not None:
            return []
        # Before `grow`: what was flushed before the lock was released is then complete.
        has_writer = self.reader.has_writer
        self._has_lock |= has_writer
        self.reader.grow()
        found = self._items()
        if self.is_up_to_date and self._is_finished(has_writer):
            if not has_writer:
                self.reader.settle()
                found += self._items()
            if self.is_up_to_date and self.ended is None:
                self._go_on()
        return found

    def _items(self) -> list[Item]:
        """The items of the next chunks, and the gaps that the file reports anew."""
        chunks, size = list[ChunkRef](), 0
        for chunk in self.reader.contents.chunks[self._seen :]:
            if chunks and size + chunk.size > MOST_BYTES:
                break
            chunks.append(chunk)
            size += chunk.size
        self._seen += len(chunks)
        found: list[Item] = [*self._new]
        self._new = []
        if chunks:
            self._changed_s = time.monotonic()
            found += self.reader.read(chunks, self.span)
        gaps = [gap for gap in self.reader.gaps() if gap not in self._gaps]
        self._gaps += gaps
        for event in found:
            if isinstance(event, PortEvent):
                if event.kind in (PortEventKind.OPENED, PortEventKind.FOUND_AGAIN):
                    self._open_ports.add(event.port)
                elif event.kind in (PortEventKind.CLOSED, PortEventKind.LOST):
                    self._open_ports.discard(event.port)
        return found + gaps

    def _is_finished(self, has_writer: bool) -> bool:
        """Whether the file is complete, as far as can be known."""
        reader, now_s = self.reader, time.monotonic()
        if reader.times is not None and reader.times[1] >= self.span.end_ns:
            self._end_file()
            self.ended = TranslatableText("{path}: --to is reached", path=reader.path)
            return True
        is_over = self._goes_on is not None and not self._goes_on()
        if has_writer or self._has_lock or is_over:
            return not has_writer
        return now_s >= self._changed_s + IDLE_S or reader.find_next() is not None

    def _go_on(self) -> None:
        """Begin the next file, wait for it, or state how the last one ended."""
        path = self.reader.find_next()
        if path is not None:
            self._end_file()
            self._begin(Recording(path, is_growing=True))
            return
        # A writer with open ports may begin the next file soon, for example after a disk error.
        now_s = time.monotonic()
        self._waits_until_s = self._waits_until_s or now_s + RELEASE_S
        is_known = self._goes_on is not None and self._goes_on()
        if is_known or (self._open_ports and now_s < self._waits_until_s):
            return
        self._end_file()
        self.ended = self._end()

    def _end_file(self) -> None:
        note_losses(self.reader, self.note)
        if self.reader.nothing_read is not None:
            raise self.reader.nothing_read

    def _end(self) -> TranslatableText:
        """Why following ended with a file that has no next one."""
        path = self.reader.path
        if not self._has_lock:
            return TranslatableText(
                "{path}: nothing was written to it for {seconds:g} s", path=path, seconds=IDLE_S
            )
        if self._open_ports:
            return TranslatableText(
                "{path}: the program that recorded it ended without closing {ports}; it was killed"
                " or could not write, and its last rows may be missing",
                path=path,
                ports=listed(sorted(self._open_ports), Joint.AND),
            )
        return TranslatableText("{path}: the program that recorded it has ended", path=path)


def followed(follower: Follower) -> Input:
    """A recording that another program writes; its rows come as they are flushed."""

    def read(span: TimeRange | None, note: Note) -> Iterator[Item]:
        """The items of the file and of the next ones of its capture, until following ends.

        First no rows, so that the caller knows that the file could be opened.
        """
        yield NO_ROWS
        follower.span, follower.note = span or EVERYTHING, note
        try:
            while not follower.stopped and follower.ended is None:
                yield from (items := follower.poll())
                if not items:
                    time.sleep(POLL_S)
        except FileError as error:
            follower.ended = error.message
            raise
        if follower.ended is not None:
            note(follower.ended)

    found = recording_input(follower.reader)
    found.read, found.count = read, None
    return found
