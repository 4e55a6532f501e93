"""The wait for the disk is what a thread neither runs nor waits for a processor."""

import os
import time
from itertools import pairwise
from pathlib import Path

import pytest

from fte_sniff.recording.disk_wait import DiskWait
from tests.beside import Work
from tests.waiting import BOUND_S

pytestmark = pytest.mark.skipif(
    not Path("/proc/self/schedstat").exists(), reason="the system does not count what threads do"
)
LONG_S = 0.3


def test_a_call_that_blocks_is_a_wait() -> None:
    wait = DiskWait()
    reading, writing = os.pipe()

    def blocked() -> None:
        with wait.call():
            os.read(reading, 1)

    work = Work(blocked)
    until_s = time.monotonic() + BOUND_S
    while wait.seconds < LONG_S:  # known while the call lasts
        assert time.monotonic() < until_s, "the wait was not counted"
        time.sleep(0.01)
    os.write(writing, b"x")
    work.ended()
    assert wait.seconds >= LONG_S
    os.close(reading)
    os.close(writing)


def test_a_busy_processor_is_no_wait() -> None:
    """However long it takes: what others take of the processor is not a wait either."""
    wait = DiskWait()
    began_s = time.monotonic()
    with wait.call():
        for count in range(200):
            sum(range(count, 100_000))
    assert wait.seconds < (time.monotonic() - began_s) / 2


def test_waits_add_up() -> None:
    wait = DiskWait()
    waited_s = [0.0]
    for _ in range(3):
        with wait.call():
            time.sleep(0.02)
        waited_s.append(wait.seconds)
    # A busy machine counts less of a sleep: what it queues for a processor is no wait of the disk.
    assert all(earlier < later for earlier, later in pairwise(waited_s))
