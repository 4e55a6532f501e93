import os

from serial.tools.list_ports_common import ListPortInfo

from fte_sniff.capture.discovery import Holder, PortListing, holders_of, listing
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
    assert listing(port, tmp_path) == PortListing(
        device=pty.device, state="free", held_by="", usb_ids="0403:6001", location="",
        serial_number=r"A1\x1b[2J", description="FT232R", by_id=str(lasting),
    )  # fmt: skip


def test_a_port_that_is_not_usb_has_no_ids_and_is_busy_while_another_program_holds_it(pty):
    with held(pty.near) as other:
        expected = PortListing(pty.device, "busy", f"sleep (pid {other.pid})", *[""] * 5)
        assert listing(found(pty.device)) == expected


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
