from __future__ import annotations

import os
import termios
from dataclasses import replace
from pathlib import Path

import pytest

from fte_sniff.analysis.line_condition import LineCondition, LineDiagnosis
from fte_sniff.capture.discovery import Holder, PortListing, stray_adapters
from fte_sniff.capture.serial_port import LowLatency, PortCapabilities, PortSettings
from fte_sniff.capture.uart_errors import LineWatch, UartWatch
from fte_sniff.errors import PortError
from fte_sniff.protocol import Direction, LineErrorCounts
from fte_sniff.session.doctor import (
    Level,
    LineListener,
    MachineKind,
    adapter_findings,
    capability_findings,
    clock_finding,
    clock_state,
    device_findings,
    folder_finding,
    framer_finding,
    holder_findings,
    is_virtual,
    machine_kind,
    probe_finding,
    running_programs,
    terminal_findings,
    verdict_finding,
    virtual_usb_findings,
)
from fte_sniff.session.framer_hash import library_name
from tests.beside import Work
from tests.recording.conftest import unprivileged


@pytest.mark.parametrize("condition", LineCondition)
def test_every_condition_has_words_and_a_fix(condition: LineCondition) -> None:
    verdict = LineDiagnosis(condition, 100, 0.5, frozenset({Direction.CONTROL}))
    finding = verdict_finding("/dev/p", 115_200, verdict)
    assert finding.what
    assert (finding.fix is None) is (condition is LineCondition.SOUND)


def test_a_probe_names_the_baud_with_most_bytes_in_frames() -> None:
    found = {
        57_600: LineDiagnosis(LineCondition.DAMAGED, 400, 0.3),
        38_400: LineDiagnosis(LineCondition.DAMAGED, 400, 0.6),
    }
    assert probe_finding("/dev/p", found).fix == "fte-sniff live /dev/p --baud 38400"
    assert "no common baud gives frames" in probe_finding("/dev/p", {}).what


def test_a_folder_with_room_is_well(tmp_path: Path) -> None:
    assert folder_finding(tmp_path).level == "ok"


def test_a_folder_that_is_gone_or_forbidden_is_bad(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert folder_finding(tmp_path / "gone").level == "bad"
    tmp_path.chmod(0o500)
    monkeypatch.chdir(tmp_path)
    with unprivileged():
        finding = folder_finding(Path())
    assert (finding.level, finding.fix) == ("bad", "cd ~, or name a recording with -o")


@pytest.mark.parametrize(
    ("environment", "encoding", "levels"),
    [
        ({"TERM": "xterm-256color"}, "utf-8", ["ok"]),
        ({"TERM": "xterm"}, "UTF8", ["ok"]),
        ({}, "utf-8", ["warn"]),
        ({"TERM": "dumb"}, "ANSI_X3.4-1968", ["warn", "warn"]),
    ],
)
def test_a_terminal_that_cannot_show_the_screen_is_reported(
    environment: dict[str, str], encoding: str, levels: list[str]
) -> None:
    assert [finding.level for finding in terminal_findings(environment, encoding)] == levels


def test_an_interpreted_framer_is_a_warning_with_a_fix(tmp_path: Path) -> None:
    finding = framer_finding(tmp_path, compiled=False)
    assert finding.level == "warn"
    assert "C compiler" in (finding.fix or "")


def test_a_framer_compiled_from_another_source_is_a_warning_whatever_the_file_times(
    tmp_path: Path,
) -> None:
    """pip unpacks files in alphabetic order, so a source can be newer than its library."""
    source = tmp_path / "gap.py"
    source.write_text("a = 1\n")
    library = tmp_path / f"{library_name(tmp_path)}.so"
    library.touch()
    os.utime(library, (1000, 1000))
    assert framer_finding(tmp_path, compiled=True).level == "ok"
    source.write_text("a = 2\n")
    os.utime(source, (500, 500))
    finding = framer_finding(tmp_path, compiled=True)
    assert finding.level == "warn"
    assert "pip install" in (finding.fix or "")


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
        ({}, MachineKind.METAL),
        ({"proc/version": "Linux version 6.1.0-generic"}, MachineKind.METAL),
        ({"proc/version": "Linux version 5.15.1-microsoft-standard-WSL2"}, MachineKind.WSL),
        ({".dockerenv": ""}, MachineKind.CONTAINER),
        ({"run/.containerenv": "", **VIRTUAL_CPU}, MachineKind.CONTAINER),
        ({"proc/1/cgroup": "0::/kubepods/besteffort/pod1"}, MachineKind.CONTAINER),
        (VIRTUAL_CPU, MachineKind.VIRTUAL),
        ({"proc/cpuinfo": "flags: fpu sse\n"}, MachineKind.METAL),
    ],
)
def test_what_kind_of_machine_it_is(tmp_path, files, host):
    write(tmp_path, files)
    assert machine_kind(tmp_path) is host
    assert host.value


