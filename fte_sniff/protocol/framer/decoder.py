"""Decoding of a disputed span: candidate frames, posterior probabilities, segmentation.

The model is a hidden semi-Markov model: its states are segments (frame, damaged frame, junk, long
noise) of variable length.

- Candidates: a frame starts with a header or ends with a tail, unless damage took them.
  `PrefixScore` scores the bytes from a header on, `SuffixScore` those up to a tail, and
  `damaged_score` combines both. Scores of prefixes and suffixes are cumulative: entry x is the
  score of the first (or last) x bytes.
- Probabilities: `ForwardBackward` visits headers and tails only; the bytes between are summed up
  at once. The framer limits the length of a span.
- Frames are those that have the highest sum of posterior probabilities without overlap.
- The damaged spans between them get the most probable segmentation (Viterbi).
- A frame below the probability `CERTAIN` is `ambiguous`, unless it is in step between a certain
  frame and another one and could not also be two truncated frames.
- On a calm line, two truncated frames of one frame's length are not considered.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, final

from librt.vecs import append, vec
from mypy_extensions import i64, mypyc_attr

from fte_sniff.protocol.framer.model import (
    AMBIGUOUS,
    BAD_HEADER,
    BAD_TAIL,
    BOUNDARY,
    BROKEN,
    CERTAIN,
    HEADER,
    INTACT,
    JUNK,
    LIKELY,
    LONG_NOISE,
    LONGEST_JUNK,
    NO_KIND,
    NO_PAUSE_BETWEEN,
    NOISE,
    NOISE_AT_END,
    NOISE_BEGINS,
    NOISE_CONTINUES,
    NOISE_ENDS,
    NOISE_RUN,
    NOISE_TO_HEADER,
    OPEN,
    OVERLONG,
    PAUSE_WITHIN,
    SHOWN,
    TAIL,
    TRUNCATED,
    UNUSUAL,
    WIDEST_CHANGE,
    FrameTables,
    framed_faults,
    is_plain,
    is_strict,
    is_unsplit,
    kind_at,
    noise_to_end,
)
from fte_sniff.protocol.spec import NUM_OFFSET

# Candidates

_WIDEST_CHANGE: Final[i64] = WIDEST_CHANGE
_LONGEST_JUNK: Final[i64] = LONGEST_JUNK
_NAMED: Final[i64] = NUM_OFFSET + 1


@final
@mypyc_attr(acyclic=True)
class PrefixScore:
    """The scores of a header and the bytes after it as the start of a frame."""

    def __init__(self, tables: FrameTables, data: bytes, at: i64, end: i64) -> None:
        """Score the bytes from the header at `at` to `end`, at most a frame's length."""
        length = tables.length
        scores = vec[float]([0.0] * (length + 1))
        scores[0], scores[1] = 1.0, tables.header_score
        kind, fit = NO_KIND, i64(1)
        if end - at > 1:
            kind = kind_at(tables, data, at)
        if kind != NO_KIND:
            fit = _score_prefix(tables, data, at, end - at, kind, scores)
        self._truncation = tables.truncation
        self.start = at
        self.header = i64(data[at])
        self.kind = kind
        """The kind that header and CMD name, or `NO_KIND`."""
        self.scores = scores
        """The scores of the first bytes as that kind; without a kind, of the header alone."""
        self.fit = fit
        """How many bytes are legal."""
        self.whole = INTACT * scores[length] if fit == length else 0.0
        """The score of a whole frame; 0 if a byte is illegal."""
        self.bad_tail = 0.0
        """The score of a frame whose last bytes were changed; 0 if the prefix cannot be that."""
        if fit < length and end - at >= length:
            self.bad_tail = _bad_tail_score(tables, scores, fit)
        self.unusual = 0.0
        """The score of a frame with another reserve than the line's; 0 if it cannot be one."""
        if kind != NO_KIND and fit < length <= end - at and tables.open_reserve[kind * length] != 0:
            unlearned = vec[float]([0.0] * (length + 1))
            _score_prefix(tables.unlearned, data, at, length, kind, unlearned)
            self.unusual = unlearned[length]
        self.longest_truncated = min(fit, length - 1)

    def truncated(self, length: i64) -> float:
        """The score of the frame cut off after `length` bytes, 1 to `longest_truncated`."""
        return self._truncation[length] * self.scores[length]


