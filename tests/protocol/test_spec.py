"""Frame definitions, encode and decode: the protocol's own examples, and every legal value."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fte_sniff.errors import ValueRangeError
from fte_sniff.protocol.spec import KIND_BY_NAME, KINDS, Fault, FrameKind, encode
from tests.protocol.document import EXAMPLES, Example
from tests.protocol.streams import rows_of
from tests.support.faults import frame_faults


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda example: example.text)
def test_examples_of_the_document_encode(example: Example) -> None:
    assert encode(example.frame_kind, example.values) == example.raw


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda example: example.text)
def test_examples_of_the_document_decode(example: Example) -> None:
    (row,) = rows_of(example.raw)
    assert row.framed
    assert row.kind is example.frame_kind
    assert (row.values, row.faults) == (example.values, ())


@st.composite
def legal_frames(draw: st.DrawFn) -> tuple[FrameKind, dict[str, int], int, bytes]:
    """A kind, values that fit it, one of its CMDs, and the frame's bytes."""
    kind = draw(st.sampled_from(KINDS))
    values = {}
    for field in kind.fields:
        high = field.high if field.legal_bits is None else field.legal_bits
        values[field.name] = draw(st.integers(field.low, high))
    cmd = draw(st.sampled_from(kind.cmds))
    return kind, values, cmd, encode(kind, values, cmd)


@given(legal_frames())
def test_encode_then_decode_is_the_identity(
    frame: tuple[FrameKind, dict[str, int], int, bytes],
) -> None:
    kind, values, cmd, raw = frame
    (row,) = rows_of(raw)
    assert row.framed
    assert (row.kind, row.values, row.cmd, row.raw) == (kind, values, cmd, raw)
    assert set(row.faults) <= {Fault.AMBIGUOUS}


ALL_FIELDS = [(kind, field) for kind in KINDS for field in kind.fields]


def test_fields_of_a_row_name_have_one_type() -> None:
    types = {(one.name, one.size, one.signed, one.unit, one.role) for _, one in ALL_FIELDS}
    assert len(types) == len({one.name for _, one in ALL_FIELDS})


@pytest.mark.parametrize(("kind", "field"), ALL_FIELDS, ids=lambda entry: entry.name)
@pytest.mark.parametrize("beyond", ["low", "high"])
def test_a_value_out_of_range_names_field_range_and_unit(
    kind: FrameKind, field: object, beyond: str
) -> None:
    values = {other.name: other.low for other in kind.fields}
    (wrong,) = [other for other in kind.fields if other is field]
    values[wrong.name] = wrong.low - 1 if beyond == "low" else wrong.high + 1
    with pytest.raises(ValueRangeError) as error:
        encode(kind, values)
    message = str(error.value)
    assert wrong.name in message
    assert f"{wrong.low}..{wrong.high}" in message
    assert wrong.unit in message
    assert "\n" not in message


def test_a_missing_value_is_named() -> None:
    with pytest.raises(ValueRangeError, match=r"speed needs rpm \(-32768\.\.32767 RPM\)"):
        encode(KIND_BY_NAME["speed"], {"motor": 1})


def test_a_value_of_another_kind_is_named() -> None:
    with pytest.raises(ValueRangeError, match="reset has no rpm"):
        encode(KIND_BY_NAME["reset"], {"rpm": 1})


def test_a_cmd_of_another_kind_is_named() -> None:
    values = {"motor": 1, "rpm": 5}
    with pytest.raises(ValueRangeError, match="cmd 2 is out of range: speed_feedback has cmd 1 or"):
        encode(KIND_BY_NAME["speed_feedback"], values, cmd=2)


def test_a_field_with_illegal_values_has_one_byte_and_names_their_fault() -> None:
    """Faults are found byte by byte."""
    for field in (field for kind in KINDS for field in kind.fields):
        values = range(field.low, field.high + 1) if field.size == 1 else ()
        is_limited = sum(map(field.is_legal, values)) < 256
        assert (is_limited and field.size == 1) == (field.fault is not None)
        assert field.size == 1 or field.high - field.low + 1 == 1 << 8 * field.size


@given(st.sampled_from(KINDS), st.data())
def test_a_byte_is_legal_exactly_where_it_brings_no_fault(
    kind: FrameKind, data: st.DataObject
) -> None:
    legal = kind.legal_bytes()
    for offset in kind.reserved if kind.reserve is None else ():
        legal[offset] = b"\0"  # as on the rest of a line
    raw = bytearray(0 if fitting is None else fitting[0] for fitting in legal)
    offset = data.draw(st.integers(2, len(raw) - 2))
    raw[offset] = data.draw(st.integers(0, 255))
    fitting = legal[offset]
    assert bool(frame_faults(bytes(raw))) == (fitting is not None and raw[offset] not in fitting)