def test_usb_through_a_virtual_machine_is_pointed_out(tmp_path):
    assert list(virtual_usb_findings("/dev/ttyUSB0", tmp_path)) == []
    write(tmp_path, VIRTUAL_CPU)
    (finding,) = virtual_usb_findings("/dev/ttyUSB0", tmp_path)
    assert is_virtual(tmp_path)
    assert finding.level is Level.WARN
    assert "socat TCP-LISTEN:4001,reuseaddr /dev/ttyUSB0" in finding.fix


@pytest.mark.parametrize(
    ("vid", "pid", "driver", "wanted"),
    [
        ("1a86", "7523", None, "sudo modprobe ch341"),
        ("0403", "6001", "usbfs", "unplug it, sudo modprobe ftdi_sio"),
        ("10c4", "ea60", None, "sudo modprobe cp210x"),
    ],
)
def test_an_adapter_without_a_port_is_reported_with_the_driver_it_needs(
    tmp_path, vid, pid, driver, wanted
):
    plug_in(tmp_path, "1-2", vid, pid, driver=driver)
    finding, *_ = adapter_findings(tmp_path)
    assert (finding.level, finding.about, finding.fix) == (
        Level.BAD,
        f"USB {vid}:{pid}",
        wanted,
    )
    assert r"USB\x1b[2J Serial is plugged in, but does not appear as a port" in finding.what
    assert driver is None or f"{driver} has it" in finding.what


def test_brltty_is_named_where_it_runs(tmp_path):
    plug_in(tmp_path, "1-2", "1a86", "7523", driver="usbfs")
    write(tmp_path, {"proc/77/comm": "brltty\n"})
    stray, meddler = adapter_findings(tmp_path)
    assert "brltty takes it for a Braille display" in stray.what
    assert stray.fix.startswith("sudo systemctl mask --now brltty")
    assert (meddler.level, meddler.about) == (Level.WARN, "machine")


def test_adapters_that_are_ports_and_other_devices_are_not_stray(tmp_path):
    plug_in(tmp_path, "1-1", "1a86", "7523", driver="ch341", tty="ttyUSB0")
    plug_in(tmp_path, "1-3", "046d", "c077")
    devices = tmp_path / "sys/bus/usb/devices"
    (devices / "usb1").mkdir()
    assert stray_adapters(devices) == []
    assert stray_adapters(tmp_path / "none") == []


def test_a_program_that_opens_adapters_is_reported_with_the_command_that_stops_it(tmp_path):
    write(tmp_path, {"proc/12/comm": "ModemManager\n", "proc/13/comm": "bash\n"})
    assert running_programs(tmp_path) == {"ModemManager", "bash"}
    (finding,) = adapter_findings(tmp_path)
    assert finding.level is Level.WARN
    assert finding.fix == "sudo systemctl disable --now ModemManager"


def test_a_machine_without_meddlers_is_well(tmp_path):
    (finding,) = adapter_findings(tmp_path)
    assert finding.level is Level.OK


def test_this_process_is_among_the_running():
    with open(f"/proc/{os.getpid()}/comm") as file:  # noqa: PTH123
        assert file.read().strip() in running_programs()


@pytest.mark.parametrize(("state", "level"), [(0, "ok"), (1, "ok"), (5, "warn"), (None, "ok")])
def test_a_clock_that_is_not_synchronized_is_reported(state, level):
    finding = clock_finding(state)
    assert finding.level == level
    assert ("timedatectl set-ntp" in (finding.fix or "")) is (level == "warn")


def test_the_clock_of_this_machine_is_asked():
    assert clock_state() in range(6)


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
    assert "udev rule" in finding.fix


