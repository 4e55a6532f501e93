"""Tests of a window of bytes: framed, legal, readable in one way only.

Each predicate is about the frame that starts at an offset, which must be complete. They grow
stricter:

    framed       a header and a tail at the right distance
    strict       legal at every byte: no undefined flag, and the line's constant in its reserve
    unsplit      strict, and hardly two truncated frames: no payload byte where one could end and
                 the next begin
    plain        unsplit, and does not end with the usual flags of another kind
    clear        framed, and no header or tail inside
    isolated     clear, and no tail after it that could make it the start of an overlong frame
    unambiguous  strict and isolated, with the usual NUM, and ends like its own kind
"""

from __future__ import annotations

from typing import Final

from librt.strings import read_i64_le
from librt.vecs import vec
from mypy_extensions import i64, u8

from fte_sniff.protocol.framer.tables import (
    EXACT,
    EXTRA,
    HEADER,
    LEARNING,
    NO_KIND,
    TAIL,
    UNKNOWN_CMD,
    FrameTables,
)
from fte_sniff.protocol.spec import NUM_OFFSET

_NUM: Final[i64] = NUM_OFFSET


def kind_at(tables: FrameTables, data: bytes, at: i64) -> i64:
    """The kind that header and CMD name; `NO_KIND` if they name none."""
    code = i64(data[at]) << 8 | i64(data[at + 1])
    return i64(tables.kind_of[code])


def is_framed(tables: FrameTables, data: bytes, at: i64) -> bool:
    """Whether a header and a tail stand at the distance of a frame."""
    delimiters = tables.delimiters
    return delimiters[data[at + tables.length - 1]] == TAIL and delimiters[data[at]] == HEADER


def is_strict(tables: FrameTables, data: bytes, at: i64) -> bool:
    """Whether the frame is legal at every byte."""
    if tables.delimiters[data[at + tables.length - 1]] != TAIL:
        return False
    kind = kind_at(tables, data, at)
    if kind == NO_KIND:
        return False
    row, legal, checked = kind * tables.length, tables.legal, tables.checked
    number = row
    while True:
        offset = i64(checked[number])
        if offset == 0:
            return True
        if legal[(row + offset) * 256 + i64(data[at + offset])] == 0:
            return False
        number += 1


def can_split(tables: FrameTables, data: bytes, at: i64) -> bool:
    """Whether a truncated frame could end within a payload at `at` and another one begin.

    That is a tail before a header, or a header before a CMD and a NUM.
    """
    delimiter = tables.delimiters[data[at]]
    if delimiter == 0:
        return False
    if delimiter == TAIL:
        return tables.delimiters[data[at + 1]] == HEADER
    return tables.is_value_cmd[data[at + 1]] == 1 and tables.is_num[data[at + 2]] == 1


def is_unsplit(tables: FrameTables, data: bytes, at: i64) -> bool:
    """Whether the frame is strict, and hardly two truncated ones."""
    if not is_strict(tables, data, at):
        return False
    kind = kind_at(tables, data, at)
    if tables.unused_num[kind] == 1 and tables.delimiters[data[at + _NUM]] != 0:
        return False
    number = kind * tables.length
    while True:
        offset = i64(tables.free[number])
        if offset == 0:
            return True
        if tables.delimiters[data[at + offset]] != 0 and can_split(tables, data, at + offset):
            return False
        number += 1


def is_plain(tables: FrameTables, data: bytes, at: i64) -> bool:
    """Whether the frame is unsplit and does not end with the usual flags of another kind."""
    if not is_unsplit(tables, data, at):
        return False
    return not _ends_like_another(tables, data, at, kind_at(tables, data, at))


def _ends_like_another(tables: FrameTables, data: bytes, at: i64, kind: i64) -> bool:
    """Whether a strict frame ends with another kind's usual flags; no NUM of 00 contradicts."""
    ending, stop = tables.flag_ending[kind], at + tables.length - 1
    if ending == 0 or tables.ends_flags[data[stop - 1]] == 0:
        return False
    if ending == 2 and data[at + _NUM] == 0:
        return False
    return any(data[stop - len(flags) : stop] == flags for flags in tables.usual_flags)


