"""Follow a growing store; gaps and baud changes."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final, Protocol, TypeAlias, runtime_checkable

import numpy as np

from fte_sniff.analysis.fields import Ints
from fte_sniff.protocol import PortEvent, PortEventKind, Row
from fte_sniff.row_batch import Codebook, PackedRows, pack

BREAKS: Final = frozenset({PortEventKind.LOST, PortEventKind.FOUND_AGAIN, PortEventKind.OVERRUN})
"""Events at which bytes of a port are missing."""


@dataclass(frozen=True, slots=True)
class MissingRows:
    """Rows are missing: nothing is measured across."""

    place: int
    """Of the row behind the seam, among those that it is told with."""
    port: str | None = None
    """On which wire; None on all of them."""


@dataclass(frozen=True, slots=True)
class BaudChange:
    """From here on a port has another speed."""

    place: int
    """Of the first row at that speed, among those that it is told with."""
    port: str
    baud: int


StreamChange: TypeAlias = MissingRows | BaudChange


def shifted(seams: Iterable[StreamChange], by: int) -> list[StreamChange]:
    """The same, where so many rows stand before those that they were told with."""
    return [
        MissingRows(seam.place + by, seam.port)
        if isinstance(seam, MissingRows)
        else BaudChange(seam.place + by, seam.port, seam.baud)
        for seam in seams
    ]


class GapDetector:
    """Finds the seams among rows that come in pieces, by what is told beside them."""

    def __init__(self) -> None:
        """Nothing is known of any port."""
        self._bauds: dict[str, int] = {}
        self._gaps: deque[int] = deque()

    def begin(
        self, bauds: Mapping[str, int], left_out: Iterable[tuple[int, int]] = ()
    ) -> list[StreamChange]:
        """The rows to come are of an input that tells this; the seams before its first row.

        Of ports whose baud was told, later changes of it are followed.

        Args:
            bauds: bits per second by port.
            left_out: from when to when rows came that the input does not hold, nanoseconds since
                1970 UTC.
        """
        ends = (t_ns for first, last in left_out for t_ns in (first, last + 1))
        self._gaps = deque(sorted(ends))
        # What the next file of a capture tells is how it began, not how it went on.
        new = {port: baud for port, baud in bauds.items() if self._bauds.get(port) != baud}
        self._bauds.update(new)
        return [BaudChange(0, port, baud) for port, baud in new.items()]

    def seams(self, rows: Sequence[Row], events: Sequence[PortEvent] = ()) -> list[StreamChange]:
        """Those among the next rows and behind the last of them, rising.

        Args:
            rows: the next rows.
            events: what happened to ports among them.
        """
        told = [(event.t_ns, seam) for event in events for seam in self._of_event(event)]
        if not told and not self._gaps:
            return []
        times = _rising_times(rows)
        found = [
            seam for t_ns, one in told for seam in shifted([one], int(np.searchsorted(times, t_ns)))
        ]
        while self._gaps:
            place = int(np.searchsorted(times, self._gaps[0]))
            if place == len(times):
                break
            found.append(MissingRows(place))
            while self._gaps and self._gaps[0] <= times[place]:
                self._gaps.popleft()
        return sorted(found, key=lambda seam: seam.place)

    def _of_event(self, event: PortEvent) -> Iterable[StreamChange]:
        if event.kind in BREAKS:
            yield MissingRows(0, event.port)
        if event.kind is PortEventKind.BAUD_CHANGED and event.count and event.port in self._bauds:
            yield BaudChange(0, event.port, event.count)


def _rising_times(rows: Sequence[Row]) -> Ints:
    """By row, the latest time up to it: the first row from a time on can be searched for."""
    t_ns = rows.t_ns if isinstance(rows, PackedRows) else pack(rows, Codebook())[0]["t_ns"]
    return np.asarray(np.maximum.accumulate(t_ns.astype(np.int64)))


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
    seams: Sequence[StreamChange] = field(default=())
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
class LiveFeed(Protocol):
    """A feed that need not be polled in vain."""

    @property
    def descriptor(self) -> int:
        """Can be read from when there is something to poll, or the end has come; only for waiting.

        Behind the end it means nothing.
        """
        ...


@runtime_checkable
class StaticFeed(Protocol):
    """A feed whose reading takes processor time that a screen may need for a moment."""

    def rest(self) -> None:
        """Read no more until the next poll, but for what is being read now; returns at once."""
        ...
