"""Owns the way from rows that lie side by side to the packed messages of a chunk.

It must not know files. Sound frames with a read delay, whose time is their log time, are written by
columns, all of a kind at once; each other row is encoded by itself, as are port events.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import cache
from typing import Any

import numpy as np

from fte_sniff.protocol import (
    FRAME_LENGTH,
    KINDS,
    MOTORS,
    Frame,
    FrameKind,
    PortEvent,
    Row,
    Status,
    status_of,
)
from fte_sniff.protocol.spec import CMD_PLACE, NUM_PLACE
from fte_sniff.recording.encoding.batch import Batch, message_record
from fte_sniff.recording.encoding.messages import class_of, encode_row
from fte_sniff.recording.encoding.model import Columns, Model
from fte_sniff.recording.encoding.topics import EVENTS, MALFORMED, Topic, topic_of
from fte_sniff.recording.encoding.wire import SOUND_LACKS
from fte_sniff.row_batch import Array, RowColumns

ChannelId = Callable[[str, Topic], int]

_BYTES = 256
_NO_FORM = 255


def _forms() -> list[tuple[FrameKind, int]]:
    """Every kind with each of its CMDs: frames of one form make messages of one form."""
    return [(kind, cmd) for kind in KINDS for cmd in kind.cmds]


def _form_codes() -> Array:
    """By header and CMD, read as one little-endian number: the form's place in `_FORMS`."""
    codes = np.full(_BYTES * _BYTES, _NO_FORM, np.uint8)
    for code, (kind, cmd) in enumerate(_FORMS):
        codes[kind.header | cmd << 8] = code
    return codes


_FORMS = _forms()
_FORM_CODES = _form_codes()
_NAMES_MOTOR = np.zeros(_NO_FORM + 1, np.bool_)
"""By form, whether its frames name a motor."""
_NAMES_MOTOR[: len(_FORMS)] = [kind.names_motor for kind, _ in _FORMS]
_RAW = np.dtype(f"V{FRAME_LENGTH}")


