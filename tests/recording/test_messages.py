"""Messages: schemas and topics; what is written and read at once is what protobuf gives."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import pairwise
from random import Random

import numpy as np
import pytest
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from hypothesis import given
from hypothesis import strategies as st
from mcap.opcode import Opcode

from fte_sniff.protocol import (
    KIND_BY_NAME,
    KINDS,
    MOTORS,
    Damage,
    Fault,
    Field,
    Frame,
    FrameKind,
    PortEvent,
    PortEventKind,
    Row,
    encode,
)
from fte_sniff.protocol.rows import Array, Codebook, Rows
from fte_sniff.recording.mcap.reader import HEAD, MESSAGE_HEAD, index_messages
from fte_sniff.recording.mcap.writer import McapBatch
from fte_sniff.recording.messages import (
    EVENTS,
    TOPIC_BY_NAME,
    TOPICS,
    ColumnPacker,
    DecodedColumns,
    MessageReader,
    ParseBudget,
    Topic,
    decode_columns,
    encode_event,
    encode_row,
    message_class,
    schema_data,
    schema_name,
    table_crc,
    table_text,
    topic_of,
)
from tests.examples import examples
from tests.recording.conftest import entry_of
from tests.recording.test_reader import damage, events, frames

# Schemas and topics

ROW_FIELDS = (
    "offset",
    "read_delay_ns",
    "raw",
    "status",
    "faults",
    "time_ns",
    "kind",
    "order_uncertain",
)
FIELDS = {
    "fte.Reset": (*ROW_FIELDS, "cmd"),
    "fte.MotorControl": (*ROW_FIELDS, "cmd", "motor", "rpm", "pulses"),
    "fte.Chassis": (*ROW_FIELDS, "cmd", "vx_cm_s", "vy_cm_s", "wz_mrad_s"),
    "fte.MotorFeedback": (*ROW_FIELDS, "cmd", "motor", "rpm", "pulses", "error", "online"),
    "fte.Malformed": (*ROW_FIELDS, "framed", "length"),
    "fte.PortEvent": ("kind", "detail", "time_ns", "count"),
}


def _parsed(topic: Topic, data: bytes) -> dict[str, object]:
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
    values = _parsed(topic, encode_row(topic, row, row.t_ns or 0))
    own = {"cmd": row.cmd, "raw": row.raw, "offset": row.offset, **row.values}
    assert {name: values[name] for name in own} == own
    others = set(FIELDS[schema_name(topic)]) - set(ROW_FIELDS) - set(own)
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


# The encoder

_HEAD = struct.Struct("<HIQQ")
"""Channel, sequence number, log and publish time."""


def _record(channel: int, sequence: int, time: int, data: bytes) -> bytes:
    length = MESSAGE_HEAD - HEAD.size + len(data)
    return HEAD.pack(Opcode.MESSAGE, length) + _HEAD.pack(channel, sequence, time, time) + data


def _reader(topic: Topic) -> MessageReader:
    return MessageReader(topic.name, "p", schema_name(topic), schema_data(topic.schema))


Entry = Row | PortEvent
RAW = encode(KIND_BY_NAME["speed"], {"motor": 1, "rpm": 77})
ROW = Frame("p", 10, RAW, 1_000, (), 5)


def _topic(entry: Entry) -> Topic:
    return EVENTS if isinstance(entry, PortEvent) else topic_of(entry)


def _packed(packer: ColumnPacker, entries: Sequence[Entry], times: Array) -> McapBatch:
    rows = [entry for entry in entries if not isinstance(entry, PortEvent)]
    events = [entry for entry in entries if isinstance(entry, PortEvent)]
    at = [at for at, entry in enumerate(entries) if isinstance(entry, PortEvent)]
    return packer.pack(Rows.from_rows(rows, events=events), times, np.array(at, np.int64))


@examples(80)
@given(
    st.lists(st.lists(st.one_of(frames, frames, damage, events), min_size=1), max_size=3),
    st.booleans(),
)
def test_each_message_of_a_batch_has_the_bytes_that_protobuf_makes(
    batches: list[list[Entry]], own: bool
) -> None:
    ids: dict[tuple[str, str], int] = {}

    def channel_id(port: str, topic: Topic) -> int:
        return ids.setdefault((port, topic.name), len(ids) + 1)

    packer = ColumnPacker(channel_id)
    counts: dict[int, int] = {}
    for entries in batches:
        entries = sorted(entries, key=lambda entry: entry.t_ns or 0)
        times = [entry.t_ns or 0 for entry in entries]
        if not own:
            times = [max(times)] * len(times)
        batch = _packed(packer, entries, np.array(times, np.int64))
        stops = [*batch.starts.tolist(), len(batch.data)]
        for number, (start, stop) in enumerate(pairwise(stops)):
            entry, time = entries[number], times[number]
            topic = _topic(entry)
            if isinstance(entry, PortEvent):
                data = encode_event(entry, time)
            else:
                data = encode_row(topic, entry, time)
            channel = ids[entry.port, topic.name]
            sequence = counts.get(channel, 0)
            counts[channel] = sequence + 1
            assert batch.data[start:stop] == _record(channel, sequence, time, data)
            assert (batch.channels[number], batch.times[number]) == (channel, time)


def test_sequence_numbers_wrap_as_in_the_format() -> None:
    packer = ColumnPacker(lambda _port, _topic: 1)
    packer._sequences[1] = 2**32 - 1
    kinds = (PortEventKind.OPENED, PortEventKind.CLOSED)
    entries = [PortEvent(5, "p", kind, "") for kind in kinds]
    batch = _packed(packer, entries, np.array([5, 5], np.int64))
    sequences = [
        _HEAD.unpack_from(batch.data, start + HEAD.size)[1] for start in batch.starts.tolist()
    ]
    assert sequences == [2**32 - 1, 0]


@pytest.mark.parametrize(
    "raw", [b"\x00" + RAW[1:], RAW[:-1] + b"\x00"], ids=["no header", "no tail"]
)
def test_bytes_that_are_not_framed_make_no_frame(raw: bytes) -> None:
    topic = topic_of(ROW)
    data = encode_row(topic, ROW, 1_000).replace(RAW, raw)
    with pytest.raises(ValueError, match="no frame in its 10 bytes"):
        entry_of(_reader(topic), data, 1_000)


@pytest.mark.parametrize(
    ("row", "log_time", "says"),
    [(ROW, 2**63, "2262"), (replace(ROW, offset=2**63), 1_000, "offset")],
)
def test_times_and_offsets_that_no_column_can_hold(row: Frame, log_time: int, says: str) -> None:
    topic = topic_of(row)
    with pytest.raises(ValueError, match=says):
        entry_of(_reader(topic), encode_row(topic, row, 1_000), log_time)


# The decoder

MOST = 100_000
"""Records that the chunks of these tests can hold: enough to parse each message by protobuf."""

Message = tuple[int, int, bytes]
"""Channel id, log time and data."""


READERS = {number: _reader(topic) for number, topic in enumerate(TOPICS)}
CHANNELS = {reader.topic: number for number, reader in READERS.items()}


def _decoded(messages: list[Message], budget: ParseBudget | None = None) -> DecodedColumns:
    records = b"".join(_record(channel, 0, time, data) for channel, time, data in messages)
    index = index_messages(records, None, MOST)
    columns = Rows.allocate(Codebook(), len(index))
    return decode_columns(
        index, READERS.get, columns, budget or ParseBudget([len(records)], [MOST])
    )


def _message(row: Row, *, late: bool = False) -> Message:
    """The message of a row; with its own time if it is late."""
    topic, time = topic_of(row), (row.t_ns or 0) + late
    return CHANNELS[topic.name], time, encode_row(topic, row, time)


def _changed(data: bytes, random: Random) -> bytes:
    """A message with some bits, bytes or fields changed."""
    changed = bytearray(data)
    for _ in range(random.randint(1, 2)):
        at = random.randrange(len(changed))
        match random.randrange(5):
            case 0:
                changed[at] ^= 1 << random.randrange(8)
            case 1:
                changed[at] = random.choice(data)
            case 2:
                del changed[at]
            case 3:
                changed.insert(at, random.choice(data))
            case _:
                # The last value of a field counts.
                changed += data[:9]
    return bytes(changed)


_ROWS = st.one_of(frames, frames, damage)


@examples(150)
@given(
    st.lists(st.tuples(_ROWS, st.booleans()), min_size=1, max_size=4),
    st.sampled_from([0, 1, 62, 64, 130]),
    st.booleans(),
    st.randoms(use_true_random=False),
)
def test_each_message_gives_the_row_that_protobuf_gives(
    rows: list[tuple[Row, bool]], more: int, change: bool, random: Random
) -> None:
    messages = [_message(row, late=late) for row, late in rows]
    messages += [messages[0]] * more
    if change:
        at = random.randrange(len(messages))
        channel, time, data = messages[at]
        messages[at] = channel, random.choice([time, 2**63 + 5]), _changed(data, random)
    random.shuffle(messages)
    _check(messages)


def _check(messages: list[Message]) -> None:
    """Each message gives the row that protobuf gives, or is lost as there."""
    expected, lost = [], 0
    for channel, time, data in messages:
        try:
            row = entry_of(READERS[channel], data, time)
        except ValueError:
            lost += 1
            continue
        assert not isinstance(row, PortEvent)
        expected.append((row, row.read_delay_ns, row.order_uncertain))
    found = _decoded(messages)
    rows_found = list(found.columns)
    assert [(row, row.read_delay_ns, row.order_uncertain) for row in rows_found] == expected
    assert found.losses.total() == lost


@pytest.mark.parametrize("uncertain", [False, True])
def test_any_changed_byte_of_a_message_gives_what_protobuf_gives(uncertain: bool) -> None:
    """In one message alone, and in one of the many that are compared at once."""
    raw = encode(KIND_BY_NAME["speed"], {"motor": 1, "rpm": 5})
    channel, time, data = _message(Frame("p", 10, raw, 1_000, (), 5, uncertain))
    changed = [
        data[:at] + bytes([data[at] ^ bits]) + data[at + 1 :]
        for at in range(len(data))
        for bits in (1, 0x80, 0xFF)
    ]
    for one in changed:
        _check([(channel, time, one)])
        _check([(channel, time, one), *[(channel, time, data)] * 127])


def test_rows_without_faults_fit_a_template(make_rows: Callable[..., list[Row]]) -> None:
    rows = [row for row in make_rows(300, "p") if isinstance(row, Frame) and not row.faults]
    rows = [replace(row, order_uncertain=at % 3 == 0) for at, row in enumerate(rows)]
    messages = [_message(row) for row in rows]
    decoded = _decoded(messages, ParseBudget([10**6], [0]))
    found = list(decoded.columns)
    assert found == rows
    for name in ("order_uncertain", "read_delay_ns"):
        assert [getattr(row, name) for row in found] == [getattr(row, name) for row in rows]
    assert not decoded.losses


def test_a_chunk_spends_its_own_budget_only(make_rows: Callable[..., list[Row]]) -> None:
    message = _message(next(row for row in make_rows(60) if not isinstance(row, Frame)))
    size = MESSAGE_HEAD + len(message[2])
    found = _decoded([message] * 200, ParseBudget([150 * size, 50 * size], [20, 90]))
    assert (len(found.columns), found.losses.total()) == (10 + 45, 140 + 5)


def test_a_schema_with_other_fields_is_read_by_protobuf() -> None:
    assert [name for name in TOPIC_BY_NAME if not _reader(TOPIC_BY_NAME[name]).templates] == [
        "/fte/malformed",
        "/fte/port",
    ]


@pytest.mark.parametrize("delay", [2**63, 2**64 - 1])
def test_a_read_delay_that_no_column_can_hold_is_a_loss(delay: int) -> None:
    topic = TOPICS[0]
    files = FileDescriptorSet.FromString(schema_data(topic.schema))
    field = next(one for one in files.file[0].message_type[0].field if one.name == "read_delay_ns")
    field.type = field.TYPE_FIXED64
    schema = schema_name(topic), files.SerializeToString()
    reader = MessageReader(topic.name, "p", *schema)
    raw = encode(KIND_BY_NAME["reset"], {})
    message = message_class(*schema)(offset=0, read_delay_ns=delay, raw=raw)
    with pytest.raises(ValueError, match="does not fit its schema"):
        reader.read(message.SerializeToString(), 5)
