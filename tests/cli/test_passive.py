"""Passive means passive: whatever `live` is told to do, the other end of the line gets no byte."""

from __future__ import annotations

import itertools
import os
import pty as terminals
import select
import signal
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from tests.cli.processes import BOUND_S, FRAME, PROGRAM, Process, ended, started, until, wire
from tests.rfc2217_server import DTR_OFF, DTR_ON, RTS_OFF, RTS_ON, serving

_MODEM = frozenset({DTR_ON, DTR_OFF, RTS_ON, RTS_OFF})
_NOISY = FRAME + bytes(range(256)) + b"\x03\x04\x11\x13\x1a\x1c\r\n\x7f\xff" + FRAME
"""Frames, and all that a terminal could answer, echo or obey."""


class Watched:
    """The far end of a line: it sends all the while, and keeps all that it gets."""

    def __init__(self, far: int) -> None:
        self.got = b""
        self._far = far
        self._ends, self._ending = os.pipe()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def end(self) -> None:
        os.write(self._ending, b"!")
        self._thread.join()
        os.close(self._ends)
        os.close(self._ending)
        # What was written before the last program let go of the line is there yet.
        while select.select([self._far], [], [], 0)[0]:
            self.got += os.read(self._far, 65536)

    def _run(self) -> None:
        # What nobody reads must not fill the line.
        os.set_blocking(self._far, False)
        while True:
            ready, _, _ = select.select([self._ends, self._far], [], [], 0.005)
            if self._ends in ready:
                return
            if self._far in ready:
                self.got += os.read(self._far, 65536)
            try:
                os.write(self._far, _NOISY)
            except BlockingIOError:
                continue


@contextmanager
def watched_wire() -> Iterator[tuple[Watched, str]]:
    """A terminal whose far end is watched from before it is opened until after it is closed."""
    with wire() as (far, name):
        watched = Watched(far)
        try:
            yield watched, name
        finally:
            watched.end()


def listens(process: Process) -> None:
    until(process, b"reset")


_END_BY = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGKILL)
_OPTIONS = (
    ("--no-record",),
    ("-o", "x.mcap", "--filter", "motor = 1 OR motor IS NULL"),
    ("--baud", "9600", "--no-record"),
    ("--baud", "250000", "--no-record"),
    *(
        ("--dtr", dtr, "--rts", rts, "--no-record")
        for dtr, rts in itertools.product(("on", "off", "leave"), repeat=2)
    ),
)


@pytest.mark.parametrize("options", _OPTIONS, ids=" ".join)
def test_no_byte_whatever_the_options(environment, tmp_path: Path, options: tuple[str, ...]):
    with (
        watched_wire() as (watched, name),
        started(environment, tmp_path, "live", name, "--plain", *options) as process,
    ):
        listens(process)
        process.terminate()
        assert ended(process)[0] == 0
    assert watched.got == b""


@pytest.mark.parametrize("number", _END_BY)
def test_no_byte_however_it_ends(environment, tmp_path: Path, number: int):
    with (
        watched_wire() as (watched, name),
        started(environment, tmp_path, "live", name, "--plain", "--no-record") as process,
    ):
        listens(process)
        process.send_signal(number)
        ended(process)
    assert watched.got == b""


def test_no_byte_when_it_ends_by_itself(run):
    with watched_wire() as (watched, name):
        for limits in (("--duration", "0.3"), ("--count", "5")):
            assert run("live", name, "--no-record", *limits).returncode == 0
    assert watched.got == b""


def test_no_byte_on_either_of_two_wires(run):
    with watched_wire() as (one, name), watched_wire() as (other, second):
        assert run("live", name, second, "--no-record", "--duration", "0.5").returncode == 0
    assert one.got == other.got == b""


def test_no_byte_when_the_recording_cannot_be_made(run):
    with watched_wire() as (watched, name):
        assert run("live", name, "-o", "no/such/folder/x.mcap").returncode == 4
    assert watched.got == b""


def test_no_byte_from_a_screen_with_busy_keys(environment, tmp_path: Path):
    with watched_wire() as (watched, name):
        pid, screen = terminals.fork()
        if pid == 0:
            os.chdir(tmp_path)
            arguments = [*PROGRAM, "live", name, "--no-record"]
            os.execve(arguments[0], arguments, {**environment, "TERM": "xterm-256color"})
        try:
            shown = b""
            while b"LIVE" not in shown:
                assert select.select([screen], [], [], BOUND_S)[0], shown
                shown += os.read(screen, 65536)
            # Typed ahead: into the table, into a prompt, and the keys that leave both.
            os.write(screen, b"jjkk G g /motor = 1\r \x1b[A\x1b[B\x1b[5~\x1b[6~")
            os.write(screen, b"q")
            _drain(screen)
        finally:
            os.close(screen)
            os.kill(pid, signal.SIGKILL)
            os.waitpid(pid, 0)
    assert watched.got == b""


def _drain(screen: int) -> None:
    """Read what is drawn, until the program has let go of the screen."""
    while select.select([screen], [], [], BOUND_S)[0]:
        try:
            if not os.read(screen, 65536):
                return
        except OSError:
            return
    raise AssertionError("it does not end")


@pytest.mark.parametrize(("dtr", "rts"), [*itertools.product(("on", "off"), repeat=2)])
def test_an_rfc2217_server_is_asked_for_the_lines_and_given_no_byte(
    environment, tmp_path: Path, dtr: str, rts: str
):
    with watched_wire() as (watched, name), serving(name) as server:
        options = ("--dtr", dtr, "--rts", rts, "--no-record", "--plain")
        with started(environment, tmp_path, "live", server.url, *options) as process:
            listens(process)
            process.terminate()
            assert ended(process)[0] == 0
        assert server.data == b""
        asked = {DTR_ON if dtr == "on" else DTR_OFF, RTS_ON if rts == "on" else RTS_OFF}
        assert _MODEM.intersection(server.controls) == asked
        assert set(server.bauds) == {115200}
    assert watched.got == b""


def test_a_socket_is_given_no_byte(environment, tmp_path: Path):
    with socket.create_server(("127.0.0.1", 0)) as listening:
        url = f"socket://127.0.0.1:{listening.getsockname()[1]}"
        with started(environment, tmp_path, "live", url, "--plain", "--no-record") as process:
            client, _ = listening.accept()
            with client:
                client.sendall(_NOISY * 3)
                listens(process)
                process.terminate()
                assert ended(process)[0] == 0
                client.settimeout(BOUND_S)
                assert client.recv(100) == b""
