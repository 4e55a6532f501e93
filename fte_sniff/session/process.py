"""Owns the capture process: what it opens, what it obeys, and that it ends well.

It must not know what becomes of the bytes in between, nor what shows the rows. It ends when it is
told to, when its port is lost for good, when its plan is fulfilled, or when nobody listens any
more; in each case the file is closed.
"""

from __future__ import annotations

import signal
import threading
from contextlib import suppress
from multiprocessing.connection import Connection

from fte_sniff.capture.clock import Clock
from fte_sniff.capture.items import Source
from fte_sniff.errors import FteSniffError
from fte_sniff.recording.facts import PortFacts, host_facts
from fte_sniff.recording.writer import RecordingWriter
from fte_sniff.session.messages import STOP, Ended, Message, Started
from fte_sniff.session.outbox import Outbox
from fte_sniff.session.plan import CapturePlan
from fte_sniff.session.run import Run

_ENDING_SIGNALS = (signal.SIGTERM, signal.SIGHUP)


def capture(plan: CapturePlan, view: Connection) -> None:
    """Run a capture in this process until it ends, telling the view.

    Args:
        plan: what to do.
        view: where `Message`s go, and where STOP comes from; its end means STOP too.
    """
    # Ctrl-C reaches every process of the terminal; here only the view decides what it means.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    clock = Clock.tied()
    try:
        with plan.wiring.open(clock) as source:
            _capture_from(source, plan, clock, view)
    except FteSniffError as error:
        _tell(view, Ended(error=error))


def _capture_from(source: Source, plan: CapturePlan, clock: Clock, view: Connection) -> None:
    for number in _ENDING_SIGNALS:
        signal.signal(number, lambda *_: source.stop())
    if view.poll():
        # Whatever comes means the end. Nothing was captured yet: no file is made, none replaced.
        _tell(view, Ended())
        return
    # From here on an end leaves an empty recording, which is a true one: the port was open, and
    # nothing came.
    recorder = _recorder(plan, clock)
    _tell(view, Started(recorder.path if recorder else None))
    threading.Thread(target=_obey, args=(view, source), name="obeys", daemon=True).start()
    outbox = Outbox(view, source.stop)
    ended = Run(plan, source, recorder, outbox).to_the_end()
    # The file is closed: what is left to be told is nothing to hold up a signal for.
    for number in _ENDING_SIGNALS:
        signal.signal(number, signal.SIG_DFL)
    outbox.close(ended)


def _tell(view: Connection, message: Message) -> None:
    with suppress(OSError):  # the view is gone; whoever obeys it learns that too
        view.send(message)


def _recorder(plan: CapturePlan, clock: Clock) -> RecordingWriter | None:
    if plan.recording is None:
        return None
    settings = plan.wiring.settings
    facts = host_facts(clock.utc_at_tie_ns) | clock.facts() | {"settings": str(settings)}
    ports = tuple(PortFacts(name, settings.baud) for name in plan.wiring.names)
    return RecordingWriter(plan.recording, ports, facts, existing=plan.existing)


def _obey(view: Connection, source: Source) -> None:
    try:
        while view.recv() != STOP:
            pass
    except (EOFError, OSError):
        pass  # nobody is there to tell us any more
    source.stop()
