"""The quick way to messages makes the bytes that protobuf makes, whatever the frame."""

from __future__ import annotations

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fte_sniff.protocol import FRAME_LENGTH, KINDS, Fault, Frame, FrameKind, encode
from fte_sniff.recording.messages.codec import MessageReader, _encode_by_protobuf, encode_row
from fte_sniff.recording.messages.schema import MALFORMED, schema_data, schema_name, topic_of


@st.composite
def frames(draw: st.DrawFn, kind: FrameKind) -> Frame:
    """Any legal frame of a kind, anywhere and at any time."""
    values = {field.name: draw(st.integers(field.low, field.high)) for field in kind.fields}
    return Frame(
        "p",
        draw(st.integers(0, 2**63 - 1)),
        encode(kind, values),
        draw(st.integers(0, 2**63 - 1)),
        (),
        draw(st.integers(0, 2**62)),
        draw(st.booleans()),
    )


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.name)
@given(data=st.data())
def test_the_bytes_are_protobufs(kind: FrameKind, data: st.DataObject) -> None:
    row = data.draw(frames(kind))
    topic = topic_of(row)
    assert topic is not MALFORMED
    quick = encode_row(topic, row, row.t_ns or 0)
    assert quick == _encode_by_protobuf(topic, row, row.t_ns or 0)
    reader = MessageReader(topic.name, "p", schema_name(topic), schema_data(topic.schema))
    read = reader.row(quick, row.t_ns or 0)
    assert (read, read.order_uncertain) == (row, row.order_uncertain)


@pytest.mark.parametrize(
    "change",
    [{"faults": (Fault.LINE_ERROR,)}, {"read_delay_ns": None}, {"t_ns": 2_000}],
    ids=["faults", "no delay", "its own time"],
)
def test_what_is_not_plain_keeps_what_it_has(change: dict) -> None:
    raw = encode(KINDS[1], {"motor": 1, "rpm": 77})
    row = replace(Frame("p", FRAME_LENGTH, raw, 1_000, (), 5), **change)
    topic = topic_of(row)
    reader = MessageReader(topic.name, "p", schema_name(topic), schema_data(topic.schema))
    read = reader.row(encode_row(topic, row, 1_000), 1_000)
    assert (read, read.read_delay_ns) == (row, row.read_delay_ns)
