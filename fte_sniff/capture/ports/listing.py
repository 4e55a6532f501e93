"""Owns the list of serial ports that are plugged in, and what the system knows of each.

It must not open one: looking never disturbs a line.
"""

from __future__ import annotations

import os
import stat
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from serial.tools.list_ports import comports
from serial.tools.list_ports_common import ListPortInfo

from fte_sniff.capture.ports.holders import Holder, holders_of
from fte_sniff.errors import shown

_BY_ID = Path("/dev/serial/by-id")
_SYS_TTY = Path("/sys/class/tty")
_SERIAL_BASE = "serial-base"
"""The bus of Linux between a port and its device; its drivers say nothing about either."""
_NOTHING_SAID = "n/a"
"""What pyserial puts where a device says nothing."""
_SYS_CHAR = Path("/sys/dev/char")
_PTY_MAJORS = range(136, 144)
"""Device numbers of pseudo-terminals, which the system tells nothing else of."""


@dataclass(frozen=True, slots=True)
class PortListing:
    """One port as the system knows it; texts from the device are made printable."""

    device: str
    """The device file."""
    by_id: str | None
    """A name that stays the same wherever the adapter is plugged in; None where there is none."""
    vid: int | None
    """USB vendor id."""
    pid: int | None
    """USB product id."""
    serial_number: str | None
    """USB serial number."""
    location: str | None
    """Where it is plugged in, as `1-1.2`."""
    description: str | None
    """What the device says it is; None where it says nothing."""
    driver: str | None
    """The kernel's driver, as `ftdi_sio`."""
    permitted: bool
    """Whether the present user may open it."""
    holders: tuple[Holder, ...]
    """Who has it open, as far as can be seen."""

    @property
    def state(self) -> str:
        """Whether it can be opened: `free`, `busy`, or `forbidden`."""
        if not self.permitted:
            return "forbidden"
        return "busy" if self.holders else "free"

    @property
    def usb_ids(self) -> str | None:
        """Vendor and product id as people write them, `0403:6001`; None where it is no USB port."""
        return None if self.vid is None else f"{self.vid:04x}:{self.pid or 0:04x}"


def list_ports() -> list[PortListing]:
    """The ports that are plugged in, in the order of their names."""
    return listings(sorted(comports()))


def listing_of(name: str) -> PortListing | None:
    """What there is to say of one port by any of its names; None where it is no terminal device."""
    if not _is_terminal(name):
        return None
    device = os.path.realpath(name)
    found = [port for port in comports() if os.path.realpath(port.device) == device]
    return listings(found or [ListPortInfo(device)])[0]


def _is_terminal(name: str) -> bool:
    try:
        facts = Path(name).stat()
    except (OSError, ValueError):
        return False
    if not stat.S_ISCHR(facts.st_mode):
        return False
    major, minor = os.major(facts.st_rdev), os.minor(facts.st_rdev)
    subsystem = _SYS_CHAR / f"{major}:{minor}" / "subsystem"
    return major in _PTY_MAJORS or subsystem.resolve().name == "tty"


def listings(found: Iterable[ListPortInfo], by_id: Path = _BY_ID) -> list[PortListing]:
    """What there is to say about ports that were found; links to them are looked for in `by_id`."""
    links = _links_in(by_id)
    return [_listing(port, links.get(os.path.realpath(port.device))) for port in found]


def _listing(port: ListPortInfo, by_id: str | None) -> PortListing:
    return PortListing(
        device=port.device,
        by_id=by_id,
        vid=port.vid,
        pid=port.pid,
        serial_number=_shown(port.serial_number),
        location=_shown(port.location),
        description=None if port.description == _NOTHING_SAID else _shown(port.description),
        driver=_driver_of(port.device),
        permitted=os.access(port.device, os.R_OK | os.W_OK),
        holders=tuple(holders_of(port.device)),
    )


def _shown(text: str | None) -> str | None:
    return None if text is None else shown(text)


def _links_in(folder: Path) -> dict[str, str]:
    """From the device file to its link in `folder`."""
    if not folder.is_dir():
        return {}
    return {os.path.realpath(link): str(link) for link in sorted(folder.iterdir(), reverse=True)}


def _driver_of(device: str) -> str | None:
    place = (_SYS_TTY / Path(device).name / "device").resolve()
    while (driver := place / "driver").exists():
        found = driver.resolve()
        if found.parent.parent.name != _SERIAL_BASE:
            return found.name
        place = place.parent
    return None
