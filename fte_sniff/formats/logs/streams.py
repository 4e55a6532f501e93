"""The streams of a log: each direction or port with its own framer, merged by time or line."""

from __future__ import annotations

from bisect import bisect_right
from collections import deque
from collections.abc import Iterable, Sequence
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Final, TypeAlias, Union

from fte_sniff.formats.logs.labels import RECEIVED, SENT
from fte_sniff.protocol import FRAME_LENGTH, HEADERS, Chunk, Direction, Fault, Framer, Row
from fte_sniff.protocol.framer.segments import DecidedSpan
from fte_sniff.protocol.framer.timestamps import PAUSE_BYTES, ArrivalTime
from fte_sniff.protocol.spec import DEFAULT_BAUD, DIRECTION_OF_HEADER, byte_time_ns

if TYPE_CHECKING:
    from fte_sniff.formats.logs.columns import Columns
    from fte_sniff.row_batch import RowBatch

Rows: TypeAlias = Union[list[Row], "RowBatch"]

LATEST_NS: Final = 2**63 - 1
"""In 2262: a table's times are 64 bits, nanoseconds since 1970."""
BYTE_NS: Final = byte_time_ns(DEFAULT_BAUD)
FEW: Final = 20_000
"""Rows of a log that come as lists, before numpy is loaded for the others."""
_FEW_AT_ONCE: Final = 100
_PAUSE_NS: Final = round(PAUSE_BYTES * BYTE_NS)
_CUT_NS: Final = 10**9
"""Silence where the log leaves out bytes, for the framer: no frame continues across it."""
_NO_LINE: Final = 2**62
_MOST_COMPARED: Final = 100_000
"""Frames of a stream whose headers are compared with its direction."""
_HEADER_OF_LABEL: Final = {
    SENT: HEADERS[Direction.CONTROL], RECEIVED: HEADERS[Direction.FEEDBACK]
}  # fmt: skip
"""The header of the frames that the host, which writes the log, sends or receives."""


