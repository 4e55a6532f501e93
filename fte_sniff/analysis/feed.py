"""The feed of a view: rows as they come, and the state of their source."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Protocol

from fte_sniff.protocol.items import Change, PortEvent
from fte_sniff.protocol.rows import NO_ROWS, Rows


@dataclass(frozen=True, slots=True)
class FeedState:
    """State of the source of the rows, as of one poll."""

    title: str
    """The names of the ports or of the file; text from outside, so it is only shown."""
    recording: str | None = None
    """The path of the file that is being written; None where nothing is recorded."""
    running: bool = True
    """Whether more rows can come."""
    ended: str | None = None
    """Why it ended, one line for people; None while it runs, or without a reason to show."""
    trouble: str | None = None
    """What went wrong although it runs on, one line for people: the recording has stopped."""
    waiting: bool = False
    """Whether a port is lost, and the source waits for it."""
    rows: int = 0
    """All rows so far."""
    progress: float | None = None
    """How much of a file is read, 0 to 1; None for a live source."""
    live: bool = True
    """Whether rows come as they happen, not from a file."""
    follows: bool = False
    """Whether another program records the rows, and they come from its file."""
    files: Sequence[str] = ()
    """Paths of the files that rows come from or are recorded to."""
    recorded_bytes: int = 0
    """Size of the recording's files."""


@dataclass(frozen=True, slots=True)
class FeedUpdate:
    """What came since the previous poll."""

    state: FeedState
    rows: Rows = NO_ROWS
    """In display order."""
    events: Sequence[PortEvent] = field(default=())
    changes: Sequence[Change] = field(default=())
    """Gaps and baud changes between the rows, by rising index."""


class Feed(Protocol):
    """A source of rows for a view. Both methods return at once."""

    def poll(self) -> FeedUpdate:
        """What came since the previous poll; never blocks; may be called after the end."""

    def stop(self) -> None:
        """Ask the source to end; a later poll reports the end. Calling it again does nothing."""
