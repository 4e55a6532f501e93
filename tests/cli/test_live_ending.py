"""How `live` ends when something works against it: signals, stuck processes, outputs, files."""

from __future__ import annotations

import fcntl
import os
import resource
import select
import signal
import subprocess
import sys
import termios
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from time import monotonic
from typing import IO

import pytest

from tests.cli.processes import (
    BOUND_S,
    PROGRAM,
    Process,
    ended,
    holding,
    started,
    until,
    until_told,
    wait_until,
)

SIM = "sim://?seed=1&rate=1000"


def test_a_storm_of_signals_is_one(environment, tmp_path: Path) -> None:
    with started(environment, tmp_path, "live", SIM, "-o", "x.mcap") as process:
        until(process, b"speed_feedback")
        deadline = monotonic() + BOUND_S
        while process.poll() is None:
            for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
                process.send_signal(number)
            # What it prints must go on; its pipe is not what holds it up here.
            if process.stdout and select.select([process.stdout], [], [], 0.001)[0]:
                os.read(process.stdout.fileno(), 1 << 16)
            assert monotonic() < deadline
        code, _, errors = ended(process)
    assert code == 0, errors
    told = errors.splitlines()
    assert told[0] == "recording to x.mcap"
    assert " rows, " in told[1]
    assert told[2:] == ["recorded to x.mcap"]


def test_a_capture_that_is_stuck_does_not_hold_up_the_end(run, environment, tmp_path: Path) -> None:
    with started(environment, tmp_path, "live", SIM, "-o", "x.mcap") as process:
        until(process, b"speed_feedback")
        (capture,) = holding(tmp_path / "x.mcap")
        os.kill(capture, signal.SIGSTOP)
        process.send_signal(signal.SIGINT)
        code, _, errors = ended(process)
    assert code == 3
    assert "was killed" in errors
    assert "Traceback" not in errors
    assert run("decode", "x.mcap").returncode == 0


@contextmanager
def flood() -> Iterator[str]:
    """A server that sends faster than anything can be recorded; its name as a port."""
    served = (
        "import socket\n"
        "server = socket.create_server(('127.0.0.1', 0))\n"
        "print(server.getsockname()[1], flush=True)\n"
        "connection, _ = server.accept()\n"
        "while True: connection.sendall(bytes.fromhex('55010100000000000FEE') * 6000)\n"
    )
    with subprocess.Popen(
        [sys.executable, "-c", served], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    ) as server:
        try:
            assert server.stdout is not None
            yield f"socket://127.0.0.1:{server.stdout.readline().strip()}"
        finally:
            server.kill()


@pytest.mark.parametrize("way", ["--duration", signal.SIGINT, signal.SIGTERM])
def test_a_flood_holds_up_no_end(run, environment, tmp_path: Path, way: str | int) -> None:
    bound = ("--duration", "1") if way == "--duration" else ()
    with flood() as port:
        arguments = ("live", port, "--plain", "-o", "x.mcap", "--no-reconnect", *bound)
        with started(environment, tmp_path, *arguments) as process:
            if isinstance(way, int):
                until_told(process, b"recording to")
                recording = tmp_path / "x.mcap"
                wait_until(lambda: recording.stat().st_size > 500_000)
                process.send_signal(way)
            told = until_told(process, b"bytes wait; Ctrl-C drops them")
            # What waited takes a minute to be written, and more than BOUND_S.
            process.send_signal(signal.SIGTERM)
            code, _, errors = ended(process)
    assert code == 0, errors
    assert told.count(b"bytes wait") == 1
    assert " waited to be written at the end" in errors
    decoded = run("decode", "x.mcap")
    assert decoded.returncode == 0
    assert "reported overrun" in decoded.stderr


def test_an_output_that_nobody_reads_does_not_hold_up_the_end(
    run, environment, tmp_path: Path
) -> None:
    with started(environment, tmp_path, "live", SIM, "-o", "x.mcap") as process:
        assert process.stdout is not None
        size = fcntl.fcntl(process.stdout, fcntl.F_SETPIPE_SZ, 4096)
        wait_until(lambda: bytes_waiting(process.stdout) == size)
        process.terminate()
        assert process.wait(BOUND_S) == 0
        _, _, errors = ended(process)
    assert "nobody takes the output" in errors
    assert "recorded to x.mcap" in errors
    done = run("decode", "x.mcap")
    assert done.returncode == 0
    assert "cut" not in done.stderr


def test_outputs_that_nobody_reads_do_not_hold_up_the_end(environment, tmp_path: Path) -> None:
    with subprocess.Popen(
        [*PROGRAM, "live", SIM, "--no-record"],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        env=environment,
        cwd=tmp_path,
    ) as process:
        assert process.stdout is not None
        size = fcntl.fcntl(process.stdout, fcntl.F_SETPIPE_SZ, 4096)
        wait_until(lambda: bytes_waiting(process.stdout) == size)
        process.terminate()
        assert process.wait(BOUND_S) == 0


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT, signal.SIGKILL])
def test_ended_while_it_starts_it_leaves_no_noise_and_no_broken_file(
    run, environment, tmp_path: Path, number: int
) -> None:
    with started(environment, tmp_path, "live", SIM, "-o", "x.mcap") as process:
        wait_until(lambda: any(has_loaded("zstandard", child) for child in captures_of(process)))
        process.send_signal(number)
        # The orphan has the pipe too: this waits for both.
        _, _, errors = ended(process)
    assert "Traceback" not in errors
    files = list(tmp_path.iterdir())
    assert [file.name for file in files] in ([], ["x.mcap"])
    assert all(run("decode", file).returncode == 0 for file in files)


