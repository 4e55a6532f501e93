"""Segmentation of a disputed span: Viterbi decoding, frame selection, and the fast paths.

- Its frames are those that have the highest sum of posterior probabilities without overlap.
- The damaged spans between them get the most probable segmentation (Viterbi).
- A frame below the probability `CERTAIN` is `ambiguous`, unless it is in step between a certain
  frame and another one and could not also be two truncated frames.
- On a calm line, two truncated frames of one frame's length are not considered.

`clear_damage` and `decode_alone` decide common damage without the two passes, with the same result.
"""

from __future__ import annotations

from typing import Final, final

from librt.vecs import vec
from mypy_extensions import i64, mypyc_attr

from fte_sniff.protocol.framer.candidates import (
    CandidateSet,
    PrefixScore,
    SuffixScore,
    damaged_score,
)
from fte_sniff.protocol.framer.likelihood import (
    BOUNDARY,
    CERTAIN,
    JUNK,
    LIKELY,
    LONGEST_JUNK,
    NOISE_RUN,
    SHOWN,
    WIDEST_CHANGE,
)
from fte_sniff.protocol.framer.posterior import ForwardBackward, after_certain_frame
from fte_sniff.protocol.framer.predicates import (
    ends_like_its_kind,
    find_strict,
    framed_faults,
    is_plain,
    is_strict,
    is_unambiguous,
    is_unsplit,
    kind_at,
    prefix_fit,
    suffix_fit,
)
from fte_sniff.protocol.framer.segments import Segment
from fte_sniff.protocol.framer.tables import (
    AMBIGUOUS,
    BAD_HEADER,
    BAD_TAIL,
    EXTRA,
    HEADER,
    NO_KIND,
    NOISE,
    OVERLONG,
    TAIL,
    TRUNCATED,
    FrameTables,
)

_NOISE_SCORE: Final = -1.0
"""In place of a candidate's score: the segment is noise."""


@final
@mypyc_attr(acyclic=True, free_list_len=1)
class DamagedSpan:
    """Viterbi segmentation of the bytes between two shown frames, or after the last."""

    def __init__(self, candidates: CandidateSet, start: i64, stop: i64) -> None:
        """Decode the bytes from `start` to `stop` of the candidate set."""
        self._candidates = candidates
        self._start = start
        self._stop = stop
        size = stop - start + 1
        self._best = vec[float]([0.0] * size)
        """By offset from the start: the score of the best path to it; 0 if there is none."""
        self._begins = vec[i64]([i64(0)] * size)
        """The start of the last segment of that path."""
        self._scores = vec[float]([0.0] * size)
        """The score of that segment, or `_NOISE_SCORE`."""
        self._best[0] = 1.0
        self._begins[0] = start
        self._extend_all()

    def _extend_all(self) -> None:
        prefixes = self._candidates.prefixes
        header: i64 = 0
        for at in range(self._start, self._stop):
            while header < len(prefixes) and prefixes[header].start < at:
                header += 1
            if self._best[at - self._start] > 0.0:
                self._extend(at, header)

    def _extend(self, at: i64, header: i64) -> None:
        """Extend the best path to `at` by every segment that can start there, or at `header`."""
        own = at - self._start
        score, candidates = self._best[own], self._candidates
        after_noise = self._scores[own] == _NOISE_SCORE
        contact = score if after_noise else score * candidates.contact_score(at)
        if candidates.tables.delimiters[candidates.data[at]] == HEADER:
            self._extend_from_header(candidates.prefixes[header], contact)
            header += 1
        self._extend_to_tails(at, contact)
        if after_noise:
            return
        while header < len(candidates.prefixes) and candidates.prefixes[header].start < self._stop:
            stop = candidates.prefixes[header].start
            self._reach(stop, at, score * NOISE_RUN[stop - at], _NOISE_SCORE)
            header += 1
        self._reach(self._stop, at, score * NOISE_RUN[self._stop - at], _NOISE_SCORE)

    def _extend_from_header(self, prefix: PrefixScore, score: float) -> None:
        candidates, at = self._candidates, prefix.start
        for length in range(i64(1), prefix.longest_truncated + 1):
            own = candidates.truncated(prefix, length)
            self._reach(at + length, at, score * own, own)
        own = candidates.full_length(prefix, prefix.bad_tail)
        if own > 0.0:
            self._reach(at + candidates.tables.length, at, score * own, own)

    def _extend_to_tails(self, at: i64, score: float) -> None:
        for end in self._candidates.ends:
            if end.first <= at < end.stop:
                own = end.scores[at - end.first]
                self._reach(end.stop, at, score * own, own)

    def _reach(self, stop: i64, begin: i64, score: float, own: float) -> None:
        """Keep the path to `stop` whose last segment starts at `begin`, if it is the best."""
        if stop > self._stop:
            return
        at = stop - self._start
        if score > self._best[at]:
            self._best[at], self._begins[at], self._scores[at] = score, begin, own

    def end_with_cut_off(self, prefix: PrefixScore, own: float) -> None:
        """Let the span end with a frame that starts there and continues, if that is best."""
        if prefix.start >= self._start and own > 0.0:
            score = self._best[prefix.start - self._start] * own
            self._reach(self._stop, prefix.start, score, own)

    def segments(self) -> list[Segment]:
        """The segments from left to right; `probability` holds the score of each."""
        segments: list[Segment] = []
        stop = self._stop
        while stop > self._start:
            at = stop - self._start
            begin = self._begins[at]
            segments.append(_segment(self._candidates, begin, stop, self._scores[at]))
            stop = begin
        segments.reverse()
        return segments


