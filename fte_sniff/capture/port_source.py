"""Serial ports that are only read: one port, or several."""

from __future__ import annotations

import os
import time
from collections.abc import Iterable, Iterator
from functools import partial
from typing import Final

from fte_sniff.capture.clock import Clock
from fte_sniff.capture.discovery import holders_of, holders_text
from fte_sniff.capture.lasting_name import LastingPort
from fte_sniff.capture.line_errors import LineErrors, counters_of
from fte_sniff.capture.serial_port import (
    device_of,
    max_latency_ns,
    reader_of,
    request_low_latency,
)
from fte_sniff.capture.source import Connection, Reader, Received
from fte_sniff.errors import TranslatableText
from fte_sniff.protocol.items import Chunk, PortEvent, PortEventKind


def connect_port(lasting: LastingPort, clock: Clock) -> Connection:
    """Open a port to read it; raises PortError if it cannot be opened."""
    name, settings, port = lasting.name, lasting.settings, lasting.open()
    device = device_of(port)
    if not settings.share:
        request_low_latency(port)
    errors, read = LineErrors(name, counters_of(port)), reader_of(port)

    def received() -> Iterable[Received]:
        data, now_ns = read(), clock.now_ns()
        chunk = Chunk(name, now_ns, data, errors.came())
        return *errors.report(now_ns), chunk

    def close() -> Iterable[Received]:
        port.close()
        return errors.report(clock.now_ns(), at_end=True)

    readers: list[Reader] = [received]
    if device is not None:
        readers.append(partial(next, holders_coming(name, device, clock)))
    return Connection(
        names=(name,),
        detail=TranslatableText(
            "{settings}; {line}", settings=str(settings), line=errors.description
        ),
        readers=readers,
        close=close,
        place=None if device is None else os.path.realpath(device),
        comes_back=lasting.comes_back,
        uncertainty_ns={name: max_latency_ns(port)},
    )


# Other programs at the same port

_STEP_S: Final = 0.05
_SEARCH_EVERY_S: Final = 4.0
_SEARCH_SHARE: Final = 0.005
"""Share of the time that the search for other programs takes at most."""


def holders_coming(name: str, device: str, clock: Clock) -> Iterator[Iterable[Received]]:
    """Report each program that opens the device beside this one, once, without an end."""
    known = set[int]()
    while True:
        start_s = time.monotonic()
        found = holders_of(device)
        took_s = time.monotonic() - start_s
        if new := [holder for holder in found if holder.pid not in known]:
            detail = TranslatableText(
                "{holders} too, and may take bytes away", holders=holders_text(new)
            )
            yield (PortEvent(clock.now_ns(), name, PortEventKind.SHARED, detail),)
        known = {holder.pid for holder in found}
        while time.monotonic() < start_s + max(_SEARCH_EVERY_S, took_s / _SEARCH_SHARE):
            time.sleep(_STEP_S)
            yield ()
