"""What becomes of the screen when its terminal goes, stands still, is resized, or serves a shell.

Whatever it is: the program ends when it should, the recording is whole, and nothing is left behind.
"""

from __future__ import annotations

import os
import shutil
import signal
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.cli.processes import PROGRAM, holding, wait_until
from tests.cli.terminals import Terminal, in_session, ruling, silent, terminal

LIVE = ("live", "sim://?rate=2500", "--baud", "460800", "-o", "x.mcap")
END_S = 60.0
"""How long the end may take; on a quiet machine two seconds."""
ROWS = "55 02 0"
"""Feedback, as the table shows its bytes."""
NORMAL_SCREEN = "\x1b[?1049l"
TELLING = pytest.mark.parametrize("manner", [ruling, silent])
TIMES = pytest.mark.parametrize("time", range(int(os.environ.get("REPEATS", "1"))))
"""What depends on the moment shows at times only: REPEATS=20 looks longer for it."""


def draws_much(screen: Terminal) -> None:
    """Wait until the screen is up, and have it draw at every key."""
    screen.until(ROWS)
    screen.type("M" + "kkkjjj" * 40)


def stands_still(recording: Path) -> None:
    """Wait, without reading the terminal, until far more was to be drawn than it can take."""
    enough = recording.stat().st_size + 25_000
    wait_until(lambda: recording.stat().st_size > enough)


def assert_all_is_well(run, screen: Terminal, recording: Path) -> None:
    """The program has ended, with all that it had started, and the recording is whole."""
    assert screen.process.wait(END_S) in (0, -signal.SIGHUP)
    wait_until(lambda: in_session(screen.process.pid) == [])
    assert_whole(run, recording)


def assert_whole(run, recording: Path) -> None:
    done = run("decode", recording)
    assert done.returncode == 0
    # This line alone: nothing of a cut end.
    assert " rows, nothing malformed" in done.stderr
    assert done.stderr.count("\n") == 1


@TIMES
@TELLING
def test_a_terminal_that_is_closed_ends_it(
    run, environment, tmp_path: Path, manner: Callable[[], None], time: int
) -> None:
    with terminal(environment, tmp_path, *LIVE, size=(200, 60), manner=manner) as screen:
        draws_much(screen)
        screen.close()
        assert_all_is_well(run, screen, tmp_path / "x.mcap")


@TIMES
def test_signals_that_come_with_the_end_of_a_terminal_change_nothing(
    run, environment, tmp_path: Path, time: int
) -> None:
    with terminal(environment, tmp_path, *LIVE, size=(200, 60), manner=ruling) as screen:
        draws_much(screen)
        screen.close()
        for number in (signal.SIGCONT, signal.SIGWINCH, signal.SIGHUP, signal.SIGCONT) * 5:
            screen.process.send_signal(number)
        assert_all_is_well(run, screen, tmp_path / "x.mcap")


@TELLING
def test_a_terminal_that_stands_still_and_is_closed_ends_it(
    run, environment, tmp_path: Path, manner: Callable[[], None]
) -> None:
    recording = tmp_path / "x.mcap"
    with terminal(environment, tmp_path, *LIVE, size=(200, 60), manner=manner) as screen:
        draws_much(screen)
        stands_still(recording)
        screen.resize(100, 30)
        screen.close()
        assert_all_is_well(run, screen, recording)


@pytest.mark.parametrize("way", ["q", signal.SIGTERM, signal.SIGINT, signal.SIGHUP])
def test_a_terminal_that_stands_still_does_not_hold_up_the_end(
    run, environment, tmp_path: Path, way: str | signal.Signals
) -> None:
    recording = tmp_path / "x.mcap"
    with terminal(environment, tmp_path, *LIVE, size=(200, 60)) as screen:
        draws_much(screen)
        stands_still(recording)
        if isinstance(way, str):
            screen.type(way)
        else:
            screen.process.send_signal(way)
        assert_all_is_well(run, screen, recording)


