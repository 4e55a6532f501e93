import os
import re
import struct
import termios
from itertools import pairwise
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fte_sniff.capture.clock import Clock
from fte_sniff.capture.port_source import PortSource, open_source
from fte_sniff.capture.serial_port import (
    LowLatency,
    PortCapabilities,
    PortSettings,
    has_low_latency,
    latency_timer_ms,
    open_port,
    reader_of,
    request_low_latency,
    with_low_latency,
)
from fte_sniff.capture.uart_errors import (
    REPORT_INTERVAL_NS,
    LineWatch,
    UartWatch,
    Unmarker,
    counted_since,
    counters_of,
    enable_error_marks,
    line_watch_of,
    parse_counters,
)
from fte_sniff.protocol import Chunk, LineErrorCounts, PortEventKind
from tests.beside import Work

KINDS = ("framing", "parity", "breaks", "overruns", "buffer_overruns")
UART = Path("/dev/ttyS0")


class Counting:
    """Counters that a test moves."""

    def __init__(self, **counts):
        self.counts = LineErrorCounts(**counts)

    def __call__(self):
        return self.counts

    def add(self, **counts):
        self.counts += LineErrorCounts(**counts)


def as_marked(data, bad):
    """What the terminal makes of `data` with PARMRK, bytes at the places `bad` in error."""
    return b"".join(
        b"\xff\x00" + bytes([byte]) if place in bad else bytes([byte]) * (2 if byte == 0xFF else 1)
        for place, byte in enumerate(data)
    )


@pytest.mark.parametrize(
    ("place", "kind"),
    [(6, "framing"), (7, "overruns"), (8, "parity"), (9, "breaks"), (10, "buffer_overruns")],
)
def test_each_counter_stands_in_its_place(place, kind):
    numbers = [100 + n for n in range(20)]
    found = parse_counters(struct.pack("=20I", *numbers))
    assert getattr(found, kind) == numbers[place]


@given(st.integers(0, 2**32 - 1), st.integers(0, 2**31), st.sampled_from(KINDS))
def test_a_counter_that_wraps_counts_on(before, more, kind):
    earlier = LineErrorCounts(**{kind: before})
    later = LineErrorCounts(**{kind: (before + more) % 2**32})
    assert counted_since(later, earlier) == LineErrorCounts(**{kind: more})


marked_bytes = st.lists(
    st.tuples(st.sampled_from([0xFF, 0x00, 0xAA, 0x41]), st.booleans()), max_size=60
)


@given(marked_bytes, st.lists(st.integers(0, 180), max_size=8))
def test_marks_are_taken_out_however_they_were_cut(bytes_, cuts):
    data = bytes(byte for byte, _ in bytes_)
    bad = [place for place, (_, wrong) in enumerate(bytes_) if wrong]
    marked = as_marked(data, bad)
    edges = [0, *sorted(cut for cut in cuts if cut < len(marked)), len(marked)]
    unmarker, clean, found = Unmarker(), b"", []
    for start, stop in pairwise(edges):
        piece, places = unmarker.feed(marked[start:stop])
        found += [len(clean) + place for place in places]
        clean += piece
    assert (clean, found) == (data, bad)


def test_a_real_terminal_marks_as_it_is_unmarked(pty):
    """Linux doubles FF where marks are asked for; all else it can tell only of a real UART."""
    sent = bytes(range(256)) * 8 + b"\xff\x00\xff\xff\x00" * 40
    with open_port(pty.device) as port:
        enable_error_marks(port.fileno())
        assert pty.attributes()[0] & termios.INPCK
        read, raw = reader_of(port), b""
        Work(pty.send, sent)
        while len(raw) < len(as_marked(sent, [])):
            raw += read()
    assert raw == as_marked(sent, [])
    assert Unmarker().feed(raw) == (sent, [])


def test_opening_again_without_marks_leaves_no_marks(pty):
    enable_error_marks(pty.near)
    with open_port(pty.device) as port:
        pty.send(b"\xff\x00A")
        read, raw = reader_of(port), b""
        while len(raw) < 3:
            raw += read()
    assert raw == b"\xff\x00A"


def test_marked_and_counted_errors_are_placed_and_reported_by_kind():
    counters = Counting(framing=7)
    watch = UartWatch(counters)
    assert watch.feed(b"abc") == (b"abc", ())
    counters.add(framing=2, breaks=1)
    assert watch.feed(b"ab\xff\x00Cd" + b"\xff\xff" * 12 + b"\xff\x00\x00") == (
        b"abCd" + b"\xff" * 12 + b"\x00",
        ((2, 3), (16, 17)),
    )
    assert watch.report(5) == LineErrorCounts(framing=2, breaks=1)
    assert watch.report(5 + REPORT_INTERVAL_NS) is None


def test_errors_that_are_only_counted_lie_anywhere_up_to_the_next_byte():
    counters = Counting()
    watch = UartWatch(counters)
    counters.add(overruns=1)
    assert watch.feed(b"abcd") == (b"abcd", ((0, 5),))
    counters.add(buffer_overruns=9)
    assert watch.feed(b"") == (b"", ((0, 1),))
    assert watch.flush() == LineErrorCounts(overruns=1, buffer_overruns=9)
    assert watch.flush() is None