def _segment(candidates: CandidateSet, start: i64, stop: i64, score: float) -> Segment:
    if score == _NOISE_SCORE:
        return Segment(start, stop, False, NOISE, 0.0)
    tables, data = candidates.tables, candidates.data
    fault = damage_fault(tables, data, start, stop)
    if fault:
        return Segment(start, stop, False, fault, score)
    return Segment(start, stop, True, framed_faults(tables, data, start), score)


def damage_fault(tables: FrameTables, data: bytes, start: i64, stop: i64) -> i64:
    """The fault of a candidate's bytes; 0 if they are framed."""
    size = stop - start
    has_header = tables.delimiters[data[start]] == HEADER
    if size != tables.length:
        if not has_header:
            return NOISE
        return TRUNCATED if size < tables.length else OVERLONG
    if not has_header:
        return BAD_HEADER
    return i64(0) if tables.delimiters[data[stop - 1]] == TAIL else BAD_TAIL


def decode(posterior: ForwardBackward, following: Segment | None = None) -> list[Segment]:
    """The segmentation of a span; `following` is known to come after it."""
    candidates = posterior.candidates
    length, probabilities = candidates.tables.length, posterior.frame_probabilities()
    after_rows = probabilities
    if posterior.follows_frame:
        after_rows = posterior.frame_probabilities_after_rows()
    segments: list[Segment] = []
    at: i64 = 0
    for number in _shown_frames(candidates, after_rows):
        start = candidates.prefixes[number].start
        if at < start:
            _append_damage(posterior, DamagedSpan(candidates, at, start), segments)
        faults = i64(0) if probabilities[number] >= CERTAIN else AMBIGUOUS
        segments.append(Segment(start, start + length, True, faults, probabilities[number]))
        at = start + length
    if at < posterior.size:
        damage = DamagedSpan(candidates, at, posterior.size)
        for prefix in candidates.prefixes:
            if prefix.start > posterior.size - length:
                damage.end_with_cut_off(prefix, posterior.cut_off_score(prefix))
        _append_damage(posterior, damage, segments)
    _trust_neighbours(posterior, segments, following)
    return segments


def _append_damage(
    posterior: ForwardBackward, damage: DamagedSpan, segments: list[Segment]
) -> None:
    """Append the segments of a damaged span; unlikely framed ones are `ambiguous`."""
    for one in damage.segments():
        faults, probability = one.faults, 0.0
        if one.framed:
            probability = posterior.probability(one.start, one.stop, one.probability)
            if probability < (LIKELY if faults else CERTAIN):
                faults |= AMBIGUOUS
            if one.faults:
                probability = 0.0
        segments.append(Segment(one.start, one.stop, one.framed, faults, probability))


