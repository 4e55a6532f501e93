"""Rows packed by columns are, byte for byte, what each would be by itself."""

from itertools import pairwise

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from mcap.opcode import Opcode

from fte_sniff.protocol import PortEvent, PortEventKind, Row
from fte_sniff.recording.messages.codec import encode_event, encode_row
from fte_sniff.recording.messages.packer import MESSAGE, MESSAGE_HEAD, Packer
from fte_sniff.recording.messages.schema import EVENTS, Topic, topic_of
from tests.examples import examples
from tests.recording.test_round_trip import damage, events, frames

Entry = Row | PortEvent


def _topic(entry: Entry) -> Topic:
    return EVENTS if isinstance(entry, PortEvent) else topic_of(entry)


@examples(80)
@given(
    st.lists(st.lists(st.one_of(frames, frames, damage, events), min_size=1), max_size=3),
    st.booleans(),
)
def test_each_message_is_what_it_would_be_alone(batches: list[list[Entry]], own: bool) -> None:
    ids: dict[tuple[str, str], int] = {}

    def channel_id(port: str, topic: Topic) -> int:
        return ids.setdefault((port, topic.name), len(ids) + 1)

    packer = Packer(channel_id)
    counts: dict[int, int] = {}
    for entries in batches:
        entries = sorted(entries, key=lambda entry: entry.t_ns or 0)
        times = [entry.t_ns or 0 for entry in entries]
        if not own:
            times = [max(times)] * len(times)
        batch = packer.pack(entries, np.array(times, np.int64))
        stops = [*batch.places.tolist(), len(batch.data)]
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


def test_sequence_numbers_wrap_as_the_format_says() -> None:
    packer = Packer(lambda _port, _topic: 1)
    packer._sequences[1] = 2**32 - 1
    kinds = (PortEventKind.OPENED, PortEventKind.CLOSED)
    entries = [PortEvent(5, "p", kind, "") for kind in kinds]
    batch = packer.pack(entries, np.array([5, 5], np.int64))
    sequences = [MESSAGE.unpack_from(batch.data, place)[3] for place in batch.places.tolist()]
    assert sequences == [2**32 - 1, 0]
