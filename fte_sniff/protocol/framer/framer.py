"""Public Framer: feed chunks, get rows; decides when enough bytes have arrived.

It must not do I/O or read a clock; the times come with the chunks. How likely things are stands in
`likelihood`, how readings are weighed in `weighing`, when in `due`, how bytes get their times in
`timeline`, what becomes of decided ones in `line`.

The stream is decided from left to right, each decision final. Every decision depends on the bytes
up to a place that those bytes themselves determine, and on silence; never on how the stream was
cut into chunks. There are three states:

    in step   A frame ended here beyond doubt. Frames that fit their kind at every place are taken
              as long as each is followed by another one in step, unless a header in their
              payload, behind a tail or before a CMD and a motor, could make them two truncated
              ones; so could an end that is another kind's, but on a calm line: before any damage,
              and `CALM_STREAK` frames behind it. Even the last is taken, if it holds no second
              header or tail: on a calm line at once; else when the bytes behind it show that it is
              not the beginning of an overlong one.
    disputed  Anything else. Bytes are gathered to the first of: a frame that fits and leaves no
              doubt by itself, before which all is decided then; two frames that fit, in step;
              three that fit, in step or not; three times ten framed bytes in step (each of these
              with the four bytes behind, which an overlong frame could end with); `AHEAD` bytes
              behind ten framed ones; `WIDEST` bytes; silence. Then all readings of them are
              weighed. If the last two frames are certain, all but the last is settled and the
              stream is in step; else only what has `AHEAD` bytes behind it. No frame waits for
              more. Where that does not end with a certain frame, the weights are handed on.
    lost      Long noise. Bytes are passed over up to `LEAD` bytes before the next anchor.

Silence of 20 ms settles whatever is pending, but for the beginning of a frame that can still be
completed: a reading process that was held up shows silence where there was none, and must not tear
a frame. Such a beginning is given up after 500 ms. Shorter pauses, from 3.5 byte times, are
evidence for a boundary where readings compete.
"""

from __future__ import annotations

from typing import Final, final

from mypy_extensions import i64

from fte_sniff.protocol.framer.candidates import CandidateSet, PrefixScore
from fte_sniff.protocol.framer.decoder import calmly, chosen, read_by_itself, undisputed
from fte_sniff.protocol.framer.likelihood import BOUNDARY, CLOSED, OPEN
from fte_sniff.protocol.framer.posterior import (
    BoundaryState,
    ForwardBackward,
    joined,
    lost,
    settled,
    trusted,
)
from fte_sniff.protocol.framer.predicates import (
    ANCHOR_REACH,
    BEHIND,
    anchor_from,
    doubtless_frame,
    framed,
    framed_from,
    is_calm,
    is_firm,
    run_end,
    strict,
    strict_from,
)
from fte_sniff.protocol.framer.segments import DecidedSpan, LineHealth, PendingBytes, Segment
from fte_sniff.protocol.framer.tables import LENGTH, NOISE, TRUNCATED
from fte_sniff.protocol.framer.timestamps import SETTLING_NS, ArrivalTimeline, IdleTimes
from fte_sniff.protocol.rows import Chunk, Row
from fte_sniff.protocol.spec import DEFAULT_BAUD, byte_time_ns

WIDEST: Final[i64] = 44
"""Bytes that are weighed at once, at most, while bytes keep coming."""

AHEAD: Final[i64] = 2 * LENGTH
"""Bytes behind ten framed ones with which it is decided at the latest what these are; and bytes
that stay undecided when `WIDEST` is reached."""

PROMISED: Final[i64] = LENGTH + AHEAD
"""Bytes from the beginning of ten framed ones to where that falls due."""

LEAD: Final[i64] = 32
"""Bytes before an anchor that are weighed, after long noise."""

_ENOUGH: Final[i64] = 3
"""Frames that fit, in step or not, that make it worth while to weigh."""

_NEVER: Final[i64] = -1


def next_due(data: bytes, start: i64, not_before: i64, weighed_to: i64) -> tuple[i64, i64]:
    """The place up to which `data` is to be weighed next, from `start`; -1 if not there yet.

    Before it stands the place up to which the bytes must be known for that. Nothing new is learnt
    before `not_before`, except that promises behind `weighed_to` fall due.
    """
    limit = min(i64(len(data)), start + WIDEST)
    known = limit - BEHIND
    if known < start + 2 * LENGTH:
        return _NEVER, _NEVER
    end = _earliest(
        _pair_end(data, max(start, not_before - 2 * LENGTH), known),
        _three_end(data, start, known),
        _third_end(data, start, known),
        not_before,
    )
    due, to = (end + BEHIND, end) if end >= 0 else (_NEVER, _NEVER)
    if limit == start + WIDEST and (due < 0 or limit < due):
        due = to = limit
    promised = next_promised(data, start, weighed_to, limit)
    if promised >= 0 and (due < 0 or promised < due or (promised == due and promised < to)):
        due = to = promised
    return due, to


