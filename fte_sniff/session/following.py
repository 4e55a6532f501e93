"""Follow a recording that another program writes, from file to file of its capture.

    is it over? ── grow ── items of the new chunks ── wait, and again ── next file, or the end

The file is polled. Following ends when no writer holds its lock; one whose disk is full holds that
of its last file until it can begin the next one.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from typing import Final

from fte_sniff.errors import FileError, TranslatableText
from fte_sniff.protocol.items import Gap, PortEvent, PortEventKind
from fte_sniff.protocol.rows import NO_ROWS, Item
from fte_sniff.recording.reader import EVERYTHING, Recording, TimeRange
from fte_sniff.session.inputs import Input, Note, beginning_of, note_losses, recording_input

POLL_S: Final = 0.1
"""Interval at which a file is polled by commands that only follow."""

GATHER_S: Final = 0.1
"""Time after rows in which the next ones gather: many small reads take more time than a few."""

RELEASE_S: Final = 1.0
"""How long the next file is waited for: a writer whose last write fails begins one then."""


def grown(
    reader: Recording,
    is_over: Callable[[], bool],
    known: list[Gap],
    poll_s: float = POLL_S,
    span: TimeRange = EVERYTHING,
) -> Iterator[Item]:
    """The items of a file while it grows; no rows each time that all of it was read.

    Args:
        reader: opened as growing.
        is_over: whether nothing is added any more.
        known: gaps that were reported; new ones are added. Each file of a capture reports those of
            the files before it, too.
        poll_s: seconds between two looks at a file to which nothing was added.
        span: only rows in it.

    Raises FileError if the file was deleted, replaced or cut off.
    """
    yield from beginning_of(reader)
    seen, over = 0, False
    while not over:
        over = is_over()  # first: what was flushed before is then complete
        reader.grow(is_over=over and not reader.has_writer)
        chunks = reader.contents.chunks[seen:]
        seen += len(chunks)
        if chunks or over:
            yield from reader.read(chunks, span)
            gaps = [gap for gap in reader.gaps() if gap not in known]
            known += gaps
            yield from gaps
        if not over:
            yield NO_ROWS
            time.sleep(GATHER_S if chunks else poll_s)


class Follower:
    """Follows the files of a capture that another program records."""

    def __init__(self, reader: Recording) -> None:
        """Begin with a file that was opened as growing."""
        self.reader = reader
        self.stopped = self.is_up_to_date = False
        """Whether its end was requested, and whether all that was there at first is read."""
        self.ended: str | None = None
        """Why following ended, one line; None while it goes on."""
        self._open_ports = set[str]()
        """The ports that were opened, and neither closed nor lost."""

    def stop(self) -> None:
        """Request the end of following; may be called in a signal handler."""
        self.stopped = True

    def items(self, span: TimeRange | None, note: Note) -> Iterator[Item]:
        """The items of the file and of the next ones of its capture, until following ends.

        First no rows, so that the caller knows that the file could be opened. `note` is called with
        what is wrong with a file after its last row, and with why following ended. Raises FileError
        if a file was deleted, replaced or cut off, or nothing of it can be read.
        """
        yield NO_ROWS
        wanted, known = span or EVERYTHING, list[Gap]()
        reader: Recording | None = self.reader

        def is_over() -> bool:
            self.stopped |= self.reader.times is not None and self.reader.times[1] >= wanted.end_ns
            return self.stopped or not self.reader.has_writer

        try:
            while reader is not None:
                self.reader = reader
                for item in grown(reader, is_over, known, POLL_S, wanted):
                    self.is_up_to_date |= item is NO_ROWS
                    if isinstance(item, PortEvent):
                        self._observe(item)
                    yield item
                note_losses(reader, note)
                if reader.nothing_read is not None:
                    raise reader.nothing_read
                reader = self._next()
        except FileError as error:
            self.ended = error.message
            raise
        if not self.stopped:
            self.ended = self._end()
            note(self.ended)

    def _observe(self, event: PortEvent) -> None:
        if event.kind in (PortEventKind.OPENED, PortEventKind.FOUND_AGAIN):
            self._open_ports.add(event.port)
        elif event.kind in (PortEventKind.CLOSED, PortEventKind.LOST):
            self._open_ports.discard(event.port)

    def _next(self) -> Recording | None:
        """The next file; a writer with open ports may begin one soon, as after an error."""
        until_s = time.monotonic() + (RELEASE_S if self._open_ports else 0)
        while not self.stopped:
            if (path := self.reader.find_next()) is not None:
                return Recording(path, is_growing=True)
            if time.monotonic() >= until_s:
                break
            time.sleep(POLL_S)
        return None

    def _end(self) -> TranslatableText:
        """Why following ended with a file that has no next one."""
        path = self.reader.path
        if self._open_ports:
            return TranslatableText(
                "{path}: nothing records to it any more, but its ports were not closed: the program"
                " was killed, could not write, or is on another machine",
                path=path,
            )
        return TranslatableText("{path}: the program that recorded it has ended", path=path)


def followed(follower: Follower) -> Input:
    """A recording that another program writes; its rows come as they are flushed."""
    found = recording_input(follower.reader)
    found.read, found.count = follower.items, None
    return found
