"""The screen as users meet it: `live` and `view` in a terminal."""

from __future__ import annotations

import os
import re
import signal
import sys
import time
from collections.abc import Callable
from pathlib import Path
from shutil import copy

import pytest

from tests.beside import state_of
from tests.cli.conftest import SAMPLES
from tests.cli.processes import PROGRAM, children_of, holding, wait_until
from tests.cli.terminals import Terminal, controlling_terminal, in_session, plain_terminal, terminal
from tests.slow import first
from tests.support.tools import needs
from tests.waiting import BOUND_S

pytestmark = pytest.mark.program


def test_ctrl_c_and_a_bounded_capture_end_it_too(environment, tmp_path: Path) -> None:
    """Without any colour where NO_COLOR is set."""
    plain = environment | {"NO_COLOR": "1"}
    with terminal(plain, tmp_path, "live", "sim://?drop=0.3", "--no-record") as screen:
        screen.until("truncated")
        screen.type("m\x03")
        assert screen.ended() == 0
    assert b"notes are in" not in screen.drawn  # they would go with the rows
    assert b"\x1b[38;2" not in screen.drawn
    with terminal(
        environment, tmp_path, "live", "sim://", "--count", "9", "-o", "x.mcap"
    ) as screen:
        assert screen.ended() == 0
    assert b"recorded to x.mcap" in screen.drawn


def test_standard_error_in_a_file_is_not_part_of_the_screen(environment, tmp_path: Path) -> None:
    reported = tmp_path / "err.log"
    arguments = ("live", "sim://?rate=500", "-o", "x.mcap")
    with terminal(environment, tmp_path, *arguments, errors=reported) as screen:
        screen.until("speed fb")
        assert reported.read_bytes() == b""
        screen.type("Q")
        assert screen.ended() == 0
    count, where = reported.read_text().splitlines()
    assert re.fullmatch(r"[0-9,]+ rows, nothing malformed, \d+\.\d{3} s from \S+Z", count)
    assert where == "recorded to x.mcap"
    assert b"recorded to" not in screen.drawn


@pytest.mark.smoke
@pytest.mark.parametrize("name", ["damaged.raw", "clean.mcap"])
def test_view_shows_files_and_writes_nothing(
    environment, settings_file: Path, tmp_path: Path, name: str
) -> None:
    with terminal(environment, tmp_path, "view", str(SAMPLES / name), size=(200, 60)) as screen:
        screen.until("speed_feed")
        screen.type("Q")
        assert screen.ended() == 0
    assert b"Traceback" not in screen.drawn
    assert not settings_file.exists()
    assert not list(tmp_path.iterdir())


def test_view_reports_unreadable_files_before_the_screen_opens(environment, tmp_path: Path) -> None:
    with terminal(environment, tmp_path, "view", "none.mcap") as screen:
        assert screen.ended() == 4
    assert screen.drawn.count(b"\n") == 1
    assert b"none.mcap: no such file" in screen.drawn
    (tmp_path / "x.mcap").write_bytes((SAMPLES / "clean.mcap").read_bytes()[:400])
    with terminal(environment, tmp_path, "view", "x.mcap") as screen:
        assert screen.ended() == 4
    assert screen.drawn.count(b"\n") == 1
    assert b"x.mcap: no row in it could be read" in screen.drawn


LIVE = ("live", "sim://?rate=2500", "-o", "x.mcap", "--baud", "460800")
ROWS_TERMINAL = "speed_feed"
"""A kind of rows, as a wide table shows it."""
NORMAL_SCREEN = "\x1b[?1049l"
SESSIONS = pytest.mark.parametrize("session", first(1, [controlling_terminal, plain_terminal]))


def draws_much(screen: Terminal) -> None:
    """Wait until the screen is up, and have it draw at every key."""
    screen.until(ROWS_TERMINAL)
    screen.type("M" + "kkkjjj" * 3)


