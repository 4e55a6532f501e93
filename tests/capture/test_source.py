"""Sources of connections whose readers are functions: order, limits, ends, and late bytes."""

from __future__ import annotations

import re
import threading
import time
from collections.abc import Callable, Iterable
from itertools import chain
from typing import Any

import pytest

from fte_sniff.capture import source as module
from fte_sniff.capture.source import Connection, Received, Source
from fte_sniff.errors import FileError, PortError
from fte_sniff.protocol.items import Chunk, PortEvent, PortEventKind
from tests.capture.seen import CLOCK, Seen
from tests.waiting import BOUND_S, wait_until


class Line:
    """A connection of one wire, whose reads a test gives."""

    def __init__(self, name: str = "a", clock: Any = CLOCK) -> None:
        self.name, self.clock = name, clock
        self.reads: list[bytes | BaseException] = []
        self.closed = 0
        self.refusals: list[Exception] = []
        self.rest = b""

    def connect(self) -> Connection:
        if self.refusals:
            raise self.refusals.pop(0)
        return Connection((self.name,), "", (self._read,), self._close)

    def _close(self) -> Iterable[Received]:
        self.closed += 1
        yield Chunk(self.name, self.clock.now_ns(), self.rest)

    def _read(self) -> Iterable[Received]:
        read = self.reads.pop(0) if self.reads else b""
        if isinstance(read, BaseException):
            raise read
        if not read:
            threading.Event().wait(0.001)
        return (Chunk(self.name, self.clock.now_ns(), read),)


@pytest.fixture
def line() -> Line:
    return Line()


def source_of(*lines: Line, reconnect: bool = False) -> Source:
    return Source([line.connect for line in lines], CLOCK, reconnect=reconnect)


def test_items_come_in_order_between_opened_and_closed(line: Line) -> None:
    line.reads += [b"one", b"two", b"three"]
    line.rest = b"rest"
    with Seen(source_of(line)) as seen:
        seen.wait(lambda s: s.data() == b"onetwothree")
    assert seen.data() == b"onetwothreerest"
    assert seen.kinds() == ["opened", "closed"]
    assert seen.times("a") == sorted(seen.times("a"))
    assert seen.source.lost is None
    assert line.closed == 1
    assert list(chain.from_iterable(seen.source)) == []


def test_batches_gather_for_50_ms_unless_one_is_full(line: Line, monkeypatch) -> None:
    source = source_of(line)
    began_s, batches = time.monotonic(), iter(source)
    for _ in range(6):
        next(batches)
    assert time.monotonic() - began_s >= 5 * module.BATCH_S
    monkeypatch.setattr(module, "_MOST_BATCH", 100)
    line.reads += [b"a" * 60] * 5
    wait_until(lambda: source.waiting == 300)
    sizes = [sum(len(one.data) for one in next(batches) if isinstance(one, Chunk)) for _ in "abc"]
    assert sizes == [120, 120, 60]
    source.close()


def test_source_that_is_never_read_closes_what_it_opened(line: Line) -> None:
    source_of(line).close()
    assert line.closed == 1


def test_nothing_stays_open_when_one_cannot_connect(line: Line) -> None:
    other = Line("b")
    other.refusals = [PortError("absent")]
    with pytest.raises(PortError, match="absent"):
        source_of(line, other)
    assert line.closed == 1


def test_watched_program_that_ends_is_not_an_error(line: Line) -> None:
    line.reads.append(EOFError("it ended"))
    seen = Seen(source_of(line))
    seen.ended()
    assert seen.events()[-1].detail == "it ended"
    assert seen.source.lost is None


def test_lost_connection_is_found_again_and_time_goes_on(line: Line, monkeypatch) -> None:
    monkeypatch.setattr(module, "RECONNECT_S", 0.01)
    comes_back = threading.Event()

    def again() -> Connection:
        comes_back.wait(BOUND_S)
        return line.connect()

    line.reads += [b"one", OSError("gone")]
    with Seen(Source([first_then(line.connect, again)], CLOCK, reconnect=True)) as seen:
        lost = seen.wait_for("lost")
        # No consumer waits for the times of a port that is away.
        seen.wait(lambda s: s.times("a")[-1] > lost.t_ns)
        line.reads.append(b"two")
        comes_back.set()
        found = seen.wait_for("found_again")
        seen.wait(lambda s: s.data() == b"onetwo")
    assert lost.detail == "gone; waiting for it"
    seconds = float(re.fullmatch(r"after (\d+\.\d) s", found.detail)[1])
    assert 0 <= seconds <= (found.t_ns - lost.t_ns) / 1e9 + 0.05
    assert line.closed == 2