def _shown_frames(candidates: CandidateSet, probabilities: vec[float]) -> list[i64]:
    """The headers whose frames are shown: weighted interval scheduling by probability."""
    prefixes, length = candidates.prefixes, candidates.tables.length
    likely = vec[i64]([i64(0)] * len(probabilities))
    count: i64 = 0
    for number in range(i64(len(probabilities))):
        if probabilities[number] > SHOWN:
            likely[count] = number
            count += 1
    best = vec[float]([0.0] * (count + 1))
    """By number of frames considered: the best sum."""
    previous = vec[i64]([i64(-1)] * (count + 1))
    """By the same: how many were considered before the last frame of that sum; -1 without it."""
    for number in range(count):
        start, gain = prefixes[likely[number]].start, probabilities[likely[number]] - SHOWN
        before = number
        while before > 0 and prefixes[likely[before - 1]].start + length > start:
            before -= 1
        best[number + 1] = best[number]
        if best[before] + gain > best[number]:
            best[number + 1], previous[number + 1] = best[before] + gain, before
    shown: list[i64] = []
    while count > 0:
        if previous[count] < 0:
            count -= 1
            continue
        shown.append(likely[count - 1])
        count = previous[count]
    shown.reverse()
    return shown


def _trust_neighbours(
    posterior: ForwardBackward, segments: list[Segment], following: Segment | None
) -> None:
    """Clear `ambiguous` from frames in step between a certain frame and another one.

    Another segmentation needs two faults that cancel each other out. This is rarer than the scores
    say, unless the frame could also be two truncated ones.
    """
    candidates, follows_certain = posterior.candidates, posterior.follows_certain_frame
    for number in range(i64(len(segments))):
        frame = segments[number]
        in_step, follows_certain = follows_certain, frame.certain
        if not in_step or frame.faults != AMBIGUOUS or frame.probability < LIKELY:
            continue
        after = segments[number + 1] if number + 1 < len(segments) else following
        if after is None or after.probability == 0.0:
            continue
        if is_plain(candidates.tables.unlearned, candidates.data, frame.start):
            segments[number] = frame.with_faults(0)
            follows_certain = True


def trust_calm_line(posterior: ForwardBackward, segments: list[Segment]) -> list[Segment]:
    """The segmentation on a calm line: frames up to the first damage are trusted.

    The scores alone would split every frame whose target ends like the flags of another kind: a
    line that holds a motor at 15 pulses would show nothing else. If the two truncated frames even
    score higher, because the payload imitates a tail and a header, the frame is `ambiguous`.
    """
    trusted: list[Segment] = []
    number: i64 = 0
    while number < len(segments):
        segment = segments[number]
        if not segment.framed:
            second = segments[number + 1] if number + 1 < len(segments) else None
            whole = _joined(posterior, segment, second)
            if whole is None:
                break
            segment = whole
            number += 1
        trusted.append(_trusted(posterior, segment))
        number += 1
    return trusted + segments[number:]


def _joined(posterior: ForwardBackward, first: Segment, second: Segment | None) -> Segment | None:
    tables, data = posterior.candidates.tables, posterior.candidates.data
    if second is None or second.framed or second.stop - first.start != tables.length:
        return None
    if not is_strict(tables, data, first.start):
        return None
    return Segment(first.start, second.stop, True, AMBIGUOUS, 0.0)


def _trusted(posterior: ForwardBackward, frame: Segment) -> Segment:
    """The frame without `ambiguous` if only two truncated frames could replace it."""
    if frame.faults != AMBIGUOUS or frame.probability < LIKELY:
        return frame
    if not is_unsplit(posterior.candidates.tables, posterior.candidates.data, frame.start):
        return frame
    start = posterior.boundary_probability(frame.start)
    stop = posterior.boundary_probability(frame.stop)
    return frame.with_faults(0) if min(start, stop) >= CERTAIN else frame


# Fast path: the bytes between a certain frame and an unambiguous one

_NEGLIGIBLE: Final = (1 - CERTAIN) / 4
_CERTAIN_FRAME: Final = after_certain_frame()
_FOLLOWING: Final = Segment(0, 1, True, 0, 1.0)
"""A certain frame after the span; its offsets are not used."""


