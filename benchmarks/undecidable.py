"""Shows the rows of damaged streams that are invented and called `ok`, with what the oracle says.

    python -m benchmarks.undecidable [--seeds 201 202] [--frames 100000] [--share 0.2]
                                     [--payload ordinary]

For each such row: where it is, its bytes with `|` where one sent frame's ended and the next one's
began, and how probable the oracle of the tests calls the frame, which weighs all readings of six
frames on either side, with all the time it wants. A row that the oracle believes too cannot be told
from a frame that was sent, by these bytes and this cost model.
"""

from __future__ import annotations

import argparse
from bisect import bisect_right
from collections.abc import Sequence

from benchmarks.faults import PAYLOADS, Sent, damaged_stream
from benchmarks.framer_quality import rows_of
from benchmarks.score import score
from fte_sniff.protocol import Frame
from fte_sniff.protocol.framer.likelihood import CERTAIN
from tests.protocol import oracle

NEIGHBOURS = 6
"""Frames on either side that the oracle sees."""


def probability(stream: bytes, sent: Sequence[Sent], row: Frame) -> float:
    """How probable the oracle calls the frame that this row shows."""
    number = bisect_right([frame.start for frame in sent], row.offset) - 1
    first, behind = max(0, number - NEIGHBOURS), number + NEIGHBOURS
    begin = sent[first].start - sent[first].before
    end = sent[behind].start - sent[behind].before if behind < len(sent) else len(stream)
    told: dict[int, float] = oracle.probabilities(stream[begin:end])
    return told.get(row.offset - begin, 0.0)


def divided(sent: Sequence[Sent], row: Frame) -> str:
    """The row's bytes, with a mark where those of one sent frame end."""
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
    print(f"{shown} rows, of which the oracle believes {shown - doubtful}")


if __name__ == "__main__":
    main()
