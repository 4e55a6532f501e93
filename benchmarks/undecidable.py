"""Lists invented rows with status `ok` in damaged streams, with the oracle's probability.

    python -m benchmarks.undecidable [--seeds 201 202] [--frames 100000] [--share 0.2]
                                     [--payload ordinary]

For each such row: its offset, its bytes with `|` at the boundaries of the sent frames, and the
probability that the oracle of the tests computes from six frames on either side. A row that the
oracle trusts too cannot be told from a sent frame, with these bytes and this model.
"""

from __future__ import annotations

import argparse
from bisect import bisect_right
from collections.abc import Sequence

from fte_sniff.protocol.framer.model import CERTAIN

from benchmarks.framer_quality import rows_of
from fte_sniff.protocol import Row
from tests.protocol import oracle
from tests.support.faults import PAYLOADS, Sent, damaged_stream
from tests.support.score import score

NEIGHBOURS = 6
"""Frames on either side that the oracle uses."""


def probability(stream: bytes, sent: Sequence[Sent], row: Row) -> float:
    """The oracle's probability of the frame in this row."""
    number = bisect_right([frame.start for frame in sent], row.offset) - 1
    first, behind = max(0, number - NEIGHBOURS), number + NEIGHBOURS
    begin = sent[first].start - sent[first].before
    end = sent[behind].start - sent[behind].before if behind < len(sent) else len(stream)
    probabilities: dict[int, float] = oracle.ZERO.probabilities(stream[begin:end])
    return probabilities.get(row.offset - begin, 0.0)


def divided(sent: Sequence[Sent], row: Row) -> str:
    """The row's bytes, with `|` at the boundaries of the sent frames."""
    begins = {frame.start for frame in sent} | {frame.start - frame.before for frame in sent}
    parts = [
        ("| " if row.offset + place in begins and place else "") + f"{byte:02X}"
        for place, byte in enumerate(row.raw)
    ]
    return " ".join(parts)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=100_000)
    parser.add_argument("--seeds", type=int, nargs="+", default=[201, 202, 203])
    parser.add_argument("--share", type=float, default=0.2)
    parser.add_argument("--payload", choices=list(PAYLOADS), default="ordinary")
    chosen = parser.parse_args()
    shown, doubtful = 0, 0
    for seed in chosen.seeds:
        stream, sent = damaged_stream(seed, chosen.frames, chosen.share, chosen.payload)
        for _, row in score(sent, rows_of(stream)).cases:
            probable = probability(stream, sent, row)
            shown, doubtful = shown + 1, doubtful + (probable < CERTAIN)
            print(f"{seed:5} {row.offset:8}  {divided(sent, row):33} {probable:.7f}", flush=True)
    print(f"{shown} rows, of which the oracle trusts {shown - doubtful}")


if __name__ == "__main__":
    main()