class ColumnPacker:
    """Packs rows; counts the messages of each channel."""

    def __init__(self, channel_id: ChannelId) -> None:
        """Take what gives the id of a port's channel on a topic."""
        self._channel_id = channel_id
        self._sequences: dict[int, int] = {}

    def pack(self, rows: RowColumns, times: Array, event_times: Array) -> Batch:
        """The messages of the rows and of their events, in order of log time.

        Args:
            rows: the rows, in order.
            times: their log times, never falling.
            event_times: the log times of the events, never falling.
        """
        forms = self._forms_of(rows, times)
        channels = self._channels(rows, forms)
        # Each event stands before the first row that is later.
        at = np.searchsorted(times, event_times, "right")
        events = at + np.arange(len(at))
        channels = np.insert(channels, at, [self._channel_of(event) for event in rows.events])
        times = np.insert(times, at, event_times)
        sequences = self._count(channels)
        of_rows: Any = np.delete(np.arange(len(times)), events) if len(at) else slice(None)
        odd = np.flatnonzero(forms == _NO_FORM)
        places = np.arange(len(times))[of_rows][odd].tolist()
        single: list[tuple[int, Row | PortEvent]] = [
            *zip(places, rows.parted(odd).rows(), strict=True),
            *zip(events.tolist(), rows.events, strict=True),
        ]
        records = {
            place: message_record(
                entry, int(channels[place]), int(sequences[place]), int(times[place])
            )
            for place, entry in single
        }
        lengths = np.empty(len(times), np.int64)
        lengths[of_rows] = _lengths().take(forms)
        lengths[list(records)] = [len(record) for record in records.values()]
        ends = np.cumsum(lengths)
        places = ends - lengths
        data = np.empty(int(ends[-1]), np.uint8)
        for own, lines in self._lines(
            rows, forms, channels[of_rows], sequences[of_rows], times[of_rows]
        ):
            _put(data, places[of_rows].take(own), lines)
        for place, record in records.items():
            start = int(places[place])
            data[start : start + len(record)] = np.frombuffer(record, np.uint8)
        return Batch(data.data, channels, times, places)

    def _forms_of(self, rows: RowColumns, times: Array) -> Array:
        """The form of every row that can be written by columns."""
        head = rows.raw[:, 0] | rows.raw[:, CMD_PLACE].astype(np.uint16) << np.uint16(8)
        forms: Array = _FORM_CODES.take(head)
        clean = np.array([not faults for faults in rows.words.faults]).take(rows.faults)
        plain = rows.framed & rows.delayed & ~rows.unordered & clean & (rows.t_ns == times)
        num = rows.raw[:, NUM_PLACE]
        plain &= ~_NAMES_MOTOR.take(forms) | (num >= MOTORS[0]) & (num <= MOTORS[-1])
        forms[~plain] = _NO_FORM
        return forms

    def _channels(self, rows: RowColumns, forms: Array) -> Array:
        """The channel of each row: one for every port, form and motor that there is."""
        ports = rows.port.astype(np.int64)
        motors = np.where(_NAMES_MOTOR.take(forms), rows.raw[:, NUM_PLACE], MOTORS[0])
        keys = (ports * len(_FORMS) + forms) * len(MOTORS) + motors - MOTORS[0]
        odd = np.flatnonzero(forms == _NO_FORM)
        keys[odd] = 0
        found = np.zeros(len(rows.words.ports) * len(_FORMS) * len(MOTORS), np.int64)
        present = np.bincount(keys)
        present[:1] -= len(odd)
        for key in np.flatnonzero(present).tolist():
            port_and_form, motor = divmod(key, len(MOTORS))
            port, form = divmod(port_and_form, len(_FORMS))
            topic = _topic(form, MOTORS[motor])
            found[key] = self._channel_id(rows.words.ports[port], topic)
        channels = found.take(keys)
        channels[odd] = [self._channel_of(row) for row in rows.parted(odd).rows()]
        return channels

    def _channel_of(self, entry: Row | PortEvent) -> int:
        topic = EVENTS if isinstance(entry, PortEvent) else topic_of(entry)
        return self._channel_id(entry.port, topic)

    def _count(self, channels: Array) -> Array:
        """The sequence number of each message: they count up on each channel, and wrap."""
        by_channel = np.argsort(channels.astype(np.uint16), kind="stable")
        counts = np.bincount(channels)
        present = np.flatnonzero(counts)
        counts = counts[present]
        starts = np.array([self._sequences.get(channel, 0) for channel in present.tolist()])
        ends = starts + counts
        self._sequences.update(zip(present.tolist(), ends.tolist(), strict=True))
        sequences = np.empty(len(channels), np.uint32)
        firsts = starts - (np.cumsum(counts) - counts)
        numbers = np.arange(len(channels)) + np.repeat(firsts, counts)
        sequences[by_channel] = numbers.astype(np.uint32)
        return sequences

    def _lines(
        self, rows: RowColumns, forms: Array, channels: Array, sequences: Array, times: Array
    ) -> Iterator[tuple[Array, Array]]:
        """For every form the places of its rows, and their records."""
        raws = np.ascontiguousarray(rows.raw).view(_RAW)[:, 0]
        by_form, first = np.argsort(forms, kind="stable"), 0
        for code, count in enumerate(np.bincount(forms, minlength=len(_FORMS))[: len(_FORMS)]):
            own = by_form[first : first + count]
            first += int(count)
            if not len(own):
                continue
            columns = Columns(
                channel=channels.take(own),
                sequences=sequences.take(own),
                times=times.take(own),
                offsets=rows.offset.take(own),
                delays=rows.delay_ns.take(own),
                raws=raws.take(own).view(np.uint8).reshape(-1, FRAME_LENGTH),
            )
            yield own, _model(code).lines(columns)


@cache
def _topic(form: int, motor: int) -> Topic:
    """Where frames of this form and of this motor go."""
    kind, cmd = _FORMS[form]
    return topic_of(Frame("", 0, bytes([kind.header, cmd, motor]).ljust(FRAME_LENGTH, b"\0"), 0))


@cache
def _model(code: int) -> Model:
    """The layout of the messages of a form."""
    kind, cmd = _FORMS[code]
    raw = bytes([kind.header, cmd, MOTORS[0]]).ljust(FRAME_LENGTH, b"\0")
    frame = Frame("", 0, raw, 0, (), 0)
    topic = topic_of(frame)
    assert topic is not MALFORMED
    assert status_of(()) is Status.OK
    return Model(encode_row(topic, frame, 0), class_of(topic), kind.fields, SOUND_LACKS)


@cache
def _lengths() -> Array:
    """Bytes of a record of each form, by its code."""
    lengths = np.zeros(_NO_FORM + 1, np.int64)
    lengths[: len(_FORMS)] = [_model(code).length for code in range(len(_FORMS))]
    return lengths


def _put(data: Array, places: Array, lines: Array) -> None:
    """Write records of one length to their places."""
    width = lines.dtype.itemsize
    at_every_byte: Array = np.ndarray((len(data) - width + 1,), lines.dtype, data, 0, (1,))
    at_every_byte[places] = lines
