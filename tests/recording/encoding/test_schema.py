import math

from google.protobuf.descriptor_pb2 import FileDescriptorSet
from hypothesis import given
from hypothesis import strategies as st

from fte_sniff.protocol import KINDS, Field, Frame, FrameKind, Row, encode
from fte_sniff.recording.messages.codec import encode_row
from fte_sniff.recording.messages.schema import (
    TOPICS,
    Topic,
    message_class,
    schema_data,
    schema_name,
    topic_of,
)

ROW = ("offset", "read_delay_ns", "raw", "status", "faults", "time_ns", "kind", "order_uncertain")
FIELDS = {
    "fte.Reset": (*ROW, "cmd"),
    "fte.MotorControl": (*ROW, "cmd", "motor", "rpm", "pulses"),
    "fte.Chassis": (*ROW, "cmd", "vx_cm_s", "vy_cm_s", "wz_mrad_s"),
    "fte.MotorFeedback": (*ROW, "cmd", "motor", "rpm", "pulses", "error", "online"),
    "fte.Malformed": (*ROW, "framed", "length"),
    "fte.PortEvent": ("kind", "detail", "time_ns", "count"),
}


def _decoded(topic: Topic, data: bytes) -> dict[str, object]:
    made = message_class(schema_name(topic), schema_data(topic.schema)).FromString(data)
    return {field.name: value for field, value in made.ListFields()}


def _value(field: Field) -> st.SearchStrategy[int]:
    return st.integers(field.low, field.high)


@st.composite
def sound_frames(draw: st.DrawFn) -> Frame:
    kind: FrameKind = draw(st.sampled_from(KINDS))
    values = {field.name: draw(_value(field)) for field in kind.fields}
    raw = encode(kind, values, draw(st.sampled_from(kind.cmds)))
    offset, t_ns, delay = (draw(st.integers(0, 2**63 - 1)) for _ in range(3))
    return Frame("port", offset, raw, t_ns, (), delay)


def test_the_fields_are_those_that_users_plot() -> None:
    found = {}
    for topic in TOPICS:
        descriptor = message_class(schema_name(topic), schema_data(topic.schema)).DESCRIPTOR
        found[schema_name(topic)] = tuple(field.name for field in descriptor.fields)
    assert found == FIELDS


def test_each_schema_stands_alone_with_its_enums_inside_and_every_field_has_presence() -> None:
    files = set()
    for topic in TOPICS:
        (file,) = FileDescriptorSet.FromString(schema_data(topic.schema)).file
        (message,) = file.message_type
        assert not file.enum_type
        assert not file.dependency
        names = [value.name for enum in message.enum_type for value in enum.value]
        assert len(names) == len(set(names)), "enum value names clash within the message"
        assert all(field.proto3_optional or field.name == "faults" for field in message.field)
        files.add((file.name, schema_name(topic)))
    assert len({name for name, _ in files}) == len(FIELDS)


@given(st.lists(sound_frames(), min_size=1, max_size=20))
def test_sound_frames_of_one_schema_are_equally_long(rows: list[Frame]) -> None:
    lengths: dict[str, int] = {}
    for row in rows:
        topic = topic_of(row)
        data = encode_row(topic, row, row.t_ns or 0)
        assert lengths.setdefault(topic.schema, len(data)) == len(data)


@given(sound_frames())
def test_a_message_tells_the_values_and_nan_for_what_does_not_apply(row: Frame) -> None:
    topic = topic_of(row)
    told = _decoded(topic, encode_row(topic, row, row.t_ns or 0))
    own = {"cmd": row.cmd, "raw": row.raw, "offset": row.offset, **row.values}
    assert {name: told[name] for name in own} == own
    others = set(FIELDS[schema_name(topic)]) - set(ROW) - set(own)
    assert all(math.isnan(told[name]) for name in others)  # type: ignore[arg-type]
    assert set(told) == set(FIELDS[schema_name(topic)]) - {"faults", "time_ns", "order_uncertain"}


def test_a_speed_frame_plots_no_pulses() -> None:
    kind = next(kind for kind in KINDS if kind.name == "speed")
    row: Row = Frame("port", 0, encode(kind, {"motor": 1, "rpm": 0}), 5)
    told = _decoded(topic_of(row), encode_row(topic_of(row), row, 5))
    assert told["rpm"] == 0
    assert math.isnan(told["pulses"])  # type: ignore[arg-type]
    assert told["kind"] == 2
