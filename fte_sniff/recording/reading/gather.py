"""Owns turning many messages of a chunk into columns at once.

It must not know files, threads or the order of chunks. Messages of one schema and one length are
read together, once every one of them is seen to keep to a layout: the usual ones by their fronts
(`usual`), others as they lie side by side (`side_rows`). Those that do not, and what no layout
fits, are read one by one, with the same outcome.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from fte_sniff.protocol import PortEvent
from fte_sniff.recording.encoding.layout import Layout
from fte_sniff.recording.encoding.message_reader import MessageReader
from fte_sniff.recording.reading.side import Side
from fte_sniff.recording.reading.side_rows import put_side
from fte_sniff.recording.reading.starts import CHANNEL_PLACE, LOG_TIME_PLACE, MESSAGE_HEAD, Messages
from fte_sniff.recording.reading.usual import is_usual, put_usual, which_usual
from fte_sniff.row_batch import Array, RowColumns

Readers = Mapping[int, MessageReader | None]

_FEW = 4
"""So few messages of one length are read one by one."""
_MOST_LENGTHS = 512


@dataclass(slots=True)
class Gathered:
    """What came of some messages."""

    columns: RowColumns
    messages: int
    """Messages seen, of any topic."""
    times: tuple[int, int] | None
    """First and last log time of ours."""
    losses: list[str] = field(default_factory=list)
    """What could not be read, one line each."""
    in_place: bool = False
    """Whether the columns are those that were to be filled in, and nothing stands beside them."""


def gather(messages: Messages, readers: Readers, columns: RowColumns) -> Gathered:
    """The rows and events of the messages, in that order.

    Args:
        messages: those of one or more unpacked chunks.
        readers: by channel; None for channels of no interest.
        columns: blank ones, with room for a row of each message.

    Raises:
        KeyError: there is a message of a channel that `readers` does not know.
    """
    return _Gathering(messages, readers, columns).gathered()


class _Gathering:
    def __init__(self, messages: Messages, readers: Readers, columns: RowColumns) -> None:
        self._messages, self._readers = messages, readers
        self._rows = columns
        self._kept = np.zeros(len(messages), np.bool_)
        self._events: list[tuple[int, PortEvent]] = []
        self._losses: list[str] = []
        self._first, self._last = 2**64, -1
        self._usual: list[tuple[Readers, Array]] = []
        self._channels = messages.number(CHANNEL_PLACE, "<u2").astype(np.intp)
        self._times = messages.number(LOG_TIME_PLACE, "<i8")
        self._timely = bool(self._times.min(initial=0) == 0)

    def gathered(self) -> Gathered:
        for readers, rows in self._by_schema():
            for own, length in self._by_length(readers, self._unusual(readers, rows)):
                self._take(readers, own, length)
        self._take_usual()
        self._events.sort(key=lambda placed: placed[0])
        events = tuple(event for _, event in self._events)
        columns = self._rows.parted(slice(None), events)
        whole = bool(self._kept.all())
        if not whole:
            columns = columns.parted(self._kept, events)
        times = None if self._last < 0 else (self._first, self._last)
        in_place = whole and not columns.long and not events
        return Gathered(columns, len(self._messages), times, self._losses, in_place)

    def _by_schema(self) -> Iterator[tuple[Readers, Array]]:
        """The rows of all channels that share a schema, and the readers of those channels."""
        counts = np.bincount(self._channels, minlength=1)
        present = np.flatnonzero(counts).tolist()
        groups: dict[int, dict[int, MessageReader]] = {}
        for channel in present:
            reader = self._readers[channel]
            if reader is not None:
                key = id(reader.layouts or reader)
                groups.setdefault(key, {})[channel] = reader
        if len(groups) == 1 and len(next(iter(groups.values()))) == len(present):
            yield next(iter(groups.values())), np.arange(len(self._messages))
            return
        if not groups:
            return
        codes = np.full(present[-1] + 1, len(groups), _code_type(len(groups)))
        for code, channels in enumerate(groups.values()):
            codes[list(channels)] = code
        ends = np.cumsum([counts[list(channels)].sum() for channels in groups.values()])
        by_code = np.argsort(codes.take(self._channels), kind="stable")
        yield from zip(groups.values(), np.split(by_code[: ends[-1]], ends[:-1]), strict=True)

    def _by_length(self, readers: Readers, rows: Array) -> Iterator[tuple[Array, int]]:
        """Those of these rows whose messages are equally long; the few others are taken."""
        if not len(rows):
            return
        lengths = self._messages.lengths[rows]
        if (lengths == lengths[0]).all():
            yield rows, int(lengths[0])
            return
        found, counts = np.unique(lengths, return_counts=True)
        if len(found) > _MOST_LENGTHS:
            self._take_each(readers, rows)
            return
        for length, count in zip(found.tolist(), counts.tolist(), strict=True):
            same = rows[lengths == length]
            if count <= _FEW:
                self._take_each(readers, same)
            else:
                yield same, length

    def _unusual(self, readers: Readers, rows: Array) -> Array:
        """Put the usual messages of one schema by, and leave the others."""
        layouts = next(filter(None, readers.values())).layouts
        layout = None if layouts is None else layouts.usual
        if layout is None or not is_usual(layout) or not self._timely:
            return rows
        length = len(layout.mask)
        usual = self._messages.lengths.take(rows) == length
        own = rows if usual.all() else rows[usual]
        if not len(own):
            return rows
        side = Side(self._messages.records, self._messages.starts.take(own), length)
        fits = which_usual(side, layout)
        if fits is not None:
            usual[usual] = fits
            own = own[fits]
        self._usual.append((readers, own))
        return rows[:0] if len(own) == len(rows) else rows[~usual]

    def _take_usual(self) -> None:
        """All usual rows, of whatever schema, together and in their order."""
        count = sum(len(own) for _, own in self._usual)
        if not count:
            return
        at: Any = slice(None)
        if count < len(self._messages):
            usual = np.zeros(len(self._messages), np.bool_)
            for _, own in self._usual:
                usual[own] = True
            at = np.flatnonzero(usual)
        put_usual(self._rows, at, self._messages.fronts)
        times = self._times[at]
        self._rows.t_ns[at] = times
        self._stretch(int(times.min()), int(times.max()))
        self._kept[at] = True
        every = {
            channel: reader for readers, _ in self._usual for channel, reader in readers.items()
        }
        self._rows.port[at] = self._ports(every, at)

    def _take(self, readers: Readers, rows: Array, length: int) -> None:
        """Messages of one schema and one length."""
        reader = next(filter(None, readers.values()))
        if reader.layouts is not None:
            side = Side(self._messages.records, self._messages.starts[rows], length)
            for layout in reader.layouts.of_length(length):
                fits = side.fits(layout)
                if fits is None:
                    rows = rows[self._take_side(readers, reader, rows, side, layout)]
                    break
                if fits.any():
                    part = side.parted(fits)
                    left = self._take_side(readers, reader, rows[fits], part, layout)
                    fits[np.flatnonzero(fits)[left]] = False
                    rows, side = rows[~fits], side.parted(~fits)
                if not len(rows):
                    break
        self._take_each(readers, rows)

    def _take_side(
        self, readers: Readers, reader: MessageReader, rows: Array, side: Side, layout: Layout
    ) -> Array:
        """Rows that keep to the layout; returns a mask of those that make no row all the same."""
        log_times = self._times.take(rows)
        good, times = put_side(self._rows, rows, side, log_times, layout, reader)
        if times is not None:
            own = rows[good]
            self._kept[own] = True
            self._rows.port[own] = self._ports(readers, own)
            self._stretch(*times)
        return np.asarray(~good)

    def _ports(self, readers: Readers, rows: Any) -> Any:
        ports = {channel: reader.port for channel, reader in readers.items() if reader is not None}
        codes = {channel: self._rows.words.port_code(port) for channel, port in ports.items()}
        if len(set(codes.values())) == 1:
            return next(iter(codes.values()))
        code_of_channel = np.zeros(max(codes) + 1, np.uint16)
        code_of_channel[list(codes)] = list(codes.values())
        return code_of_channel.take(self._channels[rows])

    def _take_each(self, readers: Readers, rows: Array) -> None:
        records = self._messages.records
        for row in rows.tolist():
            reader = readers[int(self._channels[row])]
            assert reader is not None
            body = int(self._messages.starts[row]) + MESSAGE_HEAD
            data = records[body : body + int(self._messages.lengths[row])]
            log_time = int(self._times[row].view(np.uint64))
            try:
                entry = reader.entry(data, log_time)
            except ValueError as error:
                self._losses.append(f"{reader.topic}: {error}")
                continue
            self._stretch(log_time, log_time)
            if isinstance(entry, PortEvent):
                self._events.append((row, entry))
            else:
                self._rows.put(row, entry)
                self._kept[row] = True

    def _stretch(self, first: int, last: int) -> None:
        self._first, self._last = min(first, self._first), max(last, self._last)


def _code_type(codes: int) -> type[np.unsignedinteger[Any]]:
    """The shortest that has one code more: numpy sorts it in the fewest passes."""
    return np.uint8 if codes < 2**8 else np.uint32
