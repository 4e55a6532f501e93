import os

from serial.tools.list_ports_common import ListPortInfo

from fte_sniff.capture.discovery import Holder, StrayAdapter, holders_of, listings, stray_adapters
from fte_sniff.capture.port_errors import permission_fix
from tests.beside import held


def found(device, **facts):
    port = ListPortInfo(device)
    for name, value in facts.items():
        setattr(port, name, value)
    return port


def test_a_port_is_listed_with_its_ids_and_its_lasting_name(pty, tmp_path):
    lasting = tmp_path / "usb-FTDI_FT232R-if00-port0"
    lasting.symlink_to(pty.device)
    port = found(pty.device, vid=0x403, pid=0x6001, serial_number="A1\x1b[2J", description="FT232R")
    (listed,) = listings([port], tmp_path)
    assert (listed.device, listed.by_id) == (pty.device, str(lasting))
    assert listed.usb_ids == "0403:6001"
    assert listed.serial_number == r"A1\x1b[2J"
    assert (listed.description, listed.permitted) == ("FT232R", True)
    assert listed.holders == ()


def test_a_port_that_is_not_usb_has_no_ids(pty, tmp_path):
    (listed,) = listings([found(pty.device)], tmp_path / "none")
    assert (listed.usb_ids, listed.by_id, listed.serial_number) == (None, None, None)
    assert listed.description is None  # what pyserial says then, "n/a", is not a description


def test_who_has_a_device_open_is_named_and_oneself_is_not(pty):
    assert holders_of(pty.device) == []
    with held(pty.near) as other:
        assert holders_of(pty.device) == [Holder(other.pid, "sleep")]
    assert holders_of("/dev/no-such-port") == []


def test_without_a_group_that_may_the_administrator_is_named(tmp_path):
    file = tmp_path / "port"
    file.touch()
    file.chmod(0o600)
    assert permission_fix(str(file)) == "ask the machine's administrator"
    assert permission_fix(str(tmp_path / "gone")) == "ask the machine's administrator"


def test_the_way_in_names_the_command_for_a_group_that_may(tmp_path):
    import grp

    group = next(group for group in grp.getgrall() if group.gr_gid not in (0, *os.getgroups()))
    file = tmp_path / "port"
    file.touch()
    file.chmod(0o660)
    if os.geteuid() == 0:
        os.chown(file, 0, group.gr_gid)
        assert f"sudo usermod -aG {group.gr_name} $USER, then log in again" in permission_fix(
            str(file)
        )


def test_adapter_without_a_device_file_is_stray(tmp_path):
    for name, chip in (("1-1", "1a86:7523"), ("1-2", "0403:6001"), ("1-3", "dead:beef")):
        (tmp_path / name / f"{name}:1.0").mkdir(parents=True)
        for file, number in zip(("idVendor", "idProduct"), chip.split(":"), strict=True):
            (tmp_path / name / file).write_text(f"{number}\n")
    (tmp_path / "1-2" / "1-2:1.0" / "ttyUSB0").mkdir()
    assert stray_adapters(tmp_path) == [StrayAdapter("1a86:7523", "", "ch341")]
    assert stray_adapters(tmp_path / "none") == []
