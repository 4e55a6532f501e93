"""Viterbi segmentation of a damaged span; fast paths for clean spans.

- Shown are those frames that together are the most probable, none overlapping another.
- What lies between them is divided into the pieces that weigh most.
- A frame whose probability is below `CERTAIN` is `ambiguous`, unless it stands in step between a
  certain frame and another, and could not also be two truncated ones.
- Where the line has shown no damage for long, two truncated frames that together have ten bytes
  are no other reading.
"""

from __future__ import annotations

from typing import Final, final

from librt.vecs import vec
from mypy_extensions import i64, mypyc_attr

from fte_sniff.protocol.codec import LONGEST_OVERLONG
from fte_sniff.protocol.framer.candidates import CandidateSet, PrefixScore, SuffixScore, between
from fte_sniff.protocol.framer.likelihood import (
    BOUNDARY,
    CERTAIN,
    JUNK,
    LIKELY,
    LONGEST_JUNK,
    SHOWN,
    WIDEST_CHANGE,
    noise_run,
)
from fte_sniff.protocol.framer.posterior import ForwardBackward, trusted
from fte_sniff.protocol.framer.predicates import (
    BEHIND,
    faults_of_framed,
    head_fit,
    is_doubtless,
    kind_named,
    plain,
    rest_fit,
    strict,
    strict_from,
    undivided,
)
from fte_sniff.protocol.framer.segments import Segment
from fte_sniff.protocol.framer.tables import (
    AMBIGUOUS,
    BAD_HEADER,
    BAD_TAIL,
    COUNT,
    ENDING,
    HEADER,
    HEADERS,
    LENGTH,
    MARKS,
    NAMES_CMD,
    NO_KIND,
    NOISE,
    OVERLONG,
    TRUNCATED,
)
from fte_sniff.protocol.spec import FRAME_LENGTH

_NOISE: Final = -1.0
"""Stands for the weight of a piece where the last part is noise."""


@final
@mypyc_attr(acyclic=True, free_list_len=1)
class DamagedSpan:
    """What lies between two shown frames, or behind the last."""

    def __init__(self, window: CandidateSet, start: i64, stop: i64) -> None:
        """From `start` to `stop` in the window."""
        self._window = window
        self._start = start
        self._stop = stop
        size = stop - start + 1
        self._best = vec[float]([0.0] * size)
        """By place from the start on: the weight of the best reading up to it; 0 where none is."""
        self._begins = vec[i64]([i64(0)] * size)
        """Where the last part of that reading begins."""
        self._pieces = vec[float]([0.0] * size)
        """What the piece weighs that this part is; `_NOISE` where it is none."""
        self._best[0] = 1.0
        self._begins[0] = start
        self._extend_all()

    def _extend_all(self) -> None:
        window = self._window
        first_header: i64 = 0
        headers: i64 = len(window.starts)
        for place in range(self._start, self._stop):
            while first_header < headers and window.starts[first_header].place < place:
                first_header += 1
            if self._best[place - self._start] > 0.0:
                self._extend(place, first_header)

    def _extend(self, place: i64, number: i64) -> None:
        """Go on from a place with all that can begin there; `number` is that of the next header."""
        at = place - self._start
        weight, window = self._best[at], self._window
        behind_noise = self._pieces[at] == _NOISE
        headed = MARKS[window.data[place]] == HEADER
        meeting = weight if behind_noise else weight * window.meeting(place)
        if headed:
            self._extend_from_header(window.starts[number], meeting)
            number += 1
        self._extend_to_tails(place, meeting)
        if behind_noise:
            return
        while number < len(window.starts) and window.starts[number].place < self._stop:
            stop = window.starts[number].place
            self._reach(stop, place, weight * noise_run(stop - place), _NOISE)
            number += 1
        self._reach(self._stop, place, weight * noise_run(self._stop - place), _NOISE)

    def _extend_from_header(self, front: PrefixScore, weight: float) -> None:
        window, place = self._window, front.place
        for length in range(i64(1), front.cut_to + 1):
            own = window.truncated(front, length)
            self._reach(place + length, place, weight * own, own)
        own = window.bad_tail(front)
        if own > 0.0:
            self._reach(place + LENGTH, place, weight * own, own)

    def _extend_to_tails(self, place: i64, weight: float) -> None:
        for stop in self._window.stops:
            if stop.first <= place < stop.place:
                own = stop.weights[place - stop.first]
                self._reach(stop.place, place, weight * own, own)

    def _reach(self, stop: i64, begin: i64, weight: float, piece: float) -> None:
        """A reading that reaches `stop` with a part from `begin` on."""
        if stop > self._stop:
            return
        at = stop - self._start
        if weight > self._best[at]:
            self._best[at], self._begins[at], self._pieces[at] = weight, begin, piece

    def end_with_cut_off(self, front: PrefixScore, own: float) -> None:
        """Let the gap end with a frame that begins there and goes on, where that is best."""
        if front.place >= self._start and own > 0.0:
            weight = self._best[front.place - self._start] * own
            self._reach(self._stop, front.place, weight, own)

    def parts(self) -> list[Segment]:
        """The parts from left to right; the probability of each is the weight of its piece."""
        parts: list[Segment] = []
        place = self._stop
        while place > self._start:
            at = place - self._start
            parts.append(_part(self._window.data, self._begins[at], place, self._pieces[at]))
            place = self._begins[at]
        parts.reverse()
        return parts