def stands_still(recording: Path) -> None:
    """Wait, without reading the terminal, until far more was to be drawn than it can take."""
    enough = recording.stat().st_size + 25_000
    wait_until(lambda: recording.stat().st_size > enough)


def assert_all_is_well(run, screen: Terminal, recording: Path) -> None:
    """The program has ended, with all that it had started, and the recording is whole."""
    assert screen.process.wait(BOUND_S) in (0, -signal.SIGHUP)
    wait_until(lambda: in_session(screen.process.pid) == [] and holding(recording) == [])
    assert_whole(run, recording)


def assert_whole(run, recording: Path) -> None:
    done = run("decode", recording)
    assert done.returncode == 0
    # This line alone: nothing of a cut end.
    assert " rows, nothing malformed" in done.stderr
    assert done.stderr.count("\n") == 1


@SESSIONS
def test_a_terminal_that_stands_still_and_is_closed_ends_it(
    run, environment, tmp_path: Path, session: Callable[[], None]
) -> None:
    recording = tmp_path / "x.mcap"
    with terminal(environment, tmp_path, *LIVE, size=(200, 60), session=session) as screen:
        draws_much(screen)
        stands_still(recording)
        screen.resize(100, 30)
        screen.close()
        assert_all_is_well(run, screen, recording)


@pytest.mark.parametrize("way", first(2, ["Q", signal.SIGTERM, signal.SIGINT, signal.SIGHUP]))
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
    with terminal(
        environment, tmp_path, *LIVE, size=(200, 60), session=controlling_terminal
    ) as screen:
        draws_much(screen)
        stands_still(recording)
        screen.resize(120, 40)
        stands_still(recording)
        screen.type("?")
        screen.until("Keys and signs")
        screen.type("q")
        screen.until(ROWS_TERMINAL)
        screen.type("Q")
        assert screen.ended() == 0
        assert b"recorded to x.mcap" in screen.drawn
        assert_all_is_well(run, screen, recording)


@SESSIONS
def test_a_recording_that_is_kept_goes_on_without_its_terminal(
    run, environment, tmp_path: Path, session: Callable[[], None]
) -> None:
    recording = tmp_path / "x.mcap"
    # Its end is for a test that is killed: nothing else would end the capture.
    arguments = (*LIVE, "--keep-recording", "--duration", "15 min")
    with terminal(environment, tmp_path, *arguments, size=(200, 60), session=session) as screen:
        draws_much(screen)
        screen.close()
        assert screen.process.wait(BOUND_S) == -signal.SIGHUP
        captures_on(recording)
        (capture,) = holding(recording)
        os.kill(capture, signal.SIGTERM)
        assert_all_is_well(run, screen, recording)


def test_a_program_that_was_stopped_takes_its_terminal_back_and_gives_it_back(
    run, environment, tmp_path: Path
) -> None:
    recording = tmp_path / "x.mcap"
    with terminal(
        environment, tmp_path, *LIVE, size=(200, 60), session=controlling_terminal
    ) as screen:
        screen.until(ROWS_TERMINAL)
        for _ in range(2):
            screen.process.send_signal(signal.SIGSTOP)
            captures_on(recording)
            screen.process.send_signal(signal.SIGCONT)
            screen.until(NORMAL_SCREEN)
            screen.until(ROWS_TERMINAL)
        screen.type("Q")
        assert screen.ended() == 0
        assert screen.is_as_it_was
        assert_all_is_well(run, screen, recording)


SIGNAL_TO_ITSELF = """
import os, queue, signal
from fte_sniff.__main__ import main
put = queue.Queue._put
def put_and_signal(self, item):
    put(self, item)
    if isinstance(item, str) and "speed_feed" in item:
        queue.Queue._put = put
        os.kill(os.getpid(), signal.{name})
queue.Queue._put = put_and_signal
main()
"""


