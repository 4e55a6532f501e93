"""The screen as its users meet it: in a terminal, through `live` and `view`."""

from __future__ import annotations

import fcntl
import os
import pty
import select
import struct
import subprocess
import termios
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from time import monotonic

import pytest

from tests.cli.conftest import SAMPLES
from tests.cli.processes import BOUND_S, PROGRAM


class Terminal:
    """The program in a terminal of a given size, and all it has drawn so far."""

    def __init__(self, far: int, process: subprocess.Popen[bytes]) -> None:
        self.process = process
        self._far = far
        self.drawn = b""

    def type(self, keys: str) -> None:
        os.write(self._far, keys.encode())

    def until(self, wanted: str) -> None:
        """Wait until something is drawn."""
        start, deadline = len(self.drawn), monotonic() + BOUND_S
        while wanted.encode() not in self.drawn[start:]:
            assert self._draw(deadline - monotonic()), self.drawn[-2000:]

    def ended(self) -> int:
        """Wait for the end; the exit code."""
        deadline = monotonic() + BOUND_S
        while self._draw(deadline - monotonic()):
            pass
        return self.process.wait(BOUND_S)

    def _draw(self, timeout_s: float) -> bool:
        if timeout_s <= 0 or not select.select([self._far], [], [], timeout_s)[0]:
            return False
        try:
            more = os.read(self._far, 1 << 16)
        except OSError:  # the terminal's other side is closed: the program has ended
            return False
        self.drawn += more
        return bool(more)


@contextmanager
def terminal(
    environment: dict[str, str], folder: Path, *arguments: str, size: tuple[int, int] = (80, 24)
) -> Iterator[Terminal]:
    far, near = pty.openpty()
    fcntl.ioctl(near, termios.TIOCSWINSZ, struct.pack("HHHH", size[1], size[0], 0, 0))
    with subprocess.Popen(
        [*PROGRAM, *arguments],
        stdin=near,
        stdout=near,
        stderr=near,
        env=environment,
        cwd=folder,
        start_new_session=True,
    ) as process:
        os.close(near)
        try:
            yield Terminal(far, process)
        finally:
            if process.poll() is None:
                process.kill()
            os.close(far)


@pytest.mark.parametrize("size", [(40, 10), (80, 24), (200, 60)])
def test_live_shows_rows_and_leaving_says_where_the_recording_lies(
    run, environment, tmp_path: Path, size: tuple[int, int]
) -> None:
    with terminal(environment, tmp_path, "live", "sim://?rate=500", size=size) as screen:
        screen.until("speed_feedback" if size[0] > 128 else "speed fb")
        screen.type("q")
        assert screen.ended() == 0
    assert b"Traceback" not in screen.drawn
    (recording,) = tmp_path.glob("*.mcap")
    assert f"recorded to {recording.name}".encode() in screen.drawn
    assert run("decode", recording).stdout.count("\n") > 1


def test_ctrl_c_and_a_bounded_capture_end_it_too(environment, tmp_path: Path) -> None:
    with terminal(environment, tmp_path, "live", "sim://?rate=500", "--no-record") as screen:
        screen.until("speed fb")
        screen.type("\x03")
        assert screen.ended() == 0
    with terminal(
        environment, tmp_path, "live", "sim://", "--count", "9", "-o", "x.mcap"
    ) as screen:
        assert screen.ended() == 0
    assert b"recorded to x.mcap" in screen.drawn


def test_no_color(environment, tmp_path: Path) -> None:
    environment = environment | {"NO_COLOR": "1"}
    with terminal(environment, tmp_path, "live", "sim://?drop=0.3", "--no-record") as screen:
        screen.until("truncated")
        screen.type("q")
        assert screen.ended() == 0
    assert b"\x1b[38;2" not in screen.drawn


def test_a_port_that_is_lost_stays_on_the_screen_until_the_user_leaves(
    environment, tmp_path: Path
) -> None:
    port = "sim://?rate=500&frames=40"
    with terminal(environment, tmp_path, "live", port, "--no-record", size=(200, 60)) as screen:
        screen.until("was lost")
        screen.type("q")
        assert screen.ended() == 3


def test_a_killed_screen_leaves_a_file_that_opens(run, environment, tmp_path: Path) -> None:
    with terminal(environment, tmp_path, "live", "sim://?rate=500", "-o", "x.mcap") as screen:
        screen.until("speed fb")
        screen.process.kill()
    assert run("decode", "x.mcap").returncode == 0


@pytest.mark.parametrize("name", ["clean.mcap", "damaged.raw", "midstream.hex"])
def test_view_shows_files(environment, tmp_path: Path, name: str) -> None:
    with terminal(environment, tmp_path, "view", str(SAMPLES / name), size=(200, 60)) as screen:
        screen.until("speed_feed")
        screen.type("q")
        assert screen.ended() == 0
    assert b"Traceback" not in screen.drawn


def test_view_tells_what_cannot_be_read_before_the_screen_opens(
    environment, tmp_path: Path
) -> None:
    with terminal(environment, tmp_path, "view", "none.mcap") as screen:
        assert screen.ended() == 4
    assert screen.drawn.count(b"\n") == 1
    assert b"none.mcap: there is no such file" in screen.drawn


def test_hex_takes_a_frame_apart_in_the_width_of_the_terminal(environment, tmp_path: Path) -> None:
    frame = "AA 02 02 03 E8 00 00 27 10 EE"
    with terminal(environment, tmp_path, "hex", frame, size=(60, 24)) as screen:
        assert screen.ended() == 0
    text = screen.drawn.decode()
    assert "\x1b[1m" in text
    assert "10000 pulses" in text
