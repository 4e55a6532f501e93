"""The short cut decides as weighing does."""

from __future__ import annotations

from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from benchmarks.faults import PAYLOADS, damaged_stream
from fte_sniff.protocol import Chunk, Fault, Frame, Framer, Row
from tests.examples import examples
from tests.protocol.framer.firm_frames import firm
from tests.protocol.framer.inside import BOUNDARY, reading_of, trusted, undisputed_at


def rows_of(stream: bytes) -> list[Row]:
    framer = Framer("p")
    return framer.feed(Chunk("p", None, stream)) + framer.flush()


@pytest.mark.interpreted
@pytest.mark.parametrize("share", [0.05, 0.2])
def test_the_rows_have_what_the_short_cut_and_weighing_say(share: float) -> None:
    stream, _ = damaged_stream(7, 3000, share, "ordinary")
    taken = []
    for before, row in pairwise(rows_of(stream)):
        if not row.faults or before.faults or not isinstance(before, Frame):
            continue
        at = row.offset
        part = undisputed_at(stream, at)
        taken.append(part is not None)
        if part is None:
            continue
        assert (len(row.raw), isinstance(row, Frame), row.faults) == part[1:]
        weighed = reading_of(stream[at : at + part.stop + 10], trusted(), BOUNDARY)
        assert weighed == [part, (part.stop, part.stop + 10, True, ())]
    assert sum(taken) > len(taken) / 3


@examples(400)
@given(st.integers(0, 100_000), st.sampled_from(sorted(PAYLOADS)), st.integers(0, 10_000))
def test_damage_with_one_reading_is_read_as_weighing_reads_it(
    seed: int, payload: str, behind: int
) -> None:
    data = damaged_stream(seed, 1, 1.0, payload)[0] + firm(behind)
    part = undisputed_at(data, 0)
    if part is None:
        return
    first, *others = reading_of(data[: part.stop + 10], trusted(), BOUNDARY)
    assert [other.certain for other in others] == [True]
    assert first == part


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
        ("AA 42 01 03 E8 00 00 00 00 EE", Fault.UNKNOWN_CMD),
        ("AA 01 07 03 E8 00 00 00 00 EE", Fault.BAD_MOTOR),
    ],
)
def test_plain_damage_needs_no_weighing(damage: str, fault: Fault) -> None:
    raw = bytes.fromhex(damage)
    framed = fault in (Fault.UNKNOWN_CMD, Fault.BAD_MOTOR)
    part = undisputed_at(FRAME + raw + FRAME * 2, len(FRAME))
    assert part == (0, len(raw), framed, (fault,))
    assert undisputed_at(raw + FRAME + FRAME[:3], 0) is None


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
    assert undisputed_at(bytes.fromhex(damage) + FRAME * 2, 0) is None
