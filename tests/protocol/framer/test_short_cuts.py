"""Without its short cuts the framer decides the same."""

from __future__ import annotations

from random import Random

import pytest

import fte_sniff.protocol.framer.framer as framer_module
from benchmarks.faults import damaged_stream
from fte_sniff.protocol import Chunk, Framer, Row

pytestmark = pytest.mark.interpreted

SHORT_CUTS = {"undisputed": lambda *_: None, "doubtless_frame": lambda *_: -1}
"""By name, what the framer asks: the answer that leaves it to weighing."""

STREAMS = {
    "5 %": damaged_stream(7, 1500, 0.05, "ordinary")[0],
    "20 %": damaged_stream(8, 1500, 0.2, "ordinary")[0],
    "20 % hostile": damaged_stream(8, 1500, 0.2, "hostile")[0],
    "50 % hostile": damaged_stream(9, 500, 0.5, "hostile")[0],
    "random": Random(9).randbytes(2000),
    "imitating": bytes(Random(11).choices(b"\xaa\x55\xee\x00\x01", k=600)),
}


def rows_of(stream: bytes) -> list[Row]:
    framer = Framer("p")
    return framer.feed(Chunk("p", None, stream)) + framer.flush()


@pytest.mark.parametrize("stream", STREAMS)
@pytest.mark.parametrize("without", [*((name,) for name in SHORT_CUTS), tuple(SHORT_CUTS)])
def test_without_short_cuts_the_rows_are_the_same(
    without: tuple[str, ...], stream: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    quick = rows_of(STREAMS[stream])
    for name in without:
        monkeypatch.setattr(framer_module, name, SHORT_CUTS[name])
    assert rows_of(STREAMS[stream]) == quick
