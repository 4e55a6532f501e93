"""Candidate segments of a span, and their scores: whole and damaged frames.

A frame starts with a header or ends with a tail, unless damage took them. `PrefixScore` scores the
bytes from a header on, `SuffixScore` those up to a tail, and `damaged_score` combines both. Scores
of prefixes and suffixes are cumulative: entry x is the score of the first (or last) x bytes.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, final

from librt.vecs import append, vec
from mypy_extensions import i64, mypyc_attr

from fte_sniff.protocol.framer.likelihood import (
    BROKEN,
    INTACT,
    NO_PAUSE_BETWEEN,
    PAUSE_WITHIN,
    UNUSUAL,
    WIDEST_CHANGE,
)
from fte_sniff.protocol.framer.predicates import kind_at, prefix_fit
from fte_sniff.protocol.framer.tables import HEADER, NO_KIND, TAIL, FrameTables
from fte_sniff.protocol.spec import NUM_OFFSET

_WIDEST_CHANGE: Final[i64] = WIDEST_CHANGE
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
        if kind != NO_KIND and fit < length and tables.open_reserve[kind * length] != 0:
            self.unusual = _unlearned_score(tables.unlearned, data, at, end, kind)
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


def _unlearned_score(tables: FrameTables, data: bytes, at: i64, end: i64, kind: i64) -> float:
    """The score of a frame of a kind on a line whose reserve is not known; 0 if it is not one."""
    length = tables.length
    if end - at < length or tables.delimiters[data[at + length - 1]] != TAIL:
        return 0.0
    if prefix_fit(tables, data, at, end, kind) < length:
        return 0.0
    score = tables.kind_shares[kind]
    for offset in range(length):
        score *= tables.byte_scores[(kind * length + offset) * 256 + i64(data[at + offset])]
    return score


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