def test_errors_that_are_only_marked_are_counted_by_their_marks():
    watch = UartWatch(Counting())
    assert watch.feed(b"\xff\x00A\xff\x00\x00") == (b"A\x00", ((0, 2),))
    assert watch.report(0) == LineErrorCounts(framing=1, breaks=1)


def test_many_errors_are_reported_once_a_second():
    counters = Counting()
    watch = UartWatch(counters)
    reported = []
    for beat in range(2500):
        counters.add(framing=3)
        watch.feed(b"x")
        reported.append(watch.report(beat * 1_000_000))
    assert [beat for beat, news in enumerate(reported) if news] == [0, 1000, 2000]
    assert sum(counts.total for counts in reported if counts) + watch.flush().total == 7500


def test_a_source_reports_errors_and_marks_the_bytes(pty):
    counters = Counting()
    port = open_port(pty.device)
    enable_error_marks(port.fileno())
    capabilities = PortCapabilities(UartWatch(counters), LowLatency.ABSENT, None, False)
    source = PortSource(port, "tap", Clock.tied(), capabilities=capabilities)
    items = iter(source)
    next(items)
    counters.add(framing=1)
    pty.send(b"ab\xffcd")
    found = []
    while b"".join(i.data for i in found if isinstance(i, Chunk)) != b"ab\xffcd":
        found.append(next(items))
    source.stop()
    found += items
    (event,) = [i for i in found if getattr(i, "kind", None) is PortEventKind.LINE_ERROR]
    assert (event.port, event.detail, event.count) == ("tap", "1 framing", 1)
    marked = next(i for i in found if isinstance(i, Chunk) and i.line_errors)
    assert found.index(event) < found.index(marked)


@pytest.mark.parametrize("name", ["pty", "loop://", "sim://?host=off"])
def test_ports_without_a_uart_report_that_line_errors_are_unavailable(pty, name):
    with open_port(pty.device if name == "pty" else name) as port:
        assert counters_of(port) is None
        assert type(line_watch_of(port)) is LineWatch
        assert request_low_latency(port) is LowLatency.ABSENT
    with open_source(pty.device if name == "pty" else name, PortSettings(), Clock.tied()) as source:
        opened = next(iter(source)).detail
    assert "; no low latency setting; line errors unavailable" in opened


def test_a_uart_of_this_machine_is_read():
    """Only read: it may be this machine's console."""
    if not (UART.exists() and os.access(UART, os.R_OK)):
        pytest.skip("no UART here")
    descriptor = os.open(UART, os.O_RDONLY | os.O_NOCTTY | os.O_NONBLOCK)
    try:
        counters = counters_of(os.fdopen(descriptor, "rb", buffering=0, closefd=False))
        if counters is None:
            pytest.skip("its driver does not count")
        reported = dict(
            re.findall(r"(fe|pe|brk|oe):(\d+)", Path("/proc/tty/driver/serial").read_text())
        )
        expected = [int(reported.get(name, 0)) for name in ("fe", "pe", "brk", "oe")]
        assert list(counters().by_kind[:4]) == expected
    finally:
        os.close(descriptor)


@given(st.lists(st.integers(-(2**31), 2**31 - 1), min_size=32, max_size=32))
def test_low_latency_is_one_bit_and_nothing_else_changes(numbers):
    before = struct.pack("=32i", *numbers)
    after = struct.unpack("=32i", with_low_latency(before))
    assert has_low_latency(struct.pack("=32i", *after))
    assert [n for n, (a, b) in enumerate(zip(numbers, after, strict=True)) if a != b] in ([], [4])
    assert after[4] == numbers[4] | 0x2000


def test_the_latency_timer_is_read_through_links(tmp_path):
    (tmp_path / "ttyUSB7").mkdir()
    (tmp_path / "ttyUSB7" / "latency_timer").write_text("16\n")
    link = tmp_path / "by-id"
    link.symlink_to("/dev/ttyUSB7")
    assert latency_timer_ms("/dev/ttyUSB7", tmp_path) == 16
    assert latency_timer_ms(str(link), tmp_path) == 16
    assert latency_timer_ms("/dev/ttyUSB8", tmp_path) is None
    (tmp_path / "ttyUSB7" / "latency_timer").write_text("?")
    assert latency_timer_ms("/dev/ttyUSB7", tmp_path) is None


@pytest.mark.parametrize(
    ("capabilities", "words"),
    [
        (
            PortCapabilities(LineWatch(), LowLatency.ABSENT, None, False),
            "no low latency setting; line errors unavailable",
        ),
        (
            PortCapabilities(UartWatch(Counting()), LowLatency.GRANTED, 1, True),
            "low latency granted, latency timer 1 ms; line errors counted and marked",
        ),
    ],
)
def test_capabilities_as_text(capabilities, words):
    assert str(capabilities) == words
