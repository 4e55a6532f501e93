"""Start-up: wall time of short commands relative to `python -c pass`, in one run.

python -m benchmarks.startup
"""

from __future__ import annotations

import os
import statistics
import subprocess
import sys
import time

ROUNDS = 25
FRAME = "AA 02 02 03 E8 00 00 27 10 EE"
COMMANDS = {
    "python -c pass": ["-c", "pass"],
    "hex (dissection)": ["-m", "fte_sniff", "hex", FRAME],
    "hex --format jsonl": ["-m", "fte_sniff", "hex", FRAME, "--format", "jsonl"],
    "encode": ["-m", "fte_sniff", "encode", "speed", "--motor", "1", "--rpm", "1000"],
}


def wall_time_s(arguments: list[str]) -> float:
    """Seconds from starting Python with these arguments to its end."""
    # An installed program is compiled; some containers say that it is to be compiled each time.
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}
    command = [sys.executable, *arguments]
    start = time.perf_counter()
    subprocess.run(command, stdout=subprocess.DEVNULL, env=environment, check=True)
    return time.perf_counter() - start


def main() -> None:
    """Run all commands in turn, so that noise meets each alike, and print medians and ratios."""
    times: dict[str, list[float]] = {name: [] for name in COMMANDS}
    for _ in range(ROUNDS):
        for name, arguments in COMMANDS.items():
            times[name].append(wall_time_s(arguments))
    medians = {name: statistics.median(found) for name, found in times.items()}
    base = next(iter(medians.values()))
    print(f"{'command':<20} {'median':>9} {'ratio':>6}   (wanted: at most 5)")
    for name, median in medians.items():
        print(f"{name:<20} {median * 1e3:6.1f} ms {median / base:6.2f}")


if __name__ == "__main__":
    main()
