"""Recorded bytes that are played into a pseudo-terminal, for a host program."""

from __future__ import annotations

import itertools
import os
import threading
import time
from collections.abc import Iterator

import pytest
import serial

from fte_sniff.capture.bridge import HostEnd
from fte_sniff.capture.player import play
from tests.beside import Work
from tests.waiting import BOUND_S, wait_until


@pytest.fixture
def host() -> Iterator[HostEnd]:
    end = HostEnd()
    yield end
    end.close()


def test_bytes_are_played_at_their_times_once_a_program_opens_it(host: HostEnd) -> None:
    timed = [(number / 50, bytes([number]) * 10) for number in range(20)]
    results, stopped = list[tuple[int, int]](), threading.Event()
    playing = Work(lambda: results.append(play(host, timed, stopped.is_set)))
    arrivals = [time.monotonic()]
    with serial.Serial(host.name, timeout=BOUND_S) as program:
        for _, data in timed:
            assert program.read(10) == data
            arrivals.append(time.monotonic())
        playing.ended()
    assert results == [(200, 0)]
    # A busy machine makes bytes late, but none early.
    assert arrivals[-1] - arrivals[0] >= 19 / 50
    assert min(after - before for before, after in itertools.pairwise(arrivals[1:])) < 0.05


def test_what_a_program_does_not_read_in_time_is_counted(host: HostEnd) -> None:
    data, results = os.urandom(50_000), list[tuple[int, int]]()
    stopped = threading.Event()
    with serial.Serial(host.name, timeout=BOUND_S) as program:
        timed = [(0.0, data[at : at + 10]) for at in range(0, len(data), 10)]
        playing = Work(lambda: results.append(play(host, timed, stopped.is_set)))
        wait_until(lambda: program.in_waiting > 1000)
        wait_until(lambda: host.unread == program.in_waiting)
        read = b""
        while playing.is_alive():
            read += program.read(program.in_waiting)
        playing.ended()
    ((written, refused),) = results
    assert written + refused == len(data)
    assert len(read) == written


def test_device_stays_until_a_slow_program_has_read_all(host: HostEnd) -> None:
    results, stopped = list[tuple[int, int]](), threading.Event()
    with serial.Serial(host.name, timeout=BOUND_S) as program:
        playing = Work(lambda: results.append(play(host, [(0.0, b"x" * 100)], stopped.is_set)))
        playing.join(1.0)
        assert playing.is_alive()
        assert program.read(100) == b"x" * 100
        playing.ended()
    assert results == [(100, 0)]


def test_what_the_program_writes_does_not_hold_it_up(host: HostEnd) -> None:
    results, stopped = list[tuple[int, int]](), threading.Event()
    timed = [(number / 100, b"x") for number in range(30)]
    playing = Work(lambda: results.append(play(host, timed, stopped.is_set)))
    with serial.Serial(host.name, timeout=BOUND_S, write_timeout=BOUND_S) as program:
        program.write(bytes(20_000))
        assert program.read(30) == b"x" * 30
        playing.ended()
    assert results == [(30, 0)]