def decode_alone(
    tables: FrameTables, data: bytes, start: i64, end: i64, *, calm: bool
) -> list[Segment] | None:
    """The segments before the unambiguous frame at `end`; None if damage could reach into it."""
    if _overrun_probability(tables, data, start, end) > _NEGLIGIBLE:
        return None
    candidates = CandidateSet(tables, data[start:end])
    size, own = candidates.size, candidates.data
    if calm and size >= tables.length and is_strict(tables, own, 0):
        posterior = ForwardBackward(candidates, _CERTAIN_FRAME, BOUNDARY)
        return trust_calm_line(posterior, decode(posterior, _FOLLOWING))
    if find_strict(tables, own, 0, size) < 0:
        segments = DamagedSpan(candidates, 0, size).segments()
        framed = False
        for segment in segments:
            framed = framed or segment.framed
            segment.probability = 0.0
        if not framed:
            return segments
    return decode(ForwardBackward(candidates, _CERTAIN_FRAME, BOUNDARY), _FOLLOWING)


def _overrun_probability(tables: FrameTables, data: bytes, start: i64, frame: i64) -> float:
    """An upper bound of the probability that a damaged frame reaches into the one at `frame`."""
    end = frame + tables.length
    probability = 0.0
    whole: PrefixScore | None = None
    suffix: SuffixScore | None = None
    for at in range(max(start, frame - tables.length + 1), frame):
        if tables.delimiters[data[at]] != HEADER:
            continue
        prefix, length = PrefixScore(tables, data, at, min(end, at + tables.length)), frame - at
        if length > EXTRA and prefix.bad_tail == 0.0:
            continue
        if suffix is None or whole is None:
            suffix = SuffixScore(tables, data, frame, end)
            whole = PrefixScore(tables, data, frame, end)
        over = prefix.bad_tail * suffix.headless[length]
        if length <= EXTRA:
            over += damaged_score(prefix, suffix, length + tables.length)
        probability += over / _least_score(prefix, length) / whole.whole
    return probability


def _least_score(prefix: PrefixScore, length: i64) -> float:
    """A lower bound of the score of `length` bytes that start with that prefix."""
    if prefix.longest_truncated >= length:
        return max(JUNK, prefix.truncated(length))
    most = 1.0
    for left in range(i64(1), prefix.longest_truncated + 1):
        most = max(most, prefix.truncated(left))
    return JUNK * most


# Fast path: damage with one explanation, between a certain frame and an unambiguous one

_ALONE: Final[i64] = EXTRA + 1
"""More bytes than an overlong frame can have in addition to a whole one."""
_WIDEST_CHANGE: Final[i64] = WIDEST_CHANGE
_LONGEST_JUNK: Final[i64] = LONGEST_JUNK
_STUB: Final[i64] = 2
"""A longer start of a frame cannot form one overlong frame with the frame after it."""


def clear_damage(tables: FrameTables, data: bytes, at: i64) -> Segment | None:
    """The damaged segment at `at`, with offsets from there; None if the scores must decide."""
    end: i64 = len(data)
    if end - at < 1 + tables.longest:
        return None
    delimiter = _next_delimiter(tables, data, at + 1, end)
    if delimiter == end:
        return None
    if tables.delimiters[data[at]] == HEADER:
        return _damage_from_header(tables, data, at, delimiter)
    if tables.delimiters[data[at]] == 0:
        return _damage_without_header(tables, data, at, delimiter)
    return None


def _next_delimiter(tables: FrameTables, data: bytes, at: i64, end: i64) -> i64:
    while at < end and tables.delimiters[data[at]] == 0:
        at += 1
    return at


def _before_frame(
    tables: FrameTables, data: bytes, at: i64, stop: i64, faults: i64
) -> Segment | None:
    """The damaged segment up to `stop`; None without faults, or without a frame after it."""
    if faults == 0 or not is_unambiguous(tables, data, stop, i64(len(data))):
        return None
    delimiters, size = tables.delimiters, stop - at
    framed = size == tables.length and delimiters[data[at]] == HEADER
    return Segment(0, size, framed and delimiters[data[stop - 1]] == TAIL, faults, 0.0)