@pytest.mark.parametrize("name", ["SIGCONT", "SIGTSTP"])
def test_a_stop_may_come_while_what_is_drawn_is_queued(
    run, environment, tmp_path: Path, name: str
) -> None:
    program = (sys.executable, "-c", SIGNAL_TO_ITSELF.format(name=name))
    with terminal(
        environment, tmp_path, *LIVE, size=(200, 60), session=controlling_terminal, program=program
    ) as screen:
        screen.until(ROWS_TERMINAL, NORMAL_SCREEN)
        screen.until(ROWS_TERMINAL)
        screen.type("Q")
        assert screen.ended() == 0
        assert_all_is_well(run, screen, tmp_path / "x.mcap")


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


@needs("bash")
@pytest.mark.parametrize("ends", first(1, ["kill", "Q", "late kill", "close"]))
def test_ctrl_z_lends_the_terminal_to_the_shell_and_the_capture_goes_on(
    run, environment, tmp_path: Path, ends: str
) -> None:
    recording = tmp_path / "x.mcap"
    environment = environment | {"PS1": "<ready>", "PS2": "", "HISTFILE": ""}
    bash = ("bash", "--norc", "--noprofile", "--noediting", "-i")
    with terminal(
        environment, tmp_path, size=(200, 60), session=controlling_terminal, program=bash
    ) as screen:
        screen.until("<ready>")
        line = [*PROGRAM, *(f"'{word}'" for word in LIVE)]
        screen.type(" ".join(line) + "\r")
        screen.until(ROWS_TERMINAL)
        for _ in range(2):
            assert NORMAL_SCREEN.encode() in asked(screen, "\x1a")
            captures_on(recording)
            (program,) = children_of(screen.process.pid)
            asked(screen, "bg\r")
            # In the background it stops again, before the shell resumes it for the second time.
            wait_until(lambda program=program: state_of(program) == "T")
            assert b"\nicanon" in asked(screen, "stty -a | tr ' ' '\\n' | grep icanon\r")
            screen.type("fg\r")
            screen.until(ROWS_TERMINAL)
        if ends == "Q":
            assert b"recorded to x.mcap" in asked(screen, "Q")
        else:
            asked(screen, "\x1a")
        if ends == "late kill":
            # SIGTERM comes when the pause before it resumes is over.
            os.kill(program, signal.SIGCONT)
            time.sleep(0.03)
            os.kill(program, signal.SIGSTOP)
            time.sleep(0.2)
        if "kill" in ends:
            asked(screen, "kill %1\r")
            wait_until(lambda: holding(recording) == [])
        screen.close()
        wait_until(lambda: in_session(screen.process.pid) == [])
        assert_whole(run, recording)


def test_where_nobody_could_continue_it_ctrl_z_does_not_stop_it(
    run, environment, tmp_path: Path
) -> None:
    with terminal(
        environment, tmp_path, *LIVE, size=(200, 60), session=controlling_terminal
    ) as screen:
        screen.until(ROWS_TERMINAL)
        screen.type("\x1a")
        screen.until(NORMAL_SCREEN)
        screen.until(ROWS_TERMINAL)
        screen.type("Q")
        assert screen.ended() == 0


def test_without_a_file_the_latest_recording_opens_with_its_notes(
    environment, tmp_path: Path
) -> None:
    """On a file without findings on any machine: where a list is open, `q` closes only that."""
    with terminal(environment, tmp_path, "view") as screen:
        assert screen.ended() == 2
    assert b"this folder has no recording" in screen.drawn
    copy(SAMPLES / "midstream.mcap", tmp_path / "x.mcap")
    with terminal(environment, tmp_path, "view") as screen:
        screen.until("x.mcap", "49 rows")
        screen.type("fmotor = 2\rm")
        screen.until("saved in x.mcap.notes.jsonl")
        screen.type("q")
        assert screen.ended() == 0
    assert b"notes are in x.mcap.notes.jsonl" in screen.drawn
    with terminal(environment, tmp_path, "view", "x.mcap") as screen:
        screen.until("49 rows")
        screen.type("u#a\r")
        screen.until("saved in x.mcap.notes.jsonl")
        screen.type("\x1b")
        screen.until("note: a")
        screen.type("Q")
        assert screen.ended() == 0