class LogStream:
    """The bytes of one wire, and the rows that they make.

    The framer gets chunks with the silence between them, but not their times: silence shorter than
    the resolution of the stamps is none. The times of rows come from the stamps.
    """

    def __init__(self, port: str, resolution_ns: int) -> None:
        self.port = port
        self._framer = Framer(port)
        self._resolution_ns = resolution_ns
        self._size = 0
        self._clock_ns = 0
        self._last_ns: int | None = None
        self._marks: deque[ArrivalTime] = deque()
        self._stops: list[int] = []
        self._lines: list[int] = []
        self.label: str | None = None
        """The direction of the stream in the log, or another label."""
        self.compared = self.contrary = self.cut_frame = 0
        """Frames with a direction in the log; those of another header; bytes of a last frame that
        is cut."""
        self.against: tuple[int, str, int] | None = None
        """Line, label and header of the first frame of another header."""

    def append(self, data: bytes, line: int, t_ns: int | None, *, first: bool = False) -> None:
        """Append the bytes of a line.

        Args:
            data: the bytes.
            line: the number of the line.
            t_ns: its time.
            first: whether the first byte began then; else the last one had arrived.
        """
        floor = 0
        if t_ns is None:
            self._framer.push(Chunk(self.port, None, data))
        else:
            duration = len(data) * BYTE_NS
            if first:
                t_ns = min(t_ns + duration, LATEST_NS)
            elif self._last_ns is not None and self._last_ns <= t_ns:
                floor = self._last_ns
            self._push(data, self._silence(t_ns, duration))
            self._last_ns = t_ns
        self._mark(len(data), t_ns, floor, line)

    def append_columns(self, data: bytes, columns: Columns) -> None:
        """Append the bytes of many lines."""
        if columns.t_ns is None:
            self._framer.push(Chunk(self.port, None, data))
            start, self._size = self._size, self._size + len(data)
            self._marks.append(ArrivalTime(start, self._size, None, 0, BYTE_NS))
        else:
            self._append_timed(data, columns)
        stops = self._size - len(data) + columns.stops
        self._stops += stops.tolist()
        self._lines += columns.lines.tolist()

    def _append_timed(self, data: bytes, columns: Columns) -> None:
        """Lines whose stamps follow each other as their bytes do are one chunk."""
        import numpy as np

        t_ns, stops = columns.t_ns, columns.stops
        assert t_ns is not None
        drift = (t_ns - stops * BYTE_NS) // max(min(self._resolution_ns, 10**6), 1000)
        ends = np.append(np.flatnonzero(np.diff(drift)), len(t_ns) - 1)
        start = 0
        for stop, time in zip(stops[ends].tolist(), t_ns[ends].tolist(), strict=True):
            self._push(data[start:stop], self._silence(time, (stop - start) * BYTE_NS))
            floor = self._last_ns if self._last_ns is not None and self._last_ns <= time else 0
            begin, self._size = self._size, self._size + stop - start
            self._marks.append(ArrivalTime(begin, self._size, time, floor, BYTE_NS))
            self._last_ns, start = time, stop

    def cut(self) -> None:
        """The log leaves out bytes here: no frame goes on."""
        self._push(b"", _CUT_NS)

    def _silence(self, t_ns: int, duration: int) -> int:
        if self._last_ns is None:
            return 0
        silence = t_ns - duration - self._last_ns - self._resolution_ns
        return silence if silence >= _PAUSE_NS else 0

    def _push(self, data: bytes, silence: int) -> None:
        self._clock_ns += len(data) * BYTE_NS + silence
        self._framer.push(Chunk(self.port, self._clock_ns, data))

    def _mark(self, size: int, t_ns: int | None, floor: int, line: int) -> None:
        start, self._size = self._size, self._size + size
        self._marks.append(ArrivalTime(start, self._size, t_ns, floor, BYTE_NS))
        self._stops.append(self._size)
        self._lines.append(line)

    def drain(self, *, final: bool = False) -> DecidedSpan:
        """What is decided since the last time, with the times of the log."""
        if final:
            self._framer.finish()
        span = self._framer.drain()
        self._compare(span)
        last = span.last() if final else None
        if last is not None and not last[1] and Fault.TRUNCATED in last[2]:
            self.cut_frame = last[0]
        end, marks = span.segments.end, []
        while self._marks and self._marks[0].start < end:
            marks.append(self._marks[0])
            if self._marks[0].stop > end:
                break
            self._marks.popleft()
        return DecidedSpan(span.port, span.data, span.start, span.segments, marks)

    def _compare(self, span: DecidedSpan) -> None:
        expected = _HEADER_OF_LABEL.get(self.label or "")
        if expected is None or self.compared >= _MOST_COMPARED:
            return
        headers = list(span.headers())
        contrary = [(offset, header) for offset, header in headers if header != expected]
        self.compared += len(headers)
        if contrary and self.against is None:
            offset, header = contrary[0]
            self.against = self.lines_of([offset])[0], self.label or "", header
        self.contrary += len(contrary)

    def lines_of(self, offsets: Iterable[int]) -> list[int]:
        """The numbers of the lines where bytes are."""
        return [self._lines[bisect_right(self._stops, offset)] for offset in offsets]

    def pending_line(self, end: int) -> int:
        """The line of the first byte that is not decided; a large number if there is none."""
        done = bisect_right(self._stops, end)
        return self._lines[done] if done < len(self._lines) else _NO_LINE

    def forget(self, end: int) -> None:
        """Drop the lines that are decided."""
        done = bisect_right(self._stops, end)
        del self._stops[:done], self._lines[:done]