def ends_like_its_kind(tables: FrameTables, data: bytes, stop: i64, kind: i64) -> bool:
    """Whether the bytes before the tail score no higher as the end of another kind.

    Flags are compared with a payload where every byte is legal; flags with an illegal byte are not
    compared.
    """
    scores, last, flagged = tables.byte_scores, (kind + 1) * tables.length - 1, tables.flagged
    for rival in tables.rivals:
        own, other, shift = 1.0, 1.0, (rival - kind) * tables.length * 256
        as_payload = flagged[kind] == 1 and flagged[rival] == 1
        for before in range(i64(1), tables.ending_lengths[rival] + 1):
            byte = i64(data[stop - 1 - before])
            entry = (last - before) * 256 + byte
            own *= scores[entry]
            other *= tables.payload[byte] if as_payload else scores[entry + shift]
        if own < other and (own > 0.0 or flagged[kind] == 0):
            return False
    return True


def end_of_run(
    tables: FrameTables, marks: vec[u8], data: bytes, at: i64, end: i64, *, calm: bool
) -> tuple[i64, i64]:
    """The end of the run of plain frames from `at`, before `end`; unsplit ones on a calm line.

    The second number is the end of the first frame whose kind has the mark `LEARNING` in `marks`,
    -1 without one; the run has at most one frame after it, since it can change the tables.

    One operation tests eight bytes of most frames: they are legal and hold no header, without which
    nothing splits them.
    """
    length, delimiters, kind_of = tables.length, tables.delimiters, tables.kind_of
    base, forbidden = tables.word_base, tables.word_forbidden
    unused_num, flag_ending = tables.unused_num, tables.flag_ending
    last, tail = end - length, length - 1
    while at <= last:
        kind = i64(kind_of[i64(data[at]) << 8 | i64(data[at + 1])])
        if kind == NO_KIND or delimiters[data[at + tail]] != TAIL:
            break
        mark = marks[kind]
        certain = mark == EXACT
        if certain:
            word = read_i64_le(data, at + _NUM)
            if (word - base[kind]) & forbidden[kind] != 0:
                break
            num_fits = unused_num[kind] == 0 or delimiters[data[at + _NUM]] == 0
            certain = num_fits and not _holds_header(tables, word)
        elif mark == LEARNING:
            return _end_of_lesson(tables, data, at, last, calm=calm)
        if not (certain or is_unsplit(tables, data, at)):
            break
        if not calm and flag_ending[kind] != 0 and _ends_like_another(tables, data, at, kind):
            break
        at += length
    return at, -1


def _end_of_lesson(
    tables: FrameTables, data: bytes, at: i64, last: i64, *, calm: bool
) -> tuple[i64, i64]:
    """The end of the run from a frame that teaches, and of that frame; see `end_of_run`."""
    if not _continues_run(tables, data, at, calm=calm):
        return at, -1
    taught = at + tables.length
    if taught <= last and _continues_run(tables, data, taught, calm=calm):
        return taught + tables.length, taught
    return taught, taught


def _continues_run(tables: FrameTables, data: bytes, at: i64, *, calm: bool) -> bool:
    return is_unsplit(tables, data, at) if calm else is_plain(tables, data, at)


def _holds_header(tables: FrameTables, word: i64) -> bool:
    for header in tables.header_words:
        other = word ^ header
        # A zero byte borrows from the next one and so sets its own high bit.
        if (other - tables.low_bits) & ~other & tables.high_bits != 0:
            return True
    return False


def is_clear(tables: FrameTables, data: bytes, at: i64) -> bool:
    """Whether the frame is framed with no delimiter inside; False if it is incomplete."""
    length = tables.length
    if len(data) - at < length or not is_framed(tables, data, at):
        return False
    delimiters = tables.delimiters
    for offset in range(at + 1, at + length - 1):
        if delimiters[data[offset]] != 0:
            return False
    return True


def is_isolated(tables: FrameTables, data: bytes, at: i64, end: i64) -> bool:
    """Whether the frame is isolated; False if the bytes that decide this reach beyond `end`."""
    stop = at + tables.length
    return end - stop >= EXTRA and is_clear(tables, data, at) and _no_tail_from(tables, data, stop)


