"""`live` in a bad world: full disks, closed folders, ports that vanish, and a view that stalls."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import tty
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from fte_sniff.protocol import PortEventKind
from fte_sniff.recording.reader import RecordingReader
from fte_sniff.session.capture_process import MOST_WAITING
from tests.cli.processes import (
    ended,
    hears,
    holding,
    started,
    until,
    wait_until,
    wire,
)
from tests.cli.test_live_ports import count, told

SIM = "sim://?seed=1&rate=1000"
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


@pytest.fixture
def closed_folder(tmp_path: Path) -> Iterator[Path]:
    """A folder in which nothing can be made; root too is bound by a read-only file system."""
    folder = tmp_path / "closed"
    if os.geteuid() == 0:
        with mounted(folder, "ro"):
            yield folder
    else:
        folder.mkdir(mode=0o555)
        yield folder


def test_a_disk_that_fills_up_is_told_at_once_and_the_rows_go_on(
    run, environment, small_disk: Path
) -> None:
    with started(environment, small_disk, "live", SIM, "-o", "x.mcap") as process:
        said = told(process, "recording stopped")
        assert "the disk is full" in said
        assert said.count("recording stopped") == 1
        process.send_signal(signal.SIGINT)
        code, output, errors = ended(process)
    assert code == 4
    assert output
    assert "the disk is full" in errors
    assert "Traceback" not in errors
    assert count(small_disk / "x.mcap") > 100


def test_a_folder_that_must_not_be_written_to_is_one_line(environment, closed_folder: Path) -> None:
    with started(environment, closed_folder, "live", SIM, "--count", "3") as process:
        code, output, errors = ended(process)
    assert code == 4
    assert output == ""
    assert errors.count("\n") == 1
    assert "no permission" in errors or "Read-only file system" in errors
    assert "name another place with -o" in errors


def test_a_port_that_vanishes_while_it_is_opened_is_one_line(run, tmp_path: Path) -> None:
    far, near = os.openpty()
    tty.setraw(near)
    device = os.ttyname(near)
    # The near end keeps the name alive; what is behind it is gone.
    os.close(far)
    try:
        done = run("live", device, "-o", "x.mcap")
    finally:
        os.close(near)
    assert done.returncode == 3
    assert done.stderr.count("\n") == 1
    assert "no such port" in done.stderr or "unplugged" in done.stderr
    assert list(tmp_path.iterdir()) == []


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
        told(process, "recording to")
        until(process, b"speed_feedback")
        mark.touch()
        said = told(process, " clock set: ")
        assert "this machine's clock was set back by 3600." in said
        until(process, b"speed_feedback")
        process.send_signal(signal.SIGINT)
        code, _, errors = ended(process)
    assert code == 0
    assert "port events: clock_set 1" in errors
    reader = RecordingReader(tmp_path / "x.mcap")
    times = [row.t_ns or 0 for row in reader]
    assert times == sorted(times)
    assert times[-1] - times[0] < 600 * 10**9
    (event,) = [e for e in reader.events() if e.kind is PortEventKind.CLOCK_SET]
    assert times[0] < event.t_ns < times[-1]


def test_a_stopped_view_costs_no_byte_and_bounded_memory(run, environment, tmp_path: Path) -> None:
    frames = 3 * MOST_WAITING
    file = tmp_path / "x.mcap"
    with (
        wire() as (far, name),
        started(
            environment, tmp_path, "live", name, "--baud", "3000000", "-o", "x.mcap"
        ) as process,
    ):
        hears(process, far)
        wait_until(lambda: bool(holding(file)))
        (capture,) = holding(file)
        process.send_signal(signal.SIGSTOP)
        before = memory_of(capture)
        for _ in range(frames // 64):
            os.write(far, SPEED * 64)
        wait_until(lambda: count(file) >= frames)
        grown = memory_of(capture) - before
        process.send_signal(signal.SIGCONT)
        process.send_signal(signal.SIGINT)
        code, _, errors = ended(process)
    assert code == 0
    assert "rows more came too fast to be printed" in errors
    assert sum(row.raw == SPEED for row in RecordingReader(file)) == frames
    # What waits for the view is bounded by rows, each of some hundred bytes.
    assert grown < MOST_WAITING * 1500


def memory_of(pid: int) -> int:
    """Bytes of real memory that a process has."""
    fields = Path(f"/proc/{pid}/statm").read_text().split()
    return int(fields[1]) * os.sysconf("SC_PAGE_SIZE")
