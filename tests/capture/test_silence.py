"""A wire on which nothing comes, or no frame."""

from __future__ import annotations

import pytest

from fte_sniff.analysis.filter.row_filter import Alert
from fte_sniff.capture.silence import SilenceWatch
from fte_sniff.protocol.items import Chunk, PortEvent
from fte_sniff.protocol.rows import NO_ROWS

MS = 1_000_000


def observed(watch: SilenceWatch, reads: dict[int, bytes], until_ms: int) -> list[PortEvent]:
    """The events of a wire that is read every 10 ms; `reads` are the bytes by milliseconds."""
    events = list[PortEvent]()
    for t_ms in range(0, until_ms, 10):
        events += observed_at(watch, t_ms, reads.get(t_ms, b""))
    return events


def told(events: list[PortEvent]) -> list[tuple[int, str, str, int]]:
    return [(one.t_ns // MS, one.kind.value, one.detail, one.count) for one in events]


def test_wire_that_was_alive_is_silent_and_alive_again() -> None:
    events = observed(SilenceWatch("a"), {100: b"x", 7400: b"x", 7500: b"x"}, 9000)
    assert told(events) == [
        (2100, "silent", "silent for 2.0 s", 2000),
        (7400, "bytes_again", "bytes again after 7.3 s", 7300),
    ]


def test_alert_rings_once_in_each_silence() -> None:
    alert, watch, rung = Alert(None, 5), SilenceWatch("a", 5), []
    reads = {100: b"x", 3000: b"x", 12_000: b"x", 25_000: b"x"}
    for t_ms in range(0, 30_000, 10):
        events = observed_at(watch, t_ms, reads.get(t_ms, b""))
        if alert.observe(NO_ROWS, t_ms / 1000, events):
            rung.append(t_ms)
    assert rung == [8000, 17_000]


def test_wire_that_was_never_alive_or_is_lost_is_not_silent() -> None:
    watch = SilenceWatch("a")
    assert observed(watch, {}, 9000) == []
    assert observed(watch, {8990: b"x"}, 9000) == []
    watch.lost()
    assert observed(watch, {}, 20_000) == []


@pytest.mark.parametrize(
    ("data", "named"),
    [
        (bytes(10), "only 00 for 5 s: the wire is held low"),
        (b"\xff" * 10, "only FF for 5 s: an open wire"),
        (bytes(range(10)), "no frame in 5,010 bytes for 5 s: another baud"),
    ],
)
def test_bytes_without_a_frame_are_named_once(data: bytes, named: str) -> None:
    watch = SilenceWatch("a")
    reads = dict.fromkeys(range(0, 12_000, 10), data)
    (event,) = observed(watch, reads, 12_000)
    assert event.kind == "wiring"
    assert event.detail.startswith(named)
    assert event.t_ns == 5000 * MS
    # Named again only after a frame has come, which is reported too.
    assert observed(watch, reads, 12_000) == []
    watch.frame_came()
    again, event = observed(watch, reads, 12_000)
    assert (again.kind, again.detail) == ("bytes_again", "frames again after 0.0 s")
    assert event.kind == "wiring"


def test_line_with_frames_and_a_line_with_few_bytes_are_not_named() -> None:
    watch, events = SilenceWatch("a", 60), []
    for t_ms in range(0, 12_000, 10):
        events += observed_at(watch, t_ms, b"x" * 20)
        if t_ms % 1000 == 0:
            watch.frame_came()
    assert events == []
    assert observed(SilenceWatch("a", 60), {0: bytes(20), 6000: bytes(9)}, 12_000) == []


def observed_at(watch: SilenceWatch, t_ms: int, data: bytes) -> list[PortEvent]:
    event = watch.observe(Chunk("a", t_ms * MS, data))
    return [] if event is None else [event]