def _earliest(pair: i64, three: i64, third: i64, not_before: i64) -> i64:
    """The earliest of these places that is not before that one; -1 if none is."""
    end = pair if pair >= not_before else _NEVER
    if three >= not_before and (end < 0 or three < end):
        end = three
    if third >= not_before and (end < 0 or third < end):
        end = third
    return end


def _pair_end(data: bytes, start: i64, known: i64) -> i64:
    """Where the first two strict frames in step end."""
    at = strict_from(data, start, known - LENGTH)
    while at >= 0 and not strict(data, at + LENGTH):
        at = strict_from(data, at + 1, known - LENGTH)
    return _NEVER if at < 0 else at + 2 * LENGTH


def _three_end(data: bytes, start: i64, known: i64) -> i64:
    """Where three times ten framed bytes in step end, that begin at the start."""
    end = start + 3 * LENGTH
    if end > known or not framed(data, start):
        return _NEVER
    return end if framed(data, start + LENGTH) and framed(data, start + 2 * LENGTH) else _NEVER


def _third_end(data: bytes, start: i64, known: i64) -> i64:
    """Where the third strict frame ends, in step or not."""
    end = start
    for _ in range(_ENOUGH):
        at = strict_from(data, end, known)
        if at < 0:
            return _NEVER
        end = at + LENGTH
    return end


def next_promised(data: bytes, start: i64, weighed_to: i64, limit: i64) -> i64:
    """The place by which the next ten framed bytes must be decided; -1 if behind `limit`."""
    at = framed_from(data, max(start, weighed_to + 1 - PROMISED), limit - AHEAD)
    return _NEVER if at < 0 else at + PROMISED


def settled_part(reading: list[Segment], data: bytes, start: i64, end: i64) -> list[Segment]:
    """What of a reading of `data` from `start` to `end`, where bytes may follow, is decided."""
    size = end - start
    if size >= WIDEST or (size >= PROMISED and framed(data, end - PROMISED)):
        return _up_to(reading, size - AHEAD)
    number: i64 = len(reading)
    while number > 0:
        part = reading[number - 1]
        if part.framed and part.stop <= size - AHEAD:
            break
        number -= 1
    return reading[:number]


def _up_to(reading: list[Segment], limit: i64) -> list[Segment]:
    """The parts up to `limit`: noise is cut there, an overlong frame is taken as a whole."""
    settled = [part for part in reading if part.stop <= limit]
    following = reading[len(settled)]
    if following.faults == NOISE and following.start < limit:
        settled.append(Segment(following.start, limit, False, NOISE, 0.0))
    elif following.start <= limit - LENGTH:
        settled.append(following)
    return settled


def lead(data: bytes, start: i64, known: i64) -> i64:
    """Where weighing begins after long noise, for an anchor at `known`, but not before `start`.

    What is due already has been decided: it is noise.
    """
    begin = max(start, known - LEAD)
    while True:
        late = framed_from(data, begin, max(begin, known - 1))
        if late < 0:
            return begin
        begin = late + 1


GIVING_UP_NS: Final = 500_000_000
"""Silence after which the beginning of a frame is held no longer."""

_IN_STEP: Final = trusted()
_NOWHERE: Final[i64] = -1


