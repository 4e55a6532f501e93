"""Messages that fit a template give the rows that protobuf gives, and every other message too."""

import struct
from collections.abc import Callable
from dataclasses import replace
from random import Random

import pytest
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from hypothesis import given
from hypothesis import strategies as st
from mcap.opcode import Opcode

from fte_sniff.protocol import KIND_BY_NAME, Frame, PortEvent, Row, encode
from fte_sniff.protocol.rows import Codebook, Rows
from fte_sniff.recording.mcap.reader import HEAD, MESSAGE_HEAD, index_messages
from fte_sniff.recording.messages.decode import (
    DecodedColumns,
    MessageReader,
    ParseBudget,
    decode_columns,
)
from fte_sniff.recording.messages.encode import encode_row, topic_of
from fte_sniff.recording.messages.schema import (
    TOPIC_BY_NAME,
    TOPICS,
    Topic,
    message_class,
    schema_data,
    schema_name,
)
from tests.examples import examples
from tests.recording.conftest import entry_of
from tests.recording.test_reader import damage, frames

MOST = 100_000
"""Records that the chunks of these tests can hold: enough to parse each message by protobuf."""

Message = tuple[int, int, bytes]
"""Channel id, log time and data."""


def _reader(topic: Topic) -> MessageReader:
    return MessageReader(topic.name, "p", schema_name(topic), schema_data(topic.schema))


READERS = {number: _reader(topic) for number, topic in enumerate(TOPICS)}
CHANNELS = {reader.topic: number for number, reader in READERS.items()}


def _decoded(messages: list[Message], budget: ParseBudget | None = None) -> DecodedColumns:
    records = b"".join(
        HEAD.pack(Opcode.MESSAGE, MESSAGE_HEAD - HEAD.size + len(data))
        + struct.pack("<HIQQ", channel, 0, time, time)
        + data
        for channel, time, data in messages
    )
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
    raw = encode(KIND_BY_NAME["speed"], {"motor": 1, "rpm": 5})
    channel, time, data = _message(Frame("p", 10, raw, 1_000, (), 5, uncertain))
    changed = [
        data[:at] + bytes([data[at] ^ bits]) + data[at + 1 :]
        for at in range(len(data))
        for bits in (1, 0x80, 0xFF)
    ]
    _check([(channel, time, one) for one in changed])


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
