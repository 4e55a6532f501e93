"""The short cut decides as weighing does."""

from __future__ import annotations

import pytest

import fte_sniff.protocol.framer.framer as framer_module
from benchmarks.faults import damaged_stream
from fte_sniff.protocol import Chunk, Fault, Framer, Row
from fte_sniff.protocol.framer.undisputed import undisputed


def rows_of(stream: bytes) -> list[Row]:
    framer = Framer("p")
    return framer.feed(Chunk("p", None, stream)) + framer.flush()


@pytest.mark.interpreted
@pytest.mark.parametrize("share", [0.05, 0.2])
def test_without_the_short_cut_the_rows_are_the_same(
    share: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    stream, _ = damaged_stream(7, 3000, share, "ordinary")
    taken = []

    def counted(data: bytes, at: int) -> object:
        damage = undisputed(data, at)
        taken.append(damage is not None)
        return damage

    monkeypatch.setattr(framer_module, "undisputed", counted)
    quick = rows_of(stream)
    monkeypatch.setattr(framer_module, "undisputed", lambda *_: None)
    assert quick == rows_of(stream)
    assert sum(taken) > len(taken) / 3


FRAME = bytes.fromhex("AA 01 01 03 E8 00 00 00 00 EE")


@pytest.mark.parametrize(
    ("damage", "fault"),
    [
        ("12 34", Fault.NOISE),
        ("01 03 E8 00 00 00 EE", Fault.NOISE),
        ("AA 01 01 03 E8 00", Fault.TRUNCATED),
        ("AA 01 01 00 00 00 EE", Fault.TRUNCATED),
        ("AA 01 01 03 E8 17 00 00 00 00 EE", Fault.OVERLONG),
        ("12 01 01 03 E8 00 00 00 00 EE", Fault.BAD_HEADER),
        ("AA 01 01 03 E8 00 00 00 00 12", Fault.BAD_TAIL),
    ],
)
def test_plain_damage_needs_no_weighing(damage: str, fault: Fault) -> None:
    raw = bytes.fromhex(damage)
    part = undisputed(FRAME + raw + FRAME * 2, len(FRAME))
    assert part is not None
    assert (part.start, part.stop, part.faults) == (0, len(raw), (fault,))
    assert undisputed(raw + FRAME + FRAME[:3], 0) is None


@pytest.mark.parametrize(
    "damage",
    [
        "EE",
        "34 EE",
        "AA 01",
        "12 AA 03 EE",
        "55 77 12 34 56 78 EE",
        "55 02 01 55 02",
        "AA 02 04 FF 59 FF FE 00 0F EE",
    ],
)
def test_doubtful_damage_is_left_to_weighing(damage: str) -> None:
    assert undisputed(bytes.fromhex(damage) + FRAME * 2, 0) is None
