"""The feed of a view: rows as they come, and the state of their source."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from fte_sniff.protocol.items import Change, PortEvent
from fte_sniff.protocol.rows import NO_ROWS, Rows


class FeedState(NamedTuple):
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


class FeedUpdate(NamedTuple):
    """What came since the previous poll."""

    state: FeedState
    rows: Rows = NO_ROWS
    """In display order."""
    events: Sequence[PortEvent] = ()
    changes: Sequence[Change] = ()
    """Gaps and baud changes between the rows, by rising index."""