def test_a_terminal_that_goes_on_shows_what_is_true_now(run, environment, tmp_path: Path) -> None:
    recording = tmp_path / "x.mcap"
    with terminal(environment, tmp_path, *LIVE, size=(200, 60), manner=ruling) as screen:
        draws_much(screen)
        stands_still(recording)
        screen.resize(120, 40)
        stands_still(recording)
        screen.type("?")
        screen.until("Keys and signs")
        screen.type("q")
        screen.until(ROWS)
        screen.type("q")
        assert screen.ended() == 0
        assert b"recorded to x.mcap" in screen.drawn
        assert_all_is_well(run, screen, recording)


@TELLING
def test_a_recording_that_is_kept_goes_on_without_its_terminal(
    run, environment, tmp_path: Path, manner: Callable[[], None]
) -> None:
    recording = tmp_path / "x.mcap"
    arguments = (*LIVE, "--keep-recording")
    with terminal(environment, tmp_path, *arguments, size=(200, 60), manner=manner) as screen:
        draws_much(screen)
        screen.close()
        assert screen.process.wait(END_S) == -signal.SIGHUP
        captures_on(recording)
        (capture,) = holding(recording)
        os.kill(capture, signal.SIGTERM)
        assert_all_is_well(run, screen, recording)


def test_a_program_that_was_stopped_takes_its_terminal_back_and_gives_it_back(
    run, environment, tmp_path: Path
) -> None:
    recording = tmp_path / "x.mcap"
    with terminal(environment, tmp_path, *LIVE, manner=ruling) as screen:
        before = screen.attributes
        screen.until(ROWS)
        for _ in range(3):
            screen.process.send_signal(signal.SIGSTOP)
            captures_on(recording)
            screen.process.send_signal(signal.SIGCONT)
            screen.until(NORMAL_SCREEN)
            screen.until(ROWS)
        screen.type("q")
        assert screen.ended() == 0
        assert screen.attributes == before
        assert_all_is_well(run, screen, recording)


def captures_on(recording: Path) -> None:
    """Wait until more is recorded, and more than once."""
    for _ in range(2):
        enough = recording.stat().st_size
        wait_until(lambda enough=enough: recording.stat().st_size > enough)


def asked(screen: Terminal, keys: str) -> bytes:
    """What is drawn upon these keys, until the shell asks for more."""
    start = len(screen.drawn)
    screen.type(keys)
    screen.until("<ready>")
    return screen.drawn[start:]


@pytest.mark.skipif(shutil.which("bash") is None, reason="needs a shell with jobs")
@pytest.mark.parametrize("ends", ["q", "kill", "close"])
def test_ctrl_z_lends_the_terminal_to_the_shell_and_the_capture_goes_on(
    run, environment, tmp_path: Path, ends: str
) -> None:
    recording = tmp_path / "x.mcap"
    environment = environment | {"PS1": "<ready>", "PS2": "", "HISTFILE": ""}
    bash = ("bash", "--norc", "--noprofile", "--noediting", "-i")
    with terminal(environment, tmp_path, manner=ruling, program=bash) as screen:
        screen.until("<ready>")
        screen.type(" ".join([*PROGRAM, *(f"'{word}'" for word in LIVE)]) + "\r")
        screen.until(ROWS)
        for _ in range(2):
            assert NORMAL_SCREEN.encode() in asked(screen, "\x1a")
            captures_on(recording)
            asked(screen, "bg\r")
            assert b"\nicanon" in asked(screen, "stty -a | tr ' ' '\\n' | grep icanon\r")
            screen.type("fg\r")
            screen.until(ROWS)
        if ends == "q":
            assert b"recorded to x.mcap" in asked(screen, "q")
        else:
            asked(screen, "\x1a")
        if ends == "kill":
            screen.type("kill %1\r")
            screen.until("recorded to x.mcap")
        screen.close()
        wait_until(lambda: in_session(screen.process.pid) == [])
        assert_whole(run, recording)


def test_where_nobody_could_continue_it_ctrl_z_does_not_stop_it(
    run, environment, tmp_path: Path
) -> None:
    with terminal(environment, tmp_path, *LIVE, manner=ruling) as screen:
        screen.until(ROWS)
        screen.type("\x1a")
        screen.until(NORMAL_SCREEN)
        screen.until(ROWS)
        screen.type("q")
        assert screen.ended() == 0
