"""Reopen a lost port with backoff.

It must not read it, nor say anything about it. Looking and opening happen in a thread of their own,
since opening can take seconds; whoever waits is never held up.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable
from typing import NamedTuple

import serial
from serial.tools.list_ports import comports

from fte_sniff.capture.discovery import have_open, holders_of, identity_of
from fte_sniff.capture.serial_port import PortSettings, device_of, open_port
from fte_sniff.errors import PortError, TranslatableText

FIRST_WAIT_S = 0.25
"""Seconds before it is looked for at first: as long as a system takes to know an adapter."""

LONGEST_WAIT_S = 1.0
"""Seconds between two looks at most; each wait is twice the one before."""

_TOLD_AT = 2
"""How many looks at a port that is back, but cannot be opened, it takes to say so."""

_PTY_FOLDER = "/dev/pts/"


class OpenedPort(NamedTuple):
    """A port that is open."""

    port: serial.Serial
    name: str
    """What it is called now."""


class RefusedError(PortError):
    """The port is back, and cannot be opened all the same."""


Reopen = Callable[[], OpenedPort]
"""Opens a port again; raises PortError where it is not there, RefusedError where it is refused."""


def way_back(name: str, settings: PortSettings, port: serial.Serial) -> Reopen | None:
    """How a port that is open now can be opened again after a loss; None where it never returns.

    A simulated line and a bare pseudo-terminal do not: what is called so later is another one.
    """
    identity = identity_of(name, device_of(port), comports())
    if identity is None:
        return None

    def reopen() -> OpenedPort:
        found = identity.find(comports())
        if found is None:
            raise PortError("{name} is not plugged in", name=name)
        if "://" in found:
            return OpenedPort(open_port(found, settings), found)
        return _open_device(found, settings)

    return reopen


def _open_device(found: str, settings: PortSettings) -> OpenedPort:
    target = os.path.realpath(found)
    if target.startswith(_PTY_FOLDER) and (holders := holders_of(target)):
        # The link may be left behind, and its number have become somebody's terminal.
        raise RefusedError(
            TranslatableText(
                "{target} may be somebody's terminal: {holders}; close that",
                target=target,
                holders=have_open(holders),
            )
        )
    try:
        return OpenedPort(open_port(found, settings), target)
    except PortError as error:
        raise RefusedError(error.message) from error


class Reconnector:
    """Tries to open a port again until that works, or until nobody waits for it any more."""

    def __init__(self, reopen: Reopen, first_wait_s: float = FIRST_WAIT_S) -> None:
        """Begin to look for the port, the first time after so many seconds."""
        self._reopen = reopen
        self._first_wait_s = first_wait_s
        self._found: OpenedPort | None = None
        self._given_up = False
        self._refusals = 0
        self._refusal: str | None = None
        self._changed = threading.Condition()
        threading.Thread(target=self._run, name="waits for a port", daemon=True).start()

    def wait(self, timeout_s: float) -> OpenedPort | None:
        """The open port once it is there; None if it is not within `timeout_s` seconds."""
        with self._changed:
            self._changed.wait_for(lambda: self._found, timeout_s)
            found, self._found = self._found, None
            return found

    def refusal(self) -> str | None:
        """Why the port cannot be opened although it is back, for people; told once, else None."""
        with self._changed:
            refusal, self._refusal = self._refusal, None
            return refusal

    def give_up(self) -> None:
        """Look no further; returns at once. A port that is being opened is closed again."""
        with self._changed:
            self._given_up = True
            self._changed.notify_all()
            if self._found is not None:
                self._found.port.close()

    def _run(self) -> None:
        wait_s = self._first_wait_s
        while not self._gives_up_within(wait_s):
            wait_s = min(2 * wait_s, LONGEST_WAIT_S)
            try:
                opened = self._reopen()
            except PortError as error:
                self._heed(error)
                continue
            with self._changed:
                if self._given_up:
                    opened.port.close()
                self._found = opened
                self._changed.notify_all()
            return

    def _heed(self, error: PortError) -> None:
        if isinstance(error, RefusedError):
            self._refusals += 1
            # At first it may just not be ready: a system takes a moment to set a device up.
            if self._refusals == _TOLD_AT:
                with self._changed:
                    self._refusal = TranslatableText("it is back, but {why}", why=error.message)

    def _gives_up_within(self, seconds: float) -> bool:
        with self._changed:
            return self._changed.wait_for(lambda: self._given_up, seconds)
