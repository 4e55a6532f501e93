"""How a capture ends, and what it keeps: signals, full disks, lost ports; rotation, triggers."""

from __future__ import annotations

import fcntl
import os
import re
import select
import shutil
import signal
import subprocess
import sys
import termios
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

import pytest
import serial

from fte_sniff.protocol.items import PortEventKind
from fte_sniff.recording.reader import Recording
from fte_sniff.session.live_session import END_WITHIN_S
from tests.beside import running
from tests.cli.processes import (
    BOUND_S,
    PROGRAM,
    Process,
    children_of,
    ended,
    first_output,
    holding,
    rows_in,
    started,
    stderr_until,
    until,
    wait_until,
    wire,
)
from tests.recording.conftest import file_size_limit
from tests.slow import first
from tests.support.columns import read_rows
from tests.support.recorded_rows import events_in
from tests.waiting import while_waiting

pytestmark = pytest.mark.program

SIM = "sim://?seed=1&rate=1000"


def test_a_storm_of_signals_is_one(environment, tmp_path: Path) -> None:
    with started(environment, tmp_path, "live", SIM, "-o", "x.mcap") as process:
        until(process, b"speed_feedback")
        for _ in while_waiting(lambda: "the end"):
            if process.poll() is not None:
                break
            for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
                process.send_signal(number)
            # What it prints must go on; its pipe is not what holds it up here.
            if process.stdout and select.select([process.stdout], [], [], 0.001)[0]:
                os.read(process.stdout.fileno(), 1 << 16)
        code, _, errors = ended(process)
    assert code == 0, errors
    lines_shown = errors.splitlines()
    assert lines_shown[0] == "recording to x.mcap"
    assert " rows, " in lines_shown[1]
    assert lines_shown[2:] == ["recorded to x.mcap"]


def test_a_capture_that_is_stuck_does_not_hold_up_the_end(run, environment, tmp_path: Path) -> None:
    with started(environment, tmp_path, "live", SIM, "-o", "x.mcap") as process:
        until(process, b"speed_feedback")
        (capture,) = children_of(process.pid)
        os.kill(capture, signal.SIGSTOP)
        process.send_signal(signal.SIGINT)
        code, _, errors = ended(process)
    assert code == 4
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
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.DEVNULL}
    with running([sys.executable, "-c", served], **pipes) as server:
        assert server.stdout is not None
        yield f"socket://127.0.0.1:{server.stdout.readline().decode().strip()}"


def test_flood_holds_up_no_end(run, environment, tmp_path: Path) -> None:
    recording = tmp_path / "x.mcap"
    with flood() as port:
        arguments = ("live", port, "--plain", "-o", "x.mcap")
        with started(environment, tmp_path, *arguments) as process:
            stderr_until(process, "recording to")
            wait_until(lambda: recording.stat().st_size > 500_000)
            process.send_signal(signal.SIGINT)
            shown = stderr_until(process, "not written yet; Ctrl-C drops them", "recorded to")
            # What waited takes a minute to be written, and more than BOUND_S.
            process.send_signal(signal.SIGTERM)
            code, _, errors = ended(process)
    errors = shown + errors
    assert errors.count("not written yet") <= 1
    rows = rows_in(recording)
    if code == 0:
        # All was written before the second signal came: then no row is missing.
        assert f"{rows:,} rows, " in errors
    else:
        assert code == 4, errors
        assert re.search(r"ended while it was still writing; up to .* are not in x.mcap", errors)
    assert run("decode", "x.mcap", "--filter", "noise").returncode == 0


def test_an_output_that_nobody_reads_does_not_hold_up_the_end(
    run, environment, tmp_path: Path
) -> None:
    with started(environment, tmp_path, "live", SIM, "-o", "x.mcap") as process:
        assert process.stdout is not None
        fcntl.fcntl(process.stdout, fcntl.F_SETPIPE_SZ, 4096)
        # The pipe holds one page: a write that does not fit behind the first waits for ever.
        wait_until(lambda: bytes_waiting(process.stdout) > 0)
        # The capture goes on meanwhile. More rows than one page of output can hold must exist
        # before the end, or all of them fit in the pipe and nobody has to wait.
        recording = tmp_path / "x.mcap"
        wait_until(lambda: recording.exists() and recording.stat().st_size > 100_000)
        process.terminate()
        assert process.wait(BOUND_S) == 0
        _, _, errors = ended(process)
    assert "nothing reads the output" in errors
    assert "recorded to x.mcap" in errors
    done = run("decode", "x.mcap")
    assert done.returncode == 0
    assert "cut" not in done.stderr


