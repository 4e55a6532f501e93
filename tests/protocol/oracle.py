"""Independent references for the framer: regular expressions for the predicates, and a slow model.

The regular expressions are built from the frame table alone. Each one expresses what the docstring
of `model` says of the predicate with its name.

The model takes the numbers of `model`, and nothing else from the framer: no spans, no
streaming, no shortcuts. Every way in which a frame of every kind can be damaged is written out and
scored byte by byte; every offset of the whole stream can start any of them; and the scores of all
segmentations are summed over the whole stream, from both sides. A stream is a sequence of whole
frames, damaged frames and noise:

    whole      INTACT           x the frame
    lost       truncation[n]    x the frame without some run of bytes, n left
    inserted   insertion        x the frame with 1-4 bytes (each scores 1) after one of its first 9
    changed    change[w]        x the frame with a run of w bytes (each scores 1) changed
    broken     BROKEN           x the legal bytes at the start, then the legal bytes at the end
    unusual    UNUSUAL          x header, CMD, NUM and tail; the bytes between score 1
    reserve    UNUSUAL          x the frame, on a line whose reserve is not known
    foreign    FOREIGN          x header and tail
    junk       JUNK             for each length up to 30, before a header or the end
    noise      NOISE_BEGINS, then NOISE_CONTINUES a byte, then NOISE_ENDS before a header

A frame scores the share of its kind times, for each byte, 256 times the byte's probability there.
The bytes of the open reserve are a constant of the line, or are scored like payload.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from math import exp, inf, log, prod

from fte_sniff.protocol import FRAME_LENGTH, HEADERS, KINDS, TAIL, Fault, FrameKind
from fte_sniff.protocol.framer.model import (
    BROKEN,
    FOREIGN,
    INTACT,
    JUNK,
    LONGEST_JUNK,
    MOST_INSERTED,
    NOISE_BEGINS,
    NOISE_CONTINUES,
    NOISE_ENDS,
    UNUSUAL,
    FrameTables,
    Reserve,
    byte_scores,
    change_scores,
    insertion_score,
    kind_share,
    payload_scores,
    truncation_scores,
)
from fte_sniff.protocol.spec import (
    CMD_OFFSET,
    FTE_FORMAT,
    HEADER_BYTES,
    KIND_BY_HEADER_AND_CMD,
    MOTORS,
    NUM_OFFSET,
)

_INSIDE = FRAME_LENGTH - 2
"""Bytes between the header and the tail."""

_HEADER = b"[%b]" % re.escape(HEADER_BYTES)
_TAIL = re.escape(bytes([TAIL]))
_DELIMITERS = re.escape(bytes([*HEADER_BYTES, TAIL]))
_FRAMED = b"%b.{%d}%b" % (_HEADER, _INSIDE, _TAIL)
_CLEAR = b"%b[^%b]{%d}%b" % (_HEADER, _DELIMITERS, _INSIDE, _TAIL)
_NO_TAIL_AFTER = b"(?=[^%b]{%d})" % (_TAIL, MOST_INSERTED)

_SPLITTING = b"(?:%b%b|%b[%b][%b])" % (
    _TAIL,
    _HEADER,
    _HEADER,
    re.escape(bytes({cmd for kind in KINDS if kind.fields for cmd in kind.cmds})),
    re.escape(bytes([0, *MOTORS])),
)

_NO_DELIMITER = bytes(value for value in range(256) if value not in {*HEADER_BYTES, TAIL})


def _compiled(pattern: bytes) -> re.Pattern[bytes]:
    return re.compile(pattern, re.DOTALL)


def _any_kind(patterns: Iterable[bytes]) -> bytes:
    return b"(?:%b)" % b"|".join(patterns)


def _sequence(offsets: Iterable[bytes | None]) -> bytes:
    return b"".join(b"." if one is None else b"[%b]" % re.escape(one) for one in offsets)


def _usual_flags(kind: FrameKind) -> bytes:
    """The default flags at the end of a kind's payload; empty without flags."""
    return bytes(field.default for field in kind.fields if field.default is not None)


USUAL_FLAGS = tuple({flags: None for kind in KINDS if (flags := _usual_flags(kind))})
"""The flags before the tail in nearly every frame that has flags."""


def _other_num(flags: bytes) -> bytes:
    """Any NUM but 00, and the bytes between it and the flags at the end."""
    return rb"[^\x00].{%d}" % (_INSIDE - len(flags) - NUM_OFFSET)


