"""Owns what can be wrong with one port: before it is opened, and as it was granted.

It must not open it.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from fte_sniff.capture.checks.finding import Finding, bad, ok, warn
from fte_sniff.capture.checks.machine import MEDDLERS, usb_buffering
from fte_sniff.capture.ports.granted import Granted
from fte_sniff.capture.ports.holders import Holder
from fte_sniff.capture.ports.latency import SHORT_TIMER_MS, USB_SERIAL, LowLatency, latency_timer_ms
from fte_sniff.capture.ports.line_errors import UNAVAILABLE
from fte_sniff.capture.ports.listing import PortListing
from fte_sniff.capture.ports.permission import way_in


def device_findings(port: PortListing) -> Iterator[Finding]:
    """What can be told of a port that is not open."""
    if port.permitted:
        yield ok(port.device, "you may open it")
    else:
        yield bad(port.device, "no permission", way_in(port.device))
    timer = latency_timer_ms(port.device)
    if timer is not None and timer > SHORT_TIMER_MS:
        yield ok(port.device, f"latency timer {timer} ms, until live asks for low latency")
    if port.vid is not None:
        buffering = usb_buffering(port.device)
        if buffering is not None:
            yield buffering


def holder_findings(port: PortListing) -> Iterator[Finding]:
    """That other programs have a port open."""
    for holder in port.holders:
        what = f"{holder} has it open, and takes bytes away"
        yield bad(port.device, what, _letting_go(port.device, holder))


def _letting_go(device: str, holder: Holder) -> str:
    if holder.name.endswith("getty"):
        return f"sudo systemctl stop serial-getty@{Path(device).name}.service"
    return MEDDLERS.get(holder.name, f"end it there, or: kill {holder.pid}")


def granted_findings(device: str, granted: Granted) -> Iterator[Finding]:
    """What a port's driver granted when it was opened."""
    timer = granted.timer_ms
    if timer is not None and timer > SHORT_TIMER_MS:
        yield warn(
            device,
            f"the adapter holds bytes back for up to {timer} ms",
            f"echo 1 | sudo tee {USB_SERIAL / Path(device).resolve().name}/latency_timer",
        )
    elif granted.low_latency is LowLatency.REFUSED:
        yield warn(device, str(granted.low_latency), f"sudo setserial {device} low_latency")
    else:
        held = "" if timer is None else f", latency timer {timer} ms"
        yield ok(device, f"{granted.low_latency}{held}")
    if granted.usb and granted.line.words == UNAVAILABLE:
        what = f"{granted.line.words}: damage shows in the frames alone"
        yield warn(device, what, "use an adapter whose driver tells them (FTDI, CP210x)")
    else:
        yield ok(device, granted.line.words)
