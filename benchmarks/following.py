"""Following a recording: the delay of a flush, the speed against plain decode, the memory.

    python -m benchmarks.following [--flushes 50] [--files 400]

`delay` is from the end of a flush to the row's line in the output of `decode --follow`, or to the
row count on the screen of `view --follow`. `speed` is the time of `decode --follow` for a
recording that is complete, without the wait for its end, relative to plain `decode`. `memory` is
the peak of `decode --follow` after some files of a capture that rotates with every flush.
"""

from __future__ import annotations

import argparse
import fcntl
import os
import pty
import re
import statistics
import struct
import subprocess
import sys
import termios
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter

from fte_sniff.recording.metadata import PortFacts, host_facts
from fte_sniff.recording.recorder import Recorder, RecordingOptions
from tests.support.columns import entries
from tests.support.recorded_rows import PORTS, make_recordings, rows_of

PROGRAM = [sys.executable, "-P", "-m", "fte_sniff"]

FRAMES = 100
"""Frames of each wire in a flush."""

ROUNDS = 3


def peak_kb(pid: int) -> int:
    """The peak memory of a process so far."""
    try:
        status = Path(f"/proc/{pid}/status").read_text(encoding="ascii", errors="replace")
    except OSError:
        return 0
    found = re.search(r"VmHWM:\s+(\d+) kB", status)
    return int(found[1]) if found else 0


class Reader:
    """What the program writes, as it comes."""

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor
        self._found = b""

    def until(self, wanted: bytes) -> None:
        """Read until it has written this; what comes after it stays for the next call."""
        while wanted not in self._found:
            self._found += os.read(self._descriptor, 1 << 16)
        self._found = self._found.partition(wanted)[2]


@contextmanager
def followed(command: str, path: Path, *options: str) -> Iterator[tuple[int, Reader]]:
    """The program follows a recording in a terminal; its process and what it draws."""
    ours, theirs = pty.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("4H", 24, 160, 0, 0))
    process = subprocess.Popen(
        [*PROGRAM, command, "--follow", str(path), *options],
        stdin=theirs,
        stdout=theirs,
        stderr=subprocess.DEVNULL,
        env=os.environ | {"TERM": "xterm-256color"},
    )
    try:
        yield process.pid, Reader(ours)
    finally:
        process.kill()
        process.wait()
        os.close(ours)
        os.close(theirs)


class Writer:
    """Records `FRAMES` frames of each wire with each flush."""

    def __init__(self, path: Path, options: RecordingOptions | None = None) -> None:
        ports = [PortFacts(port, 115_200) for port in PORTS]
        self._recorder = Recorder(path, ports, host_facts(10**18), options=options)
        self.path = self._recorder.path
        self.frames = 0

    def flush(self) -> None:
        """Record the next rows."""
        self._recorder.write(*entries(rows_of(self.frames, FRAMES)))
        self.frames += FRAMES
        self._recorder.flush()


def delays(
    command: str, folder: Path, flushes: int, shown: Callable[[int], bytes], *options: str
) -> list[float]:
    """Seconds from each flush to what it shows, for a number of rows."""
    writer, found = Writer(folder / f"{command}.mcap"), []
    writer.flush()
    with followed(command, writer.path, *options) as (_, reader):
        reader.until(shown(writer.frames))
        for _ in range(flushes):
            writer.flush()
            begin = perf_counter()
            reader.until(shown(writer.frames))
            found.append(perf_counter() - begin)
    return found


def seconds(*arguments: str) -> float:
    """The time that `decode` needs to write all rows of a file as CSV, and its end."""
    begin = perf_counter()
    subprocess.run(
        [*PROGRAM, "decode", *arguments, "--format", "csv"],
        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, check=True,
    )  # fmt: skip
    return perf_counter() - begin


def memory(folder: Path, files: int) -> Iterator[tuple[int, int]]:
    """Numbers of files that were followed, and the peak memory in MB up to then."""
    writer = Writer(folder / "rotating.mcap", RecordingOptions(rotate_s=1e-9))
    writer.flush()
    with followed("decode", writer.path, "--format", "csv") as (pid, reader):
        for number in range(1, files + 1):
            reader.until(line(writer.frames))
            if number in (files // 10, files // 2, files):
                yield number, peak_kb(pid) // 1000
            writer.flush()


def line(frames: int) -> bytes:
    """The start of the last row's line, after its time."""
    return b"%s,%d,10," % (PORTS[1].encode(), 10 * (frames - 1))


def count(frames: int) -> bytes:
    """The number of rows as the screen shows it."""
    return f"{frames * len(PORTS):,} rows".encode()


def main() -> None:
    """Print the delays, the speed and the memory."""
    parser = argparse.ArgumentParser(description="Delay, speed and memory of --follow.")
    parser.add_argument("--flushes", type=int, default=50)
    parser.add_argument("--files", type=int, default=400)
    options = parser.parse_args()
    with TemporaryDirectory() as name:
        folder = Path(name)
        for command, shown, given in (("decode", line, ("--format", "csv")), ("view", count, ())):
            found = delays(command, folder, options.flushes, shown, *given)
            median, most = statistics.median(found), max(found)
            print(f"{command:<6} a flush appears after {median:.2f} s, at most {most:.2f} s")
        made = folder / "made"
        made.mkdir()
        make_recordings(made, 1, 1_000_000)
        (path,) = map(str, made.iterdir())
        ratios = [
            seconds("--follow", "--idle", "0.05", path) / seconds(path) for _ in range(ROUNDS)
        ]
        print(f"1,000,000 rows: {statistics.median(ratios):.2f} of the time of plain decode")
        for number, megabytes in memory(folder, options.files):
            print(f"{number:>6,} files followed: {megabytes} MB")


if __name__ == "__main__":
    main()