@pytest.mark.parametrize(
    ("name", "fix"),
    [
        ("picocom", "end it there, or: kill 7"),
        ("fte-sniff", "end it there, or: kill 7"),
        ("agetty", "sudo systemctl stop serial-getty@x.service"),
        ("ModemManager", "sudo systemctl disable --now ModemManager"),
    ],
)
def test_who_holds_a_port_is_named_with_what_makes_it_let_go(name, fix):
    finding = next(holder_findings(replace(FREE, holders=(Holder(7, name),))))
    assert finding.level == "bad"
    assert (f"{name} (pid 7) has it open" in finding.what, finding.fix) == (True, fix)


@pytest.mark.parametrize(
    ("capabilities", "levels", "fix"),
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
            PortCapabilities(LineWatch(), LowLatency.ABSENT, None, True),
            ["ok", "warn"],
            "use an adapter whose driver reports them (FTDI, CP210x)",
        ),
        (PortCapabilities(LineWatch(), LowLatency.ABSENT, None, False), ["ok", "ok"], None),
    ],
)
def test_a_missing_capability_comes_with_its_fix(capabilities, levels, fix):
    findings = list(capability_findings("/dev/ttyUSB3", capabilities))
    assert [finding.level for finding in findings] == levels
    assert [finding.fix for finding in findings if finding.fix] == ([fix] if fix else [])


FOR_EVER_S = 60.0
SETTINGS = PortSettings()


def test_what_comes_is_heard_until_it_is_enough_and_nothing_is_written(pty):
    with LineListener(pty.device, SETTINGS) as listener:
        pty.send(b"x" * 500)
        heard = listener.listen(FOR_EVER_S, 500)
    assert (heard.data, heard.line_errors) == (b"x" * 500, LineErrorCounts())
    assert pty.arrived() == b""


def test_silence_is_heard_for_as_long_as_was_asked(pty):
    with LineListener(pty.device, SETTINGS) as listener:
        assert listener.listen(0.05, 1).data == b""


def test_line_errors_are_reported_with_the_received_bytes(pty):
    counted = [LineErrorCounts(framing=3), LineErrorCounts(framing=3), LineErrorCounts(framing=5)]
    counters = iter([*counted, *[counted[-1]] * 10_000])
    with LineListener(pty.device, SETTINGS) as listener:
        watch = UartWatch(lambda: next(counters))
        listener.capabilities = PortCapabilities(watch, LowLatency.ABSENT, None, False)
        pty.send(b"abc")
        heard = listener.listen(FOR_EVER_S, 3)
        heard_then = listener.listen(0.05, 1)
    assert heard.data == b"abc"
    assert (heard.line_errors + heard_then.line_errors) == LineErrorCounts(framing=2)


def test_a_sample_is_taken_at_another_baud_with_the_same_care(pty, until):
    with LineListener(pty.device, SETTINGS) as listener:
        found = []
        sampling = Work(lambda: found.append(listener.sample(57_600, FOR_EVER_S, 4)))
        until(lambda: pty.attributes()[4] == termios.B57600)
        # What comes at once may still be of the old baud, and is not taken.
        until(lambda: pty.send(b"\xff\x00\xff\xff") or found)
        sampling.ended()
        iflag, oflag, _, lflag, *_ = pty.attributes()
    assert set(found[0]) == {0xFF, 0x00}
    assert not iflag & (termios.BRKINT | termios.PARMRK | termios.IGNPAR | termios.ICRNL)
    assert not oflag & termios.OPOST
    assert not lflag & (termios.ECHO | termios.ICANON)
    assert pty.arrived() == b""


def test_a_port_that_goes_while_it_is_heard_is_one_line(pty):
    with LineListener(pty.device, SETTINGS) as listener:
        Work(pty.unplug)
        with pytest.raises(PortError, match=r"was lost: .*; check cable and power"):
            listener.listen(FOR_EVER_S, 1)


def test_a_baud_that_a_port_cannot_have_is_passed_over():
    with LineListener("sim://?seed=1&rate=1000&wire=feedback", SETTINGS) as listener:
        assert len(listener.listen(FOR_EVER_S, 100).data) >= 100
        # A line of 9600 baud cannot carry what is simulated here.
        assert listener.sample(9600, FOR_EVER_S, 100) is None
        assert len(listener.sample(230_400, FOR_EVER_S, 100)) >= 100
