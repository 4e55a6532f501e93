"""What waits for a consumer: in order, bounded, and with a true count of what is left out."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from itertools import islice, takewhile
from typing import cast

import pytest

from fte_sniff.capture.source import ChunkQueue, Item
from fte_sniff.protocol import Chunk, Damage, Framer, PortEvent, PortEventKind, Row

FRAME = bytes.fromhex("55010100000000000FEE")
OPENED = PortEvent(0, "a", PortEventKind.OPENED, "")


def lengths_and_kinds(items: list[Item]) -> list[int | str]:
    return [len(item.data) if isinstance(item, Chunk) else item.kind.value for item in items]


def test_what_waits_is_counted_in_bytes() -> None:
    queue = ChunkQueue("a")
    queue.put_event(OPENED)
    queue.put(Chunk("a", 1, b"abc"))
    queue.put(Chunk("a", 2, b"de"))
    assert queue.waiting == 5
    assert len(list(islice(queue, 2))) == 2
    assert queue.waiting == 2


def test_only_bytes_after_a_pause_of_the_reader_may_be_late() -> None:
    queue = ChunkQueue("a")
    times_ms = {0: False, 1: False, 5000: True, 5001: False, 9001: True, 9002: False}
    for at_ms in (0, 1, 5000, 5001, 9000, 9001, 9002):
        queue.put(Chunk("a", at_ms * 10**6, b"abc" * (at_ms != 9000)))
    queue.close()
    chunks = [item for item in queue if isinstance(item, Chunk)]
    assert {(chunk.t_ns or 0) // 10**6: chunk.is_late for chunk in chunks} == times_ms


def test_once_full_it_takes_bytes_again_when_half_is_free() -> None:
    queue = ChunkQueue("a", capacity=10_000)
    for t_ns in range(12):
        queue.put(Chunk("a", t_ns, bytes(744)))
    assert queue.waiting == 10 * 744
    items = iter(queue)
    for taken in range(1, 11):
        next(items)
        queue.put(Chunk("a", 100 + taken, bytes(744)))
        if taken == 6:
            break
        assert queue.waiting == (10 - taken) * 744
    assert queue.waiting == 5 * 744
    queue.close()
    assert lengths_and_kinds(list(items)) == [744] * 4 + ["overrun", 744]


def test_an_overrun_costs_the_frames_at_its_seams_and_no_other() -> None:
    queue, framer = ChunkQueue("a", capacity=20_000), Framer("a", 115_200)
    stream = FRAME * 20_000
    taking = iter(queue)
    rows, overruns = [], 0

    def take(count: int) -> None:
        nonlocal overruns
        for item in islice(taking, count):
            if isinstance(item, Chunk):
                rows.extend(framer.feed(item))
            else:
                overruns += 1
                rows.extend(framer.restart())

    for number, at in enumerate(range(0, len(stream), 997)):
        queue.put(Chunk("a", number, stream[at : at + 997]))
        if number % 4 == 3:
            take(3)
    queue.close()
    take(len(stream))
    rows.extend(framer.flush())
    damages = [row for row in rows if isinstance(row, Damage)]
    assert 1 < overruns < 20
    assert 0 < len(damages) <= 2 * overruns + 1
    # A frame without its end, and an end without its beginning.
    assert all(len(row.raw) < len(FRAME) for row in damages)
    assert {fault for row in damages for fault in row.faults} <= {"truncated", "noise"}
    assert Counter(type(row).__name__ for row in rows)["Frame"] > 1000


@pytest.mark.parametrize(
    ("idle_ms", "is_known"),
    [(range(10, 1000, 10), True), ((), False), ((995,), False), ((985, 995), True)],
)
def test_silence_counts_only_where_the_reader_ran(idle_ms: Sequence[int], is_known: bool) -> None:
    """A reader that runs reports silence every 10 ms; it may sleep just after a read."""
    queue, framer, rows = ChunkQueue("a"), Framer("a"), list[Row]()
    parts = {0: FRAME * 3 + FRAME[:4], **dict.fromkeys(idle_ms, b""), 1000: FRAME[4:] + FRAME}
    for t_ms, data in parts.items():
        queue.put(Chunk("a", t_ms * 1_000_000, data))
        queue.put_event(OPENED)
        for chunk in takewhile(lambda item: item is not OPENED, queue):
            rows += framer.feed(cast("Chunk", chunk))
    rows += framer.flush()
    damaged = [bool(row.faults) for row in rows]
    assert damaged == ([*3 * [False], True, True, False] if is_known else 5 * [False])