class LogStreams:
    """All streams of a log."""

    def __init__(self, resolution_ns: int = 1) -> None:
        self._resolution_ns = resolution_ns
        self._streams: dict[str, LogStream] = {}
        self._count = 0
        self._held: list[tuple[int, Row]] = []

    def __getitem__(self, port: str) -> LogStream:
        """The stream of a port, which may be new."""
        stream = self._streams.get(port)
        if stream is None:
            stream = self._streams[port] = LogStream(port, self._resolution_ns)
        return stream

    def labelled(self, port: str, label: str | None) -> LogStream:
        """The stream of a port; its label may be a direction, which its frames can contradict."""
        known = port in self._streams
        stream = self[port]
        stream.label = label if not known or stream.label == label else None
        return stream

    def __len__(self) -> int:
        """The number of streams."""
        return len(self._streams)

    def notes(self, *, ends: bool) -> list[str]:
        """Which directions frames contradict, and if `ends`, which streams end within a frame."""
        notes = []
        against = [stream.against for stream in self._streams.values() if stream.against]
        if against:
            line, label, header = min(against)
            count = sum(stream.contrary for stream in self._streams.values())
            frames = sum(stream.compared for stream in self._streams.values())
            direction = DIRECTION_OF_HEADER[header]
            first = "the first " if frames >= _MOST_COMPARED else ""
            said = "sent" if label == SENT else "received"
            notes.append(
                f"{count:,} of {first}{frames:,} frames go the other way than the log says"
                f" (line {line} says {said}, header {header:02X} says {direction}): a tap logs so,"
                " or the wires are swapped"
            )
        for stream in self._streams.values():
            if ends and stream.cut_frame:
                where = "" if len(self) == 1 else f"{stream.port.rpartition(':')[2]} "
                notes.append(
                    f"{where}ends in the middle of a frame"
                    f" ({stream.cut_frame} of {FRAME_LENGTH} bytes)"
                )
        return notes

    def drain(self, *, final: bool = False) -> list[Rows]:
        """The rows that are decided, in order."""
        streams = list(self._streams.values())
        if not streams:
            return []
        spans = [stream.drain(final=final) for stream in streams]
        rows = sum(map(len, spans))
        self._count += rows
        if len(streams) == 1:
            streams[0].forget(spans[0].segments.end)
            if not rows:
                return []
            if self._count < FEW or rows < _FEW_AT_ONCE:
                return [spans[0].rows()]
            from fte_sniff.row_batch import RowBatch

            return [RowBatch.from_span(spans[0])]
        return self._merged(streams, spans, final=final)

    def _merged(
        self, streams: Sequence[LogStream], spans: Sequence[DecidedSpan], *, final: bool
    ) -> list[Rows]:
        """Merge rows up to the first line with undecided bytes."""
        limit = min(
            stream.pending_line(span.segments.end)
            for stream, span in zip(streams, spans, strict=True)
        )
        limit = _NO_LINE if final else limit
        rows = sum(map(len, spans))
        if self._count < FEW or rows < _FEW_AT_ONCE:
            return self._merged_rows(streams, spans, limit)
        return self._merged_batches(streams, spans, limit)

    def _merged_rows(
        self, streams: Sequence[LogStream], spans: Sequence[DecidedSpan], limit: int
    ) -> list[Rows]:
        entries = self._held
        for stream, span in zip(streams, spans, strict=True):
            rows = span.rows()
            lines = stream.lines_of(row.offset for row in rows)
            entries += zip(lines, rows, strict=True)
            stream.forget(span.segments.end)
        entries.sort(key=lambda entry: entry[0])
        ready = bisect_right(entries, limit - 1, key=lambda entry: entry[0])
        self._held = entries[ready:]
        found = [row for _, row in entries[:ready]]
        times = [row.t_ns for row in found if row.t_ns is not None]
        if len(times) == len(found) and self._nearly_sorted(times):
            found.sort(key=lambda row: row.t_ns or 0)
        return [found] if found else []

    def _merged_batches(
        self, streams: Sequence[LogStream], spans: Sequence[DecidedSpan], limit: int
    ) -> list[Rows]:
        import numpy as np

        from fte_sniff.row_batch import RowBatch

        batches, lines = [], []
        if self._held:
            batches.append(RowBatch.from_rows([row for _, row in self._held]))
            lines += [line for line, _ in self._held]
        for stream, span in zip(streams, spans, strict=True):
            batch = RowBatch.from_span(span)
            batches.append(batch)
            lines += stream.lines_of(batch.offset.tolist())
            stream.forget(span.segments.end)
        whole, of_row = RowBatch.concat(batches), np.array(lines)
        order = np.argsort(of_row, kind="stable")
        ready = int(np.searchsorted(of_row[order], limit))
        held = whole.select(order[ready:])
        self._held = list(zip(of_row[order[ready:]].tolist(), held, strict=True))
        found = whole.select(order[:ready])
        if len(found) and found.timed.all() and self._nearly_sorted(found.t_ns):
            found = found.select(np.argsort(found.t_ns, kind="stable"))
        return [found] if len(found) else []

    @staticmethod
    def _nearly_sorted(times: Any) -> bool:
        """Whether times fall only by what a line takes, not because the clock was set."""
        return all(b >= a - _CUT_NS for a, b in pairwise(times))
