"""Owns the figures for the guess what is wrong with a line, by simulated UARTs.

python -m benchmarks.line_verdict

Each line of the table is one way in which the talker truly is set while the receiver is at 115200
baud: what the verdicts were, and how often the likeliest guess was the truth. The last line is the
cost of taking a terminal's marks of bytes in error out of what was read.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable
from itertools import product
from random import Random

from benchmarks.faults import draw_frame, ordinary
from benchmarks.uart import AfterError
from benchmarks.uart import heard as heard_by_hardware
from fte_sniff.analysis.baud_guess import COMMON_BAUDS, Setting, judge
from fte_sniff.capture.uart_errors import Unmarker
from fte_sniff.protocol import DEFAULT_BAUD, KINDS, Direction

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
        verdicts: Counter[str] = Counter()
        hits = 0
        truth = Setting(baud, inverted)
        for seed, kinds, after_error in product(SEEDS, TRAFFIC, AfterError):
            random = Random(f"{seed} {baud}")
            frames = [draw_frame(random, ordinary, kinds) for _ in range(FRAMES)]
            data = heard_by_hardware(
                seed, frames, baud, DEFAULT_BAUD, inverted=inverted, after_error=after_error
            )
            verdict = judge(data, DEFAULT_BAUD)
            verdicts[verdict.condition] += 1
            hits += bool(verdict.guesses) and verdict.guesses[0][0] == truth
        said = ", ".join(f"{word} {count}" for word, count in verdicts.most_common())
        polarity = "inverted" if inverted else "normal"
        print(f"{baud:>9,} {polarity:<8}  guessed {hits:>2} of {verdicts.total()}  {said}")
    _print_cost_of_marks()


def _print_cost_of_marks() -> None:
    data = Random(1).randbytes(1 << 22)
    marked = data.replace(b"\xff", b"\xff\xff")
    pieces = [marked[at : at + 4096] for at in range(0, len(marked), 4096)]
    copying = _seconds(lambda: [bytes(bytearray(piece)) for piece in pieces])
    unmarker = Unmarker()
    taking = _seconds(lambda: [unmarker.feed(piece) for piece in pieces])
    speed = len(data) / taking / 1e6
    print(f"marks taken out at {speed:.0f} MB/s, 1/{taking / copying:.0f} of copying twice")


def _seconds(work: Callable[[], object]) -> float:
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


if __name__ == "__main__":
    main()
