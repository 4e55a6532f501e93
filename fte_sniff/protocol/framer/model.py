"""The model of a line: which bytes a frame may have, and how probable they are.

A score is a prior probability times a likelihood ratio: the probability of the bytes if they were
sent as described, divided by their probability as random bytes (1/256 each). So a random byte
scores 1. Scores are multiplied, not added as logarithms: a span is short enough for floats.

The assumptions:

- One frame in ten is damaged. The result hardly depends on this number.
- Five kinds of damage are equally likely, and so is each position of it: 1 to n-1 adjacent bytes of
  a frame of n bytes lost, 1-4 inserted, one bit flipped, 2-6 adjacent bytes replaced, 1-30 bytes of
  junk before a frame.
- Payload bytes are not uniform: 00, FF and 01-03 are common, and headers and tails get a surplus,
  so that a payload that imitates the first bytes of a frame is weak evidence.
- Reserve bytes are a property of the line. Where it has a constant, nearly every frame has it;
  elsewhere they are payload bytes (see `ReserveLearner`).
- Long noise (a wrong baud rate, a plugged-in cable) rarely begins, but lasts.
- A pause on the line is 64 times as likely between two frames as within one.

`FrameTables` has all of this for a frame format and a reserve, as tables by byte. Tests of a window
of bytes use them. Each is about the frame that starts at an offset, which must be complete. They
grow stricter:

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

from collections.abc import Iterable, Mapping, Sequence
from typing import Final, final

from librt.strings import read_i64_le
from librt.vecs import vec
from mypy_extensions import i64, u8

from fte_sniff.protocol.spec import FTE_FORMAT, NUM_OFFSET, Fault, FrameFormat, FrameKind

# Priors

DAMAGED: Final = 0.1
"""Share of frames that are damaged."""

INTACT: Final = 1 - DAMAGED
"""Share of frames that arrive as they were sent."""

_EACH_DAMAGE: Final = DAMAGED / 5

MOST_INSERTED: Final = 4
"""Largest number of bytes inserted into a frame."""

WIDEST_CHANGE: Final = 6
"""Largest number of adjacent bytes that one replacement changes."""

LONGEST_JUNK: Final = 30
"""Largest number of junk bytes before a frame; more is long noise."""

JUNK: Final = _EACH_DAMAGE / LONGEST_JUNK
"""Score of junk of one given length."""

NOISE_BEGINS: Final = 1e-5
"""Score of long noise that begins at a boundary between segments."""

NOISE_ENDS: Final = 1 / 500
"""Score of long noise that ends at a header."""

NOISE_CONTINUES: Final = 1 - NOISE_ENDS
"""Score of one more byte of long noise."""

FOREIGN: Final = 0.002
"""Share of frames with a header, a tail, and a CMD that is not in the frame table."""

UNUSUAL: Final = 0.003
"""Share of frames with undefined flags, or with a reserve that the line does not have elsewhere."""

BROKEN: Final = 1e-5
"""Score of a frame of one given length, damaged twice or in another way, that keeps its tail."""

PAUSE_WITHIN: Final = 1 / 64
"""Score of a pause within a frame, relative to one between frames."""

NO_PAUSE_BETWEEN: Final = 1 / 64
"""Score of two segments that meet without a pause, on a line whose bytes show other pauses."""

# Decision thresholds (posterior probabilities)

CERTAIN: Final = 0.9995
"""A whole frame below this probability is `ambiguous`."""

LIKELY: Final = 0.5
"""A frame with other faults is also `ambiguous` below this probability."""

SHOWN: Final = 0.03
"""A whole frame below this probability is not shown as a frame."""


# Scores of a frame format


def _distribution(shares: Mapping[int, float]) -> tuple[float, ...]:
    """The score of each byte value: `shares` for the values in it, the rest is uniform."""
    rest = (1.0 - sum(shares.values(), 0.0)) / (256 - len(shares))
    return tuple(256 * shares.get(byte, rest) for byte in range(256))


_UNUSED_NUM: Final = _distribution({0x00: 0.5})
_USUAL_FLAGS: Final = 0.9
"""Share of flag bytes that have their default value."""


def payload_scores(frame_format: FrameFormat) -> tuple[float, ...]:
    """The score of each byte value in a payload where every byte is legal."""
    common = dict.fromkeys((1, 2, 3, *frame_format.headers.values(), frame_format.tail), 0.03)
    return _distribution({0x00: 0.25, 0xFF: 0.08, **common})


def byte_scores(
    frame_format: FrameFormat, kind: FrameKind, legal: Sequence[bytes | None]
) -> list[tuple[float, ...]]:
    """For each offset in a frame of a kind the score of each byte value; 0 for illegal values.

    `legal` are the kind's legal bytes; see `FrameFormat.legal_bytes`.
    """
    payload = payload_scores(frame_format)
    defaults = {f.start: f.default for f in kind.fields if f.default is not None}
    scores: list[tuple[float, ...]] = []
    for offset, own in enumerate(legal):
        if own is not None or offset in defaults:
            scores.append(_legal_scores(own or bytes(range(256)), defaults.get(offset)))
        elif offset == NUM_OFFSET and not kind.names_motor:
            scores.append(_UNUSED_NUM)
        else:
            scores.append(payload)
    return scores


def _legal_scores(legal: bytes, default: int | None) -> tuple[float, ...]:
    scores = [0.0] * 256
    for byte in legal:
        scores[byte] = 256 / len(legal)
        if default is not None:
            rest = (1 - _USUAL_FLAGS) / (len(legal) - 1)
            scores[byte] = 256 * (_USUAL_FLAGS if byte == default else rest)
    return tuple(scores)


def kind_share(frame_format: FrameFormat, kind: FrameKind) -> float:
    """The share of a kind among all frames: headers are equally likely, and CMDs of a header."""
    same_header = [k for k in frame_format.kinds if k.direction == kind.direction]
    cmds = sum(len(k.cmds) for k in same_header)
    return len(kind.cmds) / cmds / len(frame_format.headers)


def truncation_scores(length: int) -> tuple[float, ...]:
    """By number of bytes left: the score of one given run of bytes lost from `length` bytes."""
    return (0.0, *(_EACH_DAMAGE / (length - 1) / (left + 1) for left in range(1, length)))


def insertion_score(length: int) -> float:
    """The score of a given number of bytes inserted at a given offset of `length` bytes."""
    return _EACH_DAMAGE / MOST_INSERTED / (length - 1)


def change_scores(length: int) -> tuple[float, ...]:
    """By width: the score of that many bytes changed at a given offset of `length` bytes."""
    flipped = _EACH_DAMAGE / length / 8
    widths = range(2, WIDEST_CHANGE + 1)
    return (0.0, flipped, *(_EACH_DAMAGE / 5 / (length + 1 - width) for width in widths))


# Noise

OPEN: Final[i64] = 0
"""More bytes may follow the span at once."""
CLOSED: Final[i64] = 1
"""Silence or the end of the stream follows the span."""
BOUNDARY: Final[i64] = 2
"""No frame continues after the span."""

_LONGEST_SPAN: Final = 512
"""Length of the noise tables; the framer decodes shorter spans only."""

NOISE_AT_END: Final[vec[float]] = vec[float]([1.0, NOISE_ENDS, NOISE_ENDS])
"""By ending: the score of long noise at the end of a span."""

_LENGTHS: Final = range(_LONGEST_SPAN + 1)


def _to_header(length: int) -> float:
    if not length:
        return 0.0
    long = NOISE_BEGINS * NOISE_CONTINUES ** (length - 1) * NOISE_ENDS
    return long + (JUNK if length <= LONGEST_JUNK else 0.0)


def _best_run(length: int) -> float:
    if length <= LONGEST_JUNK:
        return JUNK
    return NOISE_BEGINS * NOISE_ENDS * NOISE_CONTINUES ** (length - 1)


def _to_end(ending: i64, length: int) -> float:
    if not length:
        return 1.0
    lengths = LONGEST_JUNK + 1 - length if ending == OPEN else 1
    junk = JUNK * lengths if length <= LONGEST_JUNK else 0.0
    return junk + NOISE_BEGINS * NOISE_CONTINUES ** (length - 1) * NOISE_AT_END[ending]


# By length in bytes:
NOISE_RUN: Final[vec[float]] = vec[float]([_best_run(length) for length in _LENGTHS])
"""The score of noise, as the likelier of junk and long noise."""

LONG_NOISE: Final[vec[float]] = vec[float]([NOISE_CONTINUES**length for length in _LENGTHS])
"""The score of long noise that continues."""

NOISE_TO_HEADER: Final[vec[float]] = vec[float]([_to_header(length) for length in _LENGTHS])
"""The score of noise, short or long, before a header."""

_TO_END: Final[vec[float]] = vec[float](
    [_to_end(ending, length) for ending in (OPEN, CLOSED, BOUNDARY) for length in _LENGTHS]
)


def noise_to_end(ending: i64, length: i64) -> float:
    """The score of `length` bytes of noise up to the end of a span; 1 for none."""
    return _TO_END[ending * (_LONGEST_SPAN + 1) + length]


# Fault sets

_ORDER: Final = (
    Fault.UNKNOWN_CMD,
    Fault.BAD_MOTOR,
    Fault.BAD_HEADER,
    Fault.BAD_TAIL,
    Fault.TRUNCATED,
    Fault.OVERLONG,
    Fault.NOISE,
    Fault.UNDEFINED_FLAGS,
    Fault.RESERVED_NONZERO,
    Fault.AMBIGUOUS,
)
"""The order of the faults in a row; the framer reports no others."""

_BITS: Final = {fault: 1 << number for number, fault in enumerate(_ORDER)}


def fault_set(faults: Iterable[Fault]) -> int:
    """The faults as one number, an index of `FAULT_SETS`."""
    return sum(_BITS[fault] for fault in faults)


UNKNOWN_CMD: Final[i64] = _BITS[Fault.UNKNOWN_CMD]
BAD_HEADER: Final[i64] = _BITS[Fault.BAD_HEADER]
BAD_TAIL: Final[i64] = _BITS[Fault.BAD_TAIL]
TRUNCATED: Final[i64] = _BITS[Fault.TRUNCATED]
OVERLONG: Final[i64] = _BITS[Fault.OVERLONG]
NOISE: Final[i64] = _BITS[Fault.NOISE]
RESERVED_NONZERO: Final[i64] = _BITS[Fault.RESERVED_NONZERO]
AMBIGUOUS: Final[i64] = _BITS[Fault.AMBIGUOUS]

FAULT_SETS: Final[list[tuple[Fault, ...]]] = [
    tuple([fault for fault in _ORDER if number & _BITS[fault]])
    for number in range(1 << len(_ORDER))
]
"""By number: the faults in the order of a row."""

# Codes in the tables

HEADER: Final[u8] = 1
"""In `FrameTables.delimiters`: the byte is a header."""
TAIL: Final[u8] = 2
"""In `FrameTables.delimiters`: the byte is the tail."""

NO_KIND: Final[i64] = 255
"""In `FrameTables.kind_of`: header and CMD name no kind."""

EXACT: Final[u8] = 1
"""Mark of a kind for which one operation tests eight bytes; see `word_exact`."""
LEARNING: Final[u8] = 2
"""Mark of a kind of which one more frame can change what is known of the line's reserve."""