@final
class Framer:
    """Turns the chunks of one port into rows that tile its stream exactly."""

    def __init__(self, port: str, baud: int = DEFAULT_BAUD) -> None:
        """A framer for the port of that name, whose line has `baud` bits per second."""
        self._timeline = ArrivalTimeline(byte_time_ns(baud))
        self._line = LineHealth()
        self._kept = PendingBytes(port, self._timeline.marks)
        self._data = b""
        self._base: i64 = 0
        """Offset in the stream of the first byte of `_data`."""
        self._at: i64 = 0
        """Place in `_data` up to which all is decided."""
        self._carry: BoundaryState | None = joined()
        """What the past says of the places from `_at` on; None where the stream is in step."""
        self._lost_from = _NOWHERE
        """Offset in the stream where long noise goes on; `_NOWHERE` where none was found to."""
        self._passing = False
        """Whether the long noise is already being passed over."""
        self._not_before: i64 = 0
        """Place in `_data` before which weighing again would tell nothing new."""
        self._weighed_to: i64 = 0
        """Place in `_data` up to which readings have been weighed."""
        self._firm_from: i64 = 0
        """Place in `_data` before which frames that fit are in doubt after all."""
        self._pauses = IdleTimes(baud)
        self._settled = False

    def pace(self, baud: int) -> None:
        """The line has `baud` bits per second from the next chunk on."""
        self._timeline.pace(byte_time_ns(baud))
        self._pauses.pace(baud)

    def feed(self, chunk: Chunk) -> list[Row]:
        """The rows that this chunk completes; never raises on wire data."""
        self.pour(chunk)
        return self._rows()

    def flush(self) -> list[Row]:
        """The rows of whatever is still held; the stream ends here."""
        self.end()
        return self._rows()

    def _rows(self) -> list[Row]:
        """The rows since the last time."""
        if self._line.tiles.end == self._kept.start:
            return []
        return self.take().rows()

    def take(self) -> DecidedSpan:
        """All that was decided since the last time, for who wants more at once than rows."""
        return self._kept.take(self._line.take())

    def cut(self) -> list[Row]:
        """As `flush`, but the stream goes on: what comes next joins nothing that came before.

        Offsets go on rising, and times do not fall.
        """
        rows = self.flush()
        self._carry = joined()
        self._line.join(self._base)
        return rows

    def set_back(self) -> None:
        """The clock was set: times from the next chunk on may be before those by now.

        It is for logs, whose times are as they were written; the bytes go on as they did.
        """
        self._timeline.set_back()

    @property
    def waits_since_ns(self) -> int | None:
        """When the first byte that stands in no row yet began; None where there is none."""
        offset = self._line.tiles.noise_from
        if offset < 0:
            offset = self._base + self._at
            if self._at == len(self._data):
                return None
        return self._timeline.marks.mark(offset).time_and_delay(offset)[0]

    def pour(self, chunk: Chunk) -> None:
        """Decide what this chunk decides."""
        if chunk.data:
            silence = self._timeline.add(chunk)
            if silence >= self._pauses.least_ns:
                self._be_silent(silence)
                self._pauses.add(self._base + len(self._data))
            self._data += chunk.data
            self._settled = False
            self._advance()
        else:
            self._be_silent(self._timeline.silence_at(chunk.t_ns))
        if self._at:
            self._drop_decided()

    def end(self) -> None:
        """Decide whatever is still held."""
        self._settle(hold=False)
        self._drop_decided()

    # The three states

    def _advance(self) -> None:
        """Decide all that the bytes so far decide."""
        while True:
            if self._lost_from >= 0:
                moved = self._pass_noise()
            elif self._carry is None:
                moved = self._follow_run()
            else:
                moved = self._weigh_if_due()
            if not moved:
                return

    def _follow_run(self) -> bool:
        """In step: take the frames that leave no doubt; False where more bytes are needed."""
        data, at, end = self._data, self._at, i64(len(self._data))
        if end - at < LENGTH:
            return False
        run = run_end(data, at, end, calm=self._line.calm())
        sure = run - LENGTH
        calm = self._line.calm((sure - at) // LENGTH)
        if run > at and (is_calm(data, sure) if calm else is_firm(data, sure, end)):
            sure = run
        if sure > at:
            self._line.run(self._base + at, self._base + sure)
            self._at = sure
        waiting = 2 * LENGTH if sure < run else LENGTH
        if end - self._at < waiting:
            return False
        self._carry = _IN_STEP
        self._not_before = 0
        return True

    def _weigh_if_due(self) -> bool:
        """Disputed: decide what is beyond doubt before a frame, or weigh the readings once enough
        bytes are there; False before that."""
        data, at = self._data, self._at
        if len(data) - at < LENGTH + BEHIND:
            return False
        firm = _NOWHERE
        if not self._pauses.behind(self._base + at):
            if self._carry is _IN_STEP:
                damage = undisputed(data, at)
                if damage is not None:
                    self._decide([damage])
                    self._carry = None
                    return True
            firm = doubtless_frame(data, max(at, self._firm_from), at + WIDEST)
        due, end = _NOWHERE, _NOWHERE
        if firm < 0 or firm - at >= LENGTH:
            due, end = next_due(data, at, self._not_before, self._weighed_to)
        if firm >= 0 and (due < 0 or firm + LENGTH + BEHIND <= due):
            if not self._read_before(firm):
                self._firm_from = firm + LENGTH
            return True
        if due < 0:
            return False
        self._weigh_to(end)
        return True

    def _weigh_to(self, end: i64) -> None:
        """Weigh the readings of all bytes up to there, and decide what leaves no doubt."""
        weighing = self._weigh(end, OPEN)
        reading = self._read(weighing)
        self._weighed_to = end
        if len(reading) > 1 and reading[-1].certain and reading[-2].certain:
            self._decide(reading[:-1])
            self._carry = None
            return
        parts = settled_part(reading, self._data, self._at, end)
        if not parts:
            self._not_before = min(end + LENGTH, self._at + WIDEST)
            return
        last = parts[-1]
        noise = last.faults == NOISE
        noisy = noise and end - self._at >= WIDEST
        self._carry = _IN_STEP if last.certain else weighing.carry(last.stop, ends_frame=not noise)
        self._decide(parts)
        self._not_before = 0
        if noisy:
            self._lost_from, self._passing = self._base + self._at, False

    def _read_before(self, firm: i64) -> bool:
        """Decide all before a frame beyond doubt; False where that is in doubt after all."""
        parts: list[Segment] | None = None
        if self._carry is _IN_STEP:
            parts = read_by_itself(self._data, self._at, firm, calm=self._line.calm())
        if parts is None:
            parts = self._read(self._weigh(firm + LENGTH, BOUNDARY))
            if not parts.pop().certain:
                return False
        self._decide(parts)
        self._carry = None
        self._not_before = 0
        return True

    def _weigh(self, end: i64, ending: i64) -> ForwardBackward:
        pauses = self._pauses.within(self._base + self._at, self._base + end)
        window = CandidateSet(self._data[self._at : end], pauses)
        return ForwardBackward(window, self._carry or _IN_STEP, ending)

    def _read(self, weighing: ForwardBackward) -> list[Segment]:
        reading = chosen(weighing)
        return calmly(weighing, reading) if self._line.calm() else reading

    def _pass_noise(self) -> bool:
        """Lost: pass over the noise to the next anchor; False where none has come yet."""
        data = self._data
        anchor = anchor_from(data, self._at)
        known = anchor if anchor >= 0 else len(data) - ANCHOR_REACH
        enough = self._lost_from - self._base + WIDEST
        if not self._passing:
            limit = min(i64(len(data)), enough + ANCHOR_REACH)
            promised = next_promised(data, self._at, self._weighed_to, limit)
            if promised >= 0 and (anchor < 0 or promised <= anchor + 2 * LENGTH):
                self._lost_from = _NOWHERE
                return True
        if self._passing or known >= enough:
            self._passing = True
            self._carry = lost()
            self._take_noise(lead(data, self._at, known))
        if anchor >= 0:
            self._lost_from = _NOWHERE
            self._not_before = 0
        return anchor >= 0

    # Silence

    def _be_silent(self, silence_ns: int) -> None:
        if silence_ns >= SETTLING_NS and not self._settled:
            self._settle(hold=True)
            self._settled = True
        if silence_ns >= GIVING_UP_NS:
            self._settle(hold=False)

    def _settle(self, *, hold: bool) -> None:
        """Decide everything up to here; `hold` the beginning of a frame that may go on."""
        if self._at < len(self._data):
            reading = self._read(self._weigh(len(self._data), CLOSED))
            last = reading[-1]
            held = hold and not last.framed and self._can_go_on(last)
            self._decide(reading[:-1] if held else reading)
            in_step = held or last.certain
            self._carry = None if in_step else settled()
            self._lost_from = _NOWHERE
            self._not_before = 0
        self._line.tiles.end_noise()

    def _can_go_on(self, last: Segment) -> bool:
        """Whether the pending bytes end with the beginning of a frame."""
        if last.faults & TRUNCATED == 0:
            return False
        start = self._at + last.start
        front = PrefixScore(self._data, start, min(i64(len(self._data)), start + LENGTH))
        return front.fit >= last.stop - last.start

    # Decided bytes become rows

    def _decide(self, reading: list[Segment]) -> None:
        if reading:
            self._line.parts(self._base + self._at, reading)
            self._at += reading[-1].stop
        self._firm_from = 0

    def _take_noise(self, stop: i64) -> None:
        """Take the bytes up to `stop` as noise, which may go on."""
        if stop > self._at:
            self._line.tiles.noise(self._base + self._at, self._base + stop)
            self._at = stop

    def _drop_decided(self) -> None:
        """Forget the bytes that are decided."""
        done = self._at
        self._kept.add(self._data, done)
        self._data = self._data[done:]
        self._base += done
        self._at = 0
        self._not_before = max(i64(0), self._not_before - done)
        self._weighed_to = max(i64(0), self._weighed_to - done)
        self._firm_from = max(i64(0), self._firm_from - done)
        self._pauses.forget(self._base)