def _score_prefix(
    tables: FrameTables, data: bytes, at: i64, length: i64, kind: i64, scores: vec[float]
) -> i64:
    """Fill in the scores of the first bytes; returns how many are legal."""
    score = tables.kind_shares[kind]
    row = kind * tables.length * 256
    byte_scores = tables.byte_scores
    for offset in range(length):
        own = byte_scores[row + offset * 256 + i64(data[at + offset])]
        if own == 0.0:
            return offset
        score *= own
        if offset > 0:
            scores[offset + 1] = score
    return length


def _bad_tail_score(tables: FrameTables, scores: vec[float], fit: i64) -> float:
    score, length = 0.0, tables.length
    for left in range(length - _WIDEST_CHANGE, fit + 1):
        score += tables.change[length - left] * scores[left]
    return score


@final
@mypyc_attr(acyclic=True)
class SuffixScore:
    """The scores of a tail and the bytes before it as the end of a frame, for every kind."""

    def __init__(self, tables: FrameTables, data: bytes, start: i64, end: i64) -> None:
        """Score the bytes from `start`, at most a frame's length, to behind the tail at `end`."""
        count, length = tables.kind_count, tables.length
        self.tables = tables
        self.scores = vec[float]([0.0] * ((length + 1) * count))
        """By kind * (frame length + 1) + number of bytes."""
        self.fits = vec[i64]([i64(0)] * count)
        """By kind: how many bytes are legal."""
        self.headless = vec[float]([0.0] * (tables.longest + 1))
        """By length: the score of a frame whose first bytes are lost or wrong."""
        by_length = vec[float]([0.0] * (tables.longest + 1))
        by_fit = vec[float]([0.0] * (tables.longest + 1))
        for kind in range(count):
            fit = self._score_kind(data, end, min(end - start, length), kind, by_length)
            self.fits[kind] = fit
            most = min(fit, length - 1)
            by_fit[most + 1] += tables.kind_shares[kind] * self.scores[kind * (length + 1) + most]
        self._score_headless(by_length, by_fit)

    def _score_kind(
        self, data: bytes, end: i64, length: i64, kind: i64, by_length: vec[float]
    ) -> i64:
        """Fill in the scores of the last bytes as a kind; returns how many are legal."""
        tables, scores = self.tables, self.scores
        row, share = kind * (tables.length + 1), tables.kind_shares[kind]
        byte_scores, last = tables.byte_scores, ((kind + 1) * tables.length - 1) * 256
        score = scores[row] = 1.0
        for number in range(length):
            score *= byte_scores[last - number * 256 + i64(data[end - 1 - number])]
            if score == 0.0:
                return number
            scores[row + number + 1] = score
            by_length[number + 1] += share * score
        return length

    def _score_headless(self, by_length: vec[float], by_fit: vec[float]) -> None:
        """Fill in `headless` from the scores of all suffixes, and of those legal no further."""
        headless, longer = self.headless, 0.0
        lost, change, whole = self.tables.headless, self.tables.change, self.tables.length
        for length in range(i64(1), self.tables.longest + 1):
            longer += by_fit[length]
            headless[length] = longer * BROKEN + lost[length] * by_length[length]
        for length in range(whole - _WIDEST_CHANGE, whole):
            headless[whole] += change[whole - length] * by_length[length]

    def any_kind(self, length: i64) -> float:
        """The score of the last `length` bytes as the end of a frame of any kind."""
        score, row = 0.0, self.tables.length + 1
        for kind in range(self.tables.kind_count):
            if self.fits[kind] >= length:
                score += self.tables.kind_shares[kind] * self.scores[kind * row + length]
        return score


def damaged_score(prefix: PrefixScore, suffix: SuffixScore, length: i64) -> float:
    """The score of a damaged frame of `length` bytes with this prefix and this suffix."""
    if length < 2:
        return 0.0
    score = suffix.headless[length] + _header_only(length, prefix.header, suffix)
    if length == suffix.tables.length:
        score += _unusual(suffix.tables, prefix)
    if prefix.kind != NO_KIND:
        score += _damaged_once(length, prefix, suffix) + _broken(length, prefix, suffix)
    return score


