"""Serial ports of this machine: which there are, which programs hold them, adapters without driver.

No port is opened.
"""

from __future__ import annotations

import os
import stat
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from serial.tools.list_ports import comports
from serial.tools.list_ports_common import ListPortInfo

from fte_sniff.errors import Joint, TranslatableText, listed, printable
from fte_sniff.platform import POSIX

_BY_ID = Path("/dev/serial/by-id")
_NO_DESCRIPTION = "n/a"  # in pyserial
_SYS_CHAR = Path("/sys/dev/char")
_PTY_MAJORS = range(136, 144)  # pseudo-terminals, which are not in /sys


@dataclass(frozen=True, slots=True)
class Holder:
    """A program that has a device open."""

    pid: int
    name: str

    def __str__(self) -> str:
        return f"{self.name} (pid {self.pid})"


@dataclass(frozen=True, slots=True)
class PortListing:
    """One port as the system describes it; texts from the device are printable."""

    device: str
    by_id: str | None
    """A name that does not depend on the USB socket; None if there is none."""
    vid: int | None
    pid: int | None
    """USB vendor and product id."""
    serial_number: str | None
    location: str | None
    """USB socket, as `1-1.2`."""
    description: str | None
    permitted: bool
    """True if the present user may open it."""
    holders: tuple[Holder, ...]

    @property
    def state(self) -> str:
        """`free`, `busy`, or `forbidden`."""
        if not self.permitted:
            return "forbidden"
        return "busy" if self.holders else "free"

    @property
    def usb_ids(self) -> str | None:
        """Vendor and product id as `0403:6001`; None for other ports than USB."""
        return None if self.vid is None else f"{self.vid:04x}:{self.pid or 0:04x}"


def list_ports() -> list[PortListing]:
    """The ports that are plugged in, sorted by name."""
    return listings(sorted(comports()))


def listings(found: Iterable[ListPortInfo], by_id: Path = _BY_ID) -> list[PortListing]:
    """The listings of ports that pyserial found; `by_id` is the folder of their stable names."""
    return [
        PortListing(
            device=port.device,
            by_id=next(links_to(port.device, by_id), None),
            vid=port.vid,
            pid=port.pid,
            serial_number=_shown(port.serial_number),
            location=_shown(port.location),
            description=None if port.description == _NO_DESCRIPTION else _shown(port.description),
            permitted=not POSIX or os.access(port.device, os.R_OK | os.W_OK),
            holders=tuple(holders_of(port.device)),
        )
        for port in found
    ]


def links_to(device: str, folder: Path) -> Iterator[str]:
    """The links in a folder that lead to a device, sorted."""
    target = os.path.realpath(device)
    return (str(link) for link in sorted(folder.glob("*")) if os.path.realpath(link) == target)


def is_terminal(name: str) -> bool:
    """Whether a name leads to a serial port or a pseudo-terminal."""
    if POSIX:
        try:
            facts = Path(name).stat()
        except (OSError, ValueError):
            return False
        if stat.S_ISCHR(facts.st_mode):
            major, minor = os.major(facts.st_rdev), os.minor(facts.st_rdev)
            subsystem = _SYS_CHAR / f"{major}:{minor}" / "subsystem"
            return major in _PTY_MAJORS or subsystem.resolve().name == "tty"
    return False


def _shown(text: str | None) -> str | None:
    return None if text is None else printable(text)


_PROC = Path("/proc")
_PTY_FOLDER = "/dev/pts/"


def is_pseudo_terminal(name: str) -> bool:
    """Whether a name leads to a pseudo-terminal, be it there or not."""
    return "\0" not in name and os.path.realpath(name).startswith(_PTY_FOLDER)


def holders_of(device: str) -> list[Holder]:
    """The other programs that have `device` open; only programs that this user may inspect.

    The maker of a pseudo-terminal, which has its other end, does not count.
    """
    try:
        facts = Path(device).stat()
    except (OSError, ValueError):
        return []
    number = os.minor(facts.st_rdev) if is_pseudo_terminal(device) else None
    return [
        Holder(pid, printable(text_of(_PROC / str(pid) / "comm")) or "a program")
        for pid in _other_processes()
        if any(os.path.samestat(facts, opened) for opened in open_files(pid).values())
        and (number is None or not _has_other_end(pid, number))
    ]


def _has_other_end(pid: int, number: int) -> bool:
    """Whether a process made the pseudo-terminal of a number, and so has its other end."""
    return any(
        f"tty-index:\t{number}\n" in text_of(file) + "\n"
        for file in (_PROC / str(pid) / "fdinfo").glob("*")
    )


def holders_text(holders: Sequence[Holder]) -> str:
    """`socat (pid 7) has it open`, for one program, several, or none that is visible."""
    if not holders:
        return TranslatableText("this or another program has it open")
    names = listed(holders, Joint.AND)
    if len(holders) > 1:
        return TranslatableText("{programs} have it open", programs=names)
    return TranslatableText("{program} has it open", program=names)


def _other_processes() -> list[int]:
    if not _PROC.is_dir():
        return []
    pids = sorted(int(entry.name) for entry in _PROC.iterdir() if entry.name.isdecimal())
    return [pid for pid in pids if pid != os.getpid()]


def open_files(pid: int) -> dict[str, os.stat_result]:
    """The open files of a process by name; empty if it belongs to another user, or has ended."""
    found = dict[str, os.stat_result]()
    with suppress(OSError), os.scandir(_PROC / str(pid) / "fd") as entries:
        for entry in entries:
            with suppress(OSError):  # closed meanwhile
                found[os.readlink(entry.path)] = entry.stat()  # noqa: PTH115
    return found


_USB_DEVICES = Path("/sys/bus/usb/devices")

_CHIPS = {
    "ftdi_sio": ("0403:6001", "0403:6010", "0403:6011", "0403:6014", "0403:6015"),
    "pl2303": ("067b:2303",),
    "cp210x": ("10c4:ea60", "10c4:ea70"),
    "ch341": ("1a86:5523", "1a86:7522", "1a86:7523"),
    "cdc_acm": ("1a86:55d3", "1a86:55d4"),
}
"""The common adapter chips of each driver of the kernel."""
_DRIVER_OF_CHIP = {usb_ids: driver for driver, chips in _CHIPS.items() for usb_ids in chips}


@dataclass(frozen=True, slots=True)
class StrayAdapter:
    """An adapter that is plugged in, but has no device file."""

    usb_ids: str
    """As `1a86:7523`."""
    product: str
    """Its own name, printable; may be empty."""
    wanted: str
    """The driver that makes it a port."""


def stray_adapters(devices: Path = _USB_DEVICES) -> list[StrayAdapter]:
    """The adapters that are plugged in, but have no device file."""
    if not devices.is_dir():
        return []
    found = (_stray(device) for device in sorted(devices.iterdir()))
    return [stray for stray in found if stray is not None]


def _stray(device: Path) -> StrayAdapter | None:
    usb_ids = f"{text_of(device / 'idVendor')}:{text_of(device / 'idProduct')}"
    wanted = _DRIVER_OF_CHIP.get(usb_ids)
    if wanted is None:
        return None
    # The folder of an interface is named after its device: 1-2 has 1-2:1.0.
    if any(device.glob(f"{device.name}:*/tty*")):
        return None
    return StrayAdapter(usb_ids, printable(text_of(device / "product")), wanted)


def text_of(file: Path) -> str:
    """The text of a file of the system, without white space at its ends; empty if unreadable."""
    try:
        return file.read_text(errors="replace").strip()
    except OSError:
        return ""
