"""Owns what the framer makes of some streams, as lines that another process can compare.

    python -m tests.protocol.framer.told_rows --interpreted

It must not judge them. So run, the source is interpreted, whatever was compiled of it.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator

SHARES = {"ordinary": 0.2, "hostile": 0.5}
"""By payload: the share of damaged frames."""
FRAMES = 300


def told_rows() -> list[str]:
    """Every row of the named cases and of some damaged streams, each bit of it."""
    from fte_sniff.protocol import Chunk, Framer

    told = []
    for stream in _streams():
        for size in (7, len(stream)):
            framer = Framer("p")
            rows = []
            for number, at in enumerate(range(0, len(stream), size)):
                t_ns = 10**18 + number * 4_000_000
                rows += framer.feed(Chunk("p", t_ns, stream[at : at + size]))
            told += [repr(row) for row in rows + framer.flush()]
    return told


def _streams() -> Iterator[bytes]:
    from benchmarks.faults import damaged_stream
    from tests.protocol.framer.test_framer_cases import CASES

    for case in CASES.values():
        yield b"".join(bytes.fromhex(piece) for piece, _ in case)
    for payload, share in SHARES.items():
        yield damaged_stream(1, FRAMES, share, payload)[0]


if __name__ == "__main__":
    if "--interpreted" in sys.argv:
        from tests.framer_form import interpret

        interpret()
    from fte_sniff.protocol.framer import COMPILED

    print("compiled" if COMPILED else "interpreted", *told_rows(), sep="\n")
