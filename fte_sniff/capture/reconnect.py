"""Reopen a lost port: recognize it when it comes back, and retry with exponential backoff.

Searching and opening run in a separate thread, because opening can take seconds.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Container, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple, Protocol, TypeAlias, TypeGuard

import serial
from serial.tools.list_ports import comports
from serial.tools.list_ports_common import ListPortInfo

from fte_sniff.capture.discovery import holders_of, holders_text
from fte_sniff.capture.serial_port import PortSettings, device_of, open_port
from fte_sniff.capture.url_handlers import url_scheme
from fte_sniff.errors import PortError, TranslatableText
from fte_sniff.platform import POSIX

FIRST_WAIT_S = 0.25
"""Seconds before the first attempt: a system needs this long to detect an adapter."""

LONGEST_WAIT_S = 1.0
"""Longest time between two attempts; each wait is twice the one before."""

# The refused attempt that is reported; at the first, udev may just not be finished.
_REPORTED_REFUSAL = 2

PTY_FOLDER = "/dev/pts/"


class Closable(Protocol):
    """What a source reads: a port, or a program that watches one."""

    def close(self) -> object:
        """End it."""


class OpenedPort(NamedTuple):
    """A port that is open again."""

    port: Any
    """Of the kind that the source reads."""
    name: str


class RefusedError(PortError):
    """The port is back, but it cannot be opened."""


Reopen: TypeAlias = Callable[[], OpenedPort]
"""Opens a port again. Raises PortError if it is away, RefusedError if it cannot be opened."""


class Reconnector:
    """Thread that tries to reopen a port until it succeeds or is cancelled."""

    def __init__(self, reopen: Reopen, first_wait_s: float = FIRST_WAIT_S) -> None:
        self._reopen = reopen
        self._first_wait_s = first_wait_s
        self._opened: OpenedPort | None = None
        self._cancelled = False
        self._refusal: str | None = None
        self._changed = threading.Condition()
        threading.Thread(target=self._run, name="waits for a port", daemon=True).start()

    def wait(self, timeout_s: float) -> OpenedPort | None:
        """Return the open port; None if it is not open within `timeout_s` seconds."""
        with self._changed:
            self._changed.wait_for(lambda: self._opened, timeout_s)
            opened, self._opened = self._opened, None
            return opened

    def refusal(self) -> str | None:
        """Why the port is back but cannot be opened; returned once, else None."""
        with self._changed:
            refusal, self._refusal = self._refusal, None
            return refusal

    def cancel(self) -> None:
        """Stop trying; returns at once. A port that is just being opened is closed again."""
        with self._changed:
            self._cancelled = True
            self._changed.notify_all()
            if self._opened is not None:
                self._opened.port.close()

    def _run(self) -> None:
        wait_s, refusals = self._first_wait_s, 0
        while not self._cancelled_within(wait_s):
            wait_s = min(2 * wait_s, LONGEST_WAIT_S)
            try:
                opened = self._reopen()
            except RefusedError as error:
                refusals += 1
                if refusals == _REPORTED_REFUSAL:
                    with self._changed:
                        self._refusal = TranslatableText("it is back, but {why}", why=error.message)
            except PortError:
                continue
            else:
                with self._changed:
                    if self._cancelled:
                        opened.port.close()
                    self._opened = opened
                    self._changed.notify_all()
                return

    def _cancelled_within(self, seconds: float) -> bool:
        with self._changed:
            return self._changed.wait_for(lambda: self._cancelled, seconds)


def reopener(name: str, settings: PortSettings, port: serial.Serial) -> Reopen | None:
    """A function that reopens a port after a loss; None if the port cannot come back.

    A simulated line and a bare pseudo-terminal cannot: a later one of the same name is another.
    """
    device = device_of(port)
    identity = identity_of(name, device, comports())
    if identity is None:
        return None
    # socat has both ends of its pseudo-terminal open; one that is started again has another number.
    known = {one.name for one in holders_of(device)} if _is_pty(device) else set()

    def reopen() -> OpenedPort:
        found = identity.find(comports())
        if found is None:
            raise PortError("{name} is not plugged in", name=name)
        if "://" in found:
            return OpenedPort(open_port(found, settings), found)
        return _open_device(found, settings, known)

    return reopen


def _is_pty(device: str | None) -> TypeGuard[str]:
    return device is not None and os.path.realpath(device).startswith(PTY_FOLDER)


def _open_device(found: str, settings: PortSettings, known: Container[str]) -> OpenedPort:
    """Open a device; `known` are programs that may have it open if it is a pseudo-terminal."""
    target = os.path.realpath(found)
    holders = holders_of(target) if _is_pty(target) else []
    if holders := [one for one in holders if one.name not in known]:
        # A stale link: the number may belong to a user's terminal by now.
        raise RefusedError(
            TranslatableText(
                "{target} may be in use as a terminal: {holders}; close that",
                target=target,
                holders=holders_text(holders),
            )
        )
    try:
        return OpenedPort(open_port(found, settings), target)
    except PortError as error:
        raise RefusedError(error.message) from error


@dataclass(frozen=True, slots=True)
class SameName:
    """A name that always leads to the same port: a server, a link of udev, a fixed UART."""

    name: str

    def find(self, plugged_in: Iterable[ListPortInfo]) -> str | None:
        """The name; None while the device does not exist."""
        if "://" in self.name or Path(self.name).exists():
            return self.name
        if not POSIX and any(port.device == self.name for port in plugged_in):  # COM3 is not a file
            return self.name
        return None


@dataclass(frozen=True, slots=True)
class UsbIdentity:
    """A USB adapter, recognized by its serial number or, without one, by its USB location."""

    vid: int
    pid: int
    serial_number: str | None
    """None if it has none, or shares it with another adapter that is plugged in."""
    location: str
    """The hubs and the socket, as `1-1.2`."""
    interface: str
    """Which port of a multi-port adapter, as `1.0`; empty for a single port."""

    def find(self, plugged_in: Iterable[ListPortInfo]) -> str | None:
        """The adapter's device now; None while it is away."""
        return next((port.device for port in plugged_in if self._matches(port)), None)

    def _matches(self, port: ListPortInfo) -> bool:
        location, interface = _location_of(port)
        if (port.vid, port.pid, interface) != (self.vid, self.pid, self.interface):
            return False
        if self.serial_number is not None:
            return bool(port.serial_number == self.serial_number)
        return location == self.location


Identity: TypeAlias = SameName | UsbIdentity
"""Recognizes a port that has come back; its `find` returns what to open then."""


def identity_of(
    name: str, device: str | None, plugged_in: Sequence[ListPortInfo]
) -> Identity | None:
    """How to recognize an open port later among the `plugged_in`; None if it cannot come back."""
    if device is None:
        return SameName(name) if url_scheme(name).comes_back else None
    if "://" not in name and Path(name).is_symlink():
        return SameName(name)
    real = os.path.realpath(device)
    if _is_pty(real):
        return None
    for port in plugged_in:
        if os.path.realpath(port.device) == real and port.vid is not None:
            return _usb_identity(port, plugged_in)
    return SameName(device)


def _usb_identity(port: ListPortInfo, plugged_in: Sequence[ListPortInfo]) -> UsbIdentity:
    location, interface = _location_of(port)
    found = UsbIdentity(port.vid, port.pid, port.serial_number, location, interface)
    if port.serial_number is None or sum(found._matches(other) for other in plugged_in) > 1:
        return UsbIdentity(port.vid, port.pid, None, location, interface)
    return found


def _location_of(port: ListPortInfo) -> tuple[str, str]:
    location, _, interface = (port.location or "").partition(":")
    return location, interface
