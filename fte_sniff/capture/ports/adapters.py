"""Owns the USB adapters that are plugged in but have become no port, and why.

It must not open or change anything: it reads what the system tells.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

from fte_sniff.errors import shown

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
    return StrayAdapter(f"{vid}:{pid}", shown(_word(device / "product")), wanted, driver)


def _has_port(interface: Path) -> bool:
    return any(interface.glob("tty*"))


def _word(file: Path) -> str:
    try:
        return file.read_text(errors="replace").strip()
    except OSError:
        return ""
