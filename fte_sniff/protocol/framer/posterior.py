"""Posterior probabilities of a span's segments: the forward-backward algorithm.

The model is a hidden semi-Markov model: its states are segments (frame, damaged frame, junk, long
noise) of variable length. The passes visit headers and tails only; the bytes between are summed up
at once. The framer limits the length of a span.
"""

from __future__ import annotations

from typing import Final, final

from librt.vecs import vec
from mypy_extensions import i64, mypyc_attr

from fte_sniff.protocol.framer.candidates import AT_TAIL, CandidateEnd, CandidateSet, PrefixScore
from fte_sniff.protocol.framer.likelihood import (
    BOUNDARY,
    INTACT,
    JUNK,
    LONG_NOISE,
    LONGEST_JUNK,
    NOISE_AT_END,
    NOISE_BEGINS,
    NOISE_CONTINUES,
    NOISE_ENDS,
    NOISE_TO_HEADER,
    OPEN,
    noise_to_end,
)
from fte_sniff.protocol.framer.tables import HEADER


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


_LONGEST_JUNK: Final[i64] = LONGEST_JUNK
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

    # Posterior probabilities

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
