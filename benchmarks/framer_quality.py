"""Measures the framer's quality: frames found, invented, ambiguous; labels of damage.

    python -m benchmarks.framer_quality [--frames 100000] [--seeds 1 2 3] [--joins 100000]
                                        [--reserve-frames 6000]

Prints the quality table, the confusion table of single faults, the joins, and the table of lines
whose hosts leave something else in the reserve and in a NUM without a meaning.
"""

from __future__ import annotations

import argparse
from collections import Counter
from random import Random
from time import perf_counter

from fte_sniff.protocol.framer import Framer
from fte_sniff.protocol.items import Chunk
from fte_sniff.protocol.rows import Row
from fte_sniff.protocol.spec import FRAME_LENGTH
from tests.support.columns import fed
from tests.support.faults import PAYLOADS, RESERVES, Harm, damaged_stream, draw_frame
from tests.support.score import labels, score

LINES = [(0.01, "ordinary"), (0.2, "ordinary"), (0.2, "hostile"), (0.5, "hostile")]


def rows_of(stream: bytes) -> list[Row]:
    framer = Framer("bench")
    return fed(framer, Chunk("bench", None, stream)) + list(framer.finish())


def quality(seed: int, frames: int) -> Counter[tuple[Harm, str, str]]:
    """Print the table for one seed; returns the labels of single faults."""
    named: Counter[tuple[Harm, str, str]] = Counter()
    for share, payload in LINES:
        stream, sent = damaged_stream(seed, frames, share, payload)
        began = perf_counter()
        rows = rows_of(stream)
        seconds = perf_counter() - began
        judged = score(sent, rows)
        named += labels(sent, rows)
        print(
            f"{seed:4}  {share:4.0%} {payload:9} found {judged.found_share:9.4%} "
            f"(missed {len(judged.missed)})  invented ok {judged.invented_ok_share:.4%} "
            f"({judged.invented_ok})  invented {judged.invented / judged.rows:.4%}  "
            f"doubted {judged.doubted_share:.3%}  {len(stream) / seconds / 1e6:.2f} MB/s",
            flush=True,
        )
    return named


def reserves(seed: int, frames: int) -> None:
    """Print a line for each payload and reserve: found and `ok`, by share of damage."""
    for payload in PAYLOADS:
        for reserve in RESERVES:
            cells = []
            for share in (0.0, 0.01, 0.2):
                stream, sent = damaged_stream(seed, frames, share, payload, reserve)
                judged = score(sent, rows_of(stream))
                ok = (judged.found - judged.doubted) / judged.undamaged
                cells.append(
                    f"{share:3.0%} found {judged.found_share:9.4%} ok {ok:7.2%} "
                    f"invented ok {judged.invented_ok}"
                )
            print(f"{seed:4}  {payload:8} {reserve:11}  {'  '.join(cells)}", flush=True)


def print_confusion(named: Counter[tuple[Harm, str, str]]) -> None:
    """Print the confusion table: one line for each kind of damage."""
    for done in dict.fromkeys(done for _, done, _ in sorted(named)):
        row: Counter[str] = Counter()
        for (_, kind, label), count in named.items():
            row[label] += count if kind == done else 0
        total = row.total()
        shown = [(label, count) for label, count in row.most_common() if count]
        text = ", ".join(f"{label} {count / total:.2%}" for label, count in shown)
        print(f"      {done:23} {total:6}: {text}")


def joins(seed: int, count: int) -> None:
    """Join undamaged ordinary streams at random bytes."""
    random = Random(seed)
    invented = found = 0
    for _ in range(count):
        frames = [draw_frame(random, PAYLOADS["ordinary"]) for _ in range(8)]
        stream = b"".join(frames)
        cut = random.randrange(1, FRAME_LENGTH * 2)
        first = -cut % FRAME_LENGTH
        rows = [row for row in rows_of(stream[cut:]) if row.framed]
        invented += any((row.offset - first) % FRAME_LENGTH for row in rows)
        found += any(row.offset == first for row in rows)
    print(
        f"joins {count}: streams with an invented frame {invented}, first found {found / count:.4%}"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=100_000)
    parser.add_argument("--seeds", type=int, nargs="+", default=[1, 2, 3])
    parser.add_argument("--joins", type=int, default=100_000)
    parser.add_argument("--reserve-frames", type=int, default=6000)
    chosen = parser.parse_args()
    named: Counter[tuple[Harm, str, str]] = Counter()
    for seed in chosen.seeds:
        named += quality(seed, chosen.frames)
    print("labels of single faults between intact neighbours:")
    print_confusion(named)
    if chosen.joins:
        joins(chosen.seeds[0], chosen.joins)
    if chosen.reserve_frames:
        for seed in chosen.seeds:
            reserves(seed, chosen.reserve_frames)


if __name__ == "__main__":
    main()
