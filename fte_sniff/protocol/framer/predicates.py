"""Bit-parallel tests: does this window match a frame shape.

It must not decide anything: the framer does. All that is asked about a place looks at the frame
there, which must be whole; nothing is read behind it unless that is said.

    framed     a header and a tail, whatever stands between
    strict     fits its kind at every place: no reserve byte set, no undefined flag
    undivided  strict, and not two truncated ones, unless the second was cut by chance behind what
               tells it from the rest of this one
    plain      undivided, and does not end as another kind's flags do
    calm       framed, and no header but the first and no tail but the last
    firm       calm, and no tail close behind it that could make it the beginning of an overlong one
    doubtless  strict and firm, NUM as usual, and does not end as another kind's flags do
"""

from __future__ import annotations

from typing import Final

from librt.strings import read_i64_le
from mypy_extensions import i64

from fte_sniff.protocol.codec import LONGEST_OVERLONG
from fte_sniff.protocol.framer.tables import (
    BRINGS_VALUES,
    CHECKED,
    ENDING,
    EVERY_HIGH_BIT,
    EVERY_LOW_BIT,
    FREE,
    FREE_NUM,
    HEADER,
    HEADER_WORDS,
    KIND_OF,
    LEGAL,
    LENGTH,
    MARKS,
    MAY_END_SO,
    NAMES_MOTOR,
    NO_KIND,
    PLACE_FAULTS,
    UNKNOWN_CMD,
    USUAL_FLAGS,
    WORD_FIRST,
    WORD_FORBIDDEN,
    WORD_TELLS,
)
from fte_sniff.protocol.spec import FRAME_LENGTH, NUM_OFFSET

BEHIND: Final[i64] = LONGEST_OVERLONG - FRAME_LENGTH
"""Bytes behind a frame with which it could be an overlong one."""

_NUM: Final[i64] = NUM_OFFSET


def kind_named(data: bytes, at: i64) -> i64:
    """The kind that the header and the CMD there name; `NO_KIND` where they name none."""
    return i64(KIND_OF[i64(data[at]) << 8 | i64(data[at + 1])])


def framed(data: bytes, at: i64) -> bool:
    """Whether ten bytes stand there between a header and a tail."""
    return MARKS[data[at + LENGTH - 1]] == ENDING and MARKS[data[at]] == HEADER


def strict(data: bytes, at: i64) -> bool:
    """Whether a frame stands there that fits its kind at every place."""
    return _kind_fitting(data, at) != NO_KIND


def _kind_fitting(data: bytes, at: i64) -> i64:
    """The kind of the strict frame there; `NO_KIND` where none stands."""
    if MARKS[data[at + LENGTH - 1]] != ENDING:
        return NO_KIND
    kind = kind_named(data, at)
    if kind == NO_KIND:
        return NO_KIND
    row = kind * LENGTH
    number = row
    while True:
        place = i64(CHECKED[number])
        if place == 0:
            return kind
        if LEGAL[(row + place) * 256 + i64(data[at + place])] == 0:
            return NO_KIND
        number += 1


def dividing(data: bytes, at: i64) -> bool:
    """Whether one truncated frame could end there, in a payload, and another begin, or begin with
    its motor."""
    mark = MARKS[data[at]]
    if mark == 0:
        return False
    if mark == ENDING:
        return MARKS[data[at + 1]] == HEADER
    return BRINGS_VALUES[data[at + 1]] == 1 and NAMES_MOTOR[data[at + 2]] == 1


def undivided(data: bytes, at: i64) -> bool:
    """Whether a strict frame stands there that could hardly be two truncated ones."""
    kind = _kind_fitting(data, at)
    if kind == NO_KIND or (FREE_NUM[kind] == 1 and MARKS[data[at + _NUM]] != 0):
        return False
    number = kind * LENGTH
    while True:
        place = i64(FREE[number])
        if place == 0:
            return True
        if MARKS[data[at + place]] != 0 and dividing(data, at + place):
            return False
        number += 1


def plain(data: bytes, at: i64) -> bool:
    """Whether an undivided frame stands there that does not end as another kind's flags do."""
    return undivided(data, at) and not _ends_as_flags(data, at)


def _ends_as_flags(data: bytes, at: i64) -> bool:
    """Whether a strict frame ends as another kind's flags do, and nothing else speaks for it."""
    may = MAY_END_SO[kind_named(data, at)]
    if may == 0 or (may == 2 and data[at + _NUM] == 0):
        return False
    end = at + LENGTH - 1
    for flags in USUAL_FLAGS:
        if data[end - 1] == flags[len(flags) - 1] and data[end - len(flags) : end] == flags:
            return True
    return False


def run_end(data: bytes, at: i64, end: i64, *, calm: bool) -> i64:
    """Where the run of plain frames that begins at `at` ends, at `end` at the latest; on a calm
    line, that of undivided ones."""
    last = end - LENGTH
    while at <= last and _goes_on(data, at, calm):
        at += LENGTH
    return at