def _header_only(length: i64, header: i64, suffix: SuffixScore) -> float:
    """The score of a damaged frame with its header and without its CMD."""
    score, tables = 0.0, suffix.tables
    scores, fits, whole, change = suffix.scores, suffix.fits, tables.length, tables.change
    after = min(length, whole) - 1
    for kind in range(tables.kind_count):
        if i64(tables.headers[kind]) != header:
            continue
        row, share = kind * (whole + 1), tables.kind_shares[kind] * 256
        if length == whole:
            for left in range(whole - _WIDEST_CHANGE - 1, min(fits[kind] + 1, whole - 1)):
                score += share * change[whole - 1 - left] * scores[row + left]
        elif fits[kind] >= after:
            score += share * scores[row + after]
    return score if length == whole else score * _one_damage(tables, length)


def _one_damage(tables: FrameTables, length: i64) -> float:
    return tables.truncation[length] if length < tables.length else tables.insertion


def _damaged_once(length: i64, prefix: PrefixScore, suffix: SuffixScore) -> float:
    """The score of one damage after header and CMD, summed over its offsets."""
    tables = suffix.tables
    row, fit = prefix.kind * (tables.length + 1), suffix.fits[prefix.kind]
    if length == tables.length:
        return _changed(prefix, suffix, row, fit)
    left = min(length, tables.length)
    scores, total = prefix.scores, 0.0
    for own in range(max(i64(2), left - fit), min(prefix.fit + 1, left)):
        total += scores[own] * suffix.scores[row + left - own]
    return total * _one_damage(tables, length)


def _changed(prefix: PrefixScore, suffix: SuffixScore, row: i64, fit: i64) -> float:
    tables, scores, total = suffix.tables, suffix.scores, 0.0
    change, length = tables.change, tables.length
    for own in range(i64(2), min(prefix.fit + 1, length - 1)):
        score = 0.0
        most = min(fit, length - 1 - own)
        for left in range(max(i64(1), length - _WIDEST_CHANGE - own), most + 1):
            score += change[length - own - left] * scores[row + left]
        total += prefix.scores[own] * score
    return total


def _unusual(tables: FrameTables, prefix: PrefixScore) -> float:
    """The score of framed bytes with any content, or with any reserve."""
    named = prefix.scores[_NAMED] * 256 if prefix.fit >= _NAMED else 0.0
    return tables.foreign_score + UNUSUAL * (named + prefix.unusual)


def _broken(length: i64, prefix: PrefixScore, suffix: SuffixScore) -> float:
    """The score of any other damage between the legal prefix and the legal suffix."""
    whole = suffix.tables.length
    left = min(prefix.fit, min(length - 1, whole - 2))
    ending = min(suffix.fits[prefix.kind], min(length - left, whole - 1 - left))
    return BROKEN * prefix.scores[left] * suffix.scores[prefix.kind * (whole + 1) + ending]


@final
@mypyc_attr(acyclic=True)
class CandidateEnd:
    """A tail, and the scores of the candidates that end with it."""

    def __init__(self, stop: i64, suffix: SuffixScore) -> None:
        self.stop = stop
        """Offset after the tail."""
        self.suffix = suffix
        self.first = max(i64(0), stop - suffix.tables.longest)
        """The first offset where a candidate can start."""
        self.scores = vec[float]([0.0] * suffix.tables.longest)
        """By offset from `first` to the tail: the score of the damaged frame."""


AT_TAIL: Final[i64] = 1
"""In `CandidateSet.delimiters`: a tail, not a header."""


