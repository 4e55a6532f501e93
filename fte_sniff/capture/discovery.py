"""Serial ports of this machine: which there are, and which programs hold them.

No port is opened.
"""

from __future__ import annotations

import os
import stat
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

from serial.tools.list_ports import comports
from serial.tools.list_ports_common import ListPortInfo

from fte_sniff.errors import Joint, TranslatableText, listed, printable
from fte_sniff.platform import POSIX

_BY_ID = Path("/dev/serial/by-id")
_SYS_CHAR = Path("/sys/dev/char")
_PTY_MAJORS = range(136, 144)  # pseudo-terminals, which are not in /sys


class Holder(NamedTuple):
    """A program that has a device open."""

    pid: int
    name: str

    def __str__(self) -> str:
        return f"{self.name} (pid {self.pid})"


class PortListing(NamedTuple):
    """One port as the system describes it; texts are printable, and empty if unknown."""

    device: str
    state: str
    """`free`, `busy`, or `forbidden`."""
    held_by: str
    usb_ids: str
    """USB vendor and product id as `0403:6001`."""
    location: str
    """USB socket, as `1-1.2`."""
    serial_number: str
    description: str
    by_id: str
    """A name that does not depend on the USB socket."""


def list_ports() -> list[PortListing]:
    """The ports that are plugged in, sorted by name."""
    return [*map(listing, sorted(comports()))]


def listing(port: ListPortInfo, by_id: Path = _BY_ID) -> PortListing:
    """The listing of a port that pyserial found; `by_id` is the folder of its stable name."""
    holders = holders_of(port.device)
    is_permitted = not POSIX or os.access(port.device, os.R_OK | os.W_OK)
    return PortListing(
        device=port.device,
        state=("busy" if holders else "free") if is_permitted else "forbidden",
        held_by=", ".join(map(str, holders)),
        usb_ids="" if port.vid is None else f"{port.vid:04x}:{port.pid or 0:04x}",
        location=printable(port.location or ""),
        serial_number=printable(port.serial_number or ""),
        description="" if port.vid is None else printable(port.description),
        by_id=next(links_to(port.device, by_id), ""),
    )


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


def text_of(file: Path) -> str:
    """The text of a file of the system, without white space at its ends; empty if unreadable."""
    try:
        return file.read_text(errors="replace").strip()
    except OSError:
        return ""
