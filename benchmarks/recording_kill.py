"""Owns the figure for recordings that are killed: what is left after SIGKILL at random moments.

python -m benchmarks.recording_kill [--kills 200] [--every 1.0] [--folder FOLDER]
python -m benchmarks.recording_kill --stress        flush after flush, without a rest
python -m benchmarks.recording_kill --stress --rotate        and a new file every few flushes

A child records two wires at full line rate, and tells each flush after it returned. It is killed at
a random moment once it has begun. Then the file must open as it is in the mcap package's
seeking reader, all checksums checked, and hold every row whose flush was told; what it lacks of the
rows that were written is at most what came since. `--beside` runs so many children at once.
With `--rotate` all files of the sequence must open so, and hold those rows together.
"""

from __future__ import annotations

import argparse
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from mcap.reader import make_reader

from benchmarks.recorded_rows import PORTS, rows_a_second, rows_of
from fte_sniff.recording.metadata import PortFacts
from fte_sniff.recording.reader import RecordingReader
from fte_sniff.recording.recorder import Recorder
from fte_sniff.recording.retention import DEFAULT_MAX_INDEX_BYTES, RecordingOptions

_PACE_S = 0.02
_LONGEST_S = 5.0
_ROTATE_INDEX = 9_000


@dataclass(frozen=True, slots=True)
class Left:
    """What one killed child left."""

    problem: str
    """Why its file is not valid; empty if it is."""
    told: int
    """Rows whose flush it told."""
    written: int
    """Rows that it had told to be about to write, flushed or not."""
    found: int
    """Rows in the file."""
    since_flush_s: float
    """From its last flush to its death."""
    files: int
    """Files that it had begun."""

    @property
    def missing(self) -> int:
        """Rows that were flushed and are not there."""
        return max(0, self.told - self.found)


def record(path: Path, every_s: float, max_index_bytes: int | None) -> None:
    """Record for ever; `every_s` 0 flushes after each write. Tells `w ROWS` and `f ROWS`."""
    a_second = rows_a_second()
    step = max(1, int(a_second * _PACE_S))
    ready = [rows_of(first, step) for first in range(0, a_second * 8, step)]
    ports = [PortFacts(port, 115_200) for port in PORTS]
    writer = Recorder(path, ports, options=RecordingOptions(max_index_bytes=max_index_bytes))
    begun = flushed = time.monotonic()
    count = 0
    for rows in ready if every_s else _endless(step * 50):
        count += len(rows)
        print("w", count, flush=True)
        writer.write(rows)
        now = time.monotonic()
        if now - flushed >= every_s:
            writer.flush()
            print("f", count, time.monotonic(), flush=True)
            flushed = now
        if every_s:
            time.sleep(max(0.0, begun + count / (2 * a_second) - time.monotonic()))


def _endless(step: int) -> Iterator[list[object]]:
    first = 0
    while True:
        yield rows_of(first, step)  # type: ignore[misc]
        first += step


def kill_one(path: Path, every_s: float, after_s: float, *, rotates: bool = False) -> Left:
    """Let a child record to `path`, kill it `after_s` seconds after its first rows, and look."""
    command = [sys.executable, "-m", "benchmarks.recording_kill", "--record", str(path)]
    command += ["--rotate"] if rotates else []
    with subprocess.Popen(
        [*command, "--every", str(every_s)], stdout=subprocess.PIPE, text=True
    ) as child:
        assert child.stdout is not None
        told = [child.stdout.readline()]
        killer = time.monotonic() + after_s
        while time.monotonic() < killer and told[-1]:
            told.append(child.stdout.readline())
        killed_s = time.monotonic()
        child.send_signal(signal.SIGKILL)
        told += child.stdout.read().splitlines(keepends=True)
    counts, flushed_s = {"w": 0, "f": 0}, killed_s
    for line in told:
        if not line.endswith("\n"):
            continue  # it was killed while it told this
        word, count, *at = line.split()
        counts[word] = int(count)
        if at:
            flushed_s = float(at[0])
    looked = [opened(one) for one in sorted(path.parent.glob(f"{path.stem}[._]*mcap"))]
    problem, found = next((one for one, _ in looked if one), ""), sum(count for _, count in looked)
    waited_s = killed_s - flushed_s
    return Left(problem, counts["f"], counts["w"], found, waited_s, len(looked))


def opened(path: Path) -> tuple[str, int]:
    """What is wrong with the file for a reader that seeks; and how many rows ours finds in it."""
    try:
        with path.open("rb") as file:
            reader = make_reader(file, validate_crcs=True)
            summary = reader.get_summary()
            count = sum(1 for _ in reader.iter_messages())
        if summary is None or summary.statistics is None:
            return "no summary", count
        if summary.statistics.message_count != count:
            return "its summary counts other messages", count
    except Exception as error:  # noqa: BLE001 - whatever the package raises means that it is not valid
        try:
            return f"{type(error).__name__}: {error}", sum(1 for _ in RecordingReader(path))
        except Exception as worse:  # noqa: BLE001
            return f"{type(error).__name__}, {worse}", 0
    return "", count


def report(found: list[Left], every_s: float) -> None:
    """Print the table."""
    problems = Counter(left.problem for left in found if left.problem)
    lost = sorted(left.written - left.found for left in found)
    print(f"{len(found)} kills, a flush every {every_s:g} s")
    print(f"{'opened as they are, seeking, checksums on':<48} {len(found) - problems.total()}")
    print(f"{'files of them all':<48} {sum(left.files for left in found)}")
    print(f"{'kills that cost flushed rows':<48} {sum(left.missing > 0 for left in found)}")
    print(f"{'rows not flushed, and lost: median':<48} {lost[len(lost) // 2]}")
    print(f"{'rows not flushed, and lost: most':<48} {lost[-1]}")
    waited_s = max(left.since_flush_s for left in found)
    print(f"{'seconds from the last flush to the kill: most':<48} {waited_s:.2f}")
    for problem, count in problems.items():
        print(f"{count} times: {problem}")


def main() -> None:
    """Kill many, and print what they left."""
    parser = argparse.ArgumentParser(description="What recordings that are killed leave.")
    parser.add_argument("--kills", type=int, default=200)
    parser.add_argument("--every", type=float, default=1.0)
    parser.add_argument("--stress", action="store_true")
    parser.add_argument("--rotate", action="store_true")
    parser.add_argument("--beside", type=int, default=8)
    parser.add_argument("--folder", type=Path)
    parser.add_argument("--record", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args()
    every_s = 0.0 if options.stress else options.every
    if options.record:
        record(
            options.record, every_s, _ROTATE_INDEX if options.rotate else DEFAULT_MAX_INDEX_BYTES
        )
        return
    rng = random.Random()
    with (
        tempfile.TemporaryDirectory(dir=options.folder) as name,
        ThreadPoolExecutor(1 if options.stress else options.beside) as pool,
    ):
        kills = [
            pool.submit(
                kill_one,
                Path(name) / f"{number}.mcap",
                every_s,
                rng.uniform(0, 0.3 if options.stress else _LONGEST_S),
                rotates=options.rotate,
            )
            for number in range(options.kills)
        ]
        report([kill.result() for kill in kills], every_s)


if __name__ == "__main__":
    main()
