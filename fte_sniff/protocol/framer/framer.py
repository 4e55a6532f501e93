"""The `Framer`: chunks in, rows out; decides when enough bytes have arrived.

The stream is decided from left to right, and every decision is final. A decision depends on silence
and on the bytes up to an offset that these bytes determine, never on the chunks. States:

    in step   A certain frame ended here. Plain frames are taken as long as another one follows in
              step, on a calm line unsplit ones too. The last one is taken at once if the line is
              calm and the frame clear; else when it cannot be the start of an overlong frame.
    disputed  Anything else. Bytes are decoded as soon as there is: an unambiguous frame, for the
              bytes before it; two strict frames in step; three strict frames; three framed segments
              in step; a framed segment and `lookahead` bytes; `widest` bytes; or silence. Decided
              is all but the last frame if the last two are certain; else what has `lookahead` bytes
              after it. The forward probabilities at the boundary start the next decoding.
    lost      Long noise. Bytes are skipped up to `lead` bytes before the next anchor.

Silence of 20 ms decides all pending bytes, except the start of a frame that can still be completed:
the reading process may have been held up. Such a start is given up after 500 ms. Shorter pauses,
from 3.5 byte times, are evidence for a boundary between segments.
"""

from __future__ import annotations

from typing import Final, final

from mypy_extensions import i64

from fte_sniff.protocol.framer.decoder import (
    BoundaryState,
    CandidateSet,
    ForwardBackward,
    PrefixScore,
    after_certain_frame,
    after_silence,
    at_stream_start,
    decode,
    in_long_noise,
    trust_calm_line,
)
from fte_sniff.protocol.framer.model import (
    BOUNDARY,
    CLOSED,
    EXTRA,
    FTE_TABLES,
    LIKELY,
    NOISE,
    OPEN,
    RESERVED_NONZERO,
    TRUNCATED,
    FrameTables,
    ReserveLearner,
    end_of_run,
    find_anchor,
    find_framed,
    find_strict,
    find_unambiguous,
    is_clear,
    is_framed,
    is_isolated,
    is_strict,
)
from fte_sniff.protocol.framer.segments import (
    SETTLING_NS,
    ArrivalTimeline,
    IdleTimes,
    LineHealth,
    PendingBytes,
    Segment,
)
from fte_sniff.protocol.items import Chunk
from fte_sniff.protocol.rows import Codebook, Row, Rows
from fte_sniff.protocol.spec import DEFAULT_BAUD, byte_time_ns

_ENOUGH: Final[i64] = 3
"""Strict frames, or framed segments in step, that are worth decoding."""

_NEVER: Final[i64] = -1

# Scheduling: how many bytes to wait for


def next_decoding(
    tables: FrameTables, data: bytes, start: i64, not_before: i64, decoded_to: i64
) -> tuple[i64, i64]:
    """The number of bytes to wait for and the offset to decode to, from `start`; -1 if unknown.

    Nothing new is learnt before `not_before`, except deadlines after `decoded_to`.
    """
    limit = min(i64(len(data)), start + tables.widest)
    known = limit - EXTRA
    if known < start + 2 * tables.length:
        return _NEVER, _NEVER
    end = _end_of_pair(tables, data, max(start, not_before - 2 * tables.length), known)
    end = _earlier(end, _end_of_framed_run(tables, data, start, known), not_before)
    end = _earlier(end, _end_of_third(tables, data, start, known), not_before)
    wait, to = (end + EXTRA, end) if end >= 0 else (_NEVER, _NEVER)
    if limit == start + tables.widest and (wait < 0 or limit < wait):
        wait = to = limit
    deadline = next_deadline(tables, data, start, decoded_to, limit)
    if deadline >= 0 and (wait < 0 or deadline < wait or (deadline == wait and deadline < to)):
        wait = to = deadline
    return wait, to


def _earlier(first: i64, second: i64, not_before: i64) -> i64:
    """The smaller offset of those that are not before `not_before`; -1 if there is none."""
    if first < not_before or (not_before <= second < first):
        first = second
    return first if first >= not_before else _NEVER


def _end_of_pair(tables: FrameTables, data: bytes, start: i64, known: i64) -> i64:
    length = tables.length
    at = find_strict(tables, data, start, known - length)
    while at >= 0 and not is_strict(tables, data, at + length):
        at = find_strict(tables, data, at + 1, known - length)
    return _NEVER if at < 0 else at + 2 * length