@pytest.mark.parametrize("number", first(1, [signal.SIGINT, signal.SIGTERM, signal.SIGKILL]))
def test_ended_while_it_starts_it_leaves_no_noise_and_no_broken_file(
    run, environment, tmp_path: Path, number: int
) -> None:
    # Started anew: what was forked has loaded everything.
    words = (*PROGRAM, "live", SIM, "-o", "x.mcap")
    streams = {"stdin": subprocess.DEVNULL, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    with running(words, env=environment, cwd=tmp_path, **streams) as process:
        wait_until(lambda: any(has_loaded("zstandard", child) for child in captures_of(process)))
        process.send_signal(number)
        # The orphan has the pipe too: this waits for both.
        _, _, errors = ended(process)
    assert "Traceback" not in errors
    files = list(tmp_path.iterdir())
    assert [file.name for file in files] in ([], ["x.mcap"])
    assert all(run("decode", file).returncode == 0 for file in files)


def _empty(path: Path) -> None:
    """Do as `: > path`."""
    os.truncate(path, 0)


@pytest.mark.parametrize("take_away", [Path.unlink, _empty])
def test_a_recording_that_is_taken_away_is_reported_at_once_and_the_rows_go_on(
    environment, tmp_path: Path, take_away: Callable[[Path], None]
) -> None:
    with started(environment, tmp_path, "live", SIM, "-o", "x.mcap") as process:
        file = tmp_path / "x.mcap"
        # Two chunks and their indexes: the rows of the first are not written again elsewhere.
        wait_until(lambda: file.exists() and file.read_bytes().count(b"zstd") >= 4)
        take_away(file)
        reported = stderr_until(process, "recording to x_00002.mcap")
        assert "x.mcap was deleted, moved, replaced or cut off" in reported
        until(process, b"speed_feedback")
        process.send_signal(signal.SIGINT)
        code, _, errors = ended(process)
    assert code == 4
    assert "recorded to " in errors
    assert "x_00002.mcap" in errors
    last = errors.splitlines()[-1]
    assert last.startswith("fte-sniff: ")
    assert "were not recorded: the file was deleted, moved" in last


def test_a_file_that_cannot_grow_is_reported_at_once_and_the_next_one_has_the_rows(
    run, environment, tmp_path: Path
) -> None:
    first, second = tmp_path / "x.mcap", tmp_path / "x_00002.mcap"
    # A file of Python's cache may be larger than the limit.
    environment |= {"PYTHONDONTWRITEBYTECODE": "1"}
    with (
        wire() as (far, name),
        file_size_limit(20_000),
        started(environment, tmp_path, "live", name, "-o", first.name) as process,
    ):
        stderr_until(process, "recording to x.mcap")
        while not second.exists():
            size = first.stat().st_size
            os.write(far, SPEED * 10)
            wait_until(lambda size=size: first.stat().st_size != size or second.exists())
        stopped = stderr_until(process, "recording to x_00002.mcap")
        os.write(far, SPEED * 10)
        process.send_signal(signal.SIGINT)
        code, _, errors = ended(process)
    assert code == 0, errors
    assert "recording stopped: " in stopped
    assert "x.mcap is complete up to there" in stopped
    offsets = [row.offset for path in sorted(tmp_path.glob("*.mcap")) for row in read_rows(path)]
    assert offsets == list(range(0, 10 * len(offsets), 10))
    assert f"{len(offsets):,} rows, " in errors
    assert run("decode", "x.mcap").returncode == 0


SLOW_SYNC = """
#define _GNU_SOURCE
#include <dlfcn.h>
#include <fcntl.h>
#include <stdlib.h>
#include <unistd.h>
int fdatasync(int descriptor) {
    const char *slow = getenv("SLOW_WHILE"), *delay = getenv("DELAY_MS");
    if (delay) usleep(1000 * atoi(delay));
    while (slow && access(slow, F_OK) == 0) {
        close(creat("sync-waits", 0600));
        usleep(20000);
    }
    return ((int (*)(int))dlsym(RTLD_NEXT, "fdatasync"))(descriptor);
}
"""


def slow_syncs(folder: Path, **settings: str) -> dict[str, str]:
    """The environment of a program whose syncs are slow."""
    compiler = shutil.which("gcc")
    if compiler is None:
        pytest.skip("gcc is needed to make the disk slow")
    library = folder / "slow.so"
    subprocess.run(
        [compiler, "-shared", "-fPIC", "-o", library, "-x", "c", "-", "-ldl"],
        input=SLOW_SYNC.encode(),
        check=True,
    )
    return {"LD_PRELOAD": str(library), **settings}


@contextmanager
def recording_on_a_slow_disk(environment, folder: Path) -> Iterator[tuple[Process, Path]]:
    """A program that records, whose syncs last as long as the second value exists."""
    slow = folder / "slow"
    preloaded = environment | slow_syncs(folder, SLOW_WHILE=str(slow))
    with started(preloaded, folder, "live", SIM, "-o", "x.mcap") as process:
        until(process, b"speed_feedback")
        slow.touch()
        yield process, slow


def test_the_end_waits_for_a_slow_disk(run, environment, tmp_path: Path) -> None:
    with recording_on_a_slow_disk(environment, tmp_path) as (process, slow):
        process.send_signal(signal.SIGINT)
        stderr_until(process, "the disk is slow: ")
        with pytest.raises(subprocess.TimeoutExpired):
            process.wait(END_WITHIN_S + 1)
        slow.unlink()
        code, _, errors = ended(process)
    assert code == 0, errors
    assert errors.endswith("recorded to x.mcap\n")
    assert f"{len(read_rows(tmp_path / 'x.mcap')):,} rows, " in errors


def forwarded(host: serial.Serial, far: int) -> bool:
    """Send a command through a bridge; returns True when it has arrived."""
    host.write(SPEED)
    arrived = b""
    while len(arrived) < len(SPEED):
        assert select.select([far], [], [], BOUND_S)[0], f"waited for {SPEED!r} after {arrived!r}"
        arrived += os.read(far, len(SPEED))
    return arrived == SPEED


def test_a_second_ctrl_c_does_not_wait_for_a_slow_disk_and_reports_all_that_it_drops(
    environment, tmp_path: Path
) -> None:
    slow = tmp_path / "slow"
    preloaded = environment | slow_syncs(tmp_path, SLOW_WHILE=str(slow))
    with wire() as (far, name):
        words = ("bridge", name, "--link", "motors", "-o", "x.mcap")
        with started(preloaded, tmp_path, *words) as process:
            stderr_until(process, "recording to")
            slow.touch()
            with serial.Serial(str(tmp_path / "motors")) as host:
                # What the bridge forwards, it has read, also while the disk holds it up.
                sent, awaited = 0, while_waiting(lambda: "a slow sync")
                while not (tmp_path / "sync-waits").exists():
                    next(awaited)
                    sent += forwarded(host, far)
                sent += sum(forwarded(host, far) for _ in range(100))
            process.send_signal(signal.SIGINT)
            stderr_until(process, " are not written yet; Ctrl-C drops them")
            process.send_signal(signal.SIGINT)
            code, _, errors = ended(process)
    assert code == 4
    *_, recorded, last = errors.splitlines()
    found = re.fullmatch(
        "fte-sniff: the capture was ended while it was still writing; "
        r"up to ([\d,]+) rows? and ([\d,]+) bytes? not yet in rows are not in x\.mcap",
        last,
    )
    assert found is not None, last
    assert recorded == "recorded to x.mcap"
    rows, in_no_row = (int(text.replace(",", "")) for text in found.groups())
    missing = sent - rows_in(tmp_path / "x.mcap")
    assert 0 < len(SPEED) * missing <= len(SPEED) * rows + in_no_row


def test_no_command_replaces_a_file_that_is_being_recorded(
    run, samples: Path, environment, tmp_path: Path
) -> None:
    source = str(samples / "clean.mcap")
    cut = tmp_path / "cut.mcap"
    cut.write_bytes((samples / "clean.mcap").read_bytes()[:-200])
    with started(environment, tmp_path, "live", SIM, "-o", "x.mcap") as process:
        until(process, b"speed_feedback")
        for command in (
            ("live", SIM, "--count", "5"),
            ("repair", "cut.mcap"),
            *(("decode", source, "--format", form) for form in ("mcap", "csv", "raw", "parquet")),
        ):
            second = run(*command, "-o", "x.mcap", "--force")
            assert second.returncode == 4, command
            assert second.stdout == ""
            assert second.stderr.count("\n") == 1, second.stderr
            assert "x.mcap is being recorded to by another program" in second.stderr
        assert sorted(path.name for path in tmp_path.iterdir()) == ["cut.mcap", "x.mcap"]
        process.send_signal(signal.SIGINT)
        code, output, _ = ended(process)
    assert code == 0
    assert run("decode", "x.mcap").stdout.endswith(output.splitlines()[-1] + "\n")


def test_full_standard_output_is_one_line_after_the_path_of_the_recording(
    run, environment, tmp_path: Path
) -> None:
    with (
        Path("/dev/full").open("wb") as full,
        started(
            environment, tmp_path, "live", SIM, "-o", "x.mcap", stdout=full.fileno()
        ) as process,
    ):
        code, _, errors = ended(process)
    assert code == 4
    recording, summary, recorded, refusal = errors.splitlines()
    assert recording == "recording to x.mcap"
    assert " rows" in summary
    assert recorded == "recorded to x.mcap"
    assert "disk is full" in refusal
    assert "cut" not in run("decode", "x.mcap").stderr


def bytes_waiting(stream: IO[bytes]) -> int:
    """How many bytes can be read there at once."""
    lines_shown = fcntl.ioctl(stream, termios.FIONREAD, bytes(4))
    return int.from_bytes(lines_shown, sys.byteorder)


def captures_of(process: Process) -> list[Path]:
    """The capture processes that a program has started, in /proc."""
    children = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()
    found = [Path("/proc") / child for child in children]
    return [child for child in found if b"worker()" in (child / "cmdline").read_bytes()]


def has_loaded(library: str, process: Path) -> bool:
    """True once a process has loaded the library."""
    return library in (process / "maps").read_text()


SPEED = bytes.fromhex("AA010103E800000000EE")


@contextmanager
def mounted(folder: Path, options: str) -> Iterator[Path]:
    """A file system of its own in a new folder."""
    folder.mkdir()
    mount = shutil.which("mount")
    if mount is None or os.geteuid() != 0:
        pytest.skip("only root can mount a file system")
    made = subprocess.run([mount, "-t", "tmpfs", "-o", options, "none", folder], check=False)
    if made.returncode:
        pytest.skip("no file system can be mounted here")
    try:
        yield folder
    finally:
        subprocess.run(["umount", "-l", folder], check=True)


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    with mounted(tmp_path / "small", "size=64k") as folder:
        yield folder


def test_oldest_file_makes_room_on_a_full_disk_where_the_newest_are_kept(
    environment, tmp_path: Path
) -> None:
    options = ("--max-size", "10MB", "--rotate", "30kB", "--min-free", "0")
    with (
        mounted(tmp_path / "small", "size=256k") as disk,
        started(environment, disk, "live", SIM, "-o", "x.mcap", *options) as process,
    ):
        stderr_until(process, "recording stopped: the disk is full")
        wait_until(lambda: len({*disk.glob("*.mcap")}) > 2 and not (disk / "x_00002.mcap").exists())
        process.send_signal(signal.SIGINT)
        code, _, errors = ended(process)
        files = sorted(disk.glob("*.mcap"))
        rows = [row for file in files for row in read_rows(file)]
    assert (code, "not recorded" in errors) == (0, False), errors
    assert rows[0].offset > 0
    assert [row.offset for row in rows[1:]] == [row.offset + len(row.raw) for row in rows[:-1]]


@pytest.mark.parametrize(
    ("options", "why"),
    [((), "the disk has only "), (("--min-free", "0"), "the disk is full")],
)
def test_a_disk_that_fills_up_is_reported_at_once_and_what_is_not_recorded_at_the_end(
    environment, small_disk: Path, options: tuple[str, ...], why: str
) -> None:
    with started(environment, small_disk, "live", SIM, "-o", "x.mcap", *options) as process:
        said = stderr_until(process, "recording stopped")
        assert why in said
        assert said.count("recording stopped") == 1
        process.send_signal(signal.SIGINT)
        code, _, errors = ended(process)
    assert code == 4
    *_, last = errors.splitlines()
    assert re.match(r"fte-sniff: [\d,]+ rows from .* were not recorded: ", last)
    assert why in last
    assert (last.count(why), "recording stopped" in errors) == (1, False)
    assert "Traceback" not in errors
    assert rows_in(small_disk / "x.mcap") > 100


SET_BACK = r"""
#define _GNU_SOURCE
#include <dlfcn.h>
#include <stdlib.h>
#include <time.h>
#include <unistd.h>

/* The system's clock as it is; an hour behind once the file in CLOCK_SET_BACK is there. */
int clock_gettime(clockid_t clock, struct timespec *time)
{
    static int (*real)(clockid_t, struct timespec *);
    if (!real)
        real = (int (*)(clockid_t, struct timespec *))dlsym(RTLD_NEXT, "clock_gettime");
    int failed = real(clock, time);
    if (clock == CLOCK_REALTIME && access(getenv("CLOCK_SET_BACK"), F_OK) == 0)
        time->tv_sec -= 3600;
    return failed;
}
"""


def test_a_clock_that_is_set_back_is_noted_and_times_go_on_evenly(
    environment, tmp_path: Path
) -> None:
    compiler = shutil.which("cc")
    if compiler is None:
        pytest.skip("no compiler, to make a clock that can be set")
    library, mark = tmp_path / "clock.so", tmp_path / "mark"
    built = [compiler, "-shared", "-fPIC", "-o", str(library), "-x", "c", "-", "-ldl"]
    subprocess.run(built, input=SET_BACK.encode(), check=True)
    world = {**environment, "LD_PRELOAD": str(library), "CLOCK_SET_BACK": str(mark)}
    with started(world, tmp_path, "live", SIM, "-o", "x.mcap") as process:
        stderr_until(process, "recording to")
        until(process, b"speed_feedback")
        mark.touch()
        said = stderr_until(process, " clock set: ")
        assert "this machine's clock was set by -3600." in said
        until(process, b"speed_feedback")
        process.send_signal(signal.SIGINT)
        code, _, errors = ended(process)
    assert code == 0
    assert "clock set" not in errors
    file = tmp_path / "x.mcap"
    times = [row.t_ns or 0 for row in read_rows(file)]
    assert times == sorted(times)
    assert times[-1] - times[0] < 600 * 10**9
    (event,) = [e for e in events_in(Recording(file)) if e.kind is PortEventKind.CLOCK_SET]
    assert times[0] < event.t_ns < times[-1]


def test_a_stopped_view_costs_no_byte_and_bounded_memory(run, environment, tmp_path: Path) -> None:
    frames = 196_608
    file = tmp_path / "x.mcap"
    with (
        wire() as (far, name),
        started(
            environment, tmp_path, "live", name, "--baud", "3000000", "-o", "x.mcap"
        ) as process,
    ):
        first_output(process, far)
        wait_until(lambda: bool(holding(file)))
        (capture,) = children_of(process.pid)
        process.send_signal(signal.SIGSTOP)
        before = memory_of(capture)
        for _ in range(frames // 64):
            os.write(far, SPEED * 64)
        wait_until(lambda: rows_in(file) >= frames)
        grown = memory_of(capture) - before
        process.send_signal(signal.SIGCONT)
        process.send_signal(signal.SIGINT)
        code, _, _errors = ended(process)
    assert code == 0
    assert sum(row.raw == SPEED for row in read_rows(file)) == frames
    assert grown < 100_000_000


def memory_of(pid: int) -> int:
    """Bytes of real memory that a process has."""
    fields = Path(f"/proc/{pid}/statm").read_text().split()
    return int(fields[1]) * os.sysconf("SC_PAGE_SIZE")


FAST = ("sim://?seed=1&rate=5000", "--baud", "1000000")
"""Many rows in little time."""


def test_the_oldest_file_makes_room_where_that_is_asked_for(environment, tmp_path: Path) -> None:
    options = ("--max-size", "200kB")
    with started(environment, tmp_path, "live", *FAST, *options, "-o", "x.mcap") as process:
        while not (tmp_path / "x_00009.mcap").exists():
            until(process, b"speed_feedback")
        process.send_signal(signal.SIGINT)
        code, _, errors = ended(process)
    assert code == 0, errors
    files = sorted(tmp_path.glob("*.mcap"))
    assert files[0].name != "x_00001.mcap"
    rows = [row for file in files for row in read_rows(file)]
    first = rows[0].offset
    named = f"recorded to {files[0].name} to {files[-1].name}, {len(files)} files\n"
    assert errors.endswith(named)
    assert [row.offset for row in rows] == list(range(first, first + 10 * len(rows), 10))
