"""Measures the commands that read files on raw bytes and hex logs, against recordings and a copy.

    python -m benchmarks.decode_speed [--frames 1000000] [--rounds 3] [--work csv stats ...]

The inputs hold the same rows: raw bytes, damaged raw bytes, hex lines, a log with times and
directions, and a recording. Each command is a process; the figure is rows in a second of processor
time, from the difference between all rows and an eighth of them, so that start-up does not count;
the median of the rounds. `benchmarks.against` compares two checkouts.
"""

from __future__ import annotations

import argparse
import os
import resource
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory

import numpy as np

from benchmarks.recording_speed import PORTS, frame_pool
from fte_sniff.protocol.rows import Rows
from fte_sniff.protocol.spec import FRAME_LENGTH
from tests.support.faults import damaged_stream
from tests.support.recorded_rows import write_recording

START_NS = 1_770_000_000 * 10**9
PART = 8
"""Divisor for the rows of the part."""
INPUTS = ("recording", "raw", "damaged", "hex", "log")
WORK: Mapping[str, tuple[str, ...]] = {
    "csv": ("decode", "--format", "csv"),
    "jsonl": ("decode", "--format", "jsonl"),
    "table": ("decode", "--format", "table"),
    "parquet": ("decode", "--force", "-o", "out.parquet"),
    "raw": ("decode", "--force", "-o", "out.raw"),
    "filter": ("decode", "--format", "csv", "--filter", "motor = 1 AND rpm > 1500"),
    "stats": ("stats",),
}
NAME = {
    "raw": "rows.bin",
    "damaged": "damaged.bin",
    "hex": "rows.hex",
    "log": "rows.log",
    "recording": "rows.mcap",
}


def written(folder: Path, frames: int) -> Path:
    """Write the rows in every input format."""
    folder.mkdir()
    pool = frame_pool()
    rows = pool[np.random.default_rng(2).integers(0, len(pool), frames)]
    data = rows.tobytes()
    (folder / NAME["raw"]).write_bytes(data)
    stream, _ = damaged_stream(1, min(frames, 50_000), 0.01, "ordinary")
    damaged = stream * (frames * FRAME_LENGTH // len(stream) + 1)
    (folder / NAME["damaged"]).write_bytes(damaged[: frames * FRAME_LENGTH])
    texts = [data[at : at + FRAME_LENGTH].hex(" ").upper() for at in range(0, len(data), 10)]
    (folder / NAME["hex"]).write_text("".join(f"{text}\n" for text in texts))
    (folder / NAME["log"]).write_text(
        "".join(
            f"[2026-01-31 10:{at // 60_000 % 60:02}:{at // 1000 % 60:02}.{at % 1000:03}]"
            f"{'收←◆' if text.startswith('55') else '发→◇'}{text}\n"
            for at, text in enumerate(texts)
        )
    )
    columns = Rows.blank(frames, (PORTS[0].name,))
    at = np.arange(frames)
    columns.t_ns[:], columns.offset[:] = START_NS + at * 868_056, at * FRAME_LENGTH
    columns.raw[:, :FRAME_LENGTH] = rows
    write_recording(folder / NAME["recording"], PORTS[:1], [columns])
    return folder


def cost(command: tuple[str, ...], folder: Path) -> float:
    """Processor seconds of a process."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run(
        command,
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(Path(__file__).parent.parent.resolve())},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        check=True,
    )
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


@dataclass(frozen=True)
class Inputs:
    """All rows, and a part of them, in every input format."""

    whole: Path
    part: Path
    between: int
    """Rows that only the whole has."""

    @classmethod
    def written(cls, folder: Path, frames: int) -> Inputs:
        """Write them."""
        part = frames // PART
        return cls(written(folder / "whole", frames), written(folder / "part", part), frames - part)

    def speed(self, work: str, source: str) -> float:
        """Rows in a second of processor time; the start-up is in both runs."""
        command = (sys.executable, "-m", "fte_sniff", *WORK[work], NAME[source])
        used = [cost(command, folder) for folder in (self.whole, self.part)]
        return self.between / max(used[0] - used[1], 0.001)


def measure(inputs: Inputs, rounds: int, works: list[str]) -> None:
    """Print a line for each command and input: rows a second, and relative to the recording."""
    print("rows in a second of processor time")
    for work in works:
        of_recording = 0.0
        for source in INPUTS:
            found = median(inputs.speed(work, source) for _ in range(rounds))
            of_recording = of_recording or found
            line = f"{work:8}{source:10}{found:12,.0f}  {found / of_recording:5.2f}x recording"
            print(line, flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=1_000_000)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--work", nargs="*", choices=WORK, default=list(WORK))
    chosen = parser.parse_args()
    with TemporaryDirectory() as name:
        inputs = Inputs.written(Path(name), chosen.frames)
        measure(inputs, chosen.rounds, chosen.work)
        copied = cost(("cp", NAME["raw"], "copy"), inputs.whole)
        print(f"cp of the raw bytes: {chosen.frames / max(copied, 1e-4):,.0f} rows a second")


if __name__ == "__main__":
    main()