EXTRA: Final[i64] = MOST_INSERTED
"""Bytes by which a damaged frame is at most longer than a whole one."""

_WORD: Final = 8
"""Bytes that are tested at once."""

_LegalBytes = Sequence[bytes | None]

Reserve = Mapping[tuple[int, int], int]
"""The constants that a line has in its open reserve, by kind and offset."""

_MOST_VARIANTS: Final = 32
"""Tables of one format that are kept for lines with other reserves."""


def _set_of(values: Iterable[int]) -> bytes:
    members = set(values)
    return bytes(byte in members for byte in range(256))


def _delimiters(frame_format: FrameFormat) -> bytes:
    delimiters = bytearray(256)
    for header in frame_format.headers.values():
        delimiters[header] = HEADER
    delimiters[frame_format.tail] = TAIL
    return bytes(delimiters)


def _unused_num(kind: FrameKind, legal: _LegalBytes) -> bool:
    return legal[NUM_OFFSET] is None and not kind.names_motor


def _by_kind(offsets: Iterable[list[int]], size: int) -> vec[u8]:
    """Offsets of each kind, padded with 0 to `size`."""
    return vec[u8](b"".join(bytes(own).ljust(size, b"\0") for own in offsets))


def _word_test(legal: _LegalBytes) -> tuple[int, int, bool]:
    """Base and forbidden bits: the bytes from NUM to before the tail, as one little-endian number,
    are legal if `(word - base) & forbidden` is 0; and whether that is exact."""
    base = forbidden = 0
    exact = len(legal) == NUM_OFFSET + _WORD
    for number, values in enumerate(legal[NUM_OFFSET:-1] if exact else ()):
        if values is None:
            continue
        lowest, used = min(values), 0
        for value in values:
            used |= value - lowest
        mask = 0xFF ^ used
        fitting = [value for value in range(256) if (value - lowest) & 0xFF & mask == 0]
        # A smaller byte borrows from the next one, and never fits itself.
        exact = exact and fitting == sorted(values)
        base |= lowest << 8 * number
        forbidden |= mask << 8 * number
    return base, forbidden, exact


