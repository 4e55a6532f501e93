"""List serial ports and USB identities; who holds a port.

It must not open one: looking never disturbs a line.
"""

from __future__ import annotations

import os
import stat
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Protocol

from serial.tools.list_ports import comports
from serial.tools.list_ports_common import ListPortInfo

from fte_sniff.errors import TranslatableText, printable

_PROC = Path("/proc")


@dataclass(frozen=True, slots=True)
class Holder:
    """A program that has a device open."""

    pid: int
    name: str
    """What the program calls itself, made printable."""

    def __str__(self) -> str:
        return f"{self.name} (pid {self.pid})"


def holders_of(device: str) -> list[Holder]:
    """The other programs that have `device` open; empty where there are none or none can be seen.

    This process itself is not among them.
    """
    try:
        wanted = Path(device).stat()
    except (OSError, ValueError):
        return []
    return [
        Holder(pid, _name_of(pid))
        for pid in _others()
        if any((s.st_dev, s.st_ino) == (wanted.st_dev, wanted.st_ino) for s in _open_files(pid))
    ]


def have_open(holders: list[Holder]) -> str:
    """`socat (pid 7) has it open`, for one or several; for none, that nobody can be named."""
    if not holders:
        return TranslatableText("this or another program has it open")
    names = " and ".join(map(str, holders))
    if len(holders) > 1:
        return TranslatableText("{programs} have it open", programs=names)
    return TranslatableText("{program} has it open", program=names)


def sharing_note(device: str | None) -> str:
    """What to add where a port is told to be open: who else has it; empty where nobody has."""
    holders = holders_of(device) if device else []
    if not holders:
        return ""
    names = " and ".join(map(str, holders))
    if len(holders) > 1:
        return TranslatableText(
            "; {programs} have it open too, and may take bytes away", programs=names
        )
    return TranslatableText("; {program} has it open too, and may take bytes away", program=names)


def _others() -> list[int]:
    if not _PROC.is_dir():
        return []
    pids = sorted(int(entry.name) for entry in _PROC.iterdir() if entry.name.isdecimal())
    return [pid for pid in pids if pid != os.getpid()]


def _open_files(pid: int) -> Iterator[os.stat_result]:
    try:
        with os.scandir(_PROC / str(pid) / "fd") as entries:
            for entry in entries:
                yield entry.stat()
    except OSError:
        # It belongs to another user, or has ended meanwhile: nothing can be said about it.
        return


def _name_of(pid: int) -> str:
    try:
        return printable((_PROC / str(pid) / "comm").read_text(errors="replace").strip())
    except OSError:
        return "a program"


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
    return None if text is None else printable(text)


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


USB_DEVICES = Path("/sys/bus/usb/devices")
"""Where the system tells of all that is plugged in."""

DRIVER_OF_CHIP: Mapping[tuple[str, str], str] = MappingProxyType(
    {
        ("0403", "6001"): "ftdi_sio",
        ("0403", "6010"): "ftdi_sio",
        ("0403", "6011"): "ftdi_sio",
        ("0403", "6014"): "ftdi_sio",
        ("0403", "6015"): "ftdi_sio",
        ("067b", "2303"): "pl2303",
        ("10c4", "ea60"): "cp210x",
        ("10c4", "ea70"): "cp210x",
        ("1a86", "5523"): "ch341",
        ("1a86", "7522"): "ch341",
        ("1a86", "7523"): "ch341",
        ("1a86", "55d3"): "cdc_acm",
        ("1a86", "55d4"): "cdc_acm",
    }
)
"""The kernel's driver for the chips that most adapters have, by USB vendor and product id."""


@dataclass(frozen=True, slots=True)
class StrayAdapter:
    """An adapter that is plugged in, and has no device file."""

    usb_ids: str
    """As `1a86:7523`."""
    product: str
    """What it calls itself, made printable; may be empty."""
    wanted: str
    """The driver that would make it a port."""
    driver: str | None
    """What has it instead: `usbfs` is a program; None where nothing has it."""


def stray_adapters(devices: Path = USB_DEVICES) -> list[StrayAdapter]:
    """The adapters that have become no port."""
    if not devices.is_dir():
        return []
    found = (_stray(device) for device in sorted(devices.iterdir()))
    return [stray for stray in found if stray is not None]


def _stray(device: Path) -> StrayAdapter | None:
    vid, pid = _word(device / "idVendor"), _word(device / "idProduct")
    wanted = DRIVER_OF_CHIP.get((vid, pid))
    if wanted is None:
        return None
    # An interface's folder is named after its device: 1-2 has 1-2:1.0.
    interfaces = sorted(device.glob(f"{device.name}:*"))
    if any(_has_port(interface) for interface in interfaces):
        return None
    drivers = [i / "driver" for i in interfaces if (i / "driver").exists()]
    driver = drivers[0].resolve().name if drivers else None
    return StrayAdapter(f"{vid}:{pid}", printable(_word(device / "product")), wanted, driver)


def _has_port(interface: Path) -> bool:
    return any(interface.glob("tty*"))


def _word(file: Path) -> str:
    try:
        return file.read_text(errors="replace").strip()
    except OSError:
        return ""
