"""What `live --attach` costs the program that it watches: round trips a second, with and without.

The target writes a frame to a pseudo-terminal and reads the answer, as fast as it can; a thread of
this program answers. That is far more than a line carries: at 115200 baud, a round trip of two
frames takes 1.7 ms. Runs with and without alternate.

    python -m benchmarks.attach_cost [--seconds S] [--runs N]
"""

from __future__ import annotations

import argparse
import os
import statistics
import subprocess
import sys
import threading
import tty

from fte_sniff.capture.clock import Clock
from fte_sniff.capture.wiring import Wiring
from fte_sniff.protocol.items import Chunk
from fte_sniff.protocol.spec import FRAME_LENGTH

_TARGET = """
import os, sys, time
line = os.open(sys.argv[1], os.O_RDWR | os.O_NOCTTY)
print(flush=True); sys.stdin.readline()
frame, end, trips = bytes.fromhex("AA010103E800000000EE"), time.monotonic() + float(sys.argv[2]), 0
while time.monotonic() < end:
    os.write(line, frame); os.read(line, 64); trips += 1
print(trips, flush=True); sys.stdin.readline()
"""
_ANSWER = bytes.fromhex("55010103E80000000FEE")


def run(seconds: float, *, attach: bool) -> tuple[float, int, int]:
    """Round trips a second, the bytes that the target moved, and those that were seen."""
    far, near = os.openpty()
    tty.setraw(near)
    threading.Thread(target=_answer, args=(far,), daemon=True).start()
    words = [sys.executable, "-c", _TARGET, os.ttyname(near), str(seconds)]
    with subprocess.Popen(
        words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as target:
        assert target.stdin is not None
        assert target.stdout is not None
        target.stdout.readline()
        os.close(near)
        seen = 0
        source = Wiring([words[3]], way="attach").open(Clock.tied()).__enter__() if attach else None
        target.stdin.write("\n")
        target.stdin.flush()
        trips = int(target.stdout.readline())
        if source is not None:
            source.stop()
            seen = sum(
                len(item.data) for batch in source for item in batch if isinstance(item, Chunk)
            )
        target.stdin.close()
    os.close(far)
    return trips / seconds, 2 * FRAME_LENGTH * trips, seen


def _answer(far: int) -> None:
    try:
        while os.read(far, 64):
            os.write(far, _ANSWER)
    except OSError:
        return


def main() -> None:
    """Run the benchmark, and print its table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=3.0)
    parser.add_argument("--runs", type=int, default=5)
    options = parser.parse_args()
    rates: dict[bool, list[float]] = {False: [], True: []}
    for _ in range(options.runs):
        for attach in (False, True):
            rate, moved, seen = run(options.seconds, attach=attach)
            rates[attach].append(rate)
            if attach:
                print(f"{moved:,} bytes moved, {seen:,} seen")
    alone, watched = (statistics.median(rates[attach]) for attach in (False, True))
    print(f"{alone:,.0f} round trips/s alone, {watched:,.0f} watched: {watched / alone:.0%}")
    print(f"a round trip takes {1e6 / alone:.0f} us alone, {1e6 / watched:.0f} us watched")


if __name__ == "__main__":
    main()
