"""Lookup tables of a frame format: legal bytes, byte scores, delimiters, fault sets.

`FrameTables`, a pure function of a `FrameFormat` and of the reserve that a line is known to have,
is all that the framer knows of the protocol.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Final, final

from librt.vecs import vec
from mypy_extensions import i64, u8

from fte_sniff.protocol.framer import likelihood
from fte_sniff.protocol.spec import FTE_FORMAT, NUM_OFFSET, Fault, FrameFormat, FrameKind

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

EXTRA: Final[i64] = likelihood.MOST_INSERTED
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
    """Everything that the framer knows of a frame format, and of a line's reserve.

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
        self.is_cmd = vec[u8](_set_of(cmd for kind in kinds for cmd in kind.cmds))
        """By byte: 1 if it is the CMD of a kind."""
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
        self.payload = vec[float](likelihood.payload_scores(frame_format))
        """By byte: its score in a payload where every byte is legal."""
        self.byte_scores = vec[float](
            [
                score
                for kind, own in both
                for scores in likelihood.byte_scores(frame_format, kind, own)
                for score in scores
            ]
        )
        """By (kind * length + offset) * 256 + byte: the score of the byte in that kind."""
        self.kind_shares = vec[float]([likelihood.kind_share(frame_format, kind) for kind in kinds])
        """By kind: the share among all frames."""
        self.header_score = 256 / len(frame_format.headers)
        """The score of a header byte at the start of a frame."""
        self.foreign_score = likelihood.FOREIGN * self.header_score * 256
        """The score of a header, any bytes, and a tail at the right distance."""
        lost = likelihood.truncation_scores(size)
        self.truncation = vec[float](lost)
        """By number of bytes left: the score of one given run of bytes lost."""
        self.headless = vec[float](
            [likelihood.BROKEN + score for score in lost] + [0.0] * (likelihood.MOST_INSERTED + 1)
        )
        """By number of bytes left, up to `longest`: the score of the first bytes lost."""
        self.insertion = likelihood.insertion_score(size)
        """The score of a given number of bytes inserted at a given offset."""
        self.change = vec[float](likelihood.change_scores(size))
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
