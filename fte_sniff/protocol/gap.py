"""How gaps are divided into frames, damaged frames and noise; all gaps at once.

A gap is the bytes between two bounds (`islands`). Its division is a sequence of candidates
(`candidates`) with noise between them. A division scores the product of the scores of its
candidates; noise of any length scores little more than what it costs to begin, and ends before a
header, or with the gap. Forward and backward sums over all divisions give the posterior probability
of each candidate. Those above 0.5 are segments (they cannot overlap); what is between them is
noise. So a byte is noise because no candidate with it is more probable than all others together.

The gaps of a table are right-aligned, so that a step of a sum is one operation over all of them:

    offset    0  1  2  3  4  5  6  7            scores[offset, length, gap]
    gap 0     .  .  .  AA 01 12 34 EE
    gap 1     .  AA 01 01 03 E8 00 00
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final, NamedTuple

import numpy as np
from numpy.lib.stride_tricks import as_strided

from fte_sniff.protocol.candidates import EACH_DAMAGE, LONGEST, scores_of
from fte_sniff.protocol.rows import IS_HEADER, Array, Bools, Codes, Ints
from fte_sniff.protocol.spec import FRAME_LENGTH

_NOISE_BEGINS: Final = EACH_DAMAGE / 30
_NOISE_CONTINUES: Final = 0.98
_MOST_GAPS: Final = 512
"""Gaps in a table."""


class DecidedSegments(NamedTuple):
    """Segments that are not noise, and bounds where noise ends, in columns; offsets in the data."""

    start: Ints
    stop: Ints
    """Equal to `start` for a bound."""
    probability: Array
    """Of a whole frame (0-1); 0 for all other segments, and for a frame that others contest."""


class Gaps(NamedTuple):
    """Some gaps of a buffer, or windows of them, in columns."""

    start: Ints
    stop: Ints
    first: Ints
    last: Ints
    """The segments that begin from `first` on, and before `last`, are taken."""
    is_open_before: Array
    """Whether a frame may have begun before the gap."""
    is_open_after: Array
    """Whether a frame may reach over the end of the gap."""


def divide(data: Codes, gaps: Gaps) -> Iterator[DecidedSegments]:
    """Divide gaps of a buffer of bytes, those of about the same size in one table."""
    order = np.argsort(gaps.stop - gaps.start, kind="stable")
    for at in range(0, len(order), _MOST_GAPS):
        own = order[at : at + _MOST_GAPS]
        yield _divide(data, Gaps(*(column[own] for column in gaps)))


def _divide(data: Codes, gaps: Gaps) -> DecidedSegments:
    """Divide gaps in one table."""
    sizes = gaps.stop - gaps.start
    width = int(sizes.max())
    at = gaps.stop - width + np.arange(width)[:, None]
    block = np.where(at >= gaps.start, data[np.maximum(at, 0)], 0).astype(np.uint8)
    first = width - sizes
    scores, is_whole = scores_of(block, first, gaps.is_open_after)
    posterior = _posteriors(scores, block, first, gaps.is_open_before)
    likely = np.flatnonzero(posterior > 0.5)
    start, length, gap = np.unravel_index(likely, posterior.shape)
    probability = posterior[start, length, gap]
    probability[(length != FRAME_LENGTH - 1) | ~is_whole[start, gap]] = 0
    start += (gaps.start - first)[gap]
    own = (start >= gaps.first[gap]) & (start < gaps.last[gap])
    return DecidedSegments(start[own], (start + length + 1)[own], probability[own])


def _posteriors(scores: Array, block: Array, first: Ints, is_open: Bools) -> Array:
    """By offset, length - 1 and gap: the probability that this candidate is a segment.

    Noise ends before a header, or with the gap.
    """
    width, count = block.shape
    is_header = IS_HEADER[block].astype(np.float64)
    begins = _NOISE_BEGINS * _NOISE_CONTINUES
    at, by_length, by_gap = scores.strides
    # By offset and length: the score of the candidate that ends behind the offset.
    ending = as_strided(scores[LONGEST:, 1:], (width, LONGEST, count), (at, by_length - at, by_gap))
    entering = np.zeros((LONGEST + width, count))
    before, noise = np.zeros((width + 1, count)), np.zeros((width + 1, count))
    before[first, np.arange(count)] = 1
    column = np.flatnonzero(is_open)
    for number in range(1, LONGEST):
        before[np.minimum(first[column] + number, width), column] = 1
    multiply, einsum = np.multiply, np.einsum
    for offset in range(width):
        now = entering[LONGEST + offset]
        multiply(noise[offset], is_header[offset], out=now)
        now += before[offset]
        multiply(before[offset], begins, out=noise[offset + 1])
        noise[offset + 1] += noise[offset] * _NOISE_CONTINUES
        recent = entering[LONGEST + offset : offset : -1]
        before[offset + 1] += einsum("lg,lg->g", recent, ending[offset])
    after, in_noise = np.zeros((width + 1 + LONGEST, count)), np.ones(count)
    after[width] = 1
    own = scores[LONGEST : LONGEST + width, 1:]
    for offset in range(width - 1, -1, -1):
        leaving = einsum("lg,lg->g", own[offset], after[offset + 1 : offset + 1 + LONGEST])
        multiply(in_noise, begins, out=after[offset])
        after[offset] += leaving
        in_noise *= _NOISE_CONTINUES
        leaving *= is_header[offset]
        in_noise += leaving
    own *= entering[LONGEST:, None] / (before[width] + noise[width])
    step, by_gap = after.strides
    own *= as_strided(after[1:], (width, LONGEST, count), (step, step, by_gap))
    return own
