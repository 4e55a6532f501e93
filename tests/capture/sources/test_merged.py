"""Several sources as one: simulated lines and real pseudo-terminals on one time line."""

import itertools

import pytest

from fte_sniff.capture.clock import Clock
from fte_sniff.capture.multi_source import PortGroup
from fte_sniff.capture.serial_port import PortSettings, open_port
from fte_sniff.capture.source import SourceEnd
from fte_sniff.errors import PortError, UsageError
from fte_sniff.protocol import Chunk, PortEvent, PortEventKind

CLOCK = Clock.tied()


def opened(*names, reconnect=True):
    return PortGroup(names, PortSettings(), reconnect=reconnect).open(CLOCK)


def data_of(items, port):
    return b"".join(i.data for i in items if isinstance(i, Chunk) and i.port == port)


def kinds_of(items, port):
    return [i.kind for i in items if isinstance(i, PortEvent) and i.port == port]


def test_all_of_both_comes_in_order_of_time(new_pty):
    one, two = new_pty(), new_pty()
    source = opened(one.device, two.device)
    items, sent = [], {one.device: b"", two.device: b""}
    turns = itertools.cycle([one, one, two])
    for item in source:
        items.append(item)
        if sum(map(len, sent.values())) < 3000:
            pty = next(turns)
            piece = bytes([len(items) % 256]) * 7
            pty.send(piece)
            sent[pty.device] += piece
        elif all(data_of(items, device) == whole for device, whole in sent.items()):
            source.stop()
    times = [item.t_ns for item in items]
    assert times == sorted(times)
    for device, whole in sent.items():
        assert data_of(items, device) == whole
        assert kinds_of(items, device) == [PortEventKind.OPENED, PortEventKind.CLOSED]
    assert source.end is SourceEnd.STOPPED


def test_one_that_is_lost_for_good_ends_all(pty):
    items = []
    with opened("sim://?frames=20&rate=1000", pty.device) as source:
        items += source
    assert kinds_of(items, pty.device) == [PortEventKind.OPENED, PortEventKind.CLOSED]
    assert items[-1].kind in (PortEventKind.LOST, PortEventKind.CLOSED)
    assert source.end is SourceEnd.LOST
    assert list(source) == []


def test_one_that_comes_back_ends_none(new_pty, tmp_path):
    going, staying, again = new_pty(), new_pty(), new_pty()
    link = tmp_path / "link"
    link.symlink_to(going.device)
    source = opened(str(link), staying.device)
    items = []
    for item in source:
        items.append(item)
        if len(items) == 10:
            link.unlink()
            going.unplug()
        elif isinstance(item, PortEvent) and item.kind is PortEventKind.LOST:
            staying.send(b"still here")
            link.symlink_to(again.device)
        elif isinstance(item, PortEvent) and item.kind is PortEventKind.FOUND_AGAIN:
            source.stop()
    assert data_of(items, staying.device) == b"still here"
    assert source.end is SourceEnd.STOPPED


def test_if_one_cannot_be_opened_none_stays_open(pty):
    with pytest.raises(PortError, match="no such port"):
        opened(pty.device, "/dev/ttyNOPE")
    open_port(pty.device).close()


def test_a_consumer_that_breaks_off_leaves_all_free(new_pty):
    ptys = [new_pty(), new_pty()]
    items = iter(opened(*(pty.device for pty in ptys)))
    next(items)
    items.close()
    for pty in ptys:
        open_port(pty.device).close()


def test_each_port_is_as_uncertain_as_it_is(pty):
    with opened(pty.device, "loop://") as source:
        assert set(source.uncertainty_ns) == {pty.device, "loop://"}


def test_a_port_can_be_named_once_only():
    with pytest.raises(UsageError, match="named twice"):
        PortGroup(("sim://", "sim://"))


def test_a_port_can_be_named_once_only_however_it_is_spelled(tmp_path):
    (tmp_path / "one").touch()
    (tmp_path / "link").symlink_to("one")
    for other in (tmp_path / "link", f"{tmp_path}/./one"):
        with pytest.raises(UsageError, match="named twice"):
            PortGroup((str(tmp_path / "one"), str(other)))