def _part(data: bytes, start: i64, stop: i64, piece: float) -> Segment:
    """What these bytes are, as the piece or as noise."""
    if piece == _NOISE:
        return Segment(start, stop, False, NOISE, 0.0)
    fault = _named(data, start, stop)
    if fault:
        return Segment(start, stop, False, fault, piece)
    return Segment(start, stop, True, faults_of_framed(data, start), piece)


def _named(data: bytes, start: i64, stop: i64) -> i64:
    """What is wrong with the bytes of a piece; 0 where they are framed."""
    size = stop - start
    headed = MARKS[data[start]] == HEADER
    if size != LENGTH:
        if not headed:
            return NOISE
        return TRUNCATED if size < LENGTH else OVERLONG
    if not headed:
        return BAD_HEADER
    return i64(0) if MARKS[data[stop - 1]] == ENDING else BAD_TAIL


def chosen(weighing: ForwardBackward, following: Segment | None = None) -> list[Segment]:
    """The chosen reading of a window, which begins where the rows so far end.

    `following` is known to stand behind it.
    """
    window = weighing.window
    probable = weighing.whole_frames()
    behind_rows = weighing.whole_frames_behind_rows() if weighing.behind_rows else probable
    reading: list[Segment] = []
    at: i64 = 0
    for number in _shown_frames(weighing, behind_rows):
        place = window.starts[number].place
        if at < place:
            _divide(weighing, DamagedSpan(window, at, place), reading)
        reading.append(_frame(place, probable[number]))
        at = place + LENGTH
    if at < weighing.size:
        gap = DamagedSpan(window, at, weighing.size)
        for start in window.starts:
            if start.place > weighing.size - LENGTH:
                gap.end_with_cut_off(start, weighing.cut_off(start))
        _divide(weighing, gap, reading)
    _believe_neighbours(window.data, reading, following)
    return reading


def _divide(weighing: ForwardBackward, gap: DamagedSpan, reading: list[Segment]) -> None:
    """Add the parts of a gap; ten framed bytes among them are `ambiguous` where unlikely."""
    for part in gap.parts():
        faults = part.faults
        if part.framed and weighing.probability(part.start, part.stop, part.probability) < LIKELY:
            faults |= AMBIGUOUS
        reading.append(Segment(part.start, part.stop, part.framed, faults, 0.0))