@final
@mypyc_attr(acyclic=True, free_list_len=1)
class CandidateSet:
    """A span of bytes with all its candidate frames and damaged frames."""

    def __init__(self, tables: FrameTables, data: bytes, pauses: Sequence[i64] = ()) -> None:
        """`pauses` are the offsets in `data` before which the line paused."""
        self.tables = tables
        self.data = data
        self.pauses = pauses
        self.paused = len(pauses) > 0
        self.size: i64 = len(data)
        self.prefixes: list[PrefixScore] = []
        """Every header, from left to right."""
        self.ends: list[CandidateEnd] = []
        """Every tail, from left to right."""
        self.delimiters = vec[i64]()
        """Both, from left to right: twice the index in its list, plus `AT_TAIL` for a tail."""
        length = tables.length
        for at in range(self.size):
            delimiter = tables.delimiters[data[at]]
            if delimiter == HEADER:
                self.delimiters = append(self.delimiters, 2 * i64(len(self.prefixes)))
                self.prefixes.append(PrefixScore(tables, data, at, min(self.size, at + length)))
            elif delimiter != 0:
                self.delimiters = append(self.delimiters, 2 * i64(len(self.ends)) + AT_TAIL)
                self.ends.append(self._end_at(at + 1))

    def _end_at(self, stop: i64) -> CandidateEnd:
        tables = self.tables
        suffix = SuffixScore(tables, self.data, max(i64(0), stop - tables.length), stop)
        end = CandidateEnd(stop, suffix)
        scores, first, headless = end.scores, end.first, suffix.headless
        for at in range(first, stop):
            scores[at - first] = headless[stop - at]
        number: i64 = len(self.prefixes) - 1
        while number >= 0 and self.prefixes[number].start >= first:
            prefix = self.prefixes[number]
            length = stop - prefix.start
            whole = length == tables.length and prefix.whole > 0.0
            scores[prefix.start - first] = 0.0 if whole else damaged_score(prefix, suffix, length)
            number -= 1
        if self.paused:
            for at in range(first, stop):
                scores[at - first] *= self._pause_score(at, stop)
                if tables.delimiters[self.data[at]] != HEADER:
                    scores[at - first] *= self.contact_score(at)
        return end

    def truncated(self, prefix: PrefixScore, length: i64) -> float:
        """The score of a frame cut off after `length` bytes."""
        score = prefix.truncated(length)
        if not self.paused:
            return score
        return score * self._pause_score(prefix.start, prefix.start + length)

    def full_length(self, prefix: PrefixScore, score: float) -> float:
        """The score of a frame's length from that header: `prefix.whole` or `prefix.bad_tail`."""
        if self.paused and score > 0.0:
            return score * self._pause_score(prefix.start, prefix.start + self.tables.length)
        return score

    def _pause_score(self, start: i64, stop: i64) -> float:
        """The factor for the pauses within a candidate."""
        score = 1.0
        for pause in self.pauses:
            if start < pause < stop:
                score *= PAUSE_WITHIN
        return score

    def contact_score(self, at: i64) -> float:
        """The factor for two frames that meet at `at` without a pause, the second with a header.

        Candidates without a header include it already.
        """
        if not self.paused or at == 0 or at in self.pauses:
            return 1.0
        return NO_PAUSE_BETWEEN

    def first_suffixes(self, longest: i64) -> vec[float]:
        """By length up to `longest`: the score of the first bytes as the end of a frame."""
        scores = vec[float]([0.0] * (longest + 1))
        for end in self.ends:
            if end.stop <= longest:
                scores[end.stop] = end.suffix.any_kind(end.stop) * self._pause_score(0, end.stop)
        return scores


# Probabilities


@final
@mypyc_attr(acyclic=True, free_list_len=1)
class BoundaryState:
    """Forward scores of a span, or probabilities at the boundary before its first byte."""

    def __init__(
        self,
        after_frame: vec[float],
        after_noise: vec[float],
        in_noise: float,
        ends_frame: bool = False,
        within_frame: float = 0.0,
    ) -> None:
        self.after_frame = after_frame
        """By offset: the sum over all paths from the left that end there with a frame, whole or
        damaged."""
        self.after_noise = after_noise
        """By offset: the same for paths that end there with noise."""
        self.in_noise = in_noise
        """The score of paths in long noise at the boundary."""
        self.ends_frame = ends_frame
        """Whether the last decided row is a frame, or another segment of known length."""
        self.within_frame = within_frame
        """The score of a start within a frame; only at the start of a stream."""

    def with_suffixes(self, candidates: CandidateSet) -> BoundaryState:
        """This state for a span that may start with the rest of a frame."""
        longest = candidates.tables.length - 1
        suffixes = candidates.first_suffixes(longest)
        scores = _resized(self.after_frame, max(i64(len(suffixes)), i64(len(self.after_frame))))
        for at in range(i64(1), i64(len(suffixes))):
            scores[at] += self.within_frame / float(longest) * suffixes[at]
        return BoundaryState(
            scores, self.after_noise, self.in_noise, self.ends_frame, self.within_frame
        )


