"""Owns what of the machine stands in the way of ports, or of true times.

It must not open a port. All is read below one root, so that any machine can be looked at.
"""

from __future__ import annotations

import ctypes
from collections.abc import Iterator
from enum import StrEnum
from pathlib import Path

from fte_sniff.capture.checks.finding import Finding, bad, ok, warn
from fte_sniff.capture.ports.adapters import StrayAdapter, stray_adapters

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


class Host(StrEnum):
    """What kind of machine this is, as far as devices go."""

    METAL = "a machine of its own"
    CONTAINER = "a container"
    WSL = "WSL"
    VIRTUAL = "a virtual machine"


def host_of(root: Path = _ROOT) -> Host:
    """What kind of machine this is; a container in a virtual machine is a container."""
    if "microsoft" in _text(root / "proc/version").lower():
        return Host.WSL
    marks = (root / ".dockerenv", root / "run/.containerenv")
    if any(mark.exists() for mark in marks) or _in_container_group(root):
        return Host.CONTAINER
    return Host.VIRTUAL if is_virtual(root) else Host.METAL


def is_virtual(root: Path = _ROOT) -> bool:
    """Whether a hypervisor is below this system."""
    flags = next(
        (line for line in _text(root / "proc/cpuinfo").splitlines() if line.startswith("flags")), ""
    )
    return "hypervisor" in flags.split()


def missing_adapter_hint(host: Host) -> str:
    """What to do where an adapter is plugged in and this machine does not see it."""
    return {
        Host.CONTAINER: "give it to the container: docker run --device /dev/ttyUSB0 ...",
        Host.WSL: "in Windows: usbipd list, then usbipd attach --wsl --busid <its BUSID>",
        Host.VIRTUAL: "hand the USB adapter on to the virtual machine, in its settings",
        Host.METAL: "plug the adapter in, and see what the system says: sudo dmesg | tail",
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
