"""Owns `live` without a screen: rows as lines on standard output, all else on standard error.

It must not know how a capture runs or what a line looks like.
"""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Callable, Iterator, Sequence

from fte_sniff.analysis.counters import Tally
from fte_sniff.analysis.feed import FeedUpdate
from fte_sniff.cli.outputs.summary import summary
from fte_sniff.cli.streams.stdout import abandon_stdout
from fte_sniff.cli.streams.telling import nobody_reads, tell
from fte_sniff.errors import FteSniffError
from fte_sniff.formats.writers import OutputFormat, row_writer
from fte_sniff.protocol import PortEvent, PortEventKind, Row
from fte_sniff.session.live_session import LOOK_EVERY_S, LiveSession

_AS_EXPECTED = frozenset({PortEventKind.OPENED, PortEventKind.CLOSED})


class PlainLines:
    """Prints what comes from a capture, and counts it."""

    def __init__(
        self, select: Callable[[Sequence[Row]], list[Row]], *, ports: bool = False
    ) -> None:
        """Print to standard output the rows that `select` picks; with `ports`, whence they came."""
        self._select = select
        self._writer = row_writer(OutputFormat.TABLE, sys.stdout, ports=ports)
        self._tally = Tally()
        self._events: Counter[PortEventKind] = Counter()
        self._failure: FteSniffError | None = None
        self._recording: str | None = None
        self._not_shown = 0
        self._leftover = _Leftover()

    def take(self, update: FeedUpdate, failure: FteSniffError | None) -> None:
        """Print an update, and what went wrong with the capture, once.

        Raises:
            OSError: standard output cannot be written.
        """
        for event in update.events:
            self._take_event(event)
        if update.state.running:
            self._take_trouble(failure, update.state.recording)
            self._leftover.take(update)
        self._not_shown = update.state.not_shown
        self._tally.add(update.rows)
        self._writer.write(self._select(update.rows))
        sys.stdout.flush()

    def end(self) -> None:
        """Say what came."""
        if self._events:
            kinds = ", ".join(f"{kind} {count:,}" for kind, count in self._events.items())
            tell(f"port events: {kinds}")
        if self._not_shown:
            tell(f"{self._not_shown:,} rows more came too fast to be printed")
        tell(summary(self._tally))

    def _take_trouble(self, failure: FteSniffError | None, recording: str | None) -> None:
        """Say that the recording has stopped, and that it goes on; each once."""
        if failure is not None and str(failure) != str(self._failure):
            self._failure, self._recording = failure, None
            tell(str(failure))
        if self._failure is not None and recording and recording != self._recording:
            self._recording = recording
            tell(f"recording goes on in {recording}")

    def _take_event(self, event: PortEvent) -> None:
        if event.kind not in _AS_EXPECTED:
            self._events[event.kind] += 1
            detail = f": {event.detail}" if event.detail else ""
            tell(f"{event.port} {event.kind.replace('_', ' ')}{detail}")


def print_lines(
    session: LiveSession, select: Callable[[Sequence[Row]], list[Row]], *, ports: bool
) -> None:
    """Print what a session that has begun captures, until it ends or nobody reads."""
    lines = PlainLines(select, ports=ports)
    try:
        for update in _updates(session):
            lines.take(update, session.told.error)
    except BrokenPipeError:
        abandon_stdout()
    finally:
        see_out(session)
    lines.end()


def tell_troubles(session: LiveSession) -> None:
    """Print no rows, only what goes wrong, until the session ends; a lost recording ends it."""
    lines = PlainLines(lambda _: [])
    try:
        for update in _updates(session):
            gone = session.told.recording is None and nobody_reads(sys.stdout.fileno())
            lines.take(update, None if gone else session.told.error)
            if session.told.recording is None:
                session.stop()
    finally:
        see_out(session)
    lines.end()


def see_out(session: LiveSession, seen: Sequence[Tally] = ()) -> None:
    """End a session, wait for its end, and say what that has to wait for; rows are not printed.

    They are counted with those that were `seen` on a screen, of which is said then what came.
    """
    session.stop()
    leftover, not_shown = _Leftover(), 0
    for update in _updates(session):
        leftover.take(update)
        not_shown = update.state.not_shown
        for tally in seen:
            tally.add(update.rows)
    session.close()
    for tally in seen:
        if not_shown:
            tell(f"{not_shown:,} rows more came too fast to be shown")
        tell(summary(tally))


class _Leftover:
    """Says, once, that much waits to be written at the end."""

    _told = False

    def take(self, update: FeedUpdate) -> None:
        count = update.state.leftover
        if update.state.running and count and not self._told:
            self._told = True
            tell(f"writing what has arrived: {count:,} bytes wait; Ctrl-C drops them")


def _updates(session: LiveSession) -> Iterator[FeedUpdate]:
    """What the session hands over, until it has ended."""
    running = True
    while running:
        update = session.wait(LOOK_EVERY_S)
        running = update.state.running
        yield update
