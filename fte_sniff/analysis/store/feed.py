"""Owns what a view asks of whatever brings it rows: a capture that runs, or a file being read.

It must not know where the rows come from, nor what shows them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Protocol, runtime_checkable

from fte_sniff.analysis.store.seams import Seam
from fte_sniff.protocol import PortEvent, Row


@dataclass(frozen=True, slots=True)
class FeedState:
    """How the source of the rows is doing, as of one poll."""

    title: str
    """The names of the ports or of the file; text from outside, so show it, never obey it."""
    recording: str | None = None
    """The path of the file that is being written; None where nothing is recorded."""
    running: bool = True
    """Whether more rows can come."""
    ended: str | None = None
    """Why it ended, one line for people; None while it runs, or where there is nothing to tell."""
    trouble: str | None = None
    """What has gone wrong although it runs on, one line for people: the recording has stopped."""
    waiting: bool = False
    """Whether a port is lost at present, and waited for."""
    rows: int = 0
    """All rows that came so far, those included that were not handed over."""
    not_shown: int = 0
    """Rows that were recorded but not handed over, because the view was too slow for them."""
    leftover: int = 0
    """Bytes that waited to be written when the reading ended, where these are many."""
    progress: float | None = None
    """How much of a file is read, 0 to 1; None where that means nothing."""
    live: bool = True
    """Whether rows come as they happen; otherwise they are read from what is there already."""
    files: Sequence[str] = ()
    """Paths of the files that rows come from or are recorded to."""


@dataclass(frozen=True, slots=True)
class FeedUpdate:
    """What came since the poll before."""

    state: FeedState
    rows: Sequence[Row] = field(default=())
    """In the order in which they are to be shown."""
    events: Sequence[PortEvent] = field(default=())
    seams: Sequence[Seam] = field(default=())
    """What stands between the rows, or behind the last of them; rising."""


class Feed(Protocol):
    """A source of rows for a view. Both methods return at once."""

    def poll(self) -> FeedUpdate:
        """What came since the poll before; never blocks, and may be asked after the end too."""
        ...

    def stop(self) -> None:
        """Ask the source to end; later polls tell when it has. Asking twice is asking once."""
        ...


@runtime_checkable
class WakingFeed(Protocol):
    """A feed that need not be polled in vain."""

    @property
    def descriptor(self) -> int:
        """Can be read from when there is something to poll, or the end has come; only for waiting.

        Behind the end it means nothing.
        """
        ...


@runtime_checkable
class RestingFeed(Protocol):
    """A feed whose reading takes processor time that a screen may need for a moment."""

    def rest(self) -> None:
        """Read no more until the next poll, but for what is being read now; returns at once."""
        ...