def _shown_frames(weighing: ForwardBackward, probable: vec[float]) -> list[i64]:
    """Of which headers the most probable whole frames begin, none overlapping another."""
    starts = weighing.window.starts
    likely = vec[i64]([i64(0)] * len(probable))
    count: i64 = 0
    for number in range(i64(len(probable))):
        if probable[number] > SHOWN:
            likely[count] = number
            count += 1
    best = vec[float]([0.0] * (count + 1))
    """By how many frames are considered: the best sum, and how many were before its last frame."""
    left = vec[i64]([i64(-1)] * (count + 1))
    for number in range(count):
        place, gain = starts[likely[number]].place, probable[likely[number]] - SHOWN
        before = number
        while before > 0 and starts[likely[before - 1]].place + LENGTH > place:
            before -= 1
        best[number + 1] = best[number]
        if best[before] + gain > best[number]:
            best[number + 1], left[number + 1] = best[before] + gain, before
    shown: list[i64] = []
    while count > 0:
        if left[count] < 0:
            count -= 1
            continue
        shown.append(likely[count - 1])
        count = left[count]
    shown.reverse()
    return shown


def _frame(start: i64, probability: float) -> Segment:
    """A whole frame: it fits its kind at every place, so its only fault can be doubt."""
    faults = i64(0) if probability >= CERTAIN else AMBIGUOUS
    return Segment(start, start + LENGTH, True, faults, probability)


def _believe_neighbours(data: bytes, reading: list[Segment], following: Segment | None) -> None:
    """Believe those frames that stand in step between others.

    Where a frame follows a certain one, and another one follows it, it takes two faults that
    cancel each other out to make a better reading; that is rarer than the weights say, unless
    the frame could be divided into two truncated ones.
    """
    for number in range(i64(1), i64(len(reading))):
        frame = reading[number]
        if frame.faults != AMBIGUOUS or frame.probability < LIKELY:
            continue
        behind = reading[number + 1] if number + 1 < len(reading) else following
        if behind is None or behind.probability == 0.0 or not reading[number - 1].certain:
            continue
        if plain(data, frame.start):
            reading[number] = frame.called(0)


def calmly(weighing: ForwardBackward, reading: list[Segment]) -> list[Segment]:
    """The reading of a line that was calm, with its frames believed up to the first damage.

    If it is only weighed, a frame is taken for two truncated ones whenever a target ends as another
    kind's flags do: those who hold a motor at 15 pulses would see nothing else. Where they even
    weigh more, as where a payload imitates a tail and a header, the frame is shown, and doubted.
    """
    believed: list[Segment] = []
    number: i64 = 0
    while number < len(reading):
        part = reading[number]
        if not part.framed:
            second = reading[number + 1] if number + 1 < len(reading) else None
            whole = _whole_of_two(weighing, part, second)
            if whole is None:
                break
            part = whole
            number += 1
        believed.append(_believed(weighing, part))
        number += 1
    return believed + reading[number:]


def _whole_of_two(
    weighing: ForwardBackward, first: Segment, second: Segment | None
) -> Segment | None:
    """The one frame that two damaged ones in a row are together; None where they are none."""
    if second is None or second.framed or second.stop - first.start != LENGTH:
        return None
    if not strict(weighing.window.data, first.start):
        return None
    return Segment(first.start, second.stop, True, AMBIGUOUS, 0.0)


def _believed(weighing: ForwardBackward, frame: Segment) -> Segment:
    """The frame without its doubt, if only two truncated ones could stand there instead."""
    if frame.faults != AMBIGUOUS or frame.probability < LIKELY:
        return frame
    if not undivided(weighing.window.data, frame.start):
        return frame
    before, behind = weighing.boundary(frame.start), weighing.boundary(frame.stop)
    return frame.called(0) if min(before, behind) >= CERTAIN else frame


_NEGLIGIBLE: Final = (1 - CERTAIN) / 4
_IN_STEP: Final = trusted()
_FRAME: Final = Segment(0, LENGTH, True, 0, 1.0)
"""The frame behind the stretch, wherever it stands."""