def _end_of_framed_run(tables: FrameTables, data: bytes, start: i64, known: i64) -> i64:
    end = start
    for _ in range(_ENOUGH):
        if end + tables.length > known or not is_framed(tables, data, end):
            return _NEVER
        end += tables.length
    return end


def _end_of_third(tables: FrameTables, data: bytes, start: i64, known: i64) -> i64:
    end = start
    for _ in range(_ENOUGH):
        at = find_strict(tables, data, end, known)
        if at < 0:
            return _NEVER
        end = at + tables.length
    return end


def next_deadline(tables: FrameTables, data: bytes, start: i64, decoded_to: i64, limit: i64) -> i64:
    """The offset where the next framed segment must be decided; -1 if it is after `limit`."""
    first = max(start, decoded_to + 1 - tables.deadline)
    at = find_framed(tables, data, first, limit - tables.lookahead)
    return _NEVER if at < 0 else at + tables.deadline


def settled_segments(
    tables: FrameTables, segments: list[Segment], data: bytes, start: i64, end: i64
) -> list[Segment]:
    """The segments from `start` to `end` that are decided although more bytes may follow."""
    size, deadline = end - start, tables.deadline
    if size >= tables.widest or (size >= deadline and is_framed(tables, data, end - deadline)):
        return _segments_to(tables, segments, size - tables.lookahead)
    number: i64 = len(segments)
    while number > 0:
        last = segments[number - 1]
        if last.framed and last.stop <= size - tables.lookahead:
            break
        number -= 1
    return segments[:number]


def _segments_to(tables: FrameTables, segments: list[Segment], limit: i64) -> list[Segment]:
    """The segments up to `limit`: noise is cut there, an overlong frame is taken as a whole."""
    settled = [segment for segment in segments if segment.stop <= limit]
    following = segments[len(settled)]
    if following.faults == NOISE and following.start < limit:
        settled.append(Segment(following.start, limit, False, NOISE, 0.0))
    elif following.start <= limit - tables.length:
        settled.append(following)
    return settled


def lead_start(tables: FrameTables, data: bytes, start: i64, anchor: i64) -> i64:
    """Where decoding starts after long noise, for an anchor, but not before `start`.

    A framed segment whose deadline has passed is noise.
    """
    begin = max(start, anchor - tables.lead)
    while True:
        late = find_framed(tables, data, begin, max(begin, anchor - 1))
        if late < 0:
            return begin
        begin = late + 1


GIVING_UP_NS: Final = 500_000_000
"""Silence that ends the wait for the rest of a frame."""

_CERTAIN: Final = after_certain_frame()
_NOWHERE: Final[i64] = -1


