"""Owns the way from one port's bytes to its rows: where frames begin and end, and what is damaged.

It must not do I/O or read a clock; the times come with the chunks. How likely things are stands in
`likelihood`, how readings are weighed in `weighing`, how bytes get their times in `timeline`.

The stream is decided from left to right, each decision final. Every decision depends on the bytes
up to a place that those bytes themselves determine, and on silence; never on how the stream was
cut into chunks. There are three states:

    in step   A frame ended here beyond doubt. Frames that fit their kind at every place are taken
              as long as each is followed by another one in step, unless a header in their
              payload, behind a tail or before a CMD and a motor, could make them two truncated
              ones. On a calm line, that is before any damage and `CALM_STREAK` frames behind it,
              even the last is taken, at once, if it holds no second header or tail.
    disputed  Anything else. Bytes are gathered to the first of: two frames that fit, in step;
              three that fit, in step or not; three times ten framed bytes in step; `WIDEST` bytes;
              silence. Then all readings of them are weighed. If the last two frames are certain,
              all but the last is settled and the stream is in step; else only what has two
              further frames behind it, or lies more than `KEPT` bytes back. The weights are
              handed on.
    lost      Long noise. Bytes are passed over up to `LEAD` bytes before the next anchor.

Silence of 20 ms settles whatever is pending, but for the beginning of a frame that can still be
completed: a reading process that was held up shows silence where there was none, and must not tear
a frame. Such a beginning is given up after 500 ms. Shorter pauses, from 3.5 byte times, are
evidence for a boundary where readings compete.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

from fte_sniff.protocol.patterns import (
    ANCHOR_REACH,
    ANCHOR_TAIL,
    CALM,
    FRAMED_THREE,
    LONG_RUN,
    PLAIN_RUN,
    STRICT,
    STRICT_PAIR,
)
from fte_sniff.protocol.pieces import Window
from fte_sniff.protocol.reading import Stretch
from fte_sniff.protocol.rows import Chunk, Fault, Row
from fte_sniff.protocol.table import DEFAULT_BAUD, FRAME_LENGTH, byte_time_ns
from fte_sniff.protocol.tiling import NOISE, Run, Tiler, rows_of
from fte_sniff.protocol.timeline import Timeline
from fte_sniff.protocol.undisputed import undisputed
from fte_sniff.protocol.weighing import (
    Carry,
    Ending,
    Weighing,
    joined,
    lost,
    trusted,
)

CALM_STREAK = 100
"""Frames without damage after which a calm frame needs no further one to be believed."""

WIDEST = 64
"""Bytes that are weighed at once, at most, while bytes keep coming."""

KEPT = 24
"""Bytes that stay undecided when `WIDEST` is reached."""

LEAD = 32
"""Bytes before an anchor that are weighed, after long noise."""

PAUSE_BYTES = 3.5
"""Byte times of silence that count as a pause."""

SETTLING_NS = 20_000_000
"""Silence that settles what is pending."""

GIVING_UP_NS = 500_000_000
"""Silence after which the beginning of a frame is held no longer."""

_IN_STEP = trusted()

Skip: TypeAlias = Callable[[bytes, int], int]
"""Counts frames in step from a place on that are as `PLAIN_RUN` has them; it may stop early."""


class Framer:
    """Turns the chunks of one port into rows that tile its stream exactly."""

    def __init__(self, port: str, baud: int = DEFAULT_BAUD, *, skip: Skip | None = None) -> None:
        """A framer for one port.

        Args:
            port: the port's name, which every row carries.
            baud: bits per second on the line, for the times of bytes.
            skip: a quicker way to count frames in step, for bulk work; the rows are the same.
        """
        self._skip = skip
        self._timeline = Timeline(byte_time_ns(baud))
        self._tiler = Tiler(port, self._timeline)
        self._pause_ns = _pause_ns(baud)
        self._data = b""
        self._base = 0
        """Offset in the stream of the first byte of `_data`."""
        self._begin = 0
        """Offset of the first byte that joins what follows: the stream's, or that behind a cut."""
        self._at = 0
        """Place in `_data` up to which all is decided."""
        self._carry: Carry | None = joined()
        """What the past says of the places from `_at` on; None where the stream is in step."""
        self._lost_from: int | None = None
        """Place in `_data` where long noise was found to go on; None where it does not."""
        self._passing = False
        """Whether the long noise is already being passed over."""
        self._not_before = 0
        """Place in `_data` before which weighing again would tell nothing new."""
        self._streak = CALM_STREAK
        """Frames since the last damage; a line that has shown none yet is calm."""
        self._pauses: list[int] = []
        """Offsets of bytes before which the line paused."""
        self._settled = False

    def pace(self, baud: int) -> None:
        """The line has `baud` bits per second from the next chunk on."""
        self._timeline.pace(byte_time_ns(baud))
        self._pause_ns = _pause_ns(baud)

    def feed(self, chunk: Chunk) -> list[Row]:
        """The rows that this chunk completes; never raises on wire data."""
        return rows_of(self.feed_spans(chunk))

    def flush(self) -> list[Row]:
        """The rows of whatever is still held; the stream ends here."""
        return rows_of(self.flush_spans())

    def cut(self) -> list[Row]:
        """As `flush`, but the stream goes on: what comes next joins nothing that came before.

        Offsets go on rising, and times do not fall.
        """
        rows = self.flush()
        self._carry, self._streak = joined(), CALM_STREAK
        self._begin = self._base
        return rows

    @property
    def waits_since_ns(self) -> int | None:
        """When the first byte that stands in no row yet began; None where there is none."""
        offset = self._tiler.noise_offset
        if offset is None:
            offset = self._base + self._at
            if self._at == len(self._data):
                return None
        return self._timeline.mark(offset).time_of(offset)

    def feed_spans(self, chunk: Chunk) -> list[Row | Run]:
        """As `feed`, but frames in step come as runs: for whoever wants many rows at once."""
        if not chunk.data:
            self._be_silent(self._timeline.silence_at(chunk.t_ns))
            return self._tiler.take()
        silence = self._timeline.add(chunk)
        if silence >= self._pause_ns:
            self._be_silent(silence)
            self._pauses.append(self._base + len(self._data))
        self._data += chunk.data
        self._settled = False
        self._advance()
        self._drop_decided()
        return self._tiler.take()

    def flush_spans(self) -> list[Row | Run]:
        """As `flush`, with frames in step as runs."""
        self._settle(hold=False)
        self._drop_decided()
        return self._tiler.take()

    # The three states

    def _advance(self) -> None:
        """Decide all that the bytes so far decide."""
        while True:
            if self._lost_from is not None:
                moved = self._pass_noise()
            elif self._carry is None:
                moved = self._follow_run()
            else:
                moved = self._weigh_if_due()
            if not moved:
                return

    def _follow_run(self) -> bool:
        """In step: take the frames that leave no doubt; False where more bytes are needed."""
        if len(self._data) - self._at < FRAME_LENGTH:
            return False
        count = self._frames_in_step()
        sure = count - 1
        last = self._at + sure * FRAME_LENGTH
        if count and self._streak + sure >= CALM_STREAK and CALM.match(self._data, last):
            sure = count
        if sure > 0:
            self._take_run(sure)
        waiting = 2 if sure < count else 1
        if len(self._data) - self._at < waiting * FRAME_LENGTH:
            return False
        self._carry = _IN_STEP
        self._not_before = 0
        return True

    def _frames_in_step(self) -> int:
        """How many frames that fit follow each other from here."""
        end = self._at
        while True:
            match = PLAIN_RUN.match(self._data, end)
            short = match is None or match.end() - end < LONG_RUN
            end = end if match is None else match.end()
            if short:
                return (end - self._at) // FRAME_LENGTH
            if self._skip is not None:
                end += self._skip(self._data, end) * FRAME_LENGTH

    def _take_run(self, count: int) -> None:
        stop = self._at + count * FRAME_LENGTH
        self._tiler.run(self._base + self._at, self._data[self._at : stop])
        self._at = stop
        self._streak += count

    def _weigh_if_due(self) -> bool:
        """Disputed: weigh the readings once enough bytes are there; False before that."""
        end = self._due()
        if end is None:
            return False
        plain = self._undisputed(end)
        if plain is not None:
            self._decide(plain)
            self._carry = None
            return True
        weighing = self._weigh(end, Ending.OPEN)
        reading = weighing.reading()
        if len(reading) > 1 and reading[-1].certain and reading[-2].certain:
            self._decide(reading[:-1])
            self._carry = None
            return True
        size = end - self._at
        settled = _settled_part(reading, size)
        if not settled:
            self._not_before = min(end + FRAME_LENGTH, self._at + WIDEST)
            return True
        self._carry = weighing.carry(settled[-1])
        noisy = size >= WIDEST and Fault.NOISE in settled[-1].faults
        self._decide(settled)
        self._not_before = 0
        if noisy:
            self._lost_from, self._passing = self._at, False
        return True

    def _undisputed(self, end: int) -> list[Stretch] | None:
        """The reading up to `end` where there is one only, and a frame ended here beyond doubt."""
        if self._carry is not _IN_STEP or any(p > self._base + self._at for p in self._pauses):
            return None
        return undisputed(self._data[self._at : end])

    def _due(self) -> int | None:
        """The place up to which the readings are to be weighed next; None if not there yet."""
        data, start, limit = self._data, self._at, min(len(self._data), self._at + WIDEST)
        ends = []
        pair = STRICT_PAIR.search(data, max(start, self._not_before - 2 * FRAME_LENGTH), limit)
        if pair:
            ends.append(pair.end())
        three = FRAMED_THREE.match(data, start, limit)
        if three:
            ends.append(three.end())
        found, count = STRICT.search(data, start, limit), 1
        while found and count < 3:
            found, count = STRICT.search(data, found.end(), limit), count + 1
        if found:
            ends.append(found.end())
        if limit == start + WIDEST:
            ends.append(limit)
        return min((end for end in ends if end >= self._not_before), default=None)

    def _weigh(self, end: int, ending: Ending) -> Weighing:
        offset = self._base + self._at
        while self._pauses and self._pauses[0] <= offset:
            del self._pauses[0]
        pauses = [place - offset for place in self._pauses if place - offset < end - self._at]
        window = Window(self._data[self._at : end], pauses)
        return Weighing(window, self._carry or _IN_STEP, ending)

    def _pass_noise(self) -> bool:
        """Lost: pass over the noise to the next anchor; False where none has come yet."""
        assert self._lost_from is not None
        anchor = ANCHOR_TAIL.search(self._data, self._at + FRAME_LENGTH - 1)
        known = anchor.end() - FRAME_LENGTH if anchor else len(self._data) - ANCHOR_REACH
        if self._passing or known >= self._lost_from + WIDEST:
            self._passing = True
            self._carry = lost()
            self._take_noise(max(self._at, known - LEAD))
        if anchor:
            self._lost_from = None
            self._not_before = 0
        return anchor is not None

    # Silence

    def _be_silent(self, silence_ns: int) -> None:
        if silence_ns >= SETTLING_NS and not self._settled:
            self._settle(hold=True)
            self._settled = True
        if silence_ns >= GIVING_UP_NS:
            self._settle(hold=False)

    def _settle(self, *, hold: bool) -> None:
        """Decide everything up to here; `hold` the beginning of a frame that may go on."""
        size = len(self._data) - self._at
        if size:
            reading = self._weigh(len(self._data), Ending.CLOSED).reading()
            last = reading[-1]
            held = hold and not last.framed and self._can_go_on(last)
            self._decide(reading[:-1] if held else reading)
            in_step = held or last.certain
            self._carry = None if in_step else Carry([1.0], [], 0.05)
            self._lost_from = None
            self._not_before = 0
        self._tiler.end_noise()

    def _can_go_on(self, last: Stretch) -> bool:
        """Whether the pending bytes end with the beginning of a frame."""
        if Fault.TRUNCATED not in last.faults:
            return False
        begin = Window(self._data[self._at + last.start :])
        return len(begin.head(0)) > last.stop - last.start

    # Decided bytes become rows

    def _decide(self, reading: list[Stretch]) -> None:
        start = self._at
        # A stream may begin within a frame: that is no damage of the line.
        first = self._begin + FRAME_LENGTH - self._base
        for part in reading:
            stop = start + part.stop
            if part.faults == NOISE:
                self._take_noise(stop)
            else:
                take = self._tiler.frame if part.framed else self._tiler.damage
                take(self._base + self._at, self._data[self._at : stop], part.faults)
                self._at = stop
            self._streak = self._streak + 1 if part.certain or stop <= first else 0

    def _take_noise(self, stop: int) -> None:
        """Take the bytes up to `stop` as noise, which may go on."""
        if stop > self._at:
            self._tiler.noise(self._base + self._at, self._data[self._at : stop])
            self._at = stop

    def _drop_decided(self) -> None:
        """Forget the bytes that are decided."""
        done = self._at
        if not done:
            return
        self._data = self._data[done:]
        self._base += done
        self._at = 0
        self._not_before = max(0, self._not_before - done)
        if self._lost_from is not None:
            self._lost_from -= done
        while self._pauses and self._pauses[0] <= self._base:
            del self._pauses[0]


def _pause_ns(baud: int) -> int:
    """Silence that counts as a pause, nanoseconds."""
    return min(SETTLING_NS, round(PAUSE_BYTES * byte_time_ns(baud)))


def _settled_part(reading: list[Stretch], size: int) -> list[Stretch]:
    """What of an unfinished reading can be decided: two frames further back, or `KEPT` bytes."""
    frames = [number for number, part in enumerate(reading) if part.framed]
    if len(frames) > 2:
        return reading[: frames[-3] + 1]
    if size < WIDEST:
        return []
    limit = size - KEPT
    settled = [part for part in reading if part.stop <= limit]
    following = reading[len(settled)]
    if following.faults == NOISE and following.start < limit:
        settled.append(following._replace(stop=limit))
    return settled