def read_by_itself(data: bytes, start: i64, firm: i64, *, calm: bool) -> list[Segment] | None:
    """The parts of the bytes between a frame beyond doubt and the one at `firm`, on a calm line or
    not; None where something could run over the beginning of that frame."""
    if _run_over(data, start, firm) > _NEGLIGIBLE:
        return None
    own = data[start:firm]
    if calm and len(own) >= LENGTH and strict(own, 0):
        weighing = ForwardBackward(CandidateSet(own), _IN_STEP, BOUNDARY)
        return calmly(weighing, chosen(weighing, _FRAME))
    return _read(own)


def _read(own: bytes) -> list[Segment]:
    window = CandidateSet(own)
    if strict_from(own, 0, window.size) < 0:
        parts = DamagedSpan(window, 0, window.size).parts()
        framed = False
        for part in parts:
            framed = framed or part.framed
            part.probability = 0.0
        if not framed:
            return parts
    return chosen(ForwardBackward(window, _IN_STEP, BOUNDARY), _FRAME)


def _run_over(data: bytes, start: i64, firm: i64) -> float:
    """At most how probable it is that the frame at `firm` is none, because a damaged one before it
    reaches into it."""
    end = firm + LENGTH
    probability = 0.0
    whole: PrefixScore | None = None
    back: SuffixScore | None = None
    for place in range(max(start, firm - LENGTH + 1), firm):
        if MARKS[data[place]] != HEADER:
            continue
        front, length = PrefixScore(data, place, min(end, place + LENGTH)), firm - place
        if length > BEHIND and front.bad_tail == 0.0:
            continue
        if back is None or whole is None:
            back, whole = SuffixScore(data, firm, end), PrefixScore(data, firm, end)
        over = front.bad_tail * back.headless[length]
        if length <= BEHIND:
            over += between(front, back, length + LENGTH)
        probability += over / _least(front, length) / whole.whole
    return probability


def _least(front: PrefixScore, length: i64) -> float:
    """What a header and the bytes behind it weigh at least, if they go on for `length`."""
    if front.cut_to >= length:
        return max(JUNK, front.truncated(length))
    most = 1.0
    for cut in range(i64(1), front.cut_to + 1):
        most = max(most, front.truncated(cut))
    return JUNK * most


_ALONE: Final[i64] = LONGEST_OVERLONG - FRAME_LENGTH + 1
"""Bytes that are too many for one overlong frame together with a whole one."""

_LEAST_LEFT: Final[i64] = FRAME_LENGTH - WIDEST_CHANGE
_LONGEST: Final[i64] = LONGEST_OVERLONG
_JUNK: Final[i64] = LONGEST_JUNK
_STUB: Final[i64] = 2
"""Too few bytes to be alone, if the frame behind them can be the rest of theirs."""


def undisputed(data: bytes, at: i64) -> Segment | None:
    """The damage at `at`, where a frame ended beyond doubt; None if it needs weighing.

    Behind it another one begins. It is counted from `at`, as all parts of a reading are.
    """
    end: i64 = len(data)
    if end - at < 1 + LENGTH + BEHIND:
        return None
    mark = _next_mark(data, at + 1, end)
    if mark == end:
        return None
    if MARKS[data[at]] == HEADER:
        return _headed(data, at, mark)
    return _headless(data, at, mark) if MARKS[data[at]] == 0 else None


def _next_mark(data: bytes, at: i64, end: i64) -> i64:
    """Where the next header or tail stands."""
    while at < end and MARKS[data[at]] == 0:
        at += 1
    return at


def _before_frame(
    data: bytes, at: i64, stop: i64, faults: i64, *, framed: bool = False
) -> Segment | None:
    """The bytes up to `stop` with these faults, if there are any and a frame stands behind them."""
    if faults == 0 or not is_doubtless(data, stop, i64(len(data))):
        return None
    return Segment(0, stop - at, framed, faults, 0.0)