def after_certain_frame() -> BoundaryState:
    """A frame ends here with certainty."""
    return BoundaryState(vec[float]([1.0]), vec[float](), 0.0)


def at_stream_start() -> BoundaryState:
    """The stream starts here: between two frames, within a frame, or in noise."""
    return BoundaryState(vec[float]([0.5]), vec[float](), 0.01, within_frame=0.5)


def after_silence() -> BoundaryState:
    """The line was silent: a segment ended here, or long noise continues."""
    return BoundaryState(vec[float]([1.0]), vec[float](), 0.05)


def in_long_noise() -> BoundaryState:
    """Long noise continues."""
    return BoundaryState(vec[float](), vec[float](), 1.0)


_CERTAIN: Final = after_certain_frame()


@final
@mypyc_attr(acyclic=True, free_list_len=1)
class ForwardBackward:
    """Forward and backward scores of a span; offsets count from its first byte."""

    def __init__(self, candidates: CandidateSet, state: BoundaryState, ending: i64) -> None:
        """`ending` is `OPEN`, `CLOSED` or `BOUNDARY`."""
        self.candidates = candidates
        self.size = candidates.size
        self.ending = ending
        self._state = state.with_suffixes(candidates) if state.within_frame else state
        self.forward = self._forward_pass(self._state, self.size)
        self.backward = vec[float]([0.0] * (self.size + 1))
        """By offset: the sum over all paths from there to the end."""
        self._from_header = vec[float]([0.0] * len(candidates.prefixes))
        """By header: the sum over the paths that start with a frame there."""
        self._backward_pass()
        self.total = self._sum_of_paths(self._state)

    # The two passes

    def _forward_pass(self, state: BoundaryState, end: i64) -> BoundaryState:
        """The forward scores of the segments that start before `end`."""
        candidates, size = self.candidates, self.size + 1
        after_frame, after_noise = (
            _resized(state.after_frame, size),
            _resized(state.after_noise, size),
        )
        forward = BoundaryState(after_frame, after_noise, 0.0)
        noise, noise_to = state.in_noise, i64(0)
        for delimiter in candidates.delimiters:
            if delimiter & AT_TAIL:
                self._reach_tail(candidates.ends[delimiter >> 1], forward, end)
                continue
            prefix = candidates.prefixes[delimiter >> 1]
            at = prefix.start
            junk = _junk_to(at, min(at, end), after_frame)
            if at >= end:
                after_noise[at] += junk
                continue
            noise = _long_noise(noise, after_frame, noise_to, at)
            noise_to = at
            after_noise[at] += junk + noise * NOISE_ENDS
            self._leave_header(prefix, self._sum_before(forward, at), after_frame)
        forward.in_noise = _long_noise(noise, after_frame, noise_to, end)
        return forward

    def _reach_tail(self, candidate_end: CandidateEnd, forward: BoundaryState, end: i64) -> None:
        """Forward step: add the paths through all candidates that end with a tail."""
        after_frame, after_noise = forward.after_frame, forward.after_noise
        scores, first, paused = candidate_end.scores, candidate_end.first, self.candidates.paused
        delimiters, data = self.candidates.tables.delimiters, self.candidates.data
        reached = 0.0
        for at in range(first, min(candidate_end.stop, end)):
            before = after_frame[at] + after_noise[at]
            if paused and delimiters[data[at]] == HEADER:
                before = self._sum_before(forward, at)
            reached += before * scores[at - first]
        after_frame[candidate_end.stop] += reached

    def _leave_header(self, prefix: PrefixScore, before: float, after_frame: vec[float]) -> None:
        """Forward step: continue the paths before a header with the candidates of its prefix."""
        candidates, at = self.candidates, prefix.start
        for length in range(i64(1), prefix.longest_truncated + 1):
            after_frame[at + length] += before * candidates.truncated(prefix, length)
        full = candidates.full_length(prefix, prefix.whole + prefix.bad_tail)
        if full > 0.0:
            after_frame[at + candidates.tables.length] += before * full

    def _backward_pass(self) -> None:
        backward, size, candidates = self.backward, self.size, self.candidates
        for at in range(size + 1):
            backward[at] = noise_to_end(self.ending, size - at)
        header: i64 = len(candidates.prefixes) - 1
        number: i64 = len(candidates.delimiters) - 1
        while number >= 0:
            delimiter = candidates.delimiters[number]
            number -= 1
            if delimiter & AT_TAIL:
                self._leave_tail(candidates.ends[delimiter >> 1], header)
                continue
            prefix = candidates.prefixes[delimiter >> 1]
            header = (delimiter >> 1) - 1
            score = self._from_header[delimiter >> 1] + self._sum_of_prefix(prefix)
            self._from_header[delimiter >> 1] = score
            start = prefix.start
            backward[start] += score * candidates.contact_score(start)
            for at in range(start):
                backward[at] += score * NOISE_TO_HEADER[start - at]

    def _leave_tail(self, candidate_end: CandidateEnd, header: i64) -> None:
        """Backward step: add the paths after a tail; `header` is the last header before it."""
        candidates, backward, first = self.candidates, self.backward, candidate_end.first
        delimiters, data, scores = (
            candidates.tables.delimiters,
            candidates.data,
            candidate_end.scores,
        )
        after = backward[candidate_end.stop]
        for at in range(first, candidate_end.stop):
            if delimiters[data[at]] != HEADER:
                backward[at] += after * scores[at - first]
        while header >= 0 and candidates.prefixes[header].start >= first:
            at = candidates.prefixes[header].start
            self._from_header[header] += after * scores[at - first]
            header -= 1

    def _sum_of_prefix(self, prefix: PrefixScore) -> float:
        backward, at, score, candidates = self.backward, prefix.start, 0.0, self.candidates
        for length in range(i64(1), prefix.longest_truncated + 1):
            score += candidates.truncated(prefix, length) * backward[at + length]
        full = candidates.full_length(prefix, prefix.whole + prefix.bad_tail)
        if full > 0.0:
            score += full * backward[at + candidates.tables.length]
        return score + self.cut_off_score(prefix)

    def _sum_of_paths(self, state: BoundaryState) -> float:
        total, noise = 0.0, LONG_NOISE[self.size] * NOISE_AT_END[self.ending]
        known, backward = state.after_frame, self.backward
        for at in range(min(i64(len(known)), self.size + 1)):
            total += known[at] * backward[at]
        for number, prefix in enumerate(self.candidates.prefixes):
            score = self._from_header[number]
            noise += LONG_NOISE[prefix.start] * NOISE_ENDS * score
            if prefix.start < len(state.after_noise):
                total += state.after_noise[prefix.start] * score
        return total + state.in_noise * noise

    def cut_off_score(self, prefix: PrefixScore) -> float:
        """The score of a frame that starts there and continues after the end of the span."""
        length, whole = self.size - prefix.start, self.candidates.tables.length
        if length >= whole or prefix.fit < length or self.ending == BOUNDARY:
            return 0.0
        score = prefix.scores[length] * INTACT
        return score if self.ending == OPEN else score / float(whole)

    def probability(self, start: i64, stop: i64, score: float) -> float:
        """The probability (0-1) of a candidate with that score from `start` to `stop`."""
        return self._sum_before(self.forward, start) * score * self.backward[stop] / self.total

    def _sum_before(self, forward: BoundaryState, at: i64) -> float:
        """The sum over all paths before an offset where a frame starts."""
        contact = self.candidates.contact_score(at)
        return forward.after_frame[at] * contact + forward.after_noise[at]

    def boundary_probability(self, at: i64) -> float:
        """The probability (0-1) that no frame, whole or damaged, spans that offset."""
        before = self.forward.after_frame[at] + self.forward.after_noise[at]
        return before * self.backward[at] / self.total

    def frame_probabilities(self) -> vec[float]:
        """By header: the probability (0-1) of a whole frame; 0 if a byte is illegal."""
        return self._frame_probabilities(self.forward, self.total)

    @property
    def follows_certain_frame(self) -> bool:
        """Whether a certain frame ends where the span starts."""
        known = self._state.after_frame
        return len(known) == 1 and known[0] == 1.0 and self._state.in_noise == 0.0

    @property
    def follows_frame(self) -> bool:
        """Whether the last decided row is a frame that the boundary state does not trust."""
        return self._state.ends_frame

    def frame_probabilities_after_rows(self) -> vec[float]:
        """`frame_probabilities` under the condition that all rows so far are right."""
        forward = self._forward_pass(_CERTAIN, self.size)
        return self._frame_probabilities(forward, self._sum_of_paths(_CERTAIN))

    def _frame_probabilities(self, forward: BoundaryState, total: float) -> vec[float]:
        candidates = self.candidates
        probabilities = vec[float]([0.0] * len(candidates.prefixes))
        for number, prefix in enumerate(candidates.prefixes):
            if prefix.whole > 0.0:
                score = self._sum_before(forward, prefix.start) * candidates.full_length(
                    prefix, prefix.whole
                )
                after = self.backward[prefix.start + candidates.tables.length]
                probabilities[number] = score * after / total
        return probabilities

    def boundary_state(self, at: i64, *, ends_frame: bool) -> BoundaryState:
        """The state at the boundary `at`, where a row ends, for the bytes after it."""
        forward = self._forward_pass(self._state, at)
        total = forward.in_noise
        for offset in range(at, self.size + 1):
            total += forward.after_frame[offset] + forward.after_noise[offset]
        return BoundaryState(
            _shares(forward.after_frame, at, total),
            _shares(forward.after_noise, at, total),
            forward.in_noise / total,
            ends_frame,
        )


