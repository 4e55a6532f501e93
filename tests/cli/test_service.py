"""`live --headless`: a capture as a service, with systemd's messages and commands for files."""

from __future__ import annotations

import os
import re
import signal
import socket
import subprocess
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path

import pytest

from fte_sniff.recording.reader import RecordingReader
from tests.cli.conftest import ROOT
from tests.cli.processes import (
    BOUND_S,
    children_of,
    ended,
    rows_in,
    started,
    stderr_until,
    wait_until,
)
from tests.slow import first
from tests.support.recorded_rows import events_in
from tests.support.tools import needs

LINE = "sim://?rate=500"
SILENT = "sim://?host=off&wire=control"
SILENCE_S = 3.0
"""Fifteen times the interval at which a watchdog is fed here."""


@pytest.fixture
def manager(tmp_path: Path) -> Iterator[socket.socket]:
    """A service manager's socket."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as channel:
        channel.bind(str(tmp_path / "notify"))
        channel.settimeout(BOUND_S)
        yield channel


def test_it_prints_no_rows_and_records_all(environment, tmp_path: Path) -> None:
    with started(environment, tmp_path, "live", LINE, "--headless", "-o", "x.mcap") as process:
        stderr_until(process, f"capturing {LINE}, recording to x.mcap\n")
        wait_until(lambda: rows_in(tmp_path / "x.mcap") > 20)
        process.send_signal(signal.SIGTERM)
        code, output, errors = ended(process)
    assert (code, output) == (0, "")
    assert "recorded to x.mcap" in errors
    assert rows_in(tmp_path / "x.mcap") > 20


def test_a_capture_of_some_rows_records_that_its_port_was_closed(run, tmp_path: Path) -> None:
    done = run("live", LINE, "--headless", "--count", "20", "-o", "x.mcap")
    assert done.returncode == 0
    assert rows_in(tmp_path / "x.mcap") == 20
    events = events_in(RecordingReader(tmp_path / "x.mcap"))
    assert [str(event.kind) for event in events] == ["opened", "closed"]


def test_usr1_begins_the_next_file_and_no_byte_is_lost(environment, tmp_path: Path) -> None:
    with started(environment, tmp_path, "live", LINE, "--headless", "-o", "x.mcap") as process:
        stderr_until(process, "capturing")
        for number in (2, 3):
            current = tmp_path / ("x.mcap" if number == 2 else "x_00002.mcap")
            wait_until(lambda path=current: rows_in(path) > 20)
            process.send_signal(signal.SIGUSR1)
            stderr_until(process, f"recording goes on in x_{number:05}.mcap")
        process.send_signal(signal.SIGTERM)
        code, _, errors = ended(process)
    assert code == 0
    assert "3 files" in errors
    names, offset = ["x.mcap", "x_00002.mcap", "x_00003.mcap"], 0
    assert sorted(path.name for path in tmp_path.glob("*.mcap")) == names
    for name in names:
        for row in RecordingReader(tmp_path / name):
            assert row.offset == offset
            offset += len(row.raw)


@pytest.fixture
def nohup() -> Iterator[None]:
    """SIGHUP is ignored by what is started, as with nohup."""
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    yield
    signal.signal(signal.SIGHUP, before)


@pytest.mark.usefixtures("nohup")
def test_with_nohup_the_end_of_the_terminal_does_not_end_it(environment, tmp_path: Path) -> None:
    with started(environment, tmp_path, "live", LINE, "--headless", "-o", "x.mcap") as process:
        stderr_until(process, "capturing")
        for pid in (process.pid, *children_of(process.pid)):
            os.kill(pid, signal.SIGHUP)
        rows = rows_in(tmp_path / "x.mcap")
        wait_until(lambda: rows_in(tmp_path / "x.mcap") > rows)
        process.send_signal(signal.SIGUSR1)
        stderr_until(process, "recording goes on in x_00002.mcap")
        process.send_signal(signal.SIGTERM)
        assert ended(process)[0] == 0


def test_usr1_without_rows_does_nothing(environment, tmp_path: Path) -> None:
    with started(environment, tmp_path, "live", SILENT, "--headless", "-o", "x.mcap") as process:
        stderr_until(process, "capturing")
        process.send_signal(signal.SIGUSR1)
        process.send_signal(signal.SIGTERM)
        code, _, _ = ended(process)
    assert code == 0
    assert [path.name for path in tmp_path.glob("*.mcap")] == ["x.mcap"]


@pytest.mark.parametrize("line", first(1, [SILENT, LINE]))
def test_systemd_hears_ready_watchdog_and_stopping(environment, tmp_path, manager, line) -> None:
    service = environment | {"NOTIFY_SOCKET": str(tmp_path / "notify"), "WATCHDOG_USEC": "4000000"}
    with started(service, tmp_path, "live", line, "--headless", "-o", "x.mcap") as process:
        assert manager.recv(100) == b"READY=1"
        for _ in range(3):
            assert manager.recv(100) == b"WATCHDOG=1"
        process.send_signal(signal.SIGTERM)
        while (state := manager.recv(100)) == b"WATCHDOG=1":
            pass
        assert state == b"STOPPING=1"
        assert ended(process)[0] == 0


def test_a_hung_capture_does_not_feed_the_watchdog(environment, tmp_path, manager) -> None:
    service = environment | {"NOTIFY_SOCKET": str(tmp_path / "notify"), "WATCHDOG_USEC": "200000"}
    with started(service, tmp_path, "live", LINE, "--headless", "-o", "x.mcap") as process:
        assert manager.recv(100) == b"READY=1"
        assert manager.recv(100) == b"WATCHDOG=1"
        (capture,) = children_of(process.pid)
        subprocess.run(["kill", "-STOP", str(capture)], check=True)
        manager.settimeout(SILENCE_S)
        with suppress(TimeoutError):
            while manager.recv(100) == b"WATCHDOG=1":
                pass
            pytest.fail("another state")
        subprocess.run(["kill", "-CONT", str(capture)], check=True)
        manager.settimeout(BOUND_S)
        assert manager.recv(100) == b"WATCHDOG=1"


@pytest.fixture
def script(tmp_path: Path) -> Callable[[str], None]:
    """Makes the command `./run` with these shell lines; it can wait for a line from `gate`."""
    os.mkfifo(tmp_path / "gate")

    def make(lines: str) -> None:
        (tmp_path / "run").write_text(f"#!/bin/sh\n{lines}\n")
        (tmp_path / "run").chmod(0o755)

    return make


def test_a_file_whose_name_begins_with_a_hyphen_is_not_an_option(
    environment, tmp_path: Path, script
) -> None:
    script('printf "%s\\n" "$@" >> done.txt')
    words = ["live", LINE, "--headless", "--output=-x.mcap", "--on-file", "./run", "--count", "9"]
    with started(environment, tmp_path, *words) as process:
        assert ended(process)[0] == 0
    assert (tmp_path / "done.txt").read_text() == "./-x.mcap\n"


def test_a_command_runs_for_each_finished_file(environment, tmp_path: Path, script) -> None:
    script('printf "%s\\n" "$@" >> done.txt')
    command = "./run '--to here' $HOME"
    words = ["live", LINE, "--headless", "-o", "a b.mcap", "--on-file", command]
    with started(environment, tmp_path, *words) as process:
        stderr_until(process, "capturing")
        wait_until(lambda: rows_in(tmp_path / "a b.mcap") > 0)
        process.send_signal(signal.SIGUSR1)
        wait_until((tmp_path / "done.txt").exists)
        process.send_signal(signal.SIGTERM)
        assert ended(process)[0] == 0
    lines = (tmp_path / "done.txt").read_text().splitlines()
    assert lines == ["--to here", "$HOME", "a b.mcap", "--to here", "$HOME", "a b_00002.mcap"]


def test_a_command_that_fails_or_waits_stops_nothing(environment, tmp_path: Path, script) -> None:
    script("case $1 in x.mcap) read line < gate ;; esac; exit 3")
    words = ["live", LINE, "--headless", "-o", "x.mcap", "--on-file", "./run"]
    with started(environment, tmp_path, *words) as process:
        stderr_until(process, "capturing")
        for name in ("x.mcap", "x_00002.mcap"):
            wait_until(lambda name=name: rows_in(tmp_path / name) > 0)
            process.send_signal(signal.SIGUSR1)
            stderr_until(process, "recording goes on in")
        # The first command still waits.
        stderr_until(process, "--on-file: ./run failed for x_00002.mcap: exit code 3\n")
        (tmp_path / "gate").write_text("go\n")
        stderr_until(process, "--on-file: ./run failed for x.mcap: exit code 3\n")
        process.send_signal(signal.SIGTERM)
        assert ended(process)[0] == 0


def test_a_command_that_hangs_is_reported_and_left_by_the_next_signal(
    environment, tmp_path: Path, script
) -> None:
    script("read line < gate; echo done > left")
    words = ["live", LINE, "--headless", "-o", "x.mcap", "--on-file", "./run"]
    with started(environment, tmp_path, *words) as process:
        stderr_until(process, "capturing")
        process.send_signal(signal.SIGTERM)
        stderr_until(process, "recorded to x.mcap")
        stderr_until(process, "waiting for ./run for x.mcap; Ctrl-C ends")
        process.send_signal(signal.SIGTERM)
        stderr_until(process, "--on-file: not waiting any longer\n")
        assert process.wait(BOUND_S) == 0
        (tmp_path / "gate").write_text("go\n")
        wait_until((tmp_path / "left").exists)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--on-file", "true"], "--on-file works with --headless; add it"),
        (["--headless", "--plain"], "--headless shows no rows; leave out --plain"),
        (["--headless", "--filter", "motor = 1"], "leave out --filter"),
        (["--headless", "--no-record"], "--headless records to files"),
        (["--headless", "-o", "-"], "--headless records to files"),
        (["--headless", "--on-file", "none-such"], "'none-such' is not a command"),
        (["--headless", "--on-file", "'open"], "No closing quotation"),
        (["--headless", "--on-file", ""], "'' is not a command"),
    ],
)
def test_contradictions_are_usage_errors(run, tmp_path: Path, words, message) -> None:
    done = run("live", "sim://", *words)
    assert (done.returncode, done.stdout) == (2, "")
    assert message in done.stderr
    assert not list(tmp_path.glob("*.mcap"))


@needs("systemd-analyze")
def test_systemd_accepts_the_unit_of_the_page(tmp_path: Path) -> None:
    text = (ROOT / "docs" / "service.md").read_text("utf-8")
    (unit,) = re.findall(r"```ini\n(.*?)```", text, re.DOTALL)
    program = re.search(r"ExecStart=(\S+)", unit)
    assert program is not None
    path = tmp_path / "fte-sniff.service"
    path.write_text(unit.replace(program[1], "/bin/true").replace("User=logger", "User=daemon"))
    done = subprocess.run(
        ["systemd-analyze", "verify", "--man=no", "--recursive-errors=no", str(path)],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert (done.returncode, done.stderr) == (0, "")
