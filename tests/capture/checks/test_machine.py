import os

import pytest

from fte_sniff.capture.diagnostics import (
    HostFacts,
    Level,
    clock_finding,
    clock_state,
    host_of,
    is_virtual,
    machine_findings,
    missing_adapter_hint,
    running,
    usb_buffering,
)
from fte_sniff.capture.discovery import stray_adapters


def write(root, files):
    for name, text in files.items():
        file = root / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text)


def plug_in(root, place, vid, pid, *, driver=None, tty=None):
    device = root / "sys/bus/usb/devices" / place
    write(
        device, {"idVendor": f"{vid}\n", "idProduct": f"{pid}\n", "product": "USB\x1b[2J Serial\n"}
    )
    interface = device / f"{place}:1.0"
    interface.mkdir()
    if driver:
        (root / "sys/drivers" / driver).mkdir(parents=True, exist_ok=True)
        (interface / "driver").symlink_to(root / "sys/drivers" / driver)
    if tty:
        (interface / tty).mkdir()


VIRTUAL_CPU = {"proc/cpuinfo": "processor: 0\nflags\t\t: fpu hypervisor sse\n"}


@pytest.mark.parametrize(
    ("files", "host"),
    [
        ({}, HostFacts.METAL),
        ({"proc/version": "Linux version 6.1.0-generic"}, HostFacts.METAL),
        ({"proc/version": "Linux version 5.15.1-microsoft-standard-WSL2"}, HostFacts.WSL),
        ({".dockerenv": ""}, HostFacts.CONTAINER),
        ({"run/.containerenv": "", **VIRTUAL_CPU}, HostFacts.CONTAINER),
        ({"proc/1/cgroup": "0::/kubepods/besteffort/pod1"}, HostFacts.CONTAINER),
        (VIRTUAL_CPU, HostFacts.VIRTUAL),
        ({"proc/cpuinfo": "flags: fpu sse\n"}, HostFacts.METAL),
    ],
)
def test_what_kind_of_machine_it_is(tmp_path, files, host):
    write(tmp_path, files)
    assert host_of(tmp_path) is host
    assert missing_adapter_hint(host)


def test_usb_through_a_virtual_machine_is_pointed_out(tmp_path):
    assert usb_buffering("/dev/ttyUSB0", tmp_path) is None
    write(tmp_path, VIRTUAL_CPU)
    finding = usb_buffering("/dev/ttyUSB0", tmp_path)
    assert is_virtual(tmp_path)
    assert finding.level is Level.WARN
    assert "socat TCP-LISTEN:4001,reuseaddr /dev/ttyUSB0" in finding.way_out


@pytest.mark.parametrize(
    ("vid", "pid", "driver", "wanted"),
    [
        ("1a86", "7523", None, "sudo modprobe ch341"),
        ("0403", "6001", "usbfs", "unplug it, sudo modprobe ftdi_sio"),
        ("10c4", "ea60", None, "sudo modprobe cp210x"),
    ],
)
def test_an_adapter_that_is_no_port_is_told_with_the_driver_it_wants(
    tmp_path, vid, pid, driver, wanted
):
    plug_in(tmp_path, "1-2", vid, pid, driver=driver)
    finding, *_ = machine_findings(tmp_path)
    assert (finding.level, finding.about, finding.way_out) == (
        Level.BAD,
        f"USB {vid}:{pid}",
        wanted,
    )
    assert r"USB\x1b[2J Serial is plugged in, but is no port" in finding.what
    assert driver is None or f"{driver} has it" in finding.what


def test_brltty_is_named_where_it_runs(tmp_path):
    plug_in(tmp_path, "1-2", "1a86", "7523", driver="usbfs")
    write(tmp_path, {"proc/77/comm": "brltty\n"})
    stray, meddler = machine_findings(tmp_path)
    assert "brltty takes it for a Braille display" in stray.what
    assert stray.way_out.startswith("sudo systemctl mask --now brltty")
    assert (meddler.level, meddler.about) == (Level.WARN, "machine")


def test_adapters_that_are_ports_and_other_devices_are_not_stray(tmp_path):
    plug_in(tmp_path, "1-1", "1a86", "7523", driver="ch341", tty="ttyUSB0")
    plug_in(tmp_path, "1-3", "046d", "c077")
    devices = tmp_path / "sys/bus/usb/devices"
    (devices / "usb1").mkdir()
    assert stray_adapters(devices) == []
    assert stray_adapters(tmp_path / "none") == []


def test_a_program_that_opens_adapters_is_told_with_what_stops_it(tmp_path):
    write(tmp_path, {"proc/12/comm": "ModemManager\n", "proc/13/comm": "bash\n"})
    assert running(tmp_path) == {"ModemManager", "bash"}
    (finding,) = machine_findings(tmp_path)
    assert finding.level is Level.WARN
    assert finding.way_out == "sudo systemctl disable --now ModemManager"


def test_a_machine_without_meddlers_is_well(tmp_path):
    (finding,) = machine_findings(tmp_path)
    assert finding.level is Level.OK


def test_this_process_is_among_the_running():
    with open(f"/proc/{os.getpid()}/comm") as file:  # noqa: PTH123
        assert file.read().strip() in running()


@pytest.mark.parametrize(("state", "level"), [(0, "ok"), (1, "ok"), (5, "warn"), (None, "ok")])
def test_a_clock_that_nothing_keeps_right_is_told(state, level):
    finding = clock_finding(state)
    assert finding.level == level
    assert ("timedatectl set-ntp" in (finding.way_out or "")) is (level == "warn")


def test_the_clock_of_this_machine_is_asked():
    assert clock_state() in range(6)
