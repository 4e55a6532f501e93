"""The explanation of a row."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fte_sniff.protocol.dissect import ExplainedField, dissect, explain
from fte_sniff.protocol.framer import Framer
from fte_sniff.protocol.items import Chunk
from fte_sniff.protocol.rows import Row
from fte_sniff.protocol.spec import HEADERS, TAIL, Fault
from tests.support.faults import damaged_stream, frame_faults

BESIDE_THE_BYTES = {Fault.AMBIGUOUS, Fault.LINE_ERROR}
"""Faults that no byte of the row shows."""
TEXT, NO_TIME, BYTES = st.text(max_size=3), st.none(), st.binary(min_size=1, max_size=16)
FAULTS = st.lists(st.sampled_from(Fault), unique=True).map(tuple)
FRAMED = st.builds(
    lambda header, payload: bytes([header, *payload, TAIL]),
    st.sampled_from(list(HEADERS.values())),
    st.binary(min_size=8, max_size=8),
)


def frame(text: str) -> list[ExplainedField]:
    raw = bytes.fromhex(text)
    return dissect(Row("p", 0, raw, None, frame_faults(raw)))


def named(fields: list[ExplainedField], name: str) -> ExplainedField:
    (field,) = [field for field in fields if field.name == name]
    return field


@pytest.mark.parametrize(
    ("text", "fault", "field", "words"),
    [
        ("AA 00 00 00 00 00 00 00 00 EE", None, "reserve", "the protocol states no value"),
        ("55 01 01 03 E8 00 00 00 0F EE", None, "reserve", "the protocol shows 00"),
        ("AA 09 01 03 E8 00 00 27 10 EE", Fault.UNKNOWN_CMD, "cmd", "expected 00-03, found 09"),
        ("AA 02 00 03 E8 00 00 27 10 EE", Fault.BAD_MOTOR, "motor", "expected 01-04, found 00"),
        (
            *("AA 01 01 03 E8 00 05 00 00 EE", Fault.RESERVED_NONZERO, "reserve"),
            "the protocol states no value expected 00 00 00 00, found 00 05 00 00",
        ),
        (
            *("55 01 01 03 E8 00 01 00 0F EE", Fault.RESERVED_NONZERO, "reserve"),
            "the protocol shows 00 expected 00 00, found 00 01",
        ),
        ("AB 01 01 03 E8 00 00 00 00 EE", Fault.BAD_HEADER, "header", "AA or 55, found AB"),
        ("AA 01 01 03 E8 00 00 00 00 EF", Fault.BAD_TAIL, "tail", "expected EE, found EF"),
        ("AA 77 01 03 E8 00 00 00 00 EF", Fault.BAD_TAIL, "tail", "expected EE, found EF"),
        ("AA B2", Fault.TRUNCATED, "missing", "8 of a frame's 10 bytes"),
        ("AA 01 01 00 00 EE", Fault.TRUNCATED, "missing", "4 of a frame's 10 bytes are missing"),
        ("AA 01 01 03 E8 00 00 12 34 00 00 EE", Fault.OVERLONG, "extra", "2 bytes too many"),
        ("01 AA 03", Fault.NOISE, "noise", ""),
    ],
)
def test_a_fault_is_at_its_bytes_with_what_was_expected(
    text: str, fault: Fault | None, field: str, words: str
) -> None:
    raw = bytes.fromhex(text)
    framed = fault in {None, Fault.UNKNOWN_CMD, Fault.BAD_MOTOR, Fault.RESERVED_NONZERO}
    found = dissect(Row("p", 0, raw, None, (fault,) if fault else (), framed=framed))
    own = named(found, field)
    assert own.fault is fault
    assert words in f"{own.meaning} {own.note}"
    assert [one.name for one in found if one.fault] == ([field] if fault else [])


def test_damage_is_explained_as_far_as_it_is_known() -> None:
    for text, words in {
        "AA 01 02 03 E8 00 00 00 00 EF": ["CMD: speed", "motor", "target speed", "reserve", "tail"],
        "AA 77 02 03 E8 00 00 00 00 EF": ["CMD", "unknown", "unknown", "tail"],
    }.items():
        row = Row("p", 0, bytes.fromhex(text), None, (Fault.BAD_TAIL,), framed=False)
        for field, word in zip(dissect(row)[1:], words, strict=True):
            assert field.meaning.startswith(word)


def test_flags_bit_by_bit_claim_no_more_than_is_known() -> None:
    fields = frame("55 01 01 03 E8 00 00 03 1D EE")
    error, online = named(fields, "error"), named(fields, "online")
    assert [bit.is_set for bit in error.bits] == [True, True] + [False] * 6
    assert all("unknown" in bit.meaning for bit in error.bits[:4])
    assert [bit.meaning.partition(" (")[0] for bit in online.bits[:4]] == [
        "motor 1 online",
        "motor 2 not online",
        "motor 3 online",
        "motor 4 online",
    ]
    assert all("assumption" in bit.meaning for bit in online.bits[:4])
    assert [bit.number for bit in online.bits if bit.is_set] == [0, 2, 3, 4]
    assert [bit.number for bit in online.bits if bit.is_raised] == [1, 4]
    assert {bit.meaning for bit in online.bits[4:]} == {"undefined"}
    assert online.fault is Fault.UNDEFINED_FLAGS


@pytest.mark.parametrize("speed", ["00 00", "00 0A", "FF F6", "00 EE", "80 00"])
def test_a_move_to_the_side_has_its_erratum_without_a_fault(speed: str) -> None:
    sideways = named(frame(f"AA 03 00 00 14 {speed} 00 00 EE"), "vy_cm_s")
    assert sideways.fault is None
    assert ("(erratum 3)" in sideways.note) == (speed != "00 00")


@given(st.integers(0, 10_000), st.sampled_from(["ordinary", "hostile"]), st.booleans())
def test_the_explanation_shows_exactly_the_faults_of_the_row(
    seed: int, payload: str, line_error: bool
) -> None:
    stream, _ = damaged_stream(seed, 12, 0.6, payload)
    framer = Framer("p")
    framer.push(Chunk("p", None, stream, has_line_errors=line_error))
    for row in framer.finish():
        shown = [field for field in dissect(row) if field.fault is not None]
        assert {field.fault for field in shown} == set(row.faults) - BESIDE_THE_BYTES
        assert all(field.note or field.meaning for field in shown if field.name != "noise")
        assert row.framed or not any(field.value for field in dissect(row))


@given(
    st.builds(Row, TEXT, st.just(0), BYTES, NO_TIME, FAULTS, st.just(False))
    | st.builds(Row, TEXT, st.just(0), FRAMED, NO_TIME, FAULTS)
)
def test_rows_of_other_programs_are_explained_by_their_faults_too(row: Row) -> None:
    fields = dissect(row)
    assert [offset for field in fields for offset in field.offsets] == list(range(len(row.raw)))
    assert b"".join(field.raw for field in fields) == row.raw
    assert {field.fault for field in fields} <= {None, *row.faults}
    assert [str(fault) for fault in row.faults] == [text.split(":")[0] for text in explain(row)]
