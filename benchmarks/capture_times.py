"""Error of row times, with the screen idle and busy.

A process writes frames to a pseudo-terminal at the pace of 115200 baud, and stores when; the real
program captures, records and shows them. Idle means that no key is pressed, busy fifty keys a
second. The bare reader only reads and stamps: the error of the machine itself in the same run.

    python -m benchmarks.capture_times [--seconds S]
"""

from __future__ import annotations

import argparse
import os
import select
import tempfile
import time
from pathlib import Path

import numpy as np

from benchmarks.live_program import LiveProgram
from benchmarks.paced_line import CLOCK, PacedLine, Sent
from fte_sniff.protocol.rows import Rows
from fte_sniff.protocol.spec import DEFAULT_BAUD, FRAME_LENGTH, byte_time_ns
from fte_sniff.recording.reader import Recording

BYTE_NS = byte_time_ns(DEFAULT_BAUD)

WANTED_MS = 2.0
"""Target for the 99th percentile, milliseconds."""


def errors_ns(recording: Path, sent: Sent) -> np.ndarray:
    """The time of each row minus the true time, nanoseconds."""
    reader = Recording(recording)
    rows = [row for item in reader.items() if isinstance(item, Rows) for row in item]
    facts = reader.facts
    tie = int(facts["clock_utc_at_tie_ns"]) - int(facts["clock_steady_at_tie_ns"])
    if len(rows) != sent.frames or any(len(row.raw) != FRAME_LENGTH for row in rows):
        raise RuntimeError(f"{sent.frames} frames were sent, but {len(rows)} rows came")
    shown = np.array([row.t_ns for row in rows])
    true = np.array(sent.times) + tie - FRAME_LENGTH * BYTE_NS
    return shown - true


def bare(seconds: float) -> tuple[np.ndarray, Sent]:
    """The errors of a loop that only reads and stamps."""
    with tempfile.TemporaryDirectory() as name:
        line = PacedLine("position_feedback")
        poll = select.poll()
        poll.register(line.near, select.POLLIN)
        line.begin(DEFAULT_BAUD, seconds, Path(name) / "times")
        shown: list[int] = []
        size = 0
        poll.poll(60_000)  # the sender starts
        while poll.poll(1000):
            size += len(os.read(line.near, 65_536))
            now_ns = time.clock_gettime_ns(CLOCK)
            while len(shown) < size // FRAME_LENGTH:
                behind = size - len(shown) * FRAME_LENGTH
                shown.append(now_ns - behind * BYTE_NS)
        sent = line.sent()
        line.close()
    return np.array(shown) - np.array(sent.times) + FRAME_LENGTH * BYTE_NS, sent


def measure(seconds: float, *, busy: bool) -> tuple[np.ndarray, Sent]:
    """The errors of one capture of one line."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        line = PacedLine("position_feedback")
        program = LiveProgram(["live", line.device, "-o", "x.mcap"], folder)
        if busy:
            program.keep_busy()
        line.begin(DEFAULT_BAUD, seconds, folder / "times")
        sent = line.sent()
        program.end()
        line.close()
        return errors_ns(folder / "x.mcap", sent), sent


def main() -> None:
    """Measure all runs, and print the percentiles."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=20.0)
    seconds = parser.parse_args().seconds
    print(f"error of row times at {DEFAULT_BAUD} baud, ms (wanted: p99 under {WANTED_MS:g})")
    print(f"{'screen':<7} {'rows':>7} {'refused':>7} {'p1':>7} {'p50':>7} {'p99':>7} {'max':>7}")
    runs = {
        "(bare)": lambda: bare(seconds),
        "idle": lambda: measure(seconds, busy=False),
        "busy": lambda: measure(seconds, busy=True),
    }
    for name, run in runs.items():
        errors, sent = run()
        low, middle, high, most = np.percentile(errors / 1e6, (1, 50, 99, 100))
        print(
            f"{name:<7} {sent.frames:>7,} {sent.refused:>7,} "
            f"{low:7.3f} {middle:7.3f} {high:7.3f} {most:7.3f}"
        )


if __name__ == "__main__":
    main()
