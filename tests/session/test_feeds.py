"""Feeds: what was read is shown at once."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator

from fte_sniff.protocol.items import PortEvent, PortEventKind
from fte_sniff.protocol.rows import Item, Rows
from fte_sniff.session.feeds import FileFeed
from tests.waiting import BOUND_S, wait_until


def test_a_poll_does_not_wait_for_more() -> None:
    going = threading.Semaphore(0)

    def items() -> Iterator[Item]:
        while going.acquire():
            yield PortEvent(0, "a", PortEventKind.LOST, "")

    feed, began_s = FileFeed(items(), "a"), time.monotonic()
    for _ in range(20):
        going.release()
        wait_until(lambda: feed.poll().events)
    feed.stop()
    going.release()
    feed.close()
    assert time.monotonic() - began_s < 15


def test_the_first_rows_come_alone() -> None:
    are_read = threading.Event()

    def items() -> Iterator[Item]:
        yield from (Rows.blank(count, ("a",)) for count in (3, 5, 7))
        are_read.set()

    feed = FileFeed(items(), "a")
    assert are_read.wait(BOUND_S)
    assert [len(feed.poll().rows) for _ in range(2)] == [3, 12]
    feed.close()
