"""Owns the way from rows that lie side by side to the packed messages of a chunk.

It must not know files. Sound frames with a read delay, whose time is their log time, are written by
columns, all of a kind at once; each other row is encoded by itself, as are port events.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import cache

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
from fte_sniff.protocol.table import CMD_PLACE, NUM_PLACE
from fte_sniff.recording.encoding.batch import Batch, message_record
from fte_sniff.recording.encoding.columns import Array, RowColumns
from fte_sniff.recording.encoding.messages import class_of, encode_row
from fte_sniff.recording.encoding.model import Columns, Model
from fte_sniff.recording.encoding.topics import EVENTS, MALFORMED, Topic, topic_of
from fte_sniff.recording.encoding.wire import SOUND_LACKS

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
        single: list[tuple[int, Row | PortEvent]] = [
            *_rows_at(rows, np.flatnonzero(forms == _NO_FORM)),
            *((len(rows) + at, event) for at, event in enumerate(rows.events)),
        ]
        all_times = np.concatenate([times, event_times])
        order = np.argsort(all_times, kind="stable")
        channels = self._channels(rows, forms, single)
        sequences = self._count(channels, order)
        records = {
            place: message_record(
                entry, int(channels[place]), int(sequences[place]), int(all_times[place])
            )
            for place, entry in single
        }
        lengths = np.empty(len(all_times), np.int64)
        lengths[list(records)] = [len(record) for record in records.values()]
        parts = list(self._lines(rows, forms, channels, sequences, times))
        for own, lines in parts:
            lengths[own] = lines.dtype.itemsize
        places = np.empty(len(lengths) + 1, np.int64)
        places[0] = 0
        np.cumsum(lengths[order], out=places[1:])
        place_of = np.empty(len(lengths), np.int64)
        place_of[order] = places[:-1]
        data = np.empty(int(places[-1]), np.uint8)
        for own, lines in parts:
            _put(data, place_of[own], lines)
        for place, record in records.items():
            start = int(place_of[place])
            data[start : start + len(record)] = np.frombuffer(record, np.uint8)
        return Batch(data.tobytes(), channels[order], all_times[order], places[:-1])

    def _forms_of(self, rows: RowColumns, times: Array) -> Array:
        """The form of every row that can be written by columns."""
        head = rows.raw[:, 0] | rows.raw[:, CMD_PLACE].astype(np.uint16) << np.uint16(8)
        forms: Array = _FORM_CODES[head]
        clean = np.array([not faults for faults in rows.words.faults])
        plain = (
            rows.framed & rows.delayed & ~rows.unordered & clean[rows.faults] & (rows.t_ns == times)
        )
        forms[~plain] = _NO_FORM
        named = np.zeros((_NO_FORM + 1,), np.bool_)
        named[[code for code, (kind, _) in enumerate(_FORMS) if kind.names_motor]] = True
        num = rows.raw[:, NUM_PLACE]
        forms[named[forms] & ((num < MOTORS[0]) | (num > MOTORS[-1]))] = _NO_FORM
        return forms

    def _channels(
        self, rows: RowColumns, forms: Array, single: list[tuple[int, Row | PortEvent]]
    ) -> Array:
        channels = np.empty(len(rows) + len(rows.events), np.int64)
        for code in np.unique(forms).tolist():
            if code != _NO_FORM:
                own = np.flatnonzero(forms == code)
                channels[own] = self._channels_of_form(rows, own, *_FORMS[code])
        for place, entry in single:
            topic = EVENTS if isinstance(entry, PortEvent) else topic_of(entry)
            channels[place] = self._channel_id(entry.port, topic)
        return channels

    def _channels_of_form(self, rows: RowColumns, own: Array, kind: FrameKind, cmd: int) -> Array:
        ports = rows.port[own].astype(np.int64)
        nums = rows.raw[own, NUM_PLACE] if kind.names_motor else np.full(len(own), MOTORS[0])
        keys = ports * _BYTES + nums
        found = np.zeros(len(rows.words.ports) * _BYTES, np.int64)
        for key in np.flatnonzero(np.bincount(keys)).tolist():
            port, num = divmod(key, _BYTES)
            raw = bytes([kind.header, cmd, num]).ljust(FRAME_LENGTH, b"\0")
            topic = topic_of(Frame("", 0, raw, 0))
            found[key] = self._channel_id(rows.words.ports[port], topic)
        return np.asarray(found[keys])

    def _count(self, channels: Array, order: Array) -> Array:
        """The sequence number of each message: they count up on each channel, and wrap."""
        in_order = channels[order].astype(np.uint16)
        by_channel = np.argsort(in_order, kind="stable")
        counts = np.bincount(in_order)
        firsts = np.cumsum(counts) - counts
        for channel in np.flatnonzero(counts).tolist():
            start = self._sequences.get(channel, 0)
            firsts[channel] -= start
            self._sequences[channel] = start + int(counts[channel])
        sequences = np.empty(len(channels), np.int64)
        sequences[order[by_channel]] = np.arange(len(channels)) - firsts[in_order[by_channel]]
        return sequences.astype(np.uint32)

    def _lines(
        self, rows: RowColumns, forms: Array, channels: Array, sequences: Array, times: Array
    ) -> Iterator[tuple[Array, Array]]:
        """For every form the places of its rows, and their records."""
        for code in np.unique(forms).tolist():
            if code == _NO_FORM:
                continue
            own = np.flatnonzero(forms == code)
            columns = Columns(
                channel=channels[own],
                sequences=sequences[own],
                times=times[own],
                offsets=rows.offset[own],
                delays=rows.delay_ns[own],
                raws=rows.raw[own],
            )
            yield own, _model(code).lines(columns)


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


def _rows_at(rows: RowColumns, places: Array) -> Iterator[tuple[int, Row]]:
    return zip(places.tolist(), rows.parted(places).rows(), strict=True)


def _put(data: Array, places: Array, lines: Array) -> None:
    """Write records of one length to their places."""
    width = lines.dtype.itemsize
    at_every_byte: Array = np.ndarray((len(data) - width + 1,), lines.dtype, data, 0, (1,))
    at_every_byte[places] = lines
