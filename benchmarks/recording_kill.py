"""Recordings killed by SIGKILL at random moments: what is left in the file.

python -m benchmarks.recording_kill [--kills 200] [--every 1.0] [--folder FOLDER]
python -m benchmarks.recording_kill --stress        flush after flush, without a pause
python -m benchmarks.recording_kill --stress --rotate       and a new file every few flushes

A child records two wires at full line rate, and reports each finished flush. It is killed at a
random moment. Then the file must open in the mcap package's seeking and streaming readers, with all
checksums checked, and hold every row whose flush was reported. `--parallel` sets the number of
children at once. With `--rotate` all files of the sequence must open so, and hold those rows.
"""

from __future__ import annotations

import argparse
import random
import tempfile
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from tests.support.recording_kill import Left, kill_one

_LONGEST_S = 5.0


def report(found: list[Left], every_s: float) -> None:
    """Print the table."""
    problems = Counter(left.problem for left in found if left.problem)
    lost = sorted(left.written - left.found for left in found)
    print(f"{len(found)} kills, a flush every {every_s:g} s")
    print(f"{'opened as they are, seeking and streaming':<48} {len(found) - problems.total()}")
    print(f"{'files of them all':<48} {sum(left.files for left in found)}")
    print(f"{'kills that cost flushed rows':<48} {sum(left.missing > 0 for left in found)}")
    print(f"{'rows not flushed, and lost: median':<48} {lost[len(lost) // 2]}")
    print(f"{'rows not flushed, and lost: most':<48} {lost[-1]}")
    waited_s = max(left.since_flush_s for left in found)
    print(f"{'seconds from the last flush to the kill: most':<48} {waited_s:.2f}")
    for problem, count in problems.items():
        print(f"{count} times: {problem}")


def main() -> None:
    """Kill many recordings, and print the results."""
    parser = argparse.ArgumentParser(description="What is left of killed recordings.")
    parser.add_argument("--kills", type=int, default=200)
    parser.add_argument("--every", type=float, default=1.0)
    parser.add_argument("--stress", action="store_true")
    parser.add_argument("--rotate", action="store_true")
    parser.add_argument("--parallel", type=int, default=8)
    parser.add_argument("--folder", type=Path)
    options = parser.parse_args()
    every_s = 0.0 if options.stress else options.every
    rng = random.Random()
    with (
        tempfile.TemporaryDirectory(dir=options.folder) as name,
        ThreadPoolExecutor(1 if options.stress else options.parallel) as pool,
    ):
        kills = [
            pool.submit(
                kill_one,
                Path(name) / f"{number}.mcap",
                every_s,
                rng.uniform(0, 0.3 if options.stress else _LONGEST_S),
                rotate=options.rotate,
            )
            for number in range(options.kills)
        ]
        report([kill.result() for kill in kills], every_s)


if __name__ == "__main__":
    main()
