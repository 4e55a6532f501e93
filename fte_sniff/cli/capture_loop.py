"""The loop of a capture: start, wait, report, and end in one order for all observers."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, closing, suppress
from functools import partial
from heapq import merge
from signal import Signals
from typing import TYPE_CHECKING

from fte_sniff.cli.streams import NOT_BEGUN, ending_signals, print_err

if TYPE_CHECKING:
    from fte_sniff.analysis.feed import FeedUpdate
    from fte_sniff.protocol.items import PortEvent
    from fte_sniff.protocol.rows import Row, Rows
    from fte_sniff.session.control import CapturePlan
    from fte_sniff.session.live_session import LiveSession


class Observer:
    """Receives what happens in a capture; this base class does nothing with it."""

    def begun(self, session: LiveSession) -> None:
        """Handle that the port and the recording, if any, are open."""

    def update(self, update: FeedUpdate, session: LiveSession) -> None:
        """Handle rows and events."""

    def ended(self, session: LiveSession) -> None:
        """Handle the end; also called if the capture or another observer failed."""


def in_order(rows: Rows, events: Sequence[PortEvent]) -> Iterator[Row | PortEvent]:
    """Rows and port events merged by their times; each keeps its own order."""
    return merge(rows, events, key=lambda entry: entry.t_ns or 0)


def capture(
    plan: CapturePlan,
    observers: Sequence[Observer],
    numbers: Sequence[Signals],
    show: Callable[[LiveSession], int] | None = None,
) -> int:
    """Run a capture until it ends, or until its end is requested.

    The first observer receives everything first, but the end last: what waits at the end does so
    after all others have printed.

    Args:
        plan: what to capture.
        observers: what is called, in this order.
        numbers: the signals that request the end.
        show: polls the session in place of this function, under signal handlers of its own.

    Returns:
        The exit code of `show`, otherwise 0.

    Raises:
        FteSniffError: the capture failed; everything is closed and reported before.
    """
    from fte_sniff.session.live_session import LiveSession

    def observe(update: FeedUpdate) -> None:
        for one in observers:
            one.update(update, session)

    code = 0
    with ExitStack() as handlers, closing(LiveSession(plan, observe)) as session:
        ending = partial(ending_signals, session.interrupt, numbers)
        handlers.enter_context(ending())
        if show is not None:  # on another core, the capture process starts meanwhile
            import fte_sniff.tui.app  # noqa: F401
        session.begin()
        if not session.capture.started:
            print_err(NOT_BEGUN)
            return 0
        with ExitStack() as ends:
            try:
                for one in observers:
                    ends.callback(one.ended, session)
                    one.begun(session)
                if show is None:
                    _drain(session)
                else:
                    with suppress(KeyboardInterrupt):  # before the screen handles signals
                        handlers.close()
                        code = show(session)
            finally:
                if show is not None:
                    begin_end = handlers.enter_context(ending())
                    begin_end()  # a stopped terminal may not block the exit either
                session.stop()
                _drain(session)
    if session.capture.error is not None:
        raise session.capture.error
    return code


def _drain(session: LiveSession) -> None:
    """Wait until the end; observers receive the rows. Report once what the end waits for."""
    from fte_sniff.session.live_session import WAIT_S

    is_reported = False
    while session.wait(WAIT_S).state.running:
        backlog = session.capture.backlog
        if session.capture.is_ending and backlog is not None and not is_reported:
            is_reported = True
            print_err(f"{backlog}; Ctrl-C drops them")