def _repeated(value: int) -> int:
    return int.from_bytes(bytes([value]) * (_WORD - 1), "little")


def _usual_flags(kind: FrameKind) -> bytes:
    """The default flags at the end of a kind's payload; empty without flags."""
    return bytes(field.default for field in kind.fields if field.default is not None)


def _ending_length(kind: FrameKind, size: int) -> int:
    """Bytes before the tail that can be mistaken for this kind's: its flags, or all reserve."""
    return len(_usual_flags(kind)) if kind.fields else size - NUM_OFFSET - 1


def _flag_ending(kind: FrameKind, legal: _LegalBytes) -> int:
    if legal[-2] is not None:
        return 0
    return 1 if kind.names_motor else 2


def _offset_fault(kind: FrameKind, legal: _LegalBytes, offset: int) -> int:
    if not NUM_OFFSET <= offset < len(legal) - 1 or legal[offset] is None:
        return 0
    if offset in kind.reserved:
        # A reserve that differs from a constant other than 00 is unusual, but no fault.
        return fault_set([Fault.RESERVED_NONZERO]) if legal[offset] == b"\x00" else 0
    return fault_set(field.fault for field in kind.fields if field.start == offset and field.fault)


@final
class FrameTables:
    """All that the framer knows of the protocol: a frame format, and a line's reserve.

    A kind is its index in the frame table. Tables "by kind and offset" have the index
    `kind * length + offset`.
    """

    def __init__(
        self,
        frame_format: FrameFormat,
        reserve: Reserve | None = None,
        unlearned: FrameTables | None = None,
    ) -> None:
        """The tables for a line that has these constants in its open reserve."""
        kinds, size = frame_format.kinds, frame_format.length
        constants: list[dict[int, int]] = [{} for _ in kinds]
        for (code, offset), byte in (reserve or {}).items():
            constants[code][offset] = byte
        legal = [
            frame_format.legal_bytes(kind, own) for kind, own in zip(kinds, constants, strict=True)
        ]
        self._format = frame_format
        self._variants: dict[tuple[tuple[tuple[int, int], int], ...], FrameTables] = {}
        self.unlearned = unlearned or (FrameTables(frame_format) if reserve else self)
        """The tables for a line whose reserve is not known."""
        both = list(zip(kinds, legal, strict=True))
        words = [_word_test(values) for values in legal]

        self.length: i64 = size
        """Bytes in every frame."""
        self.longest: i64 = size + EXTRA
        """Bytes in the longest damaged frame."""
        self.kind_count: i64 = len(kinds)
        self.lookahead: i64 = 2 * size
        """Bytes after a framed segment with which it is decided; or pending at `widest`."""
        self.deadline: i64 = 3 * size
        """Bytes from the start of a framed segment to the offset where it must be decided."""
        self.widest: i64 = 4 * size + EXTRA
        """Bytes that are decoded at once, at most, while bytes keep coming."""
        self.lead: i64 = 3 * size + 2
        """Bytes before an anchor that are decoded after long noise."""

        self.delimiters = vec[u8](_delimiters(frame_format))
        """By byte: `HEADER`, `TAIL`, or 0."""
        self.kind_of = vec[u8](frame_format.kind_codes(NO_KIND))
        """By header * 256 + CMD: the kind, or `NO_KIND`."""
        self.is_value_cmd = vec[u8](
            _set_of(cmd for kind in kinds if kind.fields for cmd in kind.cmds)
        )
        """By byte: 1 if it is the CMD of a kind with fields."""
        motors = [own[NUM_OFFSET] or b"" for kind, own in both if kind.names_motor]
        self.is_num = vec[u8](_set_of([0, *b"".join(motors)]))
        """By byte: 1 if it is a usual NUM: 00, or a motor."""

        every = range(256)
        self.legal = vec[u8](
            b"".join(_set_of(every if one is None else one) for own in legal for one in own)
        )
        """By (kind * length + offset) * 256 + byte: 1 if the byte is legal."""
        inside = range(NUM_OFFSET, size - 1)
        self.checked = _by_kind(([at for at in inside if own[at]] for own in legal), size)
        """By kind, padded with 0 to `length`: the payload offsets where some bytes are illegal."""
        self.free = _by_kind(
            ([at for at in inside[_unused_num(*one) :] if one[1][at] is None] for one in both), size
        )
        """By kind, padded with 0 to `length`: the payload offsets where every byte is legal."""
        self.open_reserve = _by_kind((list(kind.open_reserve) for kind in kinds), size)
        """By kind, padded with 0 to `length`: the offsets of reserve that each line chooses."""
        self.unused_num = vec[u8](bytes(_unused_num(*one) for one in both))
        """By kind: 1 if NUM has no meaning."""
        self.headers = vec[u8](bytes(frame_format.header(kind) for kind in kinds))
        """By kind: the header."""
        self.usual_flags = tuple({flags: None for kind in kinds if (flags := _usual_flags(kind))})
        """The flags before the tail in nearly every frame that has flags."""
        self.ends_flags = vec[u8](_set_of(flags[-1] for flags in self.usual_flags))
        """By byte: 1 if it is the last of them."""
        self.flagged = vec[u8](bytes(bool(_usual_flags(kind)) for kind in kinds))
        """By kind: 1 if it has flags."""
        endings = [_ending_length(kind, size) for kind in kinds]
        self.ending_lengths = vec[i64](endings)
        """By kind: the bytes before the tail that are typical of it; 0 if there are none."""
        self.rivals = vec[i64]([code for code, length in enumerate(endings) if length])
        """The kinds with such bytes."""
        self.flag_ending = vec[u8](bytes(_flag_ending(*one) for one in both))
        """By kind: whether the payload can end like the flags of another kind: 0 no, 1 yes, 2 yes,
        but a NUM of 00 is evidence for this kind."""
        self.offset_faults = vec[i64](
            [_offset_fault(*one, offset) for one in both for offset in range(size)]
        )
        """By kind and offset: the fault set of a frame with an illegal byte there."""

        # The eight bytes from NUM to the tail as one number, for frames of ten bytes
        self.word_base = vec[i64]([base for base, _, _ in words])
        """By kind: what to subtract from the number,"""
        self.word_forbidden = vec[i64]([forbidden for _, forbidden, _ in words])
        """and the bits that are 0 in the difference if the frame is legal."""
        self.word_exact = vec[u8](bytes(exact for _, _, exact in words))
        """By kind: 1 if this test is exact; 0 if the bytes must be tested one by one."""
        self.low_bits: i64 = _repeated(0x01)
        self.high_bits: i64 = _repeated(0x80)
        self.header_words = vec[i64]([_repeated(h) for h in frame_format.headers.values()])
        """Each header, repeated at every offset from NUM to before the tail."""

        # Scores
        self.payload = vec[float](payload_scores(frame_format))
        """By byte: its score in a payload where every byte is legal."""
        self.byte_scores = vec[float](
            [
                score
                for kind, own in both
                for scores in byte_scores(frame_format, kind, own)
                for score in scores
            ]
        )
        """By (kind * length + offset) * 256 + byte: the score of the byte in that kind."""
        self.kind_shares = vec[float]([kind_share(frame_format, kind) for kind in kinds])
        """By kind: the share among all frames."""
        self.header_score = 256 / len(frame_format.headers)
        """The score of a header byte at the start of a frame."""
        self.foreign_score = FOREIGN * self.header_score * 256
        """The score of a header, any bytes, and a tail at the right distance."""
        lost = truncation_scores(size)
        self.truncation = vec[float](lost)
        """By number of bytes left: the score of one given run of bytes lost."""
        self.headless = vec[float]([BROKEN + score for score in lost] + [0.0] * (MOST_INSERTED + 1))
        """By number of bytes left, up to `longest`: the score of the first bytes lost."""
        self.insertion = insertion_score(size)
        """The score of a given number of bytes inserted at a given offset."""
        self.change = vec[float](change_scores(size))
        """By width: the score of that many adjacent bytes changed at a given offset."""

    def with_reserve(self, reserve: Reserve) -> FrameTables:
        """The tables of the same format for a line that has these constants in its reserve."""
        if not reserve:
            return self
        key = tuple(sorted(reserve.items()))
        tables = self._variants.get(key)
        if tables is None:
            if len(self._variants) >= _MOST_VARIANTS:
                self._variants.clear()
            tables = self._variants[key] = FrameTables(self._format, reserve, self)
        return tables