FRAMED = _compiled(_FRAMED)
FRAMED_THREE = _compiled(_FRAMED * 3)
CLEAR = _compiled(_CLEAR)
ISOLATED = _compiled(_CLEAR + _NO_TAIL_AFTER)
SPLITTING = _compiled(_SPLITTING)


# The model

_TRUNCATION = truncation_scores(FRAME_LENGTH)
_INSERTION = insertion_score(FRAME_LENGTH)
_CHANGE = change_scores(FRAME_LENGTH)
_SHARES = {kind.name: kind_share(FTE_FORMAT, kind) for kind in KINDS}

IS_HEADER = frozenset(HEADERS.values())


@dataclass(frozen=True)
class Candidate:
    stop: int
    score: float
    whole: bool = False


def add(a: float, b: float) -> float:
    """log(e^a + e^b)."""
    low, high = min(a, b), max(a, b)
    return high if low == -inf else high + log(1 + exp(low - high))


def noise_score(length: int) -> float:
    """The score of noise of that length, short or long, before a header or the end."""
    junk = JUNK if length <= LONGEST_JUNK else 0.0
    return junk + NOISE_BEGINS * NOISE_CONTINUES ** (length - 1) * NOISE_ENDS


def _forward(at: list[list[Candidate]], ends: list[int]) -> list[float]:
    """By offset: the log score of all segmentations before it, a segment ending there."""
    size = len(at)
    frame, noise = [-inf] * (size + 1), [-inf] * (size + 1)
    frame[0] = 0.0
    for start in range(size):
        here = add(frame[start], noise[start])
        if here > -inf:
            for one in at[start]:
                frame[one.stop] = add(frame[one.stop], here + log(one.score))
        if frame[start] > -inf:
            for end in ends:
                if end > start:
                    noise[end] = add(noise[end], frame[start] + log(noise_score(end - start)))
    return [add(a, b) for a, b in zip(frame, noise, strict=True)]


def _backward(at: list[list[Candidate]], ends: list[int]) -> list[float]:
    """By offset: the log score of all segmentations after it, if a frame ended there."""
    size = len(at)
    after, from_frame = [-inf] * (size + 1), [-inf] * (size + 1)
    after[size] = from_frame[size] = 0.0
    for start in range(size - 1, -1, -1):
        for one in at[start]:
            from_frame[start] = add(from_frame[start], log(one.score) + after[one.stop])
        after[start] = from_frame[start]
        for end in ends:
            if end > start:
                after[start] = add(after[start], log(noise_score(end - start)) + from_frame[end])
    return after


def kind_faults(raw: bytes, kind: FrameKind, legal: Sequence[bytes | None]) -> tuple[Fault, ...]:
    """The faults visible in the bytes of a frame of `kind`, with its legal bytes on this line."""
    fields = (field for field in kind.fields if not field.is_legal(field.read(raw)))
    faults = [field.fault for field in fields if field.fault]
    if any(raw[offset] for offset in kind.reserved if legal[offset] == b"\x00"):
        faults.append(Fault.RESERVED_NONZERO)
    return tuple(dict.fromkeys(faults))


class Unambiguous:
    """The predicate `unambiguous` of a line, used like a pattern."""

    def __init__(self, line: Oracle, pattern: bytes) -> None:
        """`pattern` matches the frames of which only the end has to be compared."""
        self._line = line
        self._pattern = _compiled(pattern)

    def match(self, data: bytes, at: int = 0, end: int = sys.maxsize) -> re.Match[bytes] | None:
        found = self._pattern.match(data, at, end)
        if found is None:
            return None
        raw = found.group()
        kind = KIND_BY_HEADER_AND_CMD[raw[0], raw[CMD_OFFSET]]
        return found if self._line.ends_like_its_kind(raw, kind) else None

    def search(self, data: bytes, at: int = 0, end: int = sys.maxsize) -> re.Match[bytes] | None:
        starts = range(at, min(end, len(data)))
        return next((found for start in starts if (found := self.match(data, start, end))), None)


