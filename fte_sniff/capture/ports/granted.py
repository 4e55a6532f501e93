"""Owns what an open port is asked for before it is read, and what became of it.

It must not read or write a byte of the line.
"""

from __future__ import annotations

from dataclasses import dataclass

import serial

from fte_sniff.capture.ports.latency import LowLatency, ask_low_latency, is_usb, latency_timer_ms
from fte_sniff.capture.ports.line_errors import LineWatch, line_watch_of
from fte_sniff.capture.ports.opening import device_of
from fte_sniff.errors import Said


@dataclass(frozen=True, slots=True)
class Granted:
    """What a port's driver granted."""

    line: LineWatch
    """What knows of the line's errors."""
    low_latency: LowLatency
    timer_ms: int | None
    """The adapter's latency timer, milliseconds; None where it has none."""
    usb: bool

    def __str__(self) -> str:
        low, line = Said(self.low_latency.value), self.line.words
        if self.timer_ms is None:
            return Said("{low_latency}; {line}", low_latency=low, line=line)
        return Said(
            "{low_latency}, latency timer {ms} ms; {line}",
            low_latency=low,
            ms=self.timer_ms,
            line=line,
        )


def ask(port: serial.Serial) -> Granted:
    """Ask for low latency, and for line errors; before anything is read of an open port."""
    low_latency = ask_low_latency(port)
    device = device_of(port)
    return Granted(
        line_watch_of(port),
        low_latency,
        latency_timer_ms(device) if device else None,
        is_usb(device) if device else False,
    )
