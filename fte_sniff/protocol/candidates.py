"""Candidates: spans of bytes that may have been one frame, and the score of each.

A candidate has 1 to 14 bytes. It is a whole frame, or has one damage, which leaves `head` first
bytes and `rest` last bytes of the frame:

    truncated     AA 01 01 03 E8 ..............      bytes lost: 1-9 are left, head + rest of them
    overlong      AA 01 01 03 77 E8 00 00 00 00 EE   1-4 bytes inserted: head + rest is 10
    changed       AB 01 01 03 E8 00 00 00 00 EE      1-6 adjacent bytes replaced

The score of a candidate is the probability of its bytes if they were sent as such a frame, divided
by their probability as random bytes, times the prior probability of the damage:

    score = sum over kinds, head and rest of
              share of the kind * prior[length, rest, head] * scores of the head and rest bytes

The score of a byte depends on kind and offset; it is 0 for an illegal byte. A random byte scores 1.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Final

import numpy as np

from fte_sniff.protocol.rows import IS_HEADER, NO_KIND, Array, Bools, Codes, Ints, kind_of
from fte_sniff.protocol.spec import (
    FRAME_LENGTH,
    HEADER_BYTES,
    HEADERS,
    KINDS,
    NUM_OFFSET,
    TAIL,
    Direction,
    FrameKind,
)

INTACT: Final = 0.9
"""Share of frames that arrive as they were sent; four kinds of damage and noise share the rest."""
EACH_DAMAGE: Final = (1 - INTACT) / 5
_MOST_INSERTED: Final = 4
_WIDEST_CHANGE: Final = 6
_BROKEN: Final = 1e-5
"""Score of a frame that was damaged twice, or in another way, and keeps its tail."""
_CONTAINING: Final = 1 / 4
"""Factor of an overlong frame that contains a whole one: rather, there is damage beside that."""
_UNUSUAL: Final = 0.002
"""Share of framed bytes with an illegal value: an unknown CMD, a bad motor, undefined flags."""

LONGEST: Final = FRAME_LENGTH + _MOST_INSERTED
"""Bytes of the longest damaged frame."""

# The score of each byte, by kind and offset


def _distribution(shares: Mapping[int, float]) -> Array:
    """The score of each byte value: `shares` for the values in it, the rest is uniform."""
    scores: Array = np.full(256, (1 - sum(shares.values())) / (256 - len(shares)))
    for byte, share in shares.items():
        scores[byte] = share
    return scores * 256


_PAYLOAD = _distribution(
    {0x00: 0.25, 0xFF: 0.08, **dict.fromkeys((1, 2, 3, *HEADER_BYTES, TAIL), 0.03)}
)
"""Payload bytes are not uniform, and imitate headers and tails more often than chance does."""


def _byte_scores(kind: FrameKind) -> Iterator[Array]:
    defaults = {field.start: field.default for field in kind.fields}
    for offset, legal in enumerate(kind.legal_bytes()):
        default = defaults.get(offset)
        if legal is None and default is None:
            yield _distribution({0: 0.5}) if offset == NUM_OFFSET else _PAYLOAD
            continue
        shares = dict.fromkeys(range(256), 0.0)
        own = legal or bytes(range(256))
        for byte in own:
            shares[byte] = 1 / len(own) if default is None else 0.1 / (len(own) - 1)
        if default is not None:
            shares[default] = 0.9
        yield np.array([shares[byte] * 256 for byte in range(256)])


def _share(kind: FrameKind) -> float:
    cmds = sum(len(one.cmds) for one in KINDS if one.direction == kind.direction)
    return len(kind.cmds) / cmds / len(HEADERS)


_SCORES: Final = np.zeros((len(KINDS) + 1, FRAME_LENGTH, 256), np.float32)
"""By kind, offset and byte; 0 for an illegal byte, and for `NO_KIND`."""
_SCORES[:-1] = [list(_byte_scores(kind)) for kind in KINDS]
LEGAL: Final = _SCORES[:-1] > 0
_SHARES: Final = np.array([*map(_share, KINDS), 0], np.float32)
_IS_FEEDBACK: Final = np.array([kind.direction is Direction.FEEDBACK for kind in KINDS])
_OF_DIRECTION: Final = _SHARES[:-1] * (np.arange(2)[:, None] == _IS_FEEDBACK)
"""By direction and kind: the share of frames."""
_HEADER: Final = np.float32(256 / len(HEADERS))
"""Score of a header alone."""
_LENGTHS: Final = np.arange(LONGEST + 1)
_ANY_FRAMED: Final = _UNUSUAL * 256 / len(HEADERS) * 256
"""Score of ten bytes that have a header and a tail, but are not a legal frame."""


def _damage() -> Array:
    """By length of a candidate, last and first bytes that are left: the prior of that damage."""
    prior: Array = np.zeros((LONGEST + 1, FRAME_LENGTH + 1, FRAME_LENGTH + 1))
    for left in range(1, FRAME_LENGTH):
        for head in range(left + 1):
            lost = EACH_DAMAGE / (FRAME_LENGTH - 1) / (left + 1)
            prior[left, left - head, head] = lost
            if FRAME_LENGTH - left <= _WIDEST_CHANGE:
                changed = EACH_DAMAGE / _WIDEST_CHANGE / (left + 1)
                prior[FRAME_LENGTH, left - head, head] = changed
    for head in range(1, FRAME_LENGTH):
        inserted = EACH_DAMAGE / _MOST_INSERTED / (FRAME_LENGTH - 1)
        prior[FRAME_LENGTH + 1 :, FRAME_LENGTH - head, head] = inserted
    for length in range(2, LONGEST + 1):
        for head in range(min(length, FRAME_LENGTH)):
            prior[length, 1 : min(length, FRAME_LENGTH) - head, head] += _BROKEN
    return prior.astype(np.float32)


_DAMAGE: Final = _damage()
_HEAD_ONLY: Final = np.ascontiguousarray(_DAMAGE[:, 0, 1:])
"""By length, and first bytes that are left."""
_REST_ONLY: Final = np.ascontiguousarray(_DAMAGE[:, 1:, 0])
"""By length, and last bytes that are left."""
_BOTH: Final = np.ascontiguousarray(_DAMAGE[:, 1:, 1:])
"""By length, last and first bytes that are left."""


def scores_of(block: Array, first: Ints, is_open: Bools) -> tuple[Array, Bools]:
    """Scores by offset, length and gap, and where whole frames are.

    The table has `LONGEST` offsets more before and after the gaps.
    """
    width, count = block.shape
    scores = np.zeros((LONGEST + width + 1 + LONGEST, LONGEST + 1, count))
    own = scores[LONGEST:]
    is_inside = np.arange(width)[:, None] >= first
    start, column = np.nonzero(IS_HEADER[block] & is_inside)
    left = width - start
    heads, kinds = _prefixes(block, start, column)
    by_length = (_HEAD_ONLY @ heads).T
    by_length[left[:, None] < _LENGTHS] = 0
    own[start, :, column] = by_length
    end, end_column = np.nonzero((block == TAIL) & is_inside)
    end += 1
    rests = _suffixes(block, end, end_column, first)
    by_direction = np.einsum("dk,rkn->drn", _OF_DIRECTION, rests)
    only = (_REST_ONLY @ by_direction.sum(axis=0)).T
    begins = end[:, None] - _LENGTHS
    only[begins < first[end_column][:, None]] = 0
    at = ((LONGEST + begins) * len(_LENGTHS) + _LENGTHS) * count + end_column[:, None]
    scores.reshape(-1)[at] += only
    numbers = np.full((width + 1 + LONGEST, count), -1)
    numbers[end, end_column] = np.arange(len(end))
    mates = numbers[start[:, None] + _LENGTHS[2:], column[:, None]]
    lengths, one = np.nonzero(mates.T >= 0)
    other, lengths = mates[one, lengths], lengths + 2
    is_feedback = (block[start, column] == HEADERS[Direction.FEEDBACK]).astype(np.intp)
    by_header = by_direction[is_feedback[one], :, other]
    pairs = _pairs(
        heads[:, one], rests[:, np.minimum(kinds[one], NO_KIND - 1), other], by_header, lengths
    )
    own[start[one], lengths, column[one]] += pairs
    framed = one[lengths == FRAME_LENGTH]
    whole = INTACT * heads[-1, framed]
    at, of = start[framed], column[framed]
    own[at, FRAME_LENGTH, of] = np.where(whole > 0, whole, own[at, FRAME_LENGTH, of] + _ANY_FRAMED)
    at, of = at[whole > 0], of[whole > 0]
    is_whole = np.zeros((width, count), np.bool_)
    is_whole[at, of] = True
    contains = is_whole.copy()
    for more in range(1, _MOST_INSERTED + 1):
        contains[np.maximum(at - more, 0), of] = True
        begins, gap = np.divmod(np.flatnonzero(contains), count)
        own[begins, FRAME_LENGTH + more, gap] *= _CONTAINING
    cut = np.flatnonzero((left < FRAME_LENGTH) & is_open[column])
    own[start[cut], left[cut], column[cut]] += INTACT * heads[left[cut] - 1, cut]
    return scores, is_whole


def _prefixes(block: Array, start: Ints, column: Ints) -> tuple[Array, Codes]:
    """By number of bytes - 1 and candidate: the score of a frame's first bytes; its kind.

    Header and CMD name the kind, so there is one kind from the second byte on.
    """
    width, count = block.shape
    flat, at = block.reshape(-1), start * count + column
    found = np.empty((FRAME_LENGTH, len(start)), np.float32)
    second = flat.take(at + count, mode="clip")
    kinds = kind_of(flat.take(at), second)
    kinds[start + 1 >= width] = NO_KIND
    found[0] = _SHARES.take(kinds) * 256
    for offset in range(1, FRAME_LENGTH):
        byte = flat.take(at + offset * count, mode="clip")
        score = _SCORES[kinds, offset, byte]
        score[start + offset >= width] = 0
        np.multiply(found[offset - 1], score, out=found[offset])
    found[0] = _HEADER
    return found, kinds


def _suffixes(block: Array, end: Ints, column: Ints, first: Ints) -> Array:
    """By number of bytes - 1, kind and candidate: the score of a frame's last bytes up to there."""
    count = block.shape[1]
    flat, at = block.reshape(-1), (end - 1) * count + column
    size = end - first[column]
    found = np.empty((FRAME_LENGTH, len(KINDS), len(end)), np.float32)
    found[0] = 256
    for back in range(1, FRAME_LENGTH):
        byte = flat.take(at - back * count, mode="clip")
        score = _SCORES[:-1, FRAME_LENGTH - 1 - back].take(byte, axis=1)
        score[:, size <= back] = 0
        np.multiply(found[back - 1], score, out=found[back])
    return found


def _pairs(heads: Array, rests: Array, by_header: Array, lengths: Ints) -> Array:
    """The scores of candidates with first and last bytes; `lengths` rise.

    The kind of the last bytes is that of the first ones, if there are two or more; after a header
    alone, it is any of its direction.
    """
    found = np.empty(len(lengths), np.float32)
    bounds = np.searchsorted(lengths, np.arange(LONGEST + 2)).tolist()
    for length in range(2, LONGEST + 1):
        own = slice(bounds[length], bounds[length + 1])
        left = _BOTH[length][:, 1:] @ heads[1:, own]
        found[own] = np.einsum("rp,rp->p", left, rests[:, own])
        found[own] += by_header[own] @ _BOTH[length][:, 0] * 256
    return found
