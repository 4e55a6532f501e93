"""Checks of machine, device and line for `doctor`.

It must not open a port. All is read below one root, so that any machine can be looked at.
"""

from __future__ import annotations

import ctypes
import termios
import time
from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Self

from fte_sniff.capture.discovery import Holder, PortListing, StrayAdapter, stray_adapters
from fte_sniff.capture.port_errors import one_line, way_in
from fte_sniff.capture.serial_port import (
    SHORT_TIMER_MS,
    USB_SERIAL,
    LowLatency,
    PortCapabilities,
    PortSettings,
    Read,
    ask,
    latency_timer_ms,
    open_port,
    reader_of,
)
from fte_sniff.capture.uart_errors import UNAVAILABLE
from fte_sniff.errors import PortError, printable
from fte_sniff.protocol import LineErrorCounts


class Level(StrEnum):
    """How bad it is."""

    OK = "ok"
    WARN = "warn"
    """It works, but could be better."""
    BAD = "bad"
    """It does not work, or what is recorded will not be true."""


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing that was looked at."""

    level: Level
    about: str
    """The port, or the part of the machine."""
    what: str
    """One line for people; may hold text from outside, so show it, never obey it."""
    way_out: str | None = None
    """What mends it: a command to be typed as it stands, or what to do by hand."""


def ok(about: str, what: str) -> Finding:
    """All is well."""
    return Finding(Level.OK, about, what)


def warn(about: str, what: str, way_out: str) -> Finding:
    """It could be better."""
    return Finding(Level.WARN, about, what, way_out)


def bad(about: str, what: str, way_out: str) -> Finding:
    """It is wrong."""
    return Finding(Level.BAD, about, what, way_out)


_ROOT = Path("/")
_TIME_ERROR = 5
"""What adjtimex returns while nothing keeps the clock right."""
_TIMEX_SIZE = 512
"""More bytes than a `struct timex` has."""

MEDDLERS = {
    "ModemManager": "sudo systemctl disable --now ModemManager",
    "brltty": "sudo systemctl mask --now brltty-udev.service brltty.service, then plug it in again",
}
"""Programs that open adapters on their own account, and what makes each let go."""


class HostFacts(StrEnum):
    """What kind of machine this is, as far as devices go."""

    METAL = "a machine of its own"
    CONTAINER = "a container"
    WSL = "WSL"
    VIRTUAL = "a virtual machine"


def host_of(root: Path = _ROOT) -> HostFacts:
    """What kind of machine this is; a container in a virtual machine is a container."""
    if "microsoft" in _text(root / "proc/version").lower():
        return HostFacts.WSL
    marks = (root / ".dockerenv", root / "run/.containerenv")
    if any(mark.exists() for mark in marks) or _in_container_group(root):
        return HostFacts.CONTAINER
    return HostFacts.VIRTUAL if is_virtual(root) else HostFacts.METAL


def is_virtual(root: Path = _ROOT) -> bool:
    """Whether a hypervisor is below this system."""
    flags = next(
        (line for line in _text(root / "proc/cpuinfo").splitlines() if line.startswith("flags")), ""
    )
    return "hypervisor" in flags.split()


def missing_adapter_hint(host: HostFacts) -> str:
    """What to do where an adapter is plugged in and this machine does not see it."""
    return {
        HostFacts.CONTAINER: "give it to the container: docker run --device /dev/ttyUSB0 ...",
        HostFacts.WSL: "in Windows: usbipd list, then usbipd attach --wsl --busid <its BUSID>",
        HostFacts.VIRTUAL: "hand the USB adapter on to the virtual machine, in its settings",
        HostFacts.METAL: "plug the adapter in, and see what the system says: sudo dmesg | tail",
    }[host]


def stray_finding(stray: StrayAdapter, root: Path = _ROOT) -> Finding:
    """Why an adapter that is plugged in is no port."""
    name = f"USB {stray.usb_ids}"
    what = f"{stray.product or 'a serial adapter'} is plugged in, but is no port"
    if "brltty" in running(root):
        return bad(name, f"{what}: brltty takes it for a Braille display", MEDDLERS["brltty"])
    if stray.driver is None:
        return bad(name, f"{what}: its driver is not loaded", f"sudo modprobe {stray.wanted}")
    return bad(name, f"{what}: {stray.driver} has it", f"unplug it, sudo modprobe {stray.wanted}")


def machine_findings(root: Path = _ROOT) -> Iterator[Finding]:
    """All that the machine says, but for its clock."""
    for stray in stray_adapters(root / "sys/bus/usb/devices"):
        yield stray_finding(stray, root)
    programs = running(root)
    for name in sorted(MEDDLERS.keys() & programs):
        what = f"{name} runs: it opens new adapters for some seconds, and writes to them"
        yield warn("machine", what, MEDDLERS[name])
    if not MEDDLERS.keys() & programs:
        yield ok("machine", "no program runs that is known to take adapters away")


def usb_buffering(device: str, root: Path = _ROOT) -> Finding | None:
    """That a hypervisor stands between a USB port and this system, if one does."""
    if not is_virtual(root):
        return None
    return warn(
        device,
        "a virtual machine hands on USB in lumps: times can be late by tens of milliseconds",
        "capture on the host, or serve the port from there: "
        f"socat TCP-LISTEN:4001,reuseaddr {device},raw,b115200",
    )


def clock_finding(state: int | None) -> Finding:
    """What the system says of its clock, as `clock_state` gives it."""
    if state is None:
        return ok("clock", "this system does not say whether it is kept right")
    if state == _TIME_ERROR:
        what = "nothing keeps the system's clock right: the times of recordings may be off"
        return warn("clock", what, "sudo timedatectl set-ntp true (outside of containers)")
    return ok("clock", "kept right by the network")


def clock_state() -> int | None:
    """What adjtimex returns, asked without changing anything; None where there is no such call."""
    try:
        adjtimex = ctypes.CDLL(None, use_errno=True).adjtimex
    except (OSError, AttributeError):
        return None
    state = int(adjtimex(ctypes.create_string_buffer(_TIMEX_SIZE)))
    return None if state < 0 else state


def running(root: Path = _ROOT) -> frozenset[str]:
    """The names of the programs that run."""
    return frozenset(_text(file).strip() for file in (root / "proc").glob("[0-9]*/comm"))


def _in_container_group(root: Path) -> bool:
    groups = _text(root / "proc/1/cgroup")
    return any(word in groups for word in ("docker", "lxc", "kubepods"))


def _text(file: Path) -> str:
    try:
        return file.read_text(errors="replace")
    except OSError:
        return ""


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


def granted_findings(device: str, granted: PortCapabilities) -> Iterator[Finding]:
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


_SETTLE_S = 0.05
"""After another baud was set, seconds until what still comes was heard at that baud."""

_NEVER_ENOUGH = 2**63


@dataclass(frozen=True, slots=True)
class LineSample:
    """What came while a port was listened to."""

    data: bytes
    line_errors: LineErrorCounts


class LineListener:
    """An open port that is listened to now and then."""

    def __init__(self, name: str, settings: PortSettings) -> None:
        """Open the port, and ask it for what a capture would ask it for.

        Raises:
            PortError: the port cannot be opened.
        """
        self._name = name
        self._port = open_port(name, settings)
        self.granted: PortCapabilities = ask(self._port)
        self._read: Read = reader_of(self._port)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        self._port.close()

    def listen(self, seconds: float, enough: int) -> LineSample:
        """What comes within so many seconds, or until there are `enough` bytes.

        Raises:
            PortError: the port was lost.
        """
        data = bytearray()
        line = self.granted.line
        deadline = time.monotonic() + seconds
        while len(data) < enough and time.monotonic() < deadline:
            data += line.take(self._take())[0]
        return LineSample(bytes(data), line.rest() or LineErrorCounts())

    def sample(self, baud: int, seconds: float, enough: int) -> bytes | None:
        """As `listen`, at another baud, without line errors; None where it cannot be set.

        The port stays at that baud.

        Raises:
            PortError: the port was lost.
        """
        try:
            # pyserial also takes back that errors are to be marked.
            self._port.baudrate = baud
        except (OSError, ValueError, termios.error):
            return None
        self._collect(_SETTLE_S, _NEVER_ENOUGH)
        return self._collect(seconds, enough)

    def _collect(self, seconds: float, enough: int) -> bytes:
        data = bytearray()
        deadline = time.monotonic() + seconds
        while len(data) < enough and time.monotonic() < deadline:
            data += self._take()
        return bytes(data)

    def _take(self) -> bytes:
        try:
            return self._read()
        except OSError as error:
            told = one_line(error)
            raise PortError(
                f"{printable(self._name)} was lost: {told}; check cable and power"
            ) from error
