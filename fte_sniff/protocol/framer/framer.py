"""Owns the way from one port's bytes to its rows: where frames begin and end, and what is damaged.

It must not do I/O or read a clock; the times come with the chunks. How likely things are stands in
`likelihood`, how readings are weighed in `weighing`, when in `due`, how bytes get their times in
`timeline`, what becomes of decided ones in `decided`.

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

from collections.abc import Callable, Sequence
from typing import TypeAlias

from fte_sniff.protocol.framer.choice import calmly, chosen
from fte_sniff.protocol.framer.decided import Decided
from fte_sniff.protocol.framer.due import (
    WIDEST,
    lead,
    next_due,
    next_promised,
    settled_part,
)
from fte_sniff.protocol.framer.enclosed import firm_frame, read_by_itself
from fte_sniff.protocol.framer.ends import CANONICAL, front_of
from fte_sniff.protocol.framer.keeping import Keeper
from fte_sniff.protocol.framer.patterns import (
    ANCHOR_REACH,
    ANCHOR_TAIL,
    CALM,
    FIRM,
    LONG_RUN,
    PLAIN_RUN,
    UNDIVIDED_RUN,
)
from fte_sniff.protocol.framer.pieces import Window
from fte_sniff.protocol.framer.reading import Stretch
from fte_sniff.protocol.framer.tiling import NOISE, Tiler, Tiles
from fte_sniff.protocol.framer.timeline import SETTLING_NS, Pauses, Timeline
from fte_sniff.protocol.framer.undisputed import undisputed
from fte_sniff.protocol.framer.weighing import (
    Carry,
    Ending,
    Weighing,
    joined,
    lost,
    trusted,
)
from fte_sniff.protocol.rows import Chunk, Fault, Row
from fte_sniff.protocol.structure import LONGEST_OVERLONG
from fte_sniff.protocol.table import DEFAULT_BAUD, FRAME_LENGTH, byte_time_ns

GIVING_UP_NS = 500_000_000
"""Silence after which the beginning of a frame is held no longer."""

_IN_STEP = trusted()

Skip: TypeAlias = Callable[[int], int]
"""Counts frames in step, from a place in some bytes on, that are as `PLAIN_RUN` has them; it may
stop early. Places rise."""

Scout: TypeAlias = Callable[[bytes], Skip | None]
"""Looks through bytes at once for what is a quicker way through them; None where there is none."""


class Framer:
    """Turns the chunks of one port into rows that tile its stream exactly."""

    def __init__(self, port: str, baud: int = DEFAULT_BAUD) -> None:
        """A framer for the port of that name, whose line has `baud` bits per second."""
        self._timeline = Timeline(byte_time_ns(baud))
        self._tiler = Tiler(port, self._timeline.marks)
        self._tiles: Tiles = self._tiler
        self._decided = Decided(self._tiler)
        self._scout: Scout | None = None
        self._skip: Skip | None = None
        """Through `_data`."""
        self._data = b""
        self._base = 0
        """Offset in the stream of the first byte of `_data`."""
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
        self._weighed_to = 0
        """Place in `_data` up to which readings have been weighed."""
        self._firm_from = 0
        """Place in `_data` before which frames that fit are in doubt after all."""
        self._pauses = Pauses(baud)
        self._settled = False

    @classmethod
    def keeping(cls, port: str, scout: Scout) -> tuple[Framer, Keeper]:
        """A framer for much at once, for `pour` and `end`, and what keeps all that it decides.

        Args:
            port: as for any framer.
            scout: looks through the bytes of each chunk before the framer does.
        """
        framer = cls(port)
        framer._scout = scout
        keeper = Keeper(port, framer._timeline.marks)
        framer._tiles, framer._decided = keeper, Decided(keeper)
        return framer, keeper

    def pace(self, baud: int) -> None:
        """The line has `baud` bits per second from the next chunk on."""
        self._timeline.pace(byte_time_ns(baud))
        self._pauses.pace(baud)

    def feed(self, chunk: Chunk) -> list[Row]:
        """The rows that this chunk completes; never raises on wire data."""
        self.pour(chunk)
        return self._tiler.take()

    def flush(self) -> list[Row]:
        """The rows of whatever is still held; the stream ends here."""
        self.end()
        return self._tiler.take()

    def cut(self) -> list[Row]:
        """As `flush`, but the stream goes on: what comes next joins nothing that came before.

        Offsets go on rising, and times do not fall.
        """
        rows = self.flush()
        self._carry = joined()
        self._decided.join(self._base)
        return rows

    def set_back(self) -> None:
        """The clock was set: times from the next chunk on may be before those by now.

        It is for logs, whose times are as they were written; the bytes go on as they did.
        """
        self._timeline.set_back()

    @property
    def waits_since_ns(self) -> int | None:
        """When the first byte that stands in no row yet began; None where there is none."""
        offset = self._tiles.noise_offset
        if offset is None:
            offset = self._base + self._at
            if self._at == len(self._data):
                return None
        return self._timeline.marks.mark(offset).time_and_delay(offset)[0]

    def pour(self, chunk: Chunk) -> None:
        """Decide what this chunk decides."""
        if not chunk.data:
            self._be_silent(self._timeline.silence_at(chunk.t_ns))
            return
        silence = self._timeline.add(chunk)
        if silence >= self._pauses.least_ns:
            self._be_silent(silence)
            self._pauses.add(self._base + len(self._data))
        self._data += chunk.data
        self._settled = False
        self._skip = self._scout and self._scout(self._data)
        self._advance()
        self._skip = None
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
        calm = CALM if self._decided.calm(sure) else FIRM
        if count and calm.match(self._data, last):
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
        in_step = UNDIVIDED_RUN if self._decided.calm() else PLAIN_RUN
        while True:
            if self._skip is not None:
                end += self._skip(end) * FRAME_LENGTH
            match = in_step.match(self._data, end)
            run = 0 if match is None else match.end() - end
            end += run
            if run < LONG_RUN:
                return (end - self._at) // FRAME_LENGTH

    def _take_run(self, count: int) -> None:
        stop = self._at + count * FRAME_LENGTH
        self._decided.run(self._base + self._at, self._data, self._at, stop)
        self._at = stop

    def _weigh_if_due(self) -> bool:
        """Disputed: decide what is beyond doubt before a frame, or weigh the readings once enough
        bytes are there; False before that."""
        data, at = self._data, self._at
        if len(data) - at < LONGEST_OVERLONG:
            return False
        firm = None
        if not self._pauses.behind(self._base + at):
            plain = undisputed(data, at) if self._carry is _IN_STEP else None
            if plain is not None:
                self._decide([plain])
                self._carry = None
                return True
            firm = firm_frame(data, max(at, self._firm_from), at + WIDEST)
        due = None
        if firm is None or firm - at >= FRAME_LENGTH:
            due = next_due(data, at, self._not_before, self._weighed_to)
        if firm is not None and (due is None or firm + LONGEST_OVERLONG <= due[0]):
            if not self._read_before(firm):
                self._firm_from = firm + FRAME_LENGTH
            return True
        if due is None:
            return False
        self._weigh_to(due[1])
        return True

    def _weigh_to(self, end: int) -> None:
        """Weigh the readings of all bytes up to there, and decide what leaves no doubt."""
        weighing = self._weigh(end, Ending.OPEN)
        reading = self._read(weighing)
        self._weighed_to = end
        if len(reading) > 1 and reading[-1].certain and reading[-2].certain:
            self._decide(reading[:-1])
            self._carry = None
            return
        settled = settled_part(reading, self._data, self._at, end)
        if not settled:
            self._not_before = min(end + FRAME_LENGTH, self._at + WIDEST)
            return
        last = settled[-1]
        noise = last.faults == NOISE
        noisy = noise and end - self._at >= WIDEST
        self._carry = _IN_STEP if last.certain else weighing.carry(last.stop, ends_frame=not noise)
        self._decide(settled)
        self._not_before = 0
        if noisy:
            self._lost_from, self._passing = self._at, False

    def _read_before(self, firm: int) -> bool:
        """Decide all before a frame beyond doubt; False where that is in doubt after all."""
        parts: Sequence[Stretch] | None = None
        if self._carry is _IN_STEP:
            calm = self._decided.calm()
            parts = read_by_itself(self._data, self._at, firm, calm=calm)
        if parts is None:
            reading = self._read(self._weigh(firm + FRAME_LENGTH, Ending.BOUNDARY))
            if not reading[-1].certain:
                return False
            parts = reading[:-1]
        self._decide(parts)
        self._carry = None
        self._not_before = 0
        return True

    def _weigh(self, end: int, ending: Ending) -> Weighing:
        pauses = self._pauses.within(self._base + self._at, self._base + end)
        window = Window(self._data[self._at : end], pauses)
        return Weighing(window, self._carry or _IN_STEP, ending)

    def _read(self, weighing: Weighing) -> list[Stretch]:
        reading = chosen(weighing)
        return calmly(weighing, reading) if self._decided.calm() else reading

    def _pass_noise(self) -> bool:
        """Lost: pass over the noise to the next anchor; False where none has come yet."""
        assert self._lost_from is not None
        data = self._data
        anchor = ANCHOR_TAIL.search(data, self._at + FRAME_LENGTH - 1)
        known = anchor.end() - FRAME_LENGTH if anchor else len(data) - ANCHOR_REACH
        enough = self._lost_from + WIDEST
        if not self._passing:
            limit = min(len(data), enough + ANCHOR_REACH)
            promised = next_promised(data, self._at, self._weighed_to, limit)
            if promised is not None and (anchor is None or promised <= anchor.end() + FRAME_LENGTH):
                self._lost_from = None
                return True
        if self._passing or known >= enough:
            self._passing = True
            self._carry = lost()
            self._take_noise(lead(data, self._at, known))
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
            reading = self._read(self._weigh(len(self._data), Ending.CLOSED))
            last = reading[-1]
            held = hold and not last.framed and self._can_go_on(last)
            self._decide(reading[:-1] if held else reading)
            in_step = held or last.certain
            self._carry = None if in_step else Carry([1.0], [], 0.05)
            self._lost_from = None
            self._not_before = 0
        self._tiles.end_noise()

    def _can_go_on(self, last: Stretch) -> bool:
        """Whether the pending bytes end with the beginning of a frame."""
        if Fault.TRUNCATED not in last.faults:
            return False
        begin = self._data[self._at + last.start : self._at + last.start + FRAME_LENGTH]
        return front_of(begin.translate(CANONICAL)).length >= last.stop - last.start

    # Decided bytes become rows

    def _decide(self, reading: Sequence[Stretch]) -> None:
        if reading:
            stop = self._at + reading[-1].stop
            self._decided.parts(self._base + self._at, self._data[self._at : stop], reading)
            self._at = stop
        self._firm_from = 0

    def _take_noise(self, stop: int) -> None:
        """Take the bytes up to `stop` as noise, which may go on."""
        if stop > self._at:
            self._tiles.noise(self._base + self._at, self._data[self._at : stop])
            self._at = stop

    def _drop_decided(self) -> None:
        """Forget the bytes that are decided."""
        done = self._at
        self._data = self._data[done:]
        self._base += done
        self._at = 0
        if self._not_before:
            self._not_before = max(0, self._not_before - done)
        if self._weighed_to:
            self._weighed_to = max(0, self._weighed_to - done)
        if self._firm_from:
            self._firm_from = max(0, self._firm_from - done)
        if self._lost_from is not None:
            self._lost_from -= done
        self._pauses.forget(self._base)
