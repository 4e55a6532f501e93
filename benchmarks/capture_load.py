"""Owns the figures for load: both directions at once, screen running; what is lost, what it takes.

Two pseudo-terminals bring frames at the pace of a baud, each from a process of its own; the real
program captures, records and shows them. Lost is what was sent and is not in the recording, bytes;
refused is what the terminal had no room for, since it was not read in time. CPU is the share of one
core, from the first frame to the last; memory is the greatest seen.

    python -m benchmarks.capture_load [--seconds S] [--bauds B ...] [--busy]
    python -m benchmarks.capture_load --highest       the highest pace that loses nothing
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

from benchmarks.live_program import LiveProgram, Taken, taken
from benchmarks.paced_line import PacedLine
from fte_sniff.protocol import FRAME_LENGTH, PortEvent
from fte_sniff.recording.reader import RecordingReader

BAUDS = (115_200, 921_600, 3_000_000)
KINDS = ("position", "position_feedback")
_QUIET_S = 2.0
"""How long the program may take to record what came last, seconds."""
_LOOK_S = 0.25


@dataclass(slots=True)
class Load:
    """One run."""

    baud: int
    seconds: float
    frames: int
    refused: int
    lost: int
    overruns: int
    capture: Taken
    view: Taken

    @property
    def sound(self) -> bool:
        """Whether nothing was lost."""
        return self.lost == 0

    def line(self) -> str:
        """The run as a line of the table."""
        return (
            f"{self.baud:>9,} {self.frames:>11,} {self.frames / self.seconds:>8,.0f} "
            f"{self.lost:>9,} {self.refused:>8,} {self.overruns:>6,} "
            f"{self.capture.cpu_s / self.seconds:>8.1%} {self.capture.rss_mb:>6.0f} "
            f"{self.view.cpu_s / self.seconds:>8.1%} {self.view.rss_mb:>6.0f}"
        )


HEADER = (
    f"{'baud':>9} {'frames':>11} {'frames/s':>8} {'lost':>9} {'refused':>8} {'overr.':>6} "
    f"{'capture':>8} {'MB':>6} {'view':>8} {'MB':>6}"
)


def run(baud: int, seconds: float, *, busy: bool = False) -> Load:
    """Load the program at the pace of `baud` from both sides."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        lines = [PacedLine(kind) for kind in KINDS]
        arguments = [line.device for line in lines]
        program = LiveProgram(["live", *arguments, "--baud", str(baud), "-o", "x.mcap"], folder)
        if busy:
            program.keep_busy()
        before = taken(program.capture_pid), taken(program.pid)
        for line in lines:
            line.begin(baud, seconds)
        most = _watch(program, seconds)
        sent = [line.sent() for line in lines]
        capture, view = (
            Taken(now.cpu_s - then.cpu_s, max(now.rss_mb, peak))
            for now, then, peak in zip(
                (taken(program.capture_pid), taken(program.pid)), before, most, strict=True
            )
        )
        time.sleep(_QUIET_S)
        program.end()
        for line in lines:
            line.close()
        recorded, events = _recorded(folder / "x.mcap")
        frames = sum(one.frames for one in sent)
        return Load(
            baud=baud,
            seconds=seconds,
            frames=frames,
            refused=sum(one.refused for one in sent),
            lost=frames * FRAME_LENGTH - recorded,
            overruns=events["overrun"],
            capture=capture,
            view=view,
        )


def _watch(program: LiveProgram, seconds: float) -> tuple[float, float]:
    """Look at the program's memory while it is loaded; the most that was seen of each process."""
    start, most = time.monotonic(), (0.0, 0.0)
    while time.monotonic() < start + seconds:
        capture, view = taken(program.capture_pid), taken(program.pid)
        most = max(most[0], capture.rss_mb), max(most[1], view.rss_mb)
        time.sleep(_LOOK_S)
    return most


def _recorded(path: Path) -> tuple[int, Counter[str]]:
    """How many bytes the recording holds, and the events by kind."""
    count, events = 0, Counter[str]()
    for entry in RecordingReader(path).entries():
        if isinstance(entry, PortEvent):
            events[entry.kind.value] += 1
        else:
            count += len(entry.raw)
    return count, events


def _highest(seconds: float) -> None:
    print(HEADER)
    baud = BAUDS[-1]
    while (found := run(baud, seconds)).sound:
        print(found.line(), flush=True)
        baud = baud * 5 // 4
    print(found.line(), "(too much)")


def main() -> None:
    """Run what was asked for, and print its table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--bauds", type=int, nargs="+", default=BAUDS)
    parser.add_argument("--busy", action="store_true", help="press keys all the while")
    parser.add_argument("--highest", action="store_true")
    asked = parser.parse_args()
    if asked.highest:
        _highest(asked.seconds)
    else:
        print(HEADER)
        for baud in asked.bauds:
            print(run(baud, asked.seconds, busy=asked.busy).line(), flush=True)


if __name__ == "__main__":
    main()
