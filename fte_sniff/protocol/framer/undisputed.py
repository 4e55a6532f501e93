"""Owns the short cut: damage that has one reading only, so that nothing needs weighing.

It must not read bytes otherwise than weighing does; it is only quicker, by far, for the damage that
is the most common: one piece before a frame, with no header or tail in it but its own. (Very rarely
weighing doubts that frame by a hair, where this does not.)

    damage frame ....      the frame is beyond doubt, as in `enclosed`

Pieces that together with the frame before or behind them could be one overlong frame are left to
weighing.
"""

from __future__ import annotations

from typing import Final

from mypy_extensions import i64

from fte_sniff.protocol.framer.fault_sets import BAD_HEADER, BAD_TAIL, NOISE, OVERLONG, TRUNCATED
from fte_sniff.protocol.framer.likelihood import LONGEST_JUNK, WIDEST_CHANGE
from fte_sniff.protocol.framer.places import (
    COUNT,
    HEADER,
    HEADERS,
    LENGTH,
    MARKS,
    NAMES_CMD,
    NO_KIND,
)
from fte_sniff.protocol.framer.reading import Stretch
from fte_sniff.protocol.framer.shapes import (
    BEHIND,
    faults_of_framed,
    head_fit,
    is_doubtless,
    kind_named,
    rest_fit,
)
from fte_sniff.protocol.structure import LONGEST_OVERLONG
from fte_sniff.protocol.table import FRAME_LENGTH

_ALONE: Final[i64] = LONGEST_OVERLONG - FRAME_LENGTH + 1
"""Bytes that are too many for one overlong frame together with a whole one."""

_LEAST_LEFT: Final[i64] = FRAME_LENGTH - WIDEST_CHANGE
_LONGEST: Final[i64] = LONGEST_OVERLONG
_JUNK: Final[i64] = LONGEST_JUNK
_STUB: Final[i64] = 2
"""Too few bytes to be alone, if the frame behind them can be the rest of theirs."""


def undisputed(data: bytes, at: i64) -> Stretch | None:
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
) -> Stretch | None:
    """The bytes up to `stop` with these faults, if there are any and a frame stands behind them."""
    if faults == 0 or not is_doubtless(data, stop, i64(len(data))):
        return None
    return Stretch(0, stop - at, framed, faults, 0.0)


def _headed(data: bytes, at: i64, mark: i64) -> Stretch | None:
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


def _headless(data: bytes, at: i64, mark: i64) -> Stretch | None:
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
