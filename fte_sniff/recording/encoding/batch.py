"""Owns the way from many rows and events, in order of time, to the message records of one chunk.

It must not know files. Rows that are as most rows are, sound frames with a read delay, are written
by columns; each other row is encoded by itself.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import accumulate

import numpy as np
from mcap.opcode import Opcode
from numpy.typing import NDArray

from fte_sniff.protocol import FRAME_LENGTH, Frame, PortEvent, Row
from fte_sniff.recording.encoding.messages import class_of, encode_event, encode_row
from fte_sniff.recording.encoding.model import MESSAGE, MESSAGE_HEAD, Columns, Model
from fte_sniff.recording.encoding.topics import EVENTS, MALFORMED, Topic, topic_of
from fte_sniff.recording.encoding.wire import SOUND_LACKS

_HEAD = slice(0, 3)
"""The bytes of a frame that tell its kind and its motor."""

_Form = tuple[str, bytes, bool]
"""Port, head, and whether the order is uncertain: all that rows of one model have in common."""


@dataclass(frozen=True, slots=True)
class Batch:
    """The messages of one chunk, packed, and what its index needs; a value for each message."""

    data: bytes | memoryview
    channels: NDArray[np.int64]
    times: NDArray[np.int64]
    """Log times, nanoseconds since 1970 UTC."""
    places: NDArray[np.int64]
    """Where each message record begins in `data`."""


class Packer:
    """Packs batches; counts the messages of each channel."""

    def __init__(self, channel_id: Callable[[str, Topic], int]) -> None:
        """Take what gives the id of a port's channel on a topic."""
        self._channel_id = channel_id
        self._channel_of_form: dict[_Form, int | None] = {}
        self._sequences: dict[int, int] = {}

    def pack(self, taken: Sequence[Row | PortEvent], times: NDArray[np.int64]) -> Batch:
        """The messages of `taken`, in that order.

        Args:
            taken: rows and events.
            times: their log times; never falling.
        """
        forms, odd = self._sorted(taken, times.tolist())
        channels = np.empty(len(taken), np.int64)
        for form, places in forms.items():
            channel = self._channel_of_form[form]
            assert channel is not None
            channels[places] = channel
        for place in odd:
            entry = taken[place]
            topic = EVENTS if isinstance(entry, PortEvent) else topic_of(entry)
            channels[place] = self._channel_id(entry.port, topic)
        sequences = self._count(channels)
        records: list[bytes] = [b""] * len(taken)
        for (_, head, uncertain), places in forms.items():
            rows = [taken[place] for place in places]
            columns = _columns(rows, channels, sequences, times, np.array(places))
            for place, record in zip(places, _model(head, uncertain).records(columns), strict=True):
                records[place] = record
        for place in odd:
            records[place] = message_record(
                taken[place], int(channels[place]), int(sequences[place]), int(times[place])
            )
        return _joined(records, channels, times)

    def _sorted(
        self, taken: Sequence[Row | PortEvent], times: Sequence[int]
    ) -> tuple[dict[_Form, list[int]], list[int]]:
        """The places of the rows of each form, and of all that has none."""
        forms: dict[_Form, list[int]] = {}
        odd: list[int] = []
        known = self._channel_of_form
        for place, (entry, time) in enumerate(zip(taken, times, strict=True)):
            if (
                type(entry) is not Frame
                or entry.faults
                or entry.read_delay_ns is None
                or entry.t_ns != time
            ):
                odd.append(place)
                continue
            form = (entry.port, entry.raw[_HEAD], entry.order_uncertain)
            if form in forms:
                forms[form].append(place)
                continue
            if form not in known:
                known[form] = self._channel_of(entry)
            if known[form] is None:
                odd.append(place)
            else:
                forms[form] = [place]
        return forms, odd

    def _channel_of(self, row: Row) -> int | None:
        topic = topic_of(row)
        return None if topic is MALFORMED else self._channel_id(row.port, topic)

    def _count(self, channels: NDArray[np.int64]) -> NDArray[np.uint32]:
        """The sequence number of each message: they count up on each channel, and wrap."""
        sequences = np.empty(len(channels), np.uint64)
        for channel in np.unique(channels).tolist():
            own = np.flatnonzero(channels == channel)
            start = self._sequences.get(channel, 0)
            sequences[own] = np.arange(start, start + len(own), dtype=np.uint64)
            self._sequences[channel] = start + len(own)
        return sequences.astype(np.uint32)


@cache
def _model(head: bytes, uncertain: bool) -> Model:
    """The model of all sound frames that begin with `head`, and whose order is so certain."""
    raw = head + bytes(FRAME_LENGTH - len(head))
    model = Frame("", 0, raw, 0, (), 0, uncertain)
    topic, kind = topic_of(model), model.kind
    assert kind is not None
    lacking = SOUND_LACKS - {"order_uncertain"} if uncertain else SOUND_LACKS
    return Model(encode_row(topic, model, 0), class_of(topic), kind.fields, lacking)


def _columns(
    rows: Sequence[Row | PortEvent],
    channels: NDArray[np.int64],
    sequences: NDArray[np.uint32],
    times: NDArray[np.int64],
    places: NDArray[np.int64],
) -> Columns:
    frames = [row for row in rows if isinstance(row, Frame)]
    raws = np.frombuffer(b"".join([row.raw for row in frames]), np.uint8)
    return Columns(
        channel=int(channels[places[0]]),
        sequences=sequences[places],
        times=times[places],
        offsets=np.array([row.offset for row in frames], np.int64),
        delays=np.array([row.read_delay_ns for row in frames], np.int64),
        raws=raws.reshape(-1, FRAME_LENGTH),
    )


def message_record(entry: Row | PortEvent, channel: int, sequence: int, time: int) -> bytes:
    """The record of one message, from the row or event in it."""
    if isinstance(entry, PortEvent):
        data = encode_event(entry, time)
    else:
        data = encode_row(topic_of(entry), entry, time)
    head = (Opcode.MESSAGE, MESSAGE_HEAD + len(data), channel, sequence, time, time)
    return MESSAGE.pack(*head) + data


def _joined(records: list[bytes], channels: NDArray[np.int64], times: NDArray[np.int64]) -> Batch:
    places = np.fromiter(accumulate(map(len, records), initial=0), np.int64, len(records))
    return Batch(b"".join(records), channels, times, places)