class Oracle:
    """The predicates and the model for a line with a given reserve.

    Attributes in capitals are patterns: the predicates with these names.
    """

    def __init__(self, reserve: Reserve) -> None:
        """`reserve` are the constants of the line, by kind and offset; the rest is open."""
        self.reserve = reserve
        self.tables = FrameTables(FTE_FORMAT, reserve)
        """The tables of the framer under test for such a line; the oracle does not use them."""
        self._scores = {
            kind.name: byte_scores(FTE_FORMAT, kind, self.legal_bytes(kind)) for kind in KINDS
        }
        strict = _any_kind(_sequence(self.legal_bytes(kind)) for kind in KINDS)
        plain = _any_kind(self._unsplit(kind) + self._not_as_flags(kind) for kind in KINDS)
        unsplit = _any_kind(self._unsplit(kind) for kind in KINDS)
        usual = _any_kind(_sequence(self._with_num(kind, b"\x00")) for kind in KINDS)
        self.STRICT = _compiled(strict)
        self.STRICT_PAIR = _compiled(strict * 2)
        self.UNSPLIT = _compiled(unsplit)
        self.PLAIN = _compiled(plain)
        self.UNSPLIT_RUN = _compiled(b"%b*" % unsplit)
        self.PLAIN_RUN = _compiled(b"%b*" % plain)
        self.UNAMBIGUOUS = Unambiguous(self, b"(?=%b%b)%b" % (_CLEAR, _NO_TAIL_AFTER, usual))
        self.ANCHOR = _compiled(b"(?:%b.{%d}|%b%b)" % (strict, FRAME_LENGTH, _FRAMED, _FRAMED))

    def legal_bytes(self, kind: FrameKind) -> list[bytes | None]:
        """The legal bytes at each offset; None where every byte is legal."""
        number = KINDS.index(kind)
        own = {offset: byte for (code, offset), byte in self.reserve.items() if code == number}
        return FTE_FORMAT.legal_bytes(kind, own)

    def _with_num(self, kind: FrameKind, unused: bytes) -> list[bytes | None]:
        """The legal bytes at each offset, with `unused` for a NUM without meaning."""
        legal = list(self.legal_bytes(kind))
        if legal[NUM_OFFSET] is None:
            legal[NUM_OFFSET] = unused
        return legal

    def _unsplit(self, kind: FrameKind) -> bytes:
        """Nothing that splits starts in the free bytes, and an unused NUM is not a delimiter."""
        return b"".join(
            b"(?!%b)." % _SPLITTING if legal is None else _sequence([legal])
            for legal in self._with_num(kind, _NO_DELIMITER)
        )

    def _not_as_flags(self, kind: FrameKind) -> bytes:
        """Matches after a frame that does not end with another kind's usual flags.

        An unused NUM of 00 allows them, because it is evidence for the frame.
        """
        if self.legal_bytes(kind)[-2] is not None:
            return b""
        return b"".join(
            b"(?<!%b%b%b)"
            % (b"" if kind.names_motor else _other_num(flags), re.escape(flags), _TAIL)
            for flags in USUAL_FLAGS
        )

    def ends_like_its_kind(self, raw: bytes, kind: FrameKind) -> bool:
        """Whether the bytes that are typical of the end of another kind score no higher as its.

        Flags are compared with numbers, since other flags have the same score.
        """
        for rival in KINDS:
            flags = _usual_flags(rival)
            offsets = range(FRAME_LENGTH - 1 - len(flags) if rival.fields else NUM_OFFSET, 9)
            scores = self._scores[rival.name]
            if flags and _usual_flags(kind):
                scores = [payload_scores(FTE_FORMAT)] * FRAME_LENGTH
            own = prod(self._scores[kind.name][offset][raw[offset]] for offset in offsets)
            if own < prod(scores[offset][raw[offset]] for offset in offsets):
                return False
        return True

    def frame_faults(self, raw: bytes) -> tuple[Fault, ...]:
        """The faults of ten framed bytes on this line (docs/reference/protocol.md, "Frames")."""
        kind = KIND_BY_HEADER_AND_CMD.get((raw[0], raw[CMD_OFFSET]))
        if kind is None:
            return (Fault.UNKNOWN_CMD,)
        return kind_faults(raw, kind, self.legal_bytes(kind))

    def sent(self, kind: FrameKind, data: Sequence[int], offsets: Sequence[int]) -> float:
        """The score of these bytes at those offsets of a frame of that kind."""
        score = _SHARES[kind.name]
        for byte, offset in zip(data, offsets, strict=True):
            score *= self._scores[kind.name][offset][byte]
        return score

    def is_whole(self, data: bytes) -> bool:
        return len(data) == FRAME_LENGTH and any(self.sent(kind, data, range(10)) for kind in KINDS)

    def candidates(self, data: bytes, start: int) -> Iterator[Candidate]:
        """Every frame, whole or damaged, that can begin at `start`."""
        left = len(data) - start
        if self.is_whole(data[start : start + 10]):
            score = sum(self.sent(kind, data[start : start + 10], range(10)) for kind in KINDS)
            yield Candidate(start + 10, INTACT * score, True)
        for length in range(1, min(14, left) + 1):
            own = data[start : start + length]
            if self.is_whole(own):
                continue
            score = sum(self.damaged(kind, own) for kind in KINDS)
            if length == FRAME_LENGTH:
                score += self.framed(own)
            if score:
                yield Candidate(start + length, score)

    def damaged(self, kind: FrameKind, own: bytes) -> float:
        """The score of these bytes being one damaged frame of that kind."""
        length, score = len(own), 0.0
        for head in range(FRAME_LENGTH):
            if length < FRAME_LENGTH and head <= length:
                offsets = [*range(head), *range(head + FRAME_LENGTH - length, FRAME_LENGTH)]
                score += _TRUNCATION[length] * self.sent(kind, own, offsets)
            if length == FRAME_LENGTH:
                for width in range(1, min(6, FRAME_LENGTH - head) + 1):
                    offsets = [*range(head), *range(head + width, FRAME_LENGTH)]
                    score += _CHANGE[width] * self.sent(
                        kind, [own[offset] for offset in offsets], offsets
                    )
            if length > FRAME_LENGTH and head:
                kept = own[:head] + own[head + length - FRAME_LENGTH :]
                score += _INSERTION * self.sent(kind, kept, range(FRAME_LENGTH))
        return score + self.broken(kind, own)

    def fits(self, kind: FrameKind, byte: int, offset: int) -> bool:
        return self._scores[kind.name][offset][byte] > 0

    def broken(self, kind: FrameKind, own: bytes) -> float:
        """Nothing of the start left, or header, CMD and more; some bytes of the end left."""
        if own[-1] != TAIL:
            return 0.0
        most = min(len(own), FRAME_LENGTH - 1)
        rest = next((n for n in range(most) if not self.fits(kind, own[-1 - n], 9 - n)), most)
        score = BROKEN * self.sent(kind, own[len(own) - rest :], range(FRAME_LENGTH - rest, 10))
        most = min(len(own) - 1, FRAME_LENGTH - 2)
        head = next((n for n in range(most) if not self.fits(kind, own[n], n)), most)
        named = len(own) > 1 and self.fits(kind, own[0], 0) and self.fits(kind, own[1], 1)
        if named:
            if len(own) == 2:
                head = 1
            rest = min(rest, len(own) - head, FRAME_LENGTH - 1 - head)
            offsets = [*range(head), *range(FRAME_LENGTH - rest, FRAME_LENGTH)]
            kept = own[:head] + own[len(own) - rest :]
            if head >= 2:
                score += BROKEN * self.sent(kind, kept, offsets)
        return score

    def framed(self, own: bytes) -> float:
        """The score of ten bytes between header and tail, whatever they hold."""
        if own[0] not in IS_HEADER or own[-1] != TAIL:
            return 0.0
        named = sum(self.sent(kind, own[:3], range(3)) for kind in KINDS)
        score = FOREIGN * 256 / len(IS_HEADER) * 256 + UNUSUAL * named * 256
        others = [kind for kind in KINDS if kind.open_reserve]
        return score + UNUSUAL * sum(UNLEARNED.sent(kind, own, range(10)) for kind in others)

    def probabilities(self, data: bytes) -> dict[int, float]:
        """The offsets where a whole frame can start, with the probability (0-1) of each.

        The stream starts and ends between frames.
        """
        size = len(data)
        at = [list(self.candidates(data, start)) for start in range(size)]
        ends = [offset for offset in range(size + 1) if offset == size or data[offset] in IS_HEADER]
        before, after = _forward(at, ends), _backward(at, ends)
        total = after[0]
        return {
            start: exp(before[start] + log(one.score) + after_frame - total)
            for start in range(size)
            for one in at[start]
            if one.whole and before[start] > -inf and (after_frame := after[one.stop]) > -inf
        }


def line_with(pattern: str) -> Oracle:
    """A line whose control frames have these bytes in all their open reserve."""
    own = bytes.fromhex(pattern)
    return Oracle(
        {
            (number, offset): own[place % len(own)]
            for number, kind in enumerate(KINDS)
            for place, offset in enumerate(kind.open_reserve)
        }
    )


UNLEARNED = Oracle({})
"""A line whose reserve is not known."""

ZERO = line_with("00")

LINES = {
    "unlearned": UNLEARNED,
    "00": ZERO,
    "AA EE": line_with("AA EE"),
    "mixed": Oracle({(1, 5): 0x00, (1, 6): 0x0F}),
}
"""By name: lines with other reserves."""


def frame_faults(raw: bytes) -> tuple[Fault, ...]:
    """The faults of ten framed bytes on a line whose reserve is 00."""
    return ZERO.frame_faults(raw)
