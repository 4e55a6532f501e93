"""Play recorded bytes into a pseudo-terminal, each at its time, for a host program to read."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from typing import Final

from fte_sniff.capture.bridge import HostEnd
from fte_sniff.capture.serial_port import READ_TIMEOUT_S

_SETTLE_S: Final = 0.2
"""How long the system may take to deliver what was written, seconds."""


def play(
    host: HostEnd, timed: Iterable[tuple[float, bytes]], is_stopped: Callable[[], bool]
) -> tuple[int, int]:
    """Write bytes at their times once a program has opened the device, until it has read them.

    Args:
        host: the pseudo-terminal; what the program writes to it is discarded.
        timed: seconds since the first bytes, rising, and the bytes.
        is_stopped: whether to end early.

    Returns:
        The number of bytes that were written, and of those that the program did not read in time.
    """
    while not host.in_use and not is_stopped():
        host.read()
    written = refused = 0
    start_s = time.monotonic()
    for at_s, data in timed:
        while (wait_s := start_s + at_s - time.monotonic()) > 0 and not is_stopped():
            host.read(min(wait_s, READ_TIMEOUT_S))
        if is_stopped():
            break
        left = host.write(data)
        written, refused = written + len(data) - left, refused + left
    end_s = time.monotonic() + _SETTLE_S
    while host.in_use and not is_stopped() and (time.monotonic() < end_s or host.unread):
        host.read()
    return written, refused
