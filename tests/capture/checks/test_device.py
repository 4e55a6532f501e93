from dataclasses import replace

import pytest

from fte_sniff.capture.diagnostics import device_findings, granted_findings, holder_findings
from fte_sniff.capture.discovery import Holder, PortListing
from fte_sniff.capture.serial_port import LowLatency, PortCapabilities
from fte_sniff.capture.uart_errors import BlindWatch, UartWatch
from fte_sniff.protocol import LineErrorCounts

FREE = PortListing("/dev/x", None, None, None, None, None, "n/a", None, True, ())
COUNTING = UartWatch(LineErrorCounts)


def test_a_port_is_free_busy_or_forbidden():
    busy = replace(FREE, holders=(Holder(7, "picocom"),))
    assert [port.state for port in (FREE, busy, replace(busy, permitted=False))] == [
        "free",
        "busy",
        "forbidden",
    ]


def test_a_forbidden_port_comes_with_the_way_in(tmp_path):
    file = tmp_path / "port"
    file.touch(mode=0o600)
    finding, *_ = device_findings(replace(FREE, device=str(file), permitted=False))
    assert (finding.level, finding.what) == ("bad", "no permission")
    assert "udev rule" in finding.way_out


@pytest.mark.parametrize(
    ("name", "way_out"),
    [
        ("picocom", "end it there, or: kill 7"),
        ("fte-sniff", "end it there, or: kill 7"),
        ("agetty", "sudo systemctl stop serial-getty@x.service"),
        ("ModemManager", "sudo systemctl disable --now ModemManager"),
    ],
)
def test_who_holds_a_port_is_named_with_what_makes_it_let_go(name, way_out):
    finding = next(holder_findings(replace(FREE, holders=(Holder(7, name),))))
    assert finding.level == "bad"
    assert (f"{name} (pid 7) has it open" in finding.what, finding.way_out) == (True, way_out)


@pytest.mark.parametrize(
    ("granted", "levels", "way_out"),
    [
        (PortCapabilities(COUNTING, LowLatency.GRANTED, 1, True), ["ok", "ok"], None),
        (
            PortCapabilities(COUNTING, LowLatency.REFUSED, 16, True),
            ["warn", "ok"],
            "echo 1 | sudo tee /sys/bus/usb-serial/devices/ttyUSB3/latency_timer",
        ),
        (
            PortCapabilities(COUNTING, LowLatency.REFUSED, None, False),
            ["warn", "ok"],
            "sudo setserial /dev/ttyUSB3 low_latency",
        ),
        (
            PortCapabilities(BlindWatch(), LowLatency.ABSENT, None, True),
            ["ok", "warn"],
            "use an adapter whose driver tells them (FTDI, CP210x)",
        ),
        (PortCapabilities(BlindWatch(), LowLatency.ABSENT, None, False), ["ok", "ok"], None),
    ],
)
def test_what_was_not_granted_comes_with_what_mends_it(granted, levels, way_out):
    findings = list(granted_findings("/dev/ttyUSB3", granted))
    assert [finding.level for finding in findings] == levels
    assert [finding.way_out for finding in findings if finding.way_out] == (
        [way_out] if way_out else []
    )