def test_refusal_is_reported_once_and_tried_again(line: Line, monkeypatch) -> None:
    monkeypatch.setattr(module, "RECONNECT_S", 0.01)
    line.reads += [b"x", OSError("gone")]
    source = source_of(line, reconnect=True)
    line.refusals = [PortError("away"), *(module.RefusedError("busy") for _ in range(5))]
    with Seen(source) as seen:
        seen.wait_for("found_again")
    assert seen.kinds() == ["opened", "lost", "not_opened", "found_again", "closed"]
    assert seen.events()[2].detail == "it is back, but busy"


def test_file_error_loses_the_connection_for_good(line: Line) -> None:
    line.reads += [b"x", OSError("gone")]
    source = source_of(line, reconnect=True)
    line.refusals = [FileError("the link exists")]
    seen = Seen(source)
    seen.ended()
    assert seen.kinds() == ["opened", "lost", "lost"]
    assert seen.source.lost is not None


def test_attempt_that_hangs_does_not_hold_up_the_end(line: Line) -> None:
    hangs, asked = threading.Event(), threading.Event()
    line.reads.append(OSError("gone"))

    def hang() -> Connection:
        asked.set()
        hangs.wait(BOUND_S)
        raise PortError("no answer")

    with Seen(Source([first_then(line.connect, hang)], CLOCK, reconnect=True)):
        wait_until(asked.is_set)
    assert not hangs.is_set()
    hangs.set()


def first_then(
    first: Callable[[], Connection], later: Callable[[], Connection]
) -> Callable[[], Connection]:
    calls = [first]
    return lambda: (calls.pop() if calls else later)()


def test_connection_that_comes_after_the_end_is_closed(line: Line) -> None:
    asked, may_go_on = threading.Event(), threading.Event()
    line.reads.append(OSError("gone"))
    late = Line()

    def slow() -> Connection:
        asked.set()
        may_go_on.wait(BOUND_S)
        return late.connect()

    with Seen(Source([first_then(line.connect, slow)], CLOCK, reconnect=True)):
        wait_until(asked.is_set)
    may_go_on.set()
    wait_until(lambda: late.closed)


def test_what_does_not_fit_is_counted_where_it_is_missing(line: Line, monkeypatch) -> None:
    monkeypatch.setattr(module, "CAPACITY", 2000)
    source = source_of(line)
    # At the last, empty read, all before it were put.
    line.reads += [b"a" * 1000, b"b" * 3000, *(b"c" * 100 for _ in range(10)), b""]
    with source:
        wait_until(lambda: not line.reads)
        items = chain.from_iterable(source)
        found = [next(items) for _ in range(3)]
        # There is room again, and what comes now is kept.
        line.reads.append(b"d" * 10)
        while found[-1] != Chunk("a", found[-1].t_ns, b"d" * 10):
            found.append(next(items))
    sizes = [len(one.data) for one in found if isinstance(one, Chunk) and one.data]
    lost = [one for one in found if isinstance(one, PortEvent) and one.count]
    assert sum(sizes) + sum(one.count for one in lost) == 5010
    assert {one.kind for one in lost} == {PortEventKind.OVERRUN}
    after = found[found.index(lost[-1]) :]
    assert [len(one.data) for one in after if isinstance(one, Chunk) and one.data] == [10]


class SteppedClock:
    """A clock that only a test moves."""

    t_ns = 0

    def now_ns(self) -> int:
        return self.t_ns


@pytest.mark.parametrize("idle_before", [False, True])
def test_bytes_after_a_pause_of_the_reader_may_be_late(*, idle_before: bool) -> None:
    """After a pause an empty read tells nothing: bytes may have come since."""
    clock = SteppedClock()
    line = Line(clock=clock)

    class HeldUp(bytes):
        def __bool__(self) -> bool:
            clock.t_ns += module._HELD_UP_NS + 1
            return len(self) > 0

    line.reads += [b"early", *([HeldUp(b""), b"late"] if idle_before else [HeldUp(b"late")])]
    with Seen(Source([line.connect], clock, reconnect=False)) as seen:
        seen.wait(lambda s: s.data() == b"earlylate")
    assert [chunk.is_late for chunk in seen.chunks()] == [False, True]


def test_what_was_read_before_a_loss_is_kept(line: Line) -> None:
    def read() -> Iterable[Received]:
        yield Chunk("a", CLOCK.now_ns(), b"last words")
        raise OSError("gone")

    connection = Connection(("a",), "", (read,), tuple)
    seen = Seen(Source([lambda: connection], CLOCK, reconnect=False))
    seen.ended()
    assert seen.data() == b"last words"
    assert seen.kinds() == ["opened", "lost"]
