"""What makes a port the same one after it was away."""

import pytest
from serial.tools.list_ports_common import ListPortInfo

from fte_sniff.capture.discovery import SameName, UsbIdentity, identity_of


def adapter(device, serial_number="A1", location="1-1.2", vid=0x0403, pid=0x6001):
    port = ListPortInfo(device, skip_link_detection=True)
    port.vid, port.pid = vid, pid
    port.serial_number, port.location = serial_number, location
    return port


def uart(device):
    return ListPortInfo(device, skip_link_detection=True)


# What was plugged in when ttyUSB0 was opened, what is plugged in later, and what it is then.
USB_CASES = {
    "back under its name": ([adapter("/dev/ttyUSB0")], [adapter("/dev/ttyUSB0")], "/dev/ttyUSB0"),
    "another name": ([adapter("/dev/ttyUSB0")], [adapter("/dev/ttyUSB3")], "/dev/ttyUSB3"),
    "another socket": (
        [adapter("/dev/ttyUSB0")],
        [adapter("/dev/ttyUSB1", location="2-4")],
        "/dev/ttyUSB1",
    ),
    "another adapter under its name": (
        [adapter("/dev/ttyUSB0")],
        [adapter("/dev/ttyUSB0", "B2"), adapter("/dev/ttyUSB1", "A1", "1-3")],
        "/dev/ttyUSB1",
    ),
    "only another adapter": ([adapter("/dev/ttyUSB0")], [adapter("/dev/ttyUSB0", "B2")], None),
    "another product of that serial": (
        [adapter("/dev/ttyUSB0")],
        [adapter("/dev/ttyUSB0", pid=0x6015)],
        None,
    ),
    "away": ([adapter("/dev/ttyUSB0")], [uart("/dev/ttyS0")], None),
    "no serial, same socket": (
        [adapter("/dev/ttyUSB0", None)],
        [adapter("/dev/ttyUSB1", None, "1-3"), adapter("/dev/ttyUSB2", None)],
        "/dev/ttyUSB2",
    ),
    "no serial, another socket": (
        [adapter("/dev/ttyUSB0", None)],
        [adapter("/dev/ttyUSB0", None, "1-3")],
        None,
    ),
    "a serial that two share": (
        [adapter("/dev/ttyUSB0"), adapter("/dev/ttyUSB1", location="1-3")],
        [adapter("/dev/ttyUSB1", location="1-3")],
        None,
    ),
    "one of an adapter's ports": (
        [adapter("/dev/ttyUSB0", location="1-1:1.0"), adapter("/dev/ttyUSB1", location="1-1:1.1")],
        [adapter("/dev/ttyUSB4", location="1-2:1.1"), adapter("/dev/ttyUSB5", location="1-2:1.0")],
        "/dev/ttyUSB5",
    ),
}


@pytest.mark.parametrize(("before", "later", "found"), USB_CASES.values(), ids=USB_CASES)
def test_a_usb_adapter_is_known_by_serial_or_place_never_by_name(before, later, found):
    identity = identity_of("/dev/ttyUSB0", "/dev/ttyUSB0", before)
    assert isinstance(identity, UsbIdentity)
    assert identity.find(later) == found


def test_hwgrep_is_the_adapter_that_it_found():
    ports = [adapter("/dev/ttyUSB0")]
    identity = identity_of("hwgrep://0403", "/dev/ttyUSB0", ports)
    assert identity.find([adapter("/dev/ttyUSB7")]) == "/dev/ttyUSB7"


def test_a_link_is_followed_to_whatever_it_leads_to(tmp_path):
    link = tmp_path / "usb-FTDI-if00"
    link.symlink_to("/dev/ttyUSB0")
    identity = identity_of(str(link), "/dev/ttyUSB0", [adapter("/dev/ttyUSB0")])
    assert identity == SameName(str(link))
    link.unlink()
    assert identity.find([]) is None
    link.symlink_to("/dev/null")
    assert identity.find([]) == str(link)


def test_a_uart_of_the_board_has_its_name():
    identity = identity_of("/dev/null", "/dev/null", [uart("/dev/null")])
    assert identity.find([]) == "/dev/null"


@pytest.mark.parametrize(
    ("name", "known"),
    [
        ("socket://host:1", True),
        ("RFC2217://host:1", True),
        ("sim://?frames=3", False),
        ("loop://", False),
    ],
)
def test_a_server_can_return_and_a_simulated_line_cannot(name, known):
    identity = identity_of(name, None, [])
    assert (identity is not None) is known
    if known:
        assert identity.find([]) == name


def test_a_bare_pseudo_terminal_cannot_its_number_is_given_away(pty):
    assert identity_of(pty.device, pty.device, []) is None
