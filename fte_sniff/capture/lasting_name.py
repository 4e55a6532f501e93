"""The name by which a lost port is found again, and whether what has the name now is that port.

    URL of a server                             the URL
    a link that the user names                  the link
    an adapter with a serial number of its own  its link in /dev/serial/by-id
    another adapter                             its USB socket: the link in /dev/serial/by-path
    without such links (a container)            the device

The number of a pseudo-terminal is given to the next program that makes one, so it is not evidence:
a pseudo-terminal is found again only by a link that was made anew since.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import serial
from serial.tools.list_ports import comports
from serial.tools.list_ports_common import ListPortInfo

from fte_sniff.capture.discovery import is_pseudo_terminal, links_to
from fte_sniff.capture.serial_port import PortSettings, device_of, open_port
from fte_sniff.capture.url_handlers import is_network
from fte_sniff.errors import PortError, encodable

LINKS: Final = Path("/dev/serial")
"""Where udev makes links to adapters, by their ids and by their sockets."""


class LastingPort:
    """A port that is opened again after each loss."""

    def __init__(self, name: str, settings: PortSettings) -> None:
        """Name the port; nothing is opened."""
        self.name, self.settings = encodable(name), settings
        self._name = name
        """The name to open next."""
        self._made: tuple[int, int] | None = None
        """How the link was made when it was opened."""
        self._was_open = False

    @property
    def comes_back(self) -> bool:
        """Whether its name can lead to it again; known once it was opened."""
        if "://" in self._name:
            return is_network(self._name)
        return os.path.islink(self._name) or not is_pseudo_terminal(self._name)  # noqa: PTH114

    def open(self) -> serial.Serial:
        """Open it, for the first time or again; raises PortError if it is away or refused."""
        is_same = self._was_open and made(self._name) == self._made
        if is_same and is_pseudo_terminal(self._name):
            raise PortError("{port} is away", port=self._name)
        port = open_port(self._name, self.settings)
        if not self._was_open and (device := device_of(port)) is not None:
            self._name = lasting_name(self._name, device, comports())
        self._was_open, self._made = True, made(self._name)
        return port


def made(name: str) -> tuple[int, int] | None:
    """Inode and change time of a link; None for a name that is not a link."""
    facts = os.lstat(name) if os.path.islink(name) else None  # noqa: PTH114
    return facts and (facts.st_ino, facts.st_ctime_ns)


def lasting_name(
    name: str, device: str, plugged_in: Sequence[ListPortInfo], links: Path = LINKS
) -> str:
    """The name to open later, for an open port and the ports that are plugged in now."""
    if "://" not in name and Path(name).is_symlink():
        return name
    folders = ("by-id", "by-path") if _has_own_serial_number(device, plugged_in) else ("by-path",)
    found = (link for folder in folders for link in links_to(device, links / folder))
    return next(found, device)


def _has_own_serial_number(device: str, plugged_in: Sequence[ListPortInfo]) -> bool:
    """Whether an adapter has a serial number that no other one has."""
    own = [port for port in plugged_in if os.path.realpath(port.device) == os.path.realpath(device)]
    if not own or own[0].serial_number is None:
        return False
    ids = own[0].vid, own[0].pid, own[0].serial_number
    # The ports of one adapter share its socket: 1-1.2:1.0 and 1-1.2:1.1.
    sockets = {
        (port.location or "").partition(":")[0]
        for port in plugged_in
        if (port.vid, port.pid, port.serial_number) == ids
    }
    return len(sockets) == 1