def _goes_on(data: bytes, at: i64, calm: bool) -> bool:
    """Whether the frame there is plain, or, on a calm line, undivided. Most frames are told by
    eight of their bytes at once: they fit, and hold no header, without which nothing divides."""
    kind = kind_named(data, at)
    if kind == NO_KIND or MARKS[data[at + LENGTH - 1]] != ENDING:
        return False
    word = read_i64_le(data, at + _NUM)
    if (word - WORD_FIRST[kind]) & WORD_FORBIDDEN[kind] != 0:
        return False
    marked = WORD_TELLS[kind] == 0 or (FREE_NUM[kind] == 1 and MARKS[data[at + _NUM]] != 0)
    if (marked or _holds_header(word)) and not undivided(data, at):
        return False
    return calm or MAY_END_SO[kind] == 0 or not _ends_as_flags(data, at)


def _holds_header(word: i64) -> bool:
    """Whether a header is among the bytes from NUM to before the tail."""
    for header in HEADER_WORDS:
        other = word ^ header
        # A byte that is 0 borrows, and so gets the high bit that it did not have.
        if (other - EVERY_LOW_BIT) & ~other & EVERY_HIGH_BIT != 0:
            return True
    return False


def is_calm(data: bytes, at: i64) -> bool:
    """Whether a calm frame stands there; it may be cut off or none."""
    if len(data) - at < LENGTH or not framed(data, at):
        return False
    for place in range(at + 1, at + LENGTH - 1):
        if MARKS[data[place]] != 0:
            return False
    return True


def is_firm(data: bytes, at: i64, end: i64) -> bool:
    """Whether a firm frame stands there, and what must be known behind it before `end`."""
    return end - at >= LENGTH + BEHIND and is_calm(data, at) and _no_tail_behind(data, at)


def _no_tail_behind(data: bytes, at: i64) -> bool:
    for place in range(at + LENGTH, at + LENGTH + BEHIND):
        if MARKS[data[place]] == ENDING:
            return False
    return True


def is_doubtless(data: bytes, at: i64, end: i64) -> bool:
    """Whether a frame stands there beyond doubt, and what must be known behind it before `end`."""
    if end - at < LENGTH + BEHIND or not strict(data, at):
        return False
    if FREE_NUM[kind_named(data, at)] == 1 and data[at + _NUM] != 0:
        return False
    return is_firm(data, at, end) and not _ends_as_flags(data, at)


def doubtless_frame(data: bytes, start: i64, end: i64) -> i64:
    """Where the next frame beyond doubt stands, with what must be known behind it; -1 if none."""
    for at in range(start, min(end, i64(len(data))) - LENGTH - BEHIND + 1):
        if MARKS[data[at]] == HEADER and is_doubtless(data, at, end):
            return at
    return -1


def framed_from(data: bytes, start: i64, end: i64) -> i64:
    """Where the next ten framed bytes before `end` begin; -1 if none do."""
    for at in range(max(start, i64(0)), min(end, i64(len(data))) - LENGTH + 1):
        if MARKS[data[at]] == HEADER and MARKS[data[at + LENGTH - 1]] == ENDING:
            return at
    return -1


def strict_from(data: bytes, start: i64, end: i64) -> i64:
    """Where the next strict frame before `end` begins; -1 if none does."""
    for at in range(start, min(end, i64(len(data))) - LENGTH + 1):
        if MARKS[data[at]] == HEADER and strict(data, at):
            return at
    return -1


def anchor_from(data: bytes, start: i64) -> i64:
    """Where what can end long noise begins: a strict frame that ten bytes follow, or ten framed
    bytes before ten others; -1 if there is none yet."""
    for at in range(start, i64(len(data)) - 2 * LENGTH + 1):
        if MARKS[data[at]] != HEADER or MARKS[data[at + LENGTH - 1]] != ENDING:
            continue
        if framed(data, at + LENGTH) or strict(data, at):
            return at
    return -1


ANCHOR_REACH: Final[i64] = 2 * LENGTH - 1
"""An anchor that is not yet complete begins at most so many bytes before the end."""


def head_fit(data: bytes, at: i64, end: i64, kind: i64) -> i64:
    """How many of the bytes from `at` to `end` (0-10) fit the first places of a kind."""
    place: i64 = 0
    row = kind * LENGTH
    while place < LENGTH and at + place < end:
        if LEGAL[(row + place) * 256 + i64(data[at + place])] == 0:
            break
        place += 1
    return place


def rest_fit(data: bytes, at: i64, end: i64, kind: i64) -> i64:
    """How many of the bytes from `at` to `end` (0-10), from the last on, fit the last places."""
    place: i64 = 0
    row = (kind + 1) * LENGTH - 1
    while place < LENGTH and end - place > at:
        if LEGAL[(row - place) * 256 + i64(data[end - 1 - place])] == 0:
            break
        place += 1
    return place


def faults_of_framed(data: bytes, at: i64) -> i64:
    """The faults that ten framed bytes show by themselves, as `codec.frame_faults` names them."""
    kind = kind_named(data, at)
    if kind == NO_KIND:
        return UNKNOWN_CMD
    row = kind * LENGTH
    faults: i64 = 0
    number = row
    while True:
        place = i64(CHECKED[number])
        if place == 0:
            return faults
        if LEGAL[(row + place) * 256 + i64(data[at + place])] == 0:
            faults |= PLACE_FAULTS[row + place]
        number += 1
