"""Follow a growing store; gaps and baud changes."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from operator import attrgetter, itemgetter
from typing import TYPE_CHECKING, Final, Protocol, runtime_checkable

from fte_sniff.protocol import Gap, GapKind, PortEvent, PortEventKind
from fte_sniff.protocol.rows import NO_ROWS, Rows

if TYPE_CHECKING:
    from fte_sniff.protocol.rows import Ints

GAP_EVENTS: Final = frozenset(
    {PortEventKind.LOST, PortEventKind.FOUND_AGAIN, PortEventKind.OVERRUN}
)
"""Events at which bytes of a port are missing."""


@dataclass(frozen=True, slots=True)
class BaudChange:
    """From here on a port has another speed."""

    port: str
    baud: int


@dataclass(frozen=True, slots=True)
class StreamChange:
    """A gap or a change of speed between two rows."""

    index: int
    """Of the first row after it, among the rows that it is reported with."""
    what: Gap | BaudChange


def shifted(changes: Iterable[StreamChange], by: int) -> list[StreamChange]:
    """These changes with their indices raised by `by`."""
    return [replace(change, index=change.index + by) for change in changes]


class GapDetector:
    """Detects gaps and baud changes between rows that come in batches."""

    def __init__(self) -> None:
        self._bauds: dict[str, int] = {}
        self._edges: deque[tuple[int, Gap]] = deque()
        """The reported gaps: the first time in each, and the first time after it."""
        self._interruption: Gap | None = None
        self._last_ns: int | None = None
        self._not_shown = 0
        self.lost: set[str] = set()
        """Ports that are lost and were not found again."""
        self.found: set[str] = set()
        """Ports that were found again without having been lost: they were lost before."""

    def begin(self, bauds: Mapping[str, int], gaps: Iterable[Gap] = ()) -> list[StreamChange]:
        """Begin an input, which reports `gaps`; returns the changes before its first row.

        Later changes of the baud are followed only of the ports in `bauds`, bits per second.
        """
        self._edges.clear()
        self.expect(gaps)
        # The next file of a capture names the baud of the beginning, not of the end.
        new = {port: baud for port, baud in bauds.items() if self._bauds.get(port) != baud}
        self._bauds.update(new)
        return [StreamChange(0, BaudChange(port, baud)) for port, baud in new.items()]

    def expect(self, gaps: Iterable[Gap]) -> None:
        """Add gaps that the input reports before their rows."""
        edges = [(t_ns, gap) for gap in gaps for t_ns in _edges(gap)]
        self._edges = deque(sorted([*self._edges, *edges], key=itemgetter(0)))

    def interrupt(self, kind: GapKind, reason: str = "") -> StreamChange:
        """Report that rows are missing before the next ones."""
        port_lost = False if kind is GapKind.OTHER_RECORDING else None
        self._interruption = Gap(kind, reason=reason, port_lost=port_lost)
        return StreamChange(0, self._interruption)

    def observe(self, times: tuple[int, int] | None) -> Gap | None:
        """Rows came: returns the gap that `interrupt` reported, now that both ends are known.

        `times` are those of the first row and the latest one; None if they have no times.
        """
        if times is None:
            return None
        gap, self._interruption = self._interruption, None
        (first_ns, latest_ns), last_ns = times, self._last_ns
        self._last_ns = latest_ns if last_ns is None else max(last_ns, latest_ns)
        if gap is None or last_ns is None or first_ns - last_ns <= 1:
            return None
        return replace(gap, start_ns=last_ns + 1, end_ns=first_ns - 1)

    def changes(
        self, rows: Rows, events: Sequence[PortEvent] = (), not_shown: int = 0
    ) -> list[StreamChange]:
        """The changes before, between and after the next rows, by rising index.

        `events` are the port events of the same time; `not_shown` counts the rows that were left
        out of the view so far, these included.
        """
        found: list[StreamChange] = []
        if not_shown > self._not_shown:
            found.append(StreamChange(0, Gap(GapKind.NOT_SHOWN, not_shown - self._not_shown)))
            self._not_shown = not_shown
        happened = [(event.t_ns, what) for event in events if (what := self._effect(event))]
        if not happened and not self._edges:
            return found
        times = rising_times(rows)
        found += [StreamChange(int(times.searchsorted(t)), what) for t, what in happened]
        while self._edges:
            t_ns, gap = self._edges[0]
            index = int(times.searchsorted(t_ns))
            if index == len(times):
                break
            found.append(StreamChange(index, gap))
            while self._edges and self._edges[0][0] <= times[index]:
                self._edges.popleft()
        return sorted(found, key=attrgetter("index"))

    def _effect(self, event: PortEvent) -> Gap | BaudChange | None:
        if event.kind in GAP_EVENTS:
            t_ns, port = event.t_ns, event.port
            if event.kind is PortEventKind.LOST:
                self.lost.add(port)
            elif event.kind is PortEventKind.FOUND_AGAIN:
                self.found |= {port} - self.lost
                self.lost.discard(port)
            return Gap(GapKind.PORT, None, t_ns, t_ns, event.detail, port, bool(self.lost))
        if event.kind is PortEventKind.BAUD_CHANGED and event.count and event.port in self._bauds:
            return BaudChange(event.port, event.count)
        return None


def _edges(gap: Gap) -> Iterator[int]:
    if gap.start_ns is not None and gap.end_ns is not None:
        yield gap.start_ns
        yield gap.end_ns + 1


def rising_times(rows: Rows, floor_ns: int = -(2**63)) -> Ints:
    """For each row, the latest time up to it, at least `floor_ns`; int64."""
    import numpy as np

    return np.asarray(np.maximum.accumulate(np.maximum(rows.t_ns, floor_ns)))


SPEEDS: Final = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0)


@dataclass(frozen=True, slots=True)
class FeedState:
    """State of the source of the rows, as of one poll."""

    title: str
    """The names of the ports or of the file; text from outside, so show it, never obey it."""
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
    """All rows so far, including those in `not_shown`."""
    not_shown: int = 0
    """Rows that were recorded but not passed to the view, because it was too slow."""
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
    fired: int | None = None
    """How often the trigger of the recording fired; None without one."""


@dataclass(frozen=True, slots=True)
class FeedUpdate:
    """What came since the previous poll."""

    state: FeedState
    rows: Rows = NO_ROWS
    """In display order."""
    events: Sequence[PortEvent] = field(default=())
    changes: Sequence[StreamChange] = field(default=())
    """Gaps and baud changes between the rows, by rising index."""


class Feed(Protocol):
    """A source of rows for a view. Both methods return at once."""

    def poll(self) -> FeedUpdate:
        """What came since the previous poll; never blocks; may be called after the end."""

    def stop(self) -> None:
        """Ask the source to end; a later poll reports the end. Calling it again does nothing."""


@runtime_checkable
class StaticFeed(Protocol):
    """A feed that can pause its reading, which takes processor time from the screen."""

    def rest(self) -> None:
        """Pause reading until the next poll; a read in progress is finished; returns at once."""
