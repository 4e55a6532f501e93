"""Owns the capture process: what it opens, what it obeys, and that it ends well.

It must not know what becomes of the bytes in between, nor what shows the rows. It ends when it is
told to, when its port is lost for good, when its plan is fulfilled, or when nobody listens any
more; in each case the file is closed.
"""

from __future__ import annotations

import signal
import sys
import threading
from collections.abc import Callable
from contextlib import suppress
from multiprocessing.connection import Connection
from pathlib import Path

from fte_sniff.capture.bridge import BridgeSource
from fte_sniff.capture.clock import Clock
from fte_sniff.capture.source import Source
from fte_sniff.errors import FteSniffError
from fte_sniff.recording.metadata import PROGRAM, PortFacts, host_facts
from fte_sniff.recording.recorder import Recorder
from fte_sniff.session.capturing.messages import DROP, STOP, Ended, Message, Started
from fte_sniff.session.capturing.outbox import Outbox
from fte_sniff.session.capturing.plan import CapturePlan
from fte_sniff.session.capturing.run import Run

_SWITCH_EVERY_S = 0.0005
"""How long the thread that frames and records may keep the one that reads from its bytes."""

_DEAF_TO = (signal.SIGINT, signal.SIGTSTP, signal.SIGTTIN, signal.SIGTTOU)
"""What a terminal tells all that runs on it."""

_ENDING_SIGNALS = (signal.SIGTERM, signal.SIGHUP)


def capture(plan: CapturePlan, view: Connection) -> None:
    """Run a capture in this process until it ends, telling the view.

    Args:
        plan: what to do.
        view: where `Message`s go, and where STOP comes from; its end means STOP too.
    """
    # Whoever asks who has the port open shall read a name that says something.
    with suppress(OSError):
        Path("/proc/self/comm").write_text(PROGRAM)
    # Ctrl-C and Ctrl-Z reach every process of the terminal; here only the view decides what they
    # mean. A capture that stood still would lose what comes meanwhile.
    for number in _DEAF_TO:
        signal.signal(number, signal.SIG_IGN)
    sys.setswitchinterval(_SWITCH_EVERY_S)
    clock = Clock.tied()
    try:
        source = plan.wiring.open(clock)
        # Before it passes anything on: what is passed on is recorded, however soon the end comes.
        for number in _ENDING_SIGNALS:
            signal.signal(number, lambda *_: source.stop())
        with source:
            _capture_from(source, plan, clock, view)
    except FteSniffError as error:
        _tell(view, Ended(error=error))


def _capture_from(source: Source, plan: CapturePlan, clock: Clock, view: Connection) -> None:
    if plan.outlives_view:
        # The terminal is gone, and with it the view; that is no reason to end.
        signal.signal(signal.SIGHUP, signal.SIG_IGN)
    if view.poll() and not isinstance(source, BridgeSource):
        # Whatever comes means the end. Nothing was captured yet: no file is made, none replaced.
        # (A bridge may have passed bytes on by now, and all of these are recorded.)
        _tell(view, Ended())
        return
    # From here on an end leaves an empty recording, which is a true one: the port was open, and
    # nothing came.
    recorder = _recorder(plan, _facts(plan, clock, source))
    device = source.device if isinstance(source, BridgeSource) else None
    _tell(view, Started(recorder.path if recorder else None, device))
    when_gone = _go_on if plan.outlives_view else source.stop
    threading.Thread(target=_obey, args=(view, source, when_gone), daemon=True).start()
    outbox = Outbox(view, when_gone)
    ended = Run(plan, clock, source, recorder, outbox).to_the_end()
    # The file is closed: what is left to be told is nothing to hold up a signal for.
    for number in _ENDING_SIGNALS:
        signal.signal(number, signal.SIG_DFL)
    outbox.close(ended)


def _tell(view: Connection, message: Message) -> None:
    with suppress(OSError):  # the view is gone; whoever obeys it learns that too
        view.send(message)


def _facts(plan: CapturePlan, clock: Clock, source: Source) -> dict[str, str]:
    """What the recording says of its capture."""
    facts = host_facts(clock.utc_at_tie_ns) | clock.facts()
    facts["settings"] = str(plan.wiring.settings)
    for number, name in enumerate(plan.wiring.names, 1):
        facts[f"port.{number}.time_uncertainty_ns"] = str(source.uncertainty_ns[name])
        facts[f"port.{number}.granted"] = source.granted[name]
    return facts


def _recorder(plan: CapturePlan, facts: dict[str, str]) -> Recorder | None:
    if plan.recording is None:
        return None
    baud = plan.wiring.settings.baud
    ports = tuple(PortFacts(name, baud) for name in plan.wiring.names)
    select = None
    if plan.trigger is not None:
        from fte_sniff.analysis.filter.row_filter import RowFilter

        select = RowFilter.parse(plan.trigger).select
        facts = facts | {"trigger": plan.trigger}
    return Recorder(
        plan.recording,
        ports,
        facts,
        existing=plan.existing,
        keeping=plan.keeping,
        select=select,
    )


def _obey(view: Connection, source: Source, when_gone: Callable[[], None]) -> None:
    obeyed = {STOP: source.stop, DROP: source.drop}
    try:
        while True:
            obeyed[view.recv()]()
    except (EOFError, OSError):
        when_gone()


def _go_on() -> None:
    """What a capture does about a view that is gone, where it was asked to outlive it."""
