"""Owns what makes a port the same one after it was away: its link, its USB serial or its place.

It must not open anything. A name alone is none: after `/dev/ttyUSB0` was pulled out, another
adapter may be called so, and a pseudo-terminal's number goes to whoever opens one next.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from serial.tools.list_ports_common import ListPortInfo

_PTY_FOLDER = "/dev/pts/"
_SERVERS = ("socket", "rfc2217")


class Identity(Protocol):
    """Tells a port that has come back from any other."""

    def find(self, plugged_in: Iterable[ListPortInfo]) -> str | None:
        """What to open now, given the ports that are plugged in; None while it is away."""
        ...


@dataclass(frozen=True, slots=True)
class SameName:
    """A name that always leads to the same port: a server, a link that udev keeps, a fixed UART."""

    name: str

    def find(self, plugged_in: Iterable[ListPortInfo]) -> str | None:
        """The name; for a device, None while nothing is there."""
        if "://" in self.name or Path(self.name).exists():
            return self.name
        return None


@dataclass(frozen=True, slots=True)
class UsbIdentity:
    """An adapter known by its serial number, or where that tells nothing, by its place."""

    vid: int
    pid: int
    serial_number: str | None
    """None where it has none, or shares it with another adapter that is plugged in."""
    place: str
    """The socket and the hubs that it is behind, as `1-1.2`."""
    interface: str
    """Which port of an adapter that has several, as `1.0`; empty where it has one."""

    def find(self, plugged_in: Iterable[ListPortInfo]) -> str | None:
        """The adapter's device now; None while it is away."""
        return next((port.device for port in plugged_in if self._is(port)), None)

    def _is(self, port: ListPortInfo) -> bool:
        place, interface = _location_of(port)
        if (port.vid, port.pid, interface) != (self.vid, self.pid, self.interface):
            return False
        if self.serial_number is not None:
            return bool(port.serial_number == self.serial_number)
        return place == self.place


def identity_of(
    name: str, device: str | None, plugged_in: Sequence[ListPortInfo]
) -> Identity | None:
    """What a port that is open is to be known by; None where it cannot come back.

    Args:
        name: as it was asked for.
        device: the device file behind it, None where there is none.
        plugged_in: the ports that there are now.
    """
    if device is None:
        return SameName(name) if name.partition("://")[0].lower() in _SERVERS else None
    if "://" not in name and Path(name).is_symlink():
        return SameName(name)
    real = os.path.realpath(device)
    if real.startswith(_PTY_FOLDER):
        return None
    for port in plugged_in:
        if os.path.realpath(port.device) == real and port.vid is not None:
            return _usb_identity(port, plugged_in)
    return SameName(device)


def _usb_identity(port: ListPortInfo, plugged_in: Sequence[ListPortInfo]) -> UsbIdentity:
    place, interface = _location_of(port)
    found = UsbIdentity(port.vid, port.pid, port.serial_number, place, interface)
    if port.serial_number is None or sum(found._is(other) for other in plugged_in) > 1:
        return UsbIdentity(port.vid, port.pid, None, place, interface)
    return found


def _location_of(port: ListPortInfo) -> tuple[str, str]:
    place, _, interface = (port.location or "").partition(":")
    return place, interface