@final
class Framer:
    """Turns the chunks of one port into rows that cover its stream without gap or overlap."""

    def __init__(
        self,
        port: str,
        baud: int = DEFAULT_BAUD,
        tables: FrameTables = FTE_TABLES,
        codebook: Codebook | None = None,
    ) -> None:
        """Frame the bytes of a port, which is named in every row, at `baud` bits per second.

        The rows of framers with the same `codebook` have the same codes; by default each has
        another one.

        Raises:
            ValueRangeError: `baud` is less than 1.
        """
        self._tables = tables
        """For the reserve as it is known so far."""
        self._reserve = ReserveLearner(tables)
        self._timeline = ArrivalTimeline(byte_time_ns(baud))
        self._line = LineHealth(tables.length)
        self._decided = PendingBytes(port, self._timeline.times, codebook or Codebook())
        self._data = b""
        self._base: i64 = 0
        """Stream offset of the first byte of `_data`."""
        self._at: i64 = 0
        """Offset in `_data` up to which all is decided."""
        self._state: BoundaryState | None = at_stream_start()
        """The forward probabilities from `_at` on; None while the stream is in step."""
        self._lost_from = _NOWHERE
        """Stream offset where long noise continues; `_NOWHERE` if there is none."""
        self._skipping = False
        """Whether the long noise is already being skipped."""
        self._not_before: i64 = 0
        """Offset in `_data` before which decoding again would learn nothing new."""
        self._decoded_to: i64 = 0
        """Offset in `_data` up to which candidates have been decoded."""
        self._unambiguous_from: i64 = 0
        """Offset in `_data` before which frames turned out to be ambiguous."""
        self._pauses = IdleTimes(baud)
        self._settled = False

    def set_baud(self, baud: int) -> None:
        """Set the bits per second of the line from the next chunk on.

        Raises:
            ValueRangeError: `baud` is less than 1.
        """
        self._timeline.set_byte_time(byte_time_ns(baud))
        self._pauses.set_baud(baud)

    def feed(self, chunk: Chunk) -> list[Row]:
        """Process a chunk and return the rows it completes; never raises on wire data."""
        self.push(chunk)
        return self._rows()

    def flush(self) -> list[Row]:
        """Decide all pending bytes and return their rows; the stream ends here."""
        self.finish()
        return self._rows()

    def _rows(self) -> list[Row]:
        if self._line.segments.end == self._decided.start:
            return []
        return list(self.drain())

    def drain(self) -> Rows:
        """All rows that were decided since the last call."""
        return self._decided.drain(self._line.drain())

    def restart(self) -> list[Row]:
        """Flush, and start a new stream whose offsets and times continue."""
        rows = self.flush()
        self._state = at_stream_start()
        self._line.reset(self._base)
        self._reserve.reset()
        self._tables = self._reserve.tables
        return rows

    def reset_clock(self) -> None:
        """Let the next times be earlier than those so far, for logs whose clock was set."""
        self._timeline.reset_clock()

    @property
    def pending_since_ns(self) -> int | None:
        """When the first byte that is in no row yet began; None without such a byte."""
        offset = self._line.segments.noise_from
        if offset < 0:
            offset = self._base + self._at
            if self._at == len(self._data):
                return None
        return self._timeline.times.at(offset).time_and_delay(offset)[0]

    def push(self, chunk: Chunk) -> None:
        """Process a chunk without making rows; see `drain`."""
        if chunk.data:
            silence = self._timeline.append(chunk)
            if silence >= self._pauses.least_ns:
                self._on_silence(silence)
                self._pauses.append(self._base + len(self._data))
            self._data += chunk.data
            self._settled = False
            self._advance()
        else:
            self._on_silence(self._timeline.silence_at(chunk.t_ns))
        if self._at:
            self._drop_decided()

    def finish(self) -> None:
        """Decide all pending bytes without making rows; see `drain`."""
        self._settle(hold=False)
        self._drop_decided()

    # The three states

    def _advance(self) -> None:
        while True:
            if self._lost_from >= 0:
                moved = self._skip_noise()
            elif self._state is None:
                moved = self._follow_run()
            else:
                moved = self._decode_if_ready()
            if not moved:
                return

    def _follow_run(self) -> bool:
        """In step: take the certain frames; False if more bytes are needed."""
        tables, data, at, end = self._tables, self._data, self._at, i64(len(self._data))
        length = tables.length
        if end - at < length:
            return False
        run, taught = end_of_run(
            tables, self._reserve.marks, data, at, end, calm=self._line.is_calm()
        )
        sure = run - length
        if run > at:
            calm = self._line.is_calm((sure - at) // length)
            if is_clear(tables, data, sure) if calm else is_isolated(tables, data, sure, end):
                sure = run
        if taught >= 0 and sure >= taught:
            self._line.append_run(self._base + at, self._base + taught)
            self._at = taught
            self._reserve.observe(data, taught - length)
            self._tables = self._reserve.tables
            return True
        if sure > at:
            self._line.append_run(self._base + at, self._base + sure)
            self._at = sure
        waiting = 2 * length if sure < run else length
        if end - self._at < waiting:
            return False
        self._state = _CERTAIN
        self._not_before = 0
        return True

    def _decode_if_ready(self) -> bool:
        """Disputed: decide what comes before an unambiguous frame, or decode once enough bytes have
        arrived; False before that."""
        tables, data, at = self._tables, self._data, self._at
        if len(data) - at < tables.longest:
            return False
        frame = _NOWHERE
        if not self._pauses.any_after(self._base + at):
            frame = find_unambiguous(
                tables, data, max(at, self._unambiguous_from), at + tables.widest
            )
        wait, end = _NOWHERE, _NOWHERE
        if frame < 0 or frame - at >= tables.length:
            wait, end = next_decoding(tables, data, at, self._not_before, self._decoded_to)
        if frame >= 0 and (wait < 0 or frame + tables.longest <= wait):
            if not self._decode_before(frame):
                self._unambiguous_from = frame + tables.length
            return True
        if wait < 0:
            return False
        self._decode_to(end)
        return True

    def _decode_to(self, end: i64) -> None:
        """Decode all bytes up to `end`, and decide what is settled."""
        tables = self._tables
        posterior = self._posterior(end, OPEN)
        segments = self._decode(posterior)
        self._decoded_to = end
        if len(segments) > 1 and segments[-1].certain and segments[-2].certain:
            self._decide(segments[:-1])
            self._state = None
            return
        settled = settled_segments(tables, segments, self._data, self._at, end)
        if not settled:
            self._not_before = min(end + tables.length, self._at + tables.widest)
            return
        last = settled[-1]
        noise = last.faults == NOISE
        lost = noise and end - self._at >= tables.widest
        if last.certain:
            self._state = _CERTAIN
        else:
            self._state = posterior.boundary_state(last.stop, ends_frame=not noise)
        self._decide(settled)
        self._not_before = 0
        if lost:
            self._lost_from, self._skipping = self._base + self._at, False

    def _decode_before(self, frame: i64) -> bool:
        """Decide all before an unambiguous frame; False if that is ambiguous after all."""
        segments = self._decode(self._posterior(frame + self._tables.length, BOUNDARY))
        if not segments.pop().certain:
            return False
        self._decide(segments)
        self._state = None
        self._not_before = 0
        return True

    def _posterior(self, end: i64, ending: i64) -> ForwardBackward:
        pauses = self._pauses.within(self._base + self._at, self._base + end)
        candidates = CandidateSet(self._tables, self._data[self._at : end], pauses)
        return ForwardBackward(candidates, self._state or _CERTAIN, ending)

    def _decode(self, posterior: ForwardBackward) -> list[Segment]:
        segments = decode(posterior)
        return trust_calm_line(posterior, segments) if self._line.is_calm() else segments

    def _skip_noise(self) -> bool:
        """Lost: skip the noise up to the next anchor; False if none has arrived yet."""
        tables, data = self._tables, self._data
        anchor = find_anchor(tables, data, self._at)
        reach = 2 * tables.length - 1  # Bytes that an incomplete anchor has at most.
        known = anchor if anchor >= 0 else len(data) - reach
        enough = self._lost_from - self._base + tables.widest
        if not self._skipping:
            limit = min(i64(len(data)), enough + reach)
            deadline = next_deadline(tables, data, self._at, self._decoded_to, limit)
            if deadline >= 0 and (anchor < 0 or deadline <= anchor + 2 * tables.length):
                self._lost_from = _NOWHERE
                return True
        if self._skipping or known >= enough:
            self._skipping = True
            self._state = in_long_noise()
            self._decide_noise(lead_start(tables, data, self._at, known))
        if anchor >= 0:
            self._lost_from = _NOWHERE
            self._not_before = 0
        return anchor >= 0

    # Silence

    def _on_silence(self, silence_ns: int) -> None:
        if silence_ns >= SETTLING_NS and not self._settled:
            self._settle(hold=True)
            self._settled = True
        if silence_ns >= GIVING_UP_NS:
            self._settle(hold=False)

    def _settle(self, *, hold: bool) -> None:
        """Decide all bytes so far; `hold` keeps the start of a frame that may continue."""
        if self._at < len(self._data):
            segments = self._decode(self._posterior(len(self._data), CLOSED))
            last = segments[-1]
            held = hold and not last.framed and self._can_continue(last)
            self._decide(segments[:-1] if held else segments)
            self._state = None if held or last.certain else after_silence()
            self._lost_from = _NOWHERE
            self._not_before = 0
        self._line.segments.end_noise()

    def _can_continue(self, last: Segment) -> bool:
        if last.faults & TRUNCATED == 0:
            return False
        start = self._at + last.start
        end = min(i64(len(self._data)), start + self._tables.length)
        prefix = PrefixScore(self._tables, self._data, start, end)
        return prefix.fit >= last.stop - last.start

    # Decided bytes

    def _decide(self, segments: list[Segment]) -> None:
        if segments:
            self._line.append(self._base + self._at, segments)
            for segment in segments:
                if segment.faults == RESERVED_NONZERO or segment.probability >= LIKELY:
                    self._reserve.observe(self._data, self._at + segment.start)
            self._tables = self._reserve.tables
            self._at += segments[-1].stop
        self._unambiguous_from = 0

    def _decide_noise(self, stop: i64) -> None:
        """Decide that the bytes up to `stop` are noise, which may continue."""
        if stop > self._at:
            self._line.segments.append_noise(self._base + self._at, self._base + stop)
            self._at = stop

    def _drop_decided(self) -> None:
        done = self._at
        self._decided.append(self._data, done)
        self._data = self._data[done:]
        self._base += done
        self._at = 0
        self._not_before = max(i64(0), self._not_before - done)
        self._decoded_to = max(i64(0), self._decoded_to - done)
        self._unambiguous_from = max(i64(0), self._unambiguous_from - done)
        self._pauses.forget(self._base)
