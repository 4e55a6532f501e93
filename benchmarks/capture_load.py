"""Load of a capture: both directions at a baud, with the screen; lost bytes, CPU and memory.

Two processes write frames to pseudo-terminals at the pace of a baud; the real program captures,
records and shows them. Lost are bytes that were sent and are not in the recording; refused are
bytes that the terminal had no room for, because it was not read in time. CPU is the share of one
core from the first frame to the last; memory is the peak.

    python -m benchmarks.capture_load [--seconds S] [--bauds B ...] [--busy] [--also OPTIONS]
    python -m benchmarks.capture_load --highest       the highest pace that loses nothing
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from benchmarks.live_program import LiveProgram, Taken, taken
from benchmarks.paced_line import PacedLine
from fte_sniff.protocol.items import PortEvent
from fte_sniff.protocol.rows import Rows
from fte_sniff.protocol.spec import FRAME_LENGTH
from fte_sniff.recording.reader import Recording

BAUDS = (115_200, 921_600, 3_000_000)
KINDS = ("position", "position_feedback")
_QUIET_S = 2.0
"""Time for the program to record the last bytes, seconds."""
_SAMPLE_S = 0.25


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
        """True if nothing was lost."""
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


def run(baud: int, seconds: float, *, busy: bool = False, also: Sequence[str] = ()) -> Load:
    """Load the program at the pace of `baud` in both directions; `also` are options of `live`."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        lines = [PacedLine(kind) for kind in KINDS]
        arguments = [line.device for line in lines]
        words = ["live", *arguments, "--baud", str(baud), "-o", "x.mcap", *also]
        program = LiveProgram(words, folder)
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
    """Sample the memory of both processes while they are loaded; return the peaks."""
    start, most = time.monotonic(), (0.0, 0.0)
    while time.monotonic() < start + seconds:
        capture, view = taken(program.capture_pid), taken(program.pid)
        most = max(most[0], capture.rss_mb), max(most[1], view.rss_mb)
        time.sleep(_SAMPLE_S)
    return most


def _recorded(path: Path) -> tuple[int, Counter[str]]:
    """Number of bytes in the recording, and of events by kind."""
    count, events = 0, Counter[str]()
    for item in Recording(path).items():
        if isinstance(item, PortEvent):
            events[item.kind.value] += 1
        elif isinstance(item, Rows):
            count += int(item.length.sum())
    return count, events


def _highest(seconds: float) -> None:
    print(HEADER)
    baud = BAUDS[-1]
    while (found := run(baud, seconds)).sound:
        print(found.line(), flush=True)
        baud = baud * 5 // 4
    print(found.line(), "(too much)")


def main() -> None:
    """Run the benchmark, and print its table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--bauds", type=int, nargs="+", default=BAUDS)
    parser.add_argument("--busy", action="store_true", help="press keys meanwhile")
    parser.add_argument("--highest", action="store_true")
    parser.add_argument("--also", default="", help="further options of live, in one word")
    options = parser.parse_args()
    if options.highest:
        _highest(options.seconds)
    else:
        print(HEADER)
        for baud in options.bauds:
            print(
                run(baud, options.seconds, busy=options.busy, also=options.also.split()).line(),
                flush=True,
            )


if __name__ == "__main__":
    main()