def _no_tail_from(tables: FrameTables, data: bytes, at: i64) -> bool:
    delimiters = tables.delimiters
    for offset in range(at, at + EXTRA):
        if delimiters[data[offset]] == TAIL:
            return False
    return True


def is_unambiguous(tables: FrameTables, data: bytes, at: i64, end: i64) -> bool:
    """Whether the frame is unambiguous; False if the bytes that decide this reach beyond `end`."""
    if end - at < tables.longest or not is_strict(tables, data, at):
        return False
    kind = kind_at(tables, data, at)
    if tables.unused_num[kind] == 1 and data[at + _NUM] != 0:
        return False
    if not ends_like_its_kind(tables, data, at + tables.length, kind):
        return False
    return is_isolated(tables, data, at, end)


# Searches: the offset of the first match that is complete before `end`, or -1


def find_unambiguous(tables: FrameTables, data: bytes, start: i64, end: i64) -> i64:
    """The next unambiguous frame, with the bytes after it that decide this."""
    delimiters = tables.delimiters
    for at in range(start, min(end, i64(len(data))) - tables.longest + 1):
        if delimiters[data[at]] == HEADER and is_unambiguous(tables, data, at, end):
            return at
    return -1


def find_framed(tables: FrameTables, data: bytes, start: i64, end: i64) -> i64:
    """The next framed bytes."""
    delimiters, last = tables.delimiters, tables.length - 1
    for at in range(max(start, i64(0)), min(end, i64(len(data))) - last):
        if delimiters[data[at]] == HEADER and delimiters[data[at + last]] == TAIL:
            return at
    return -1


def find_strict(tables: FrameTables, data: bytes, start: i64, end: i64) -> i64:
    """The next strict frame."""
    delimiters = tables.delimiters
    for at in range(start, min(end, i64(len(data))) - tables.length + 1):
        if delimiters[data[at]] == HEADER and is_strict(tables, data, at):
            return at
    return -1


def find_anchor(tables: FrameTables, data: bytes, start: i64) -> i64:
    """The next offset where long noise can end: two framed segments or one strict frame."""
    delimiters, length, last = tables.delimiters, tables.length, tables.length - 1
    at, end = start, i64(len(data)) - 2 * length + 1
    while True:
        while at < end and delimiters[data[at + last]] != TAIL:
            at += 1
        if at >= end:
            return -1
        if delimiters[data[at]] == HEADER and (
            is_framed(tables, data, at + length) or is_strict(tables, data, at)
        ):
            return at
        at += 1


# Partial matches


def prefix_fit(tables: FrameTables, data: bytes, at: i64, end: i64, kind: i64) -> i64:
    """How many bytes from `at`, up to `end`, are legal as the first bytes of a kind."""
    fit: i64 = 0
    length, row = tables.length, kind * tables.length
    while fit < length and at + fit < end:
        if tables.legal[(row + fit) * 256 + i64(data[at + fit])] == 0:
            break
        fit += 1
    return fit


def suffix_fit(tables: FrameTables, data: bytes, at: i64, end: i64, kind: i64) -> i64:
    """How many bytes before `end`, back to `at`, are legal as the last bytes of a kind."""
    fit: i64 = 0
    length, last = tables.length, (kind + 1) * tables.length - 1
    while fit < length and end - fit > at:
        if tables.legal[(last - fit) * 256 + i64(data[end - 1 - fit])] == 0:
            break
        fit += 1
    return fit


def framed_faults(tables: FrameTables, data: bytes, at: i64) -> i64:
    """The fault set that framed bytes show by themselves, in the order of a row."""
    kind = kind_at(tables, data, at)
    if kind == NO_KIND:
        return UNKNOWN_CMD
    row = kind * tables.length
    faults: i64 = 0
    number = row
    while True:
        offset = i64(tables.checked[number])
        if offset == 0:
            return faults
        if tables.legal[(row + offset) * 256 + i64(data[at + offset])] == 0:
            faults |= tables.offset_faults[row + offset]
        number += 1
