"""Owns frames beyond doubt, for tests of what stands before one."""

from __future__ import annotations

from random import Random

from benchmarks.faults import PAYLOADS, draw_frame
from tests.protocol.framer.patterns import DOUBTLESS


def firm(seed: int) -> bytes:
    """A frame beyond doubt, and what must be known behind it."""
    random = Random(seed)
    while True:
        raw = draw_frame(random, PAYLOADS["ordinary"]) + bytes(4)
        if DOUBTLESS.match(raw):
            return raw
