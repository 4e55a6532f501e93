"""Messages of batches and of single rows, and what is read from one message."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.opcode import Opcode

from fte_sniff.protocol import (
    KIND_BY_NAME,
    Frame,
    PortEvent,
    PortEventKind,
    Row,
    encode,
)
from fte_sniff.protocol.rows import Array, Rows
from fte_sniff.recording.mcap.writer import McapBatch
from fte_sniff.recording.messages.decode import MessageReader
from fte_sniff.recording.messages.encode import (
    MESSAGE,
    MESSAGE_HEAD,
    ColumnPacker,
    encode_event,
    encode_row,
    topic_of,
)
from fte_sniff.recording.messages.schema import (
    EVENTS,
    Topic,
    schema_data,
    schema_name,
)
from tests.examples import examples
from tests.recording.conftest import entry_of
from tests.recording.test_reader import damage, events, frames

Entry = Row | PortEvent
RAW = encode(KIND_BY_NAME["speed"], {"motor": 1, "rpm": 77})
ROW = Frame("p", 10, RAW, 1_000, (), 5)


def _topic(entry: Entry) -> Topic:
    return EVENTS if isinstance(entry, PortEvent) else topic_of(entry)


def _reader(topic: Topic) -> MessageReader:
    return MessageReader(topic.name, "p", schema_name(topic), schema_data(topic.schema))


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
            length = MESSAGE_HEAD + len(data)
            head = MESSAGE.pack(Opcode.MESSAGE, length, channel, sequence, time, time)
            assert batch.data[start:stop] == head + data
            assert (batch.channels[number], batch.times[number]) == (channel, time)


def test_sequence_numbers_wrap_as_in_the_format() -> None:
    packer = ColumnPacker(lambda _port, _topic: 1)
    packer._sequences[1] = 2**32 - 1
    kinds = (PortEventKind.OPENED, PortEventKind.CLOSED)
    entries = [PortEvent(5, "p", kind, "") for kind in kinds]
    batch = _packed(packer, entries, np.array([5, 5], np.int64))
    sequences = [MESSAGE.unpack_from(batch.data, start)[3] for start in batch.starts.tolist()]
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
