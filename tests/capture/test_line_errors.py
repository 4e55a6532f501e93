"""Line errors that a driver counts: placed, reported by kind, and not more than once a second."""

from __future__ import annotations

import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fte_sniff.capture.line_errors import REPORT_NS, LineErrors, counters_of, parsed
from fte_sniff.capture.serial_port import open_port
from fte_sniff.protocol.items import LineErrorCounts
from tests.capture.seen import Seen, opened

KINDS = ("framing", "parity", "breaks", "overruns", "buffer_overruns")
PLACES = {"framing": 6, "overruns": 7, "parity": 8, "breaks": 9, "buffer_overruns": 10}


@pytest.mark.parametrize("kind", KINDS)
def test_each_counter_has_its_place_in_the_struct(kind: str) -> None:
    numbers = [0] * 20
    numbers[PLACES[kind]] = 7
    assert parsed(struct.pack("=20I", *numbers)) == LineErrorCounts(**{kind: 7})


def test_errors_come_once() -> None:
    counts = [LineErrorCounts()] * 2 + [LineErrorCounts(framing=1)] * 2
    errors = LineErrors("a", lambda: counts.pop(0))
    assert [errors.came() for _ in range(3)] == [False, True, False]


@given(
    st.lists(st.tuples(*[st.integers(0, 5)] * 5), max_size=20),
    st.integers(0, 2**32 - 1),
)
def test_all_errors_are_reported_by_kind_though_counters_wrap(steps, start: int) -> None:
    counts = [start] * 5

    def counters() -> LineErrorCounts:
        return LineErrorCounts(*(count % 2**32 for count in counts))

    errors, events = LineErrors("a", counters), []
    for number, step in enumerate(steps):
        counts = [count + more for count, more in zip(counts, step, strict=True)]
        assert errors.came() == any(step)
        events += errors.report(number * REPORT_NS // 3)
    events += errors.report(len(steps) * REPORT_NS, at_end=True)
    assert sum(event.count for event in events) == sum(map(sum, steps))
    assert len(events) <= len(steps) // 3 + 2


@pytest.mark.parametrize("name", ["pty", "loop://", "sim://"])
def test_port_without_a_uart_has_no_line_errors(pty, name: str) -> None:
    with open_port(pty.device if name == "pty" else name) as port:
        errors = LineErrors("a", counters_of(port))
        assert errors.description == "line errors unavailable"
        assert not errors.came()
        assert errors.report(REPORT_NS, at_end=True) == ()


def test_source_names_what_the_driver_supports(pty) -> None:
    with Seen(opened(pty.device)) as seen:
        expected = "115200 baud 8N1, DTR off, RTS off; line errors "
        assert seen.wait_for("opened").detail == f"{expected}unavailable"