def _damage_from_header(
    tables: FrameTables, data: bytes, at: i64, delimiter: i64
) -> Segment | None:
    """Damage that starts with a header; `delimiter` is the next header or tail."""
    size = delimiter - at
    if tables.delimiters[data[delimiter]] == TAIL:
        stop = delimiter + 1
        if not _ALONE <= size + 1 <= tables.longest:
            return None
        return _before_frame(tables, data, at, stop, _faults_to_tail(tables, data, at, stop))
    if size <= _STUB:
        faults = _faults_of_stub(tables, data, at, delimiter)
    elif size < _ALONE or size > tables.length:
        return None
    elif size == tables.length:
        faults = BAD_TAIL if _starts_frame(tables, data, at) else i64(0)
    else:
        kind = kind_at(tables, data, at)
        legal = kind != NO_KIND and prefix_fit(tables, data, at, delimiter, kind) == size
        faults = TRUNCATED if legal else i64(0)
    return _before_frame(tables, data, at, delimiter, faults)


def _damage_without_header(
    tables: FrameTables, data: bytes, at: i64, delimiter: i64
) -> Segment | None:
    """Damage that starts with neither header nor tail; `delimiter` is the first of them."""
    size, last = delimiter - at, tables.length - 1
    if tables.delimiters[data[delimiter]] == TAIL:
        if size == last:
            faults = BAD_HEADER if _ends_frame(tables, data, delimiter + 1) else i64(0)
        else:
            faults = NOISE if _ALONE - 1 <= size < last else i64(0)
        return _before_frame(tables, data, at, delimiter + 1, faults)
    stop, end, delimiters = delimiter, i64(len(data)), tables.delimiters
    while delimiters[data[stop]] == HEADER and stop + 1 < end and not tables.is_cmd[data[stop + 1]]:
        # A header without a CMD starts no frame.
        stop = _next_delimiter(tables, data, stop + 1, end)
        if stop == end:
            return None
    if stop - at > _LONGEST_JUNK or delimiters[data[stop]] != HEADER:
        return None
    if stop > delimiter:
        for offset in range(stop - _ALONE + 1, stop):
            if offset <= at or delimiters[data[offset]] != 0:
                return None
    return _before_frame(tables, data, at, stop, NOISE)


def _starts_frame(tables: FrameTables, data: bytes, at: i64) -> bool:
    kind, least = kind_at(tables, data, at), tables.length - _WIDEST_CHANGE
    return kind != NO_KIND and prefix_fit(tables, data, at, at + least, kind) == least


def _ends_frame(tables: FrameTables, data: bytes, stop: i64) -> bool:
    least = tables.length - _WIDEST_CHANGE
    for kind in range(tables.kind_count):
        if suffix_fit(tables, data, stop - least, stop, kind) == least:
            return True
    return False


def _faults_of_stub(tables: FrameTables, data: bytes, at: i64, stop: i64) -> i64:
    """Truncated; 0 if the stub and the frame after it can be one overlong frame."""
    size = stop - at
    named = kind_at(tables, data, at) if size > 1 else NO_KIND
    for kind in range(tables.kind_count):
        if not _can_be(tables, data[at], named, kind):
            continue
        if suffix_fit(tables, data, stop, stop + tables.length, kind) >= tables.length - size:
            return 0
    return TRUNCATED if size == 1 or named != NO_KIND else i64(0)


def _faults_to_tail(tables: FrameTables, data: bytes, at: i64, stop: i64) -> i64:
    """The faults of the bytes from a header to a tail; 0 if unclear."""
    size = stop - at
    named = kind_at(tables, data, at)
    if size == tables.length:
        clear = named == NO_KIND or ends_like_its_kind(tables, data, stop, named)
        return framed_faults(tables, data, at) if clear else i64(0)
    whole = min(size, tables.length)
    head: i64 = 1
    if named != NO_KIND:
        head = min(prefix_fit(tables, data, at, stop - 1, named), whole - 1)
    for kind in range(tables.kind_count):
        if not _can_be(tables, data[at], named, kind):
            continue
        if head + suffix_fit(tables, data, at, stop, kind) >= whole:
            if not ends_like_its_kind(tables, data, stop, kind):
                return 0
            return TRUNCATED if size < tables.length else OVERLONG
    return 0


def _can_be(tables: FrameTables, header: int, named: i64, kind: i64) -> bool:
    """Whether a header can start a kind: the one that is named, or any of that header."""
    return kind == named or (named == NO_KIND and tables.headers[kind] == header)