def _resized(scores: vec[float], size: i64) -> vec[float]:
    """A copy of that size, cut off or filled up with 0."""
    copy = vec[float]([0.0] * size)
    for at in range(min(i64(len(scores)), size)):
        copy[at] = scores[at]
    return copy


def _long_noise(noise: float, after_frame: vec[float], start: i64, end: i64) -> float:
    """The score of long noise at `end`, which may have begun at each offset from `start`."""
    for at in range(start, end):
        noise = noise * NOISE_CONTINUES + NOISE_BEGINS * after_frame[at]
    return noise


def _junk_to(header: i64, end: i64, after_frame: vec[float]) -> float:
    """The score of junk that begins before `end` and ends at a header."""
    score = 0.0
    for at in range(max(i64(0), header - _LONGEST_JUNK), end):
        score += after_frame[at]
    return score * JUNK


def _shares(scores: vec[float], start: i64, total: float) -> vec[float]:
    shares = vec[float]([0.0] * (len(scores) - start))
    for at in range(start, i64(len(scores))):
        shares[at - start] = scores[at] / total
    return shares


# Segmentation


@final
@mypyc_attr(acyclic=True, free_list_len=1)
class Segment:
    """A segment of a decoded span: one row, except that adjacent noise becomes one row."""

    def __init__(
        self, start: i64, stop: i64, framed: bool, faults: i64, probability: float
    ) -> None:
        self.start = start
        self.stop = stop
        self.framed = framed
        self.faults = faults
        """An index of `FAULT_SETS`."""
        self.probability = probability
        """Of a frame that is legal but for an unusual reserve (0-1); 0 for any other segment."""

    @property
    def certain(self) -> bool:
        """Whether it is a frame without any fault, `ambiguous` included."""
        return self.framed and self.faults == 0

    def with_faults(self, faults: i64) -> Segment:
        """This segment with other faults."""
        return Segment(self.start, self.stop, self.framed, faults, self.probability)


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


def decode(posterior: ForwardBackward) -> list[Segment]:
    """The segmentation of a span."""
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
    _trust_neighbours(posterior, segments)
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


def _trust_neighbours(posterior: ForwardBackward, segments: list[Segment]) -> None:
    """Clear `ambiguous` from frames in step between a certain frame and another one.

    Another segmentation needs two faults that cancel each other out. This is rarer than the scores
    say, unless the frame could also be two truncated ones.
    """
    candidates, follows_certain = posterior.candidates, posterior.follows_certain_frame
    for number in range(i64(len(segments) - 1)):
        frame, after = segments[number], segments[number + 1]
        in_step, follows_certain = follows_certain, frame.certain
        if not in_step or frame.faults != AMBIGUOUS or frame.probability < LIKELY:
            continue
        if after.probability > 0.0 and is_plain(
            candidates.tables.unlearned, candidates.data, frame.start
        ):
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
