"""Progress on standard error: on a terminal, after two seconds, and never among the rows."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

import pytest

from fte_sniff.cli.progress import PATIENCE_S, progress_text
from fte_sniff.session.inputs import Progress
from tests.cli.processes import BOUND_S, FRAME
from tests.cli.terminals import terminal
from tests.slow import first

AT_ONCE = (
    "import fte_sniff.cli.progress as progress; progress.PATIENCE_S = 0\n"
    "from fte_sniff.cli import main\nmain()"
)
"""The program, whose line appears at once."""
LINE = FRAME.hex(" ").encode() + b"\n"


@pytest.fixture
def large(tmp_path: Path) -> Path:
    """Raw bytes that take some time."""
    path = tmp_path / "large.raw"
    path.write_bytes(FRAME * 1_000_000)
    return path


def test_patience() -> None:
    assert PATIENCE_S == 2


def test_a_pipe_shows_rows_after_two_seconds(
    environment: Mapping[str, str], tmp_path: Path
) -> None:
    pipe = tmp_path / "pipe.hex"
    os.mkfifo(pipe)
    arguments = ("decode", str(pipe), "-o", "rows.csv")
    with terminal(environment, tmp_path, *arguments) as screen, pipe.open("wb", 0) as log:
        log.write(LINE * 300)
        screen.until(" rows/s")
        log.close()
        assert screen.ended() == 0
    *_, last = screen.drawn.decode().splitlines()
    assert last.rpartition("\x1b[K")[2].startswith("300 rows, nothing malformed")
    assert len((tmp_path / "rows.csv").read_text().splitlines()) == 301


def test_rows_on_the_same_terminal_hide_it(environment: Mapping[str, str], tmp_path: Path) -> None:
    pipe = tmp_path / "pipe.hex"
    os.mkfifo(pipe)
    arguments = ("decode", str(pipe), "--format", "jsonl")
    with terminal(environment, tmp_path, *arguments) as screen, pipe.open("wb", 0) as log:
        for _ in range(2):
            log.write(LINE * 100)
            screen.until(" rows/s")
        log.close()
        assert screen.ended() == 0
    shown = [line.rpartition("\x1b[K")[2] for line in screen.drawn.decode().split("\r\n")]
    assert len([line for line in shown if line.startswith("{") and line.endswith("}")]) == 200
    assert not [line for line in shown if "rows/s" in line]


def test_before_the_screen_opens(environment: Mapping[str, str], tmp_path: Path) -> None:
    pipe = tmp_path / "pipe.hex"
    os.mkfifo(pipe)
    with terminal(environment, tmp_path, "view", str(pipe)) as screen, pipe.open("wb", 0) as log:
        screen.until("reading")
        log.write(LINE * 1000)
        screen.until("reset")
        log.close()
        assert screen.ended_by("q") == 0


@pytest.mark.parametrize("command", first(2, ["decode", "repair", "stats"]))
def test_every_command_that_reads_files_shows_how_much_is_left(
    environment: Mapping[str, str], tmp_path: Path, large: Path, command: str
) -> None:
    arguments = [command, str(large)]
    if command == "decode":
        arguments += ["-o", "rows.csv"]
    if command == "repair":
        arguments[1] = str(damaged_recording(environment, tmp_path, large))
    program = [sys.executable, "-c", AT_ONCE]
    with terminal(environment, tmp_path, *arguments, program=program) as screen:
        screen.until("left")
        assert screen.ended() == 0
    assert re.search(r"reading .*\d%", screen.drawn.decode())


def damaged_recording(environment: Mapping[str, str], folder: Path, raw: Path) -> Path:
    path = folder / "large.mcap"
    start = ["--start", "2026-01-31T12:00:00Z"]
    subprocess.run(
        [sys.executable, "-m", "fte_sniff", "decode", raw, *start, "-o", path],
        env=environment,
        check=True,
        capture_output=True,
    )
    path.write_bytes(path.read_bytes()[:-1000])
    return path


def test_no_terminal_no_progress(
    environment: Mapping[str, str], tmp_path: Path, large: Path
) -> None:
    done = subprocess.run(
        [sys.executable, "-c", AT_ONCE, "decode", str(large), "-o", "rows.csv"],
        env=environment,
        cwd=tmp_path,
        stderr=subprocess.PIPE,
        timeout=BOUND_S,
        check=True,
    )
    assert b"\r" not in done.stderr
    assert b"\x1b" not in done.stderr


@pytest.mark.parametrize(
    ("progress", "expected"),
    [
        (Progress(), "reading"),
        (Progress(step="opening \x1b[2Jx.mcap", files=0), "opening \\x1b[2Jx.mcap"),
        (Progress(files=1, rows=1200), "reading  1,200 rows, 120 rows/s"),
        (Progress(files=12, files_done=2, rows=9), "file 3 of 12  9 rows, 1 rows/s"),
        (Progress(files=12, files_done=12, rows=9), "file 12 of 12  9 rows, 1 rows/s"),
    ],
)
def test_text_of_files_of_unknown_size(progress: Progress, expected: str) -> None:
    assert progress_text(progress, 10) == expected


def test_text_of_files_of_known_size_has_share_rate_and_time_left() -> None:
    progress = Progress("", 12, 2, 10**12, 4 * 10**11, 123_456_789)
    expected = "file 3 of 12  40%  123,456,789 rows, 12,345,679 rows/s  0:00:15 left"
    assert progress_text(progress, 10) == expected


def test_a_narrow_terminal_has_a_cut_line(
    environment: Mapping[str, str], tmp_path: Path, large: Path
) -> None:
    program = [sys.executable, "-c", AT_ONCE]
    with terminal(
        environment, tmp_path, "stats", str(large), program=program, size=(20, 24)
    ) as screen:
        screen.until("reading")
        assert screen.ended() == 0
    lines = [line.partition("\x1b[K")[2] for line in screen.drawn.decode().split("\r")]
    assert {len(line) for line in lines if line.startswith("reading")} <= set(range(20))
