"""Start-up: processor time of short commands relative to a Python that imports click, in one run.

python -m benchmarks.startup
"""

from __future__ import annotations

import os
import statistics
import sys

ROUNDS = 40
FRAME = "AA 02 02 03 E8 00 00 27 10 EE"
COMMANDS = {
    "python -c 'import click'": ["-c", "import click"],
    "hex": ["-m", "fte_sniff", "hex", FRAME],
    "hex --format jsonl": ["-m", "fte_sniff", "hex", FRAME, "--format", "jsonl"],
    "encode": ["-m", "fte_sniff", "encode", "speed", "--motor", "1", "--rpm", "1000"],
    "decode": ["-m", "fte_sniff", "decode", "samples/clean.raw", "--limit", "1"],
}


def processor_time_s(arguments: list[str]) -> float:
    """Seconds of processor time of a Python with these arguments."""
    # An installed program is compiled; some containers say that it is to be compiled each time.
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}
    nowhere = [(os.POSIX_SPAWN_OPEN, out, os.devnull, os.O_WRONLY, 0) for out in (1, 2)]
    command = [sys.executable, "-P", *arguments]
    process = os.posix_spawn(sys.executable, command, environment, file_actions=nowhere)
    _, status, usage = os.wait4(process, 0)
    assert not status
    return usage.ru_utime + usage.ru_stime


def main() -> None:
    """Run all commands in turn, so that noise meets each alike; print least times and medians."""
    times: dict[str, list[float]] = {name: [] for name in COMMANDS}
    for _ in range(ROUNDS):
        for name, arguments in COMMANDS.items():
            times[name].append(processor_time_s(arguments))
    base = next(iter(times.values()))
    print(f"{'command':<25} {'least':>9} {'ratio':>5}   {'median':>8} {'ratio':>5}")
    for name, found in times.items():
        least, median = min(found), statistics.median(found)
        ratios = least / min(base), median / statistics.median(base)
        print(
            f"{name:<25} {least * 1e3:6.1f} ms {ratios[0]:5.2f}   "
            f"{median * 1e3:5.1f} ms {ratios[1]:5.2f}"
        )


if __name__ == "__main__":
    main()
