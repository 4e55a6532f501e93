"""Ports that are lost and come back: real pseudo-terminals behind a link, and real servers."""

from __future__ import annotations

import pytest
from serial.tools.list_ports_common import ListPortInfo

from fte_sniff.capture import source
from fte_sniff.capture.lasting_name import lasting_name
from tests.beside import held
from tests.capture.seen import Adapter, Seen, opened


@pytest.fixture
def adapter(tmp_path, monkeypatch) -> Adapter:
    """An adapter, and sources that try often to connect again."""
    monkeypatch.setattr(source, "RECONNECT_S", 0.05)
    return Adapter(tmp_path)


def test_adapter_is_found_ten_times_under_another_name(new_pty, adapter) -> None:
    pty = new_pty()
    adapter.plug(pty)
    with Seen(opened(adapter.name, reconnect=True)) as seen:
        for number in range(10):
            pty.send(b"%d" % number)
            seen.wait(lambda s, number=number: len(s.data()) == number + 1)
            other = new_pty()  # so that the number of the next is another one
            adapter.pull(pty)
            lost = seen.wait_for("lost", number + 1)
            other.send(b"not yet")
            adapter.plug(other)
            found = seen.wait_for("found_again", number + 1)
            pty = other
            assert lost.detail == "the other end has hung up; waiting for it"
            assert found.detail.endswith(f" s as {pty.device}")
    assert seen.data() == b"0123456789"
    assert seen.times(adapter.name) == sorted(seen.times(adapter.name))
    assert seen.kinds() == ["opened", *["lost", "found_again"] * 10, "closed"]
    assert seen.source.lost is None


def test_number_of_a_pseudo_terminal_is_not_evidence(new_pty, adapter) -> None:
    """A stale link leads to a stranger's terminal, which got the number of the lost one."""
    pty = new_pty()
    adapter.plug(pty)
    with Seen(opened(adapter.name, reconnect=True)) as seen:
        pty.unplug()
        lost = seen.wait_for("lost")
        # One of them has the number now, or else a terminal of another program.
        strangers = [new_pty() for _ in range(20)]
        before = [stranger.attributes() for stranger in strangers]
        for stranger in strangers:
            stranger.send(b"a stranger's bytes")
        seen.wait(lambda s: s.items[-1].t_ns > lost.t_ns + 500_000_000)
        assert seen.kinds() == ["opened", "lost"]
        assert [stranger.attributes() for stranger in strangers] == before
        # Behind a link that was made anew, any number is the port.
        adapter.plug(strangers[0])
        seen.wait_for("found_again")
    assert seen.data() == b""


def test_port_that_another_program_holds_is_reported_once_and_awaited(new_pty, adapter) -> None:
    pty = new_pty()
    adapter.plug(pty)
    with Seen(opened(adapter.name, reconnect=True)) as seen:
        adapter.pull(pty)
        seen.wait_for("lost")
        theirs = new_pty()
        with held(theirs.near) as user:
            before = theirs.attributes()
            adapter.plug(theirs)
            refused = seen.wait_for("not_opened")
            assert refused.detail.startswith("it is back, but ")
            assert f"(pid {user.pid}) has it open" in refused.detail
            seen.wait(lambda s: s.items[-1].t_ns > refused.t_ns + 500_000_000)
            assert theirs.attributes() == before
        seen.wait_for("found_again")
    assert seen.kinds() == ["opened", "lost", "not_opened", "found_again", "closed"]


def test_shared_port_comes_back_beside_the_other_program(new_pty, adapter) -> None:
    pty, again = new_pty(), new_pty()
    adapter.plug(pty)
    with held(again.near), Seen(opened(adapter.name, reconnect=True, share=True)) as seen:
        adapter.pull(pty)
        seen.wait_for("lost")
        adapter.plug(again)
        seen.wait_for("found_again")
        seen.wait_for("shared")


@pytest.mark.parametrize("name", ["pty", "sim://?rate=1000&frames=5"])
def test_port_that_cannot_come_back_ends_the_capture(pty, name: str) -> None:
    seen = Seen(opened(pty.device if name == "pty" else name, reconnect=True))
    pty.unplug()
    seen.ended()
    assert seen.kinds() == ["opened", "lost"]
    assert seen.source.lost is not None


@pytest.mark.parametrize("reconnect", [True, False])
def test_loss_of_one_wire_costs_no_byte_of_the_other(new_pty, reconnect: bool) -> None:
    """Without `reconnect`, the first loss ends the capture."""
    first, second = new_pty(), new_pty()
    seen = Seen(opened(first.device, second.device, reconnect=reconnect))
    first.unplug()
    seen.wait_for("lost")
    if reconnect:
        second.send(b"more")
        seen.wait(lambda s: s.data(second.device) == b"more")
        second.unplug()
    seen.ended()
    assert seen.kinds(second.device) == ["opened", "lost" if reconnect else "closed"]
    assert seen.source.lost is not None


# The name by which an adapter is found again


def usb(device: str, serial_number: str | None = "A1", location: str = "1-1.2:1.0") -> ListPortInfo:
    port = ListPortInfo(device, skip_link_detection=True)
    port.vid, port.pid = 0x0403, 0x6001
    port.serial_number, port.location = serial_number, location
    return port


CASES = {
    "a serial number": (lambda d: [usb(d)], "by-id/usb-FTDI_A1"),
    "no serial number": (lambda d: [usb(d, None)], "by-path/pci-usb-1"),
    "two adapters with one serial number": (
        lambda d: [usb(d), usb("/dev/ttyUSB9", location="1-1.3:1.0")],
        "by-path/pci-usb-1",
    ),
    "two ports of one adapter": (
        lambda d: [usb(d), usb("/dev/ttyUSB9", location="1-1.2:1.1")],
        "by-id/usb-FTDI_A1",
    ),
    "no USB adapter": (lambda _: [], "by-path/pci-usb-1"),
}


@pytest.mark.parametrize("case", CASES)
def test_adapter_has_a_name_that_lasts(pty, tmp_path, case: str) -> None:
    plugged_in, expected = CASES[case]
    for folder, name in (("by-id", "usb-FTDI_A1"), ("by-path", "pci-usb-1")):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "another").symlink_to("/dev/null")
        (tmp_path / folder / name).symlink_to(pty.device)
    found = lasting_name(pty.device, pty.device, plugged_in(pty.device), tmp_path)
    assert found == str(tmp_path / expected)


def test_without_links_the_device_is_the_name(pty, tmp_path) -> None:
    found = lasting_name(pty.device, pty.device, [usb(pty.device)], tmp_path)
    assert found == pty.device
    found = lasting_name("hwgrep://FTDI", pty.device, [usb(pty.device)], tmp_path)
    assert found == pty.device


def test_link_that_the_user_names_is_kept(pty, tmp_path) -> None:
    (tmp_path / "by-id").mkdir()
    (tmp_path / "by-id" / "usb-FTDI_A1").symlink_to(pty.device)
    mine = tmp_path / "mine"
    mine.symlink_to(pty.device)
    assert lasting_name(str(mine), pty.device, [usb(pty.device)], tmp_path) == str(mine)