FTE_TABLES: Final = FrameTables(FTE_FORMAT)
"""The tables of this protocol's frames, for a line whose reserve is not known."""


# Tests of a window of bytes

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


# The reserve of a line

KNOWN: Final[i64] = 8
"""Frames in a row with the same byte after which it is a constant."""

MOST_COUNTED: Final[i64] = 32
"""Frames with the constant that are counted, at most."""

CONTRADICTION: Final[i64] = 4
"""How many frames with the constant one frame without it outweighs."""

ENOUGH: Final[i64] = 3
"""Frames in a row with the same other byte that end a constant."""

_OPEN: Final[i64] = -1


@final
class ReserveLearner:
    """Learns the open reserve of one line from its frames, for each kind and offset.

    The protocol document states no value for the reserve of control frames. Each host has its own:
    00, FF, the bytes of an earlier frame, or anything. So a reserve byte is evidence only as far as
    the line has shown what it usually is:

        open       nothing is known, or the byte changes: it is scored like a payload byte
        constant   `KNOWN` frames in a row had this byte: another byte is unusual, and
                   `reserved_nonzero` if the constant is 00

    A constant is given up if `ENOUGH` frames in a row contradict it with the same byte, or if many
    do: each one outweighs `CONTRADICTION` frames that agree, of which at most `MOST_COUNTED` are
    counted.

    A kind of which fewer than `KNOWN` frames were seen has the constants of another kind with the
    same header: those at the same offsets, and the byte that fills its reserve at all others. (A
    reset is rare, and the host that sends it fills the reserve in the same way.)
    """

    def __init__(self, tables: FrameTables) -> None:
        """`tables` are those of a line whose reserve is not known."""
        self._unknown = tables
        self.reset()

    def reset(self) -> None:
        """Forget everything: a new stream starts."""
        tables = self._unknown
        count, size = tables.kind_count, tables.kind_count * tables.length
        self.tables = tables
        """The tables for the reserve as it is known so far."""
        self._bytes = vec[i64]([_OPEN] * size)
        """By kind and offset: the byte of the last frame."""
        self._repeats = vec[i64]([i64(0)] * size)
        """By kind and offset: the frames in a row that had it, at most `KNOWN`."""
        self._support = vec[i64]([i64(0)] * size)
        """By kind and offset: the frames with the constant, less those without it."""
        self._constants = vec[i64]([_OPEN] * size)
        """By kind and offset: the constant, or `_OPEN`."""
        self._seen = vec[i64]([i64(0)] * count)
        """By kind: the frames seen, at most `KNOWN`."""
        self.marks = vec[u8]([u8(0)] * count)
        """By kind: `LEARNING`, else `EXACT`, else 0."""
        for kind in range(count):
            self._mark(kind, tables.open_reserve[kind * tables.length] != 0)

    def observe(self, data: bytes, at: i64) -> None:
        """Learn from the frame at an offset, and bring `tables` up to date."""
        tables = self._unknown
        kind = kind_at(tables, data, at)
        if kind == NO_KIND or tables.open_reserve[kind * tables.length] == 0:
            return
        row = kind * tables.length
        changed, settled = False, True
        if self._seen[kind] < KNOWN:
            self._seen[kind] += 1
            changed = self._seen[kind] == KNOWN
        for number in range(row, row + tables.length):
            offset = i64(tables.open_reserve[number])
            if offset == 0:
                break
            if self._count(row + offset, i64(data[at + offset])):
                changed = True
            place = row + offset
            if self._support[place] < MOST_COUNTED or self._bytes[place] != self._constants[place]:
                settled = False
        self._mark(kind, not settled)
        if changed:
            self.tables = tables.with_reserve(self._reserve())

    def _mark(self, kind: i64, learning: bool) -> None:
        exact = EXACT if self._unknown.word_exact[kind] == 1 else u8(0)
        self.marks[kind] = LEARNING if learning else exact

    def _count(self, place: i64, byte: i64) -> bool:
        """Count one byte at a kind and offset; True if it makes or ends a constant there."""
        repeats = self._repeats[place] + 1 if byte == self._bytes[place] else i64(1)
        self._bytes[place], self._repeats[place] = byte, min(repeats, KNOWN)
        constant = self._constants[place]
        if constant == _OPEN:
            if repeats < KNOWN:
                return False
            self._constants[place], self._support[place] = byte, repeats
        elif byte == constant:
            self._support[place] = min(self._support[place] + 1, MOST_COUNTED)
            return False
        else:
            self._support[place] -= CONTRADICTION
            if self._support[place] > 0 and repeats < ENOUGH:
                return False
            self._constants[place] = _OPEN
        return True

    def _reserve(self) -> dict[tuple[int, int], int]:
        """The constants of the line, by kind and offset."""
        tables, reserve = self._unknown, dict[tuple[int, int], int]()
        for kind in range(tables.kind_count):
            row = kind * tables.length
            for number in range(row, row + tables.length):
                offset = i64(tables.open_reserve[number])
                if offset == 0:
                    break
                known = self._seen[kind] == KNOWN
                constant = self._constants[row + offset] if known else self._usual(kind, offset)
                if constant != _OPEN:
                    reserve[int(kind), int(offset)] = int(constant)
        return reserve

    def _usual(self, kind: i64, offset: i64) -> i64:
        """The constant of known kinds with the same header at an offset, or at all of theirs."""
        tables = self._unknown
        for other in range(tables.kind_count):
            if tables.headers[other] != tables.headers[kind] or self._seen[other] < KNOWN:
                continue
            constant = self._constants[other * tables.length + offset]
            if constant == _OPEN:
                constant = self._only_byte(other)
            if constant != _OPEN:
                return constant
        return _OPEN

    def _only_byte(self, kind: i64) -> i64:
        """The byte that fills a kind's reserve; `_OPEN` if there are several or none."""
        tables, row = self._unknown, kind * self._unknown.length
        only = _OPEN
        for number in range(row, row + tables.length):
            offset = i64(tables.open_reserve[number])
            if offset == 0:
                break
            constant = self._constants[row + offset]
            if constant == _OPEN or (only != _OPEN and constant != only):
                return _OPEN
            only = constant
        return only
