"""Feeds: what was read is shown at once."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator

from fte_sniff.protocol.items import PortEvent, PortEventKind
from fte_sniff.protocol.rows import Item
from fte_sniff.session.feeds import FileFeed
from tests.waiting import wait_until


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
