"""`doctor` and `ports` as their users run them, with lines whose baud the test knows."""

from __future__ import annotations

import os
import select
import termios
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from random import Random

import pytest

from fte_sniff.protocol.spec import DEFAULT_BAUD, KINDS, Direction
from tests.beside import Work
from tests.cli.conftest import Run
from tests.slow import first
from tests.support.faults import draw_frame, ordinary
from tests.support.uart import received

BAUD_OF = {getattr(termios, name): int(name[1:]) for name in dir(termios) if name[1:].isdecimal()}
FEEDBACK = tuple(kind for kind in KINDS if kind.direction is Direction.FEEDBACK)
OUTPUT_SPEED = 5
CHUNK = 16
LONG = "10"
"""Seconds for a line that talks: enough came long before, except on an overloaded machine."""


class Line:
    """A sender with its own baud, and a simulated UART between it and a pseudo-terminal.

    The UART has the baud that the program has set, and so receives the bytes that a real UART with
    this baud makes of the sender's signal.
    """

    def __init__(self, far: int, baud: int, *, inverted: bool = False) -> None:
        random = Random("line")
        self._frames = [draw_frame(random, ordinary, FEEDBACK) for _ in range(40)]
        self._far, self._baud, self._inverted = far, baud, inverted
        self._received: dict[int, bytes] = {}
        self._ended = threading.Event()
        self.bauds_set: list[int] = []

    @contextmanager
    def sending(self) -> Iterator[Line]:
        # The most used bauds are computed before the start, so that sending is not interrupted.
        for baud in (DEFAULT_BAUD, self._baud):
            self._received_at(baud)
        sending = Work(self._run)
        try:
            yield self
        finally:
            self._ended.set()
            sending.ended()

    def _run(self) -> None:
        os.set_blocking(self._far, False)
        at = 0
        while not self._ended.wait(0.002):
            baud = BAUD_OF[termios.tcgetattr(self._far)[OUTPUT_SPEED]]
            if self.bauds_set[-1:] != [baud]:
                self.bauds_set.append(baud)
                at = 0
            data = self._received_at(baud)
            try:
                at += os.write(self._far, data[at : at + CHUNK])
            except BlockingIOError:
                continue
            at %= len(data)

    def _received_at(self, baud: int) -> bytes:
        if baud not in self._received:
            self._received[baud] = received(
                1, self._frames, self._baud, baud, inverted=self._inverted
            )
        return self._received[baud]


@contextmanager
def wire() -> Iterator[tuple[int, str]]:
    """A pseudo-terminal that nobody has open but at its far end: `doctor` would find who has."""
    far, near = os.openpty()
    port = os.ttyname(near)
    os.close(near)
    try:
        yield far, port
    finally:
        os.close(far)


def doctor(run: Run, *arguments: str) -> tuple[int, dict[str, list[str]]]:
    """The exit code, and what is said of the port by level."""
    done = run("doctor", *arguments)
    assert not done.stderr, done.stderr
    said: dict[str, list[str]] = {"ok": [], "warn": [], "bad": []}
    for line in done.stdout.splitlines():
        level, finding = line.split(None, 1)
        assert finding.startswith(f"{arguments[0]}: ")
        said[level].append(finding)
    return done.returncode, said


def test_a_sound_line_is_well(run: Run) -> None:
    with wire() as (far, port), Line(far, 115_200).sending():
        code, said = doctor(run, port, "--duration", LONG)
    assert code == 0
    assert not said["bad"]
    assert "are in frames: feedback (the controller's TX wire)" in said["ok"][-1]


def test_a_line_without_frames_is_reported_with_the_command_that_probes_it(run: Run) -> None:
    with wire() as (far, port), Line(far, 57_600).sending() as line:
        code, said = doctor(run, port, "--duration", LONG)
    assert code == 1
    (bad,) = said["bad"]
    assert "at 115200 baud: another baud rate, swapped polarity, or another device" in bad
    assert bad.endswith(f"->  fte-sniff doctor {port} --probe")
    assert [baud for baud in line.bauds_set if baud != 38_400] == [115_200]


@pytest.mark.parametrize("baud", first(2, [230_400, 57_600, 19_200, 1_000_000]))
def test_a_probe_finds_the_baud(run: Run, baud: int) -> None:
    with wire() as (far, port), Line(far, baud).sending() as line:
        code, said = doctor(run, port, "--duration", LONG, "--probe")
    assert code == 1
    assert f"bytes are in frames at {baud} baud" in said["bad"][-1]
    assert said["bad"][-1].endswith(f"->  fte-sniff live {port} --baud {baud}")
    assert line.bauds_set[-1] == baud


def test_a_probe_of_a_sound_line_touches_nothing(run: Run) -> None:
    with wire() as (far, port), Line(far, 115_200).sending() as line:
        code, said = doctor(run, port, "--duration", LONG, "--probe")
    assert code == 0
    assert said["ok"][-1].endswith("probe: not needed, the baud is right")
    assert [baud for baud in line.bauds_set if baud != 38_400] == [115_200]


def test_a_dead_wire_is_reported_and_nothing_is_written_to_it(run: Run) -> None:
    with wire() as (far, port):
        code, said = doctor(run, port, "--duration", "0.3", "--probe")
        poll = select.poll()
        poll.register(far, select.POLLIN)
        written = [events for _, events in poll.poll(0) if events & select.POLLIN]
    assert not written
    assert code == 1
    assert "nothing came: a dead wire" in said["bad"][0]


def test_without_a_port_no_port_is_opened(run: Run) -> None:
    done = run("doctor")
    assert (done.returncode, done.stderr) == (0, "")
    assert "ports: " in done.stdout
    assert ("USB adapters: " in done.stdout) is not ("doctor /dev/ttyS0`" in done.stdout)