def _headed(data: bytes, at: i64, mark: i64) -> Segment | None:
    """Damage that begins with a header; `mark` is what comes next."""
    size = mark - at
    if MARKS[data[mark]] != HEADER:
        stop = mark + 1
        if not _ALONE <= size + 1 <= _LONGEST:
            return None
        return _before_frame(
            data, at, stop, _faults_of_both(data, at, stop), framed=size + 1 == LENGTH
        )
    if size <= _STUB:
        faults = _faults_of_stub(data, at, mark)
    elif size < _ALONE or size > LENGTH:
        return None
    elif size == LENGTH:
        faults = BAD_TAIL if _begins(data, at) else i64(0)
    else:
        kind = kind_named(data, at)
        whole = kind != NO_KIND and head_fit(data, at, mark, kind) == size
        faults = TRUNCATED if whole else i64(0)
    return _before_frame(data, at, mark, faults)


def _headless(data: bytes, at: i64, mark: i64) -> Segment | None:
    """Damage that begins with neither a header nor a tail; `mark` is the first of them."""
    size = mark - at
    if MARKS[data[mark]] != HEADER:
        if size == LENGTH - 1:
            faults = BAD_HEADER if _ends(data, mark + 1) else i64(0)
        else:
            faults = NOISE if _ALONE - 1 <= size < LENGTH - 1 else i64(0)
        return _before_frame(data, at, mark + 1, faults)
    stop = mark
    while MARKS[data[stop]] == HEADER and stop + 1 < len(data) and NAMES_CMD[data[stop + 1]] == 0:
        # A header that no CMD follows begins nothing.
        stop = _next_mark(data, stop + 1, i64(len(data)))
        if stop == len(data):
            return None
    if stop - at > _JUNK or MARKS[data[stop]] != HEADER:
        return None
    if stop > mark:
        for place in range(stop - _ALONE + 1, stop):
            if place <= at or MARKS[data[place]] != 0:
                return None
    return _before_frame(data, at, stop, NOISE)


def _begins(data: bytes, at: i64) -> bool:
    """Whether a frame can begin there that is changed behind."""
    kind = kind_named(data, at)
    return kind != NO_KIND and head_fit(data, at, at + _LEAST_LEFT, kind) == _LEAST_LEFT


def _ends(data: bytes, stop: i64) -> bool:
    """Whether a frame can end there that is changed before."""
    for kind in range(COUNT):
        if rest_fit(data, stop - _LEAST_LEFT, stop, kind) == _LEAST_LEFT:
            return True
    return False


def _faults_of_stub(data: bytes, at: i64, stop: i64) -> i64:
    """Truncated; none where the frame behind a stub can be the rest of one overlong frame."""
    size = stop - at
    named = kind_named(data, at) if size > 1 else NO_KIND
    for kind in range(COUNT):
        if not _can_be(data, at, named, kind):
            continue
        if rest_fit(data, stop, stop + LENGTH, kind) >= LENGTH - size:
            return 0
    return TRUNCATED if size == 1 or named != NO_KIND else i64(0)


def _faults_of_both(data: bytes, at: i64, stop: i64) -> i64:
    """What is wrong with bytes between a header and a tail; none if unclear."""
    size = stop - at
    if size == LENGTH:
        return faults_of_framed(data, at)
    named = kind_named(data, at)
    whole = min(size, LENGTH)
    head: i64 = 1
    if named != NO_KIND:
        head = min(head_fit(data, at, stop - 1, named), whole - 1)
    for kind in range(COUNT):
        if _can_be(data, at, named, kind) and head + rest_fit(data, at, stop, kind) >= whole:
            return TRUNCATED if size < LENGTH else OVERLONG
    return 0


def _can_be(data: bytes, at: i64, named: i64, kind: i64) -> bool:
    """Whether bytes from a header on can be of a kind: that which is named, or any with it."""
    return kind == named or (named == NO_KIND and HEADERS[kind] == data[at])
