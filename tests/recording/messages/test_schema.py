"""Schemas and topics of the messages."""

import math

from google.protobuf.descriptor_pb2 import FileDescriptorSet
from hypothesis import given
from hypothesis import strategies as st

from fte_sniff.protocol import (
    KINDS,
    MOTORS,
    Damage,
    Fault,
    Field,
    Frame,
    FrameKind,
    encode,
)
from fte_sniff.recording.messages.encode import encode_row, topic_of
from fte_sniff.recording.messages.schema import (
    TOPICS,
    Topic,
    message_class,
    schema_data,
    schema_name,
    table_crc,
    table_text,
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


def test_each_schema_is_self_contained_and_every_field_has_presence() -> None:
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
def test_a_message_holds_the_values_and_nan_for_fields_of_other_kinds(row: Frame) -> None:
    topic = topic_of(row)
    values = _decoded(topic, encode_row(topic, row, row.t_ns or 0))
    own = {"cmd": row.cmd, "raw": row.raw, "offset": row.offset, **row.values}
    assert {name: values[name] for name in own} == own
    others = set(FIELDS[schema_name(topic)]) - set(ROW) - set(own)
    assert all(math.isnan(values[name]) for name in others)  # type: ignore[arg-type]
    assert set(values) == set(FIELDS[schema_name(topic)]) - {"faults", "time_ns", "order_uncertain"}


def _frame(kind_name: str, num: int = 1, faults: tuple[Fault, ...] = ()) -> Frame:
    kind = next(kind for kind in KINDS if kind.name == kind_name)
    values = {field.name: 1 for field in kind.fields}
    raw = bytearray(encode(kind, values))
    raw[2] = num
    return Frame("port", 0, bytes(raw), 0, faults)


def test_the_topics_are_those_that_users_know() -> None:
    assert [topic.name for topic in TOPICS] == [
        "/fte/control/reset",
        "/fte/control/motor1",
        "/fte/control/motor2",
        "/fte/control/motor3",
        "/fte/control/motor4",
        "/fte/control/chassis",
        "/fte/feedback/motor1",
        "/fte/feedback/motor2",
        "/fte/feedback/motor3",
        "/fte/feedback/motor4",
        "/fte/malformed",
        "/fte/port",
    ]


def test_each_kind_and_motor_has_its_topic() -> None:
    for motor in MOTORS:
        for name in ("speed", "position"):
            assert topic_of(_frame(name, motor)).name == f"/fte/control/motor{motor}"
            assert topic_of(_frame(f"{name}_feedback", motor)).name == f"/fte/feedback/motor{motor}"
    for num in (0, 1, 255):
        assert topic_of(_frame("mecanum", num)).name == "/fte/control/chassis"
        assert topic_of(_frame("reset", num)).name == "/fte/control/reset"


def test_a_suspect_frame_stays_with_its_kind() -> None:
    suspect = _frame("speed", 2, (Fault.RESERVED_NONZERO, Fault.AMBIGUOUS))
    assert topic_of(suspect).name == "/fte/control/motor2"


def test_malformed_rows_have_their_own_topic() -> None:
    unknown = Frame("port", 0, bytes.fromhex("AA7701000000000000EE"), 0, (Fault.UNKNOWN_CMD,))
    rows = [
        unknown,
        _frame("speed", 9, (Fault.BAD_MOTOR,)),
        _frame("speed", 1, (Fault.BAD_TAIL,)),
        _frame("speed", 9),
        Damage("port", 0, b"\x01", 0, (Fault.LINE_ERROR,)),
        Damage("port", 0, unknown.raw, 0, (Fault.NOISE,)),
    ]
    assert {topic_of(row).name for row in rows} == {"/fte/malformed"}


def test_the_table_of_topics_is_the_one_that_damaged_files_are_read_with() -> None:
    """A change needs the old table too: recordings with damaged definitions are read with it.

    Then `ports_from_metadata` accepts both checksums, each with its own table.
    """
    assert f"{table_crc():08x}" == "55a27f9f", table_text()
