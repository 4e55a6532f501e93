"""A recording that is killed by SIGKILL: what is left in the file.

A child records two wires at full line rate, and reports each finished flush. After it is killed,
the file must open in the mcap package's seeking and streaming readers, with all checksums checked,
and hold every row whose flush was reported.
"""

from __future__ import annotations

import argparse
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from mcap.reader import NonSeekingReader, make_reader

from fte_sniff.recording.metadata import PortFacts
from fte_sniff.recording.recorder import Recorder, RecordingOptions
from tests.beside import running
from tests.support.columns import entries, read_rows
from tests.support.recorded_rows import PORTS, rows_a_second, rows_of

_PACE_S = 0.02
ROTATE_BYTES = 100_000


@dataclass(frozen=True, slots=True)
class Left:
    """The result of one killed child."""

    problem: str
    """Why its file is not valid; empty if it is."""
    flushed: int
    """Rows whose flush it reported."""
    written: int
    """Rows that it reported before writing them, flushed or not."""
    found: int
    """Rows in the file."""
    since_flush_s: float
    """From its last flush to its death."""
    files: int
    """Number of its files."""

    @property
    def missing(self) -> int:
        """Flushed rows that are not in the file."""
        return max(0, self.flushed - self.found)


def record(path: Path, every_s: float, rotate_bytes: int | None) -> None:
    """Record until killed; `every_s` 0 flushes after each write. Prints `w ROWS` and `f ROWS`."""
    a_second = rows_a_second()
    step = max(1, int(a_second * _PACE_S))
    ready = [rows_of(first, step) for first in range(0, a_second * 8, step)]
    ports = [PortFacts(port, 115_200) for port in PORTS]
    writer = Recorder(path, ports, options=RecordingOptions(rotate_bytes=rotate_bytes))
    begun = flushed = time.monotonic()
    count = 0
    for rows in ready if every_s else _endless(step * 50):
        count += len(rows)
        print("w", count, flush=True)
        writer.write(*entries(rows))
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


def kill_one(
    path: Path, every_s: float, after_s: float, *, after_rows: int = 0, rotate: bool = False
) -> Left:
    """Kill a child `after_s` seconds after its first rows, and read the recording that it left.

    However slow the machine is, the child has recorded `after_rows` rows by then.
    """
    command = [sys.executable, "-m", "tests.support.recording_kill", str(path)]
    command += ["--rotate"] if rotate else []
    with running([*command, "--every", str(every_s)], stdout=subprocess.PIPE, text=True) as child:
        assert child.stdout is not None
        lines = [child.stdout.readline()]
        killer = time.monotonic() + after_s
        while lines[-1] and (time.monotonic() < killer or int(lines[-1].split()[1]) < after_rows):
            lines.append(child.stdout.readline())
        killed_s = time.monotonic()
        child.send_signal(signal.SIGKILL)
        lines += child.stdout.read().splitlines(keepends=True)
    counts, flushed_s = {"w": 0, "f": 0}, killed_s
    for line in lines:
        if not line.endswith("\n"):
            continue  # killed while printing this line
        word, count, *at = line.split()
        counts[word] = int(count)
        if at:
            flushed_s = float(at[0])
    results = [opened(one) for one in sorted(path.parent.glob(f"{path.stem}[._]*mcap"))]
    problem, found = (
        next((one for one, _ in results if one), ""),
        sum(count for _, count in results),
    )
    waited_s = killed_s - flushed_s
    return Left(problem, counts["f"], counts["w"], found, waited_s, len(results))


def opened(path: Path) -> tuple[str, int]:
    """What is wrong with the file for the readers, and the number of its rows."""
    try:
        with path.open("rb") as file:
            reader = make_reader(file, validate_crcs=True)
            summary = reader.get_summary()
            count = sum(1 for _ in reader.iter_messages())
            file.seek(0)
            streamed = NonSeekingReader(file, validate_crcs=True).iter_messages()
            if sum(1 for _ in streamed) != count:
                return "the streaming reader finds other messages", count
        if summary is None or summary.statistics is None:
            return "", count  # the fixed end of a capture has none
        # Without a chunk in the index, the package reads the file from its start, with the write
        # that the kill interrupted.
        if summary.chunk_indexes and summary.statistics.message_count != count:
            return "its summary counts other messages", count
    except Exception as error:  # noqa: BLE001 - whatever the package raises means that it is not valid
        try:
            return f"{type(error).__name__}: {error}", sum(1 for _ in read_rows(path))
        except Exception as worse:  # noqa: BLE001
            return f"{type(error).__name__}, {worse}", 0
    return "", count


def main() -> None:
    """Record until killed."""
    parser = argparse.ArgumentParser()
    parser.add_argument("path", type=Path)
    parser.add_argument("--every", type=float)
    parser.add_argument("--rotate", action="store_true")
    options = parser.parse_args()
    longest = ROTATE_BYTES if options.rotate else None
    record(options.path, options.every, longest)


if __name__ == "__main__":
    main()
