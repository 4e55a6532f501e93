"""Accuracy of the line diagnosis, on simulated UARTs.

python -m benchmarks.baud_guess

Each line of the table is one setting of the sender; the receiver is at 115200 baud. It has the
diagnoses, and how often the likeliest guess was right. The last line is the cost of removing the
terminal's PARMRK marks from received bytes.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable
from itertools import product
from random import Random

from fte_sniff.analysis.baud_guess import COMMON_BAUDS, LineSetting, diagnose
from fte_sniff.capture.uart_errors import Unmarker
from fte_sniff.protocol import DEFAULT_BAUD, KINDS, Direction
from tests.support.faults import draw_frame, ordinary
from tests.support.uart import AfterError
from tests.support.uart import received as received_by_hardware

SEEDS = range(2)
FRAMES = 80
TRAFFIC = (
    KINDS,
    tuple(kind for kind in KINDS if kind.direction is Direction.CONTROL),
    tuple(kind for kind in KINDS if kind.direction is Direction.FEEDBACK),
)


def main() -> None:
    """Print the table."""
    for inverted, baud in product((False, True), COMMON_BAUDS):
        conditions: Counter[str] = Counter()
        hits = 0
        truth = LineSetting(baud, inverted)
        for seed, kinds, after_error in product(SEEDS, TRAFFIC, AfterError):
            random = Random(f"{seed} {baud}")
            frames = [draw_frame(random, ordinary, kinds) for _ in range(FRAMES)]
            data = received_by_hardware(
                seed, frames, baud, DEFAULT_BAUD, inverted=inverted, after_error=after_error
            )
            found = diagnose(data, DEFAULT_BAUD)
            conditions[found.condition] += 1
            hits += bool(found.guesses) and found.guesses[0][0] == truth
        words = ", ".join(f"{word} {count}" for word, count in conditions.most_common())
        polarity = "inverted" if inverted else "normal"
        print(f"{baud:>9,} {polarity:<8}  guessed {hits:>2} of {conditions.total()}  {words}")
    _print_cost_of_marks()


def _print_cost_of_marks() -> None:
    data = Random(1).randbytes(1 << 22)
    marked = data.replace(b"\xff", b"\xff\xff")
    pieces = [marked[at : at + 4096] for at in range(0, len(marked), 4096)]
    copying = _seconds(lambda: [bytes(bytearray(piece)) for piece in pieces])
    unmarker = Unmarker()
    unmarking = _seconds(lambda: [unmarker.feed(piece) for piece in pieces])
    speed = len(data) / unmarking / 1e6
    print(f"marks removed at {speed:.0f} MB/s, 1/{unmarking / copying:.0f} of copying twice")


def _seconds(work: Callable[[], object]) -> float:
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


if __name__ == "__main__":
    main()