def test_a_deleted_recording_is_told_at_once_and_the_rows_go_on(
    environment, tmp_path: Path
) -> None:
    with started(environment, tmp_path, "live", SIM, "-o", "x.mcap") as process:
        until(process, b"speed_feedback")
        (tmp_path / "x.mcap").unlink()
        assert b"x.mcap was deleted" in until_told(process, b"recording goes on in x_00002.mcap")
        until(process, b"speed_feedback")
        process.send_signal(signal.SIGINT)
        code, _, errors = ended(process)
    assert code == 4
    assert "recorded to x_00002.mcap" in errors
    last = errors.splitlines()[-1]
    assert last.startswith("fte-sniff: ")
    assert "were not recorded: recording stopped: x.mcap was deleted" in last


def test_a_recording_that_stops_is_told_at_once_and_the_rows_go_on(
    run, environment, tmp_path: Path
) -> None:
    with (
        files_bounded(20_000),
        started(
            environment | {"PYTHONDONTWRITEBYTECODE": "1"}, tmp_path, "live", SIM, "-o", "x.mcap"
        ) as process,
    ):
        until_told(process, b"recording stopped")
        until(process, b"speed_feedback")
        process.send_signal(signal.SIGINT)
        code, _, errors = ended(process)
    assert code == 4
    assert "recorded to" not in errors
    assert "x.mcap is complete up to there" in errors.splitlines()[-1]
    assert run("decode", "x.mcap").returncode == 0


def test_two_cannot_record_to_one_file(run, environment, tmp_path: Path) -> None:
    with started(environment, tmp_path, "live", SIM, "-o", "x.mcap") as process:
        until(process, b"speed_feedback")
        second = run("live", SIM, "-o", "x.mcap", "--force", "--count", "5")
        assert second.returncode == 4
        assert second.stdout == ""
        assert second.stderr.count("\n") == 1
        assert "x.mcap is being recorded to by another program" in second.stderr
        process.send_signal(signal.SIGINT)
        code, output, _ = ended(process)
    assert code == 0
    assert run("decode", "x.mcap").stdout.endswith(output.splitlines()[-1] + "\n")


def test_several_that_start_at_once_record_to_a_file_each(environment, tmp_path: Path) -> None:
    processes = [
        subprocess.Popen(
            [*PROGRAM, "live", SIM, "--count", "20"],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            env=environment,
            cwd=tmp_path,
        )
        for _ in range(4)
    ]
    told = []
    for process in processes:
        code, _, errors = ended(process)
        assert code == 0, errors
        told.append(errors.splitlines()[-1].removeprefix("recorded to "))
    assert sorted(told) == sorted(path.name for path in tmp_path.iterdir())
    assert len(told) == len(processes)


def test_a_standard_error_that_is_full_shortens_nothing(run, environment, tmp_path: Path) -> None:
    with Path("/dev/full").open("wb") as full:
        done = subprocess.run(
            [*PROGRAM, "live", SIM, "--count", "50", "-o", "x.mcap"],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=full,
            env=environment,
            cwd=tmp_path,
            timeout=BOUND_S,
            check=False,
        )
    assert done.returncode == 0
    assert done.stdout.count(b"\n") == 51
    assert run("decode", "x.mcap").stdout == done.stdout.decode()


def test_a_standard_output_that_is_full_is_one_line(run, environment, tmp_path: Path) -> None:
    with Path("/dev/full").open("wb") as full:
        done = subprocess.run(
            [*PROGRAM, "live", SIM, "-o", "x.mcap"],
            stdin=subprocess.DEVNULL,
            stdout=full,
            stderr=subprocess.PIPE,
            env=environment,
            cwd=tmp_path,
            timeout=BOUND_S,
            check=False,
        )
    assert done.returncode == 4
    recording, refusal = done.stderr.decode().splitlines()
    assert recording == "recording to x.mcap"
    assert "disk is full" in refusal
    assert "cut" not in run("decode", "x.mcap").stderr


def bytes_waiting(stream: IO[bytes]) -> int:
    """How many bytes can be read there at once."""
    told = fcntl.ioctl(stream, termios.FIONREAD, bytes(4))
    return int.from_bytes(told, sys.byteorder)


def captures_of(process: Process) -> list[Path]:
    """The capture processes that a program has started, in /proc."""
    children = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()
    found = [Path("/proc") / child for child in children]
    return [child for child in found if b"spawn_main" in (child / "cmdline").read_bytes()]


def has_loaded(library: str, process: Path) -> bool:
    """Whether a process has come as far as to load a library."""
    return library in (process / "maps").read_text()


@contextmanager
def files_bounded(size: int) -> Iterator[None]:
    """Processes started in this context cannot write files longer than `size` bytes."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
