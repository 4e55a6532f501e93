"""Explain a row: its bytes field by field, and the readings of damage.

The framer decides what is wrong with a row; its decision is `row.faults`. The explanation follows
it: each fault is shown at the bytes that have it, and no other fault is reported. Rows read from a
file carry the same faults and get the same explanation.

Readings explain why damage is not a frame. They are ways to divide the bytes of a row into frames
and damage, with their probabilities:

    row                 AA 02 01 03 E8 00 00 00 0F EE
    probability 99 %    position AA 02 01 03 E8 00 00 00 0F EE
    probability 0.2 %   truncated AA 02 + rest of a frame 01 03 E8 00 00 00 0F EE

A reading is the list of segments that contain a byte of the row. Its probability is the sum over
all segmentations of the bytes around the row that have these segments, divided by the sum over all
segmentations: forward score, scores of the segments, backward score. The scores are those of the
framer (`ForwardBackward`), so the probabilities of all readings of a row add up to 1.

What the framer knew of the line is not in the rows, and is taken from the rows around:

- The bytes from the certain frame before the row to the second certain frame after it are read,
  about `CONTEXT` bytes on each side. They end at a gap, and at silence in the times of the rows.
- The reserve of the line is learned from the `LEARNED` bytes before the row.
- Pauses shorter than silence are not known.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from functools import cache, reduce
from itertools import pairwise, takewhile
from typing import Final, NamedTuple

from fte_sniff.errors import Joint, TranslatableText, listed
from fte_sniff.protocol.columns import spaced_hex
from fte_sniff.protocol.framer.decoder import (
    BoundaryState,
    CandidateSet,
    ForwardBackward,
    after_certain_frame,
    after_silence,
    at_stream_start,
    damage_fault,
    in_long_noise,
)
from fte_sniff.protocol.framer.framer import SETTLING_NS
from fte_sniff.protocol.framer.model import (
    BOUNDARY,
    CLOSED,
    FAULT_SETS,
    FTE_TABLES,
    LONG_NOISE,
    NOISE,
    NOISE_AT_END,
    NOISE_ENDS,
    NOISE_TO_HEADER,
    OPEN,
    FrameTables,
    ReserveLearner,
    framed_faults,
    noise_to_end,
)
from fte_sniff.protocol.rows import NO_ROWS, Damage, Frame, Reading, Row, Rows
from fte_sniff.protocol.spec import (
    CMD_OFFSET,
    DEFAULT_BAUD,
    DIRECTION_OF_HEADER,
    FAULT_MEANINGS,
    FRAME_LENGTH,
    FTE_FORMAT,
    HEADER_BYTES,
    KIND_BY_HEADER_AND_CMD,
    KINDS,
    MOTORS,
    NUM_OFFSET,
    TAIL,
    Direction,
    Fault,
    Field,
    FrameKind,
    Role,
    Status,
    byte_time_ns,
    motor_bit,
    status_of,
)

_HEADER_MEANINGS = {
    Direction.CONTROL: TranslatableText("header: control, host to controller"),
    Direction.FEEDBACK: TranslatableText("header: feedback, controller to host"),
}
_LIKE_HEADERS = {
    Direction.CONTROL: TranslatableText("like the header of commands, host to controller"),
    Direction.FEEDBACK: TranslatableText("like the header of feedback, controller to host"),
}
_HEADERS_TEXT = listed((f"{header:02X}" for header in HEADER_BYTES), Joint.OR)
_TAIL_TEXT = f"{TAIL:02X}"
_LAYOUTS = [
    [(kind, FTE_FORMAT.legal_bytes(kind, dict.fromkeys(kind.open_reserve, 0))) for kind in KINDS],
    [(kind, FTE_FORMAT.legal_bytes(kind)) for kind in KINDS],
]
"""The legal bytes of each kind: with 00 in its reserve, and with anything."""


_LEAST_SHARE = 0.0001


class ExplainedBit(NamedTuple):
    """One bit of a flag byte."""

    number: int
    """0 is the least significant."""
    is_set: bool
    is_raised: bool
    """Whether it differs from the default."""
    label: str
    """A word or two; adjacent bits with the same meaning have the same label."""
    meaning: str


class ExplainedField(NamedTuple):
    """Adjacent bytes of a row with one meaning."""

    offsets: range
    """Offsets in the row; empty where bytes are missing."""
    raw: bytes
    name: str
    """The field's row name, or `header`, `cmd`, `num`, `reserve`, `payload`, `tail`, and in damage
    also `missing`, `extra`, `noise`."""
    value: str = ""
    """The decoded value with its unit; empty in damage."""
    meaning: str = ""
    """Description, with the range of a number."""
    fault: Fault | None = None
    note: str = ""
    """With a fault, what was expected and what was found, and where bytes are missing, what the
    next one had to be; without one, the field's erratum."""
    bits: tuple[ExplainedBit, ...] = ()
    """The bits of a flag byte, from bit 0 up."""
    is_raised: bool = False
    """Whether it is a flag byte that differs from its default."""


@cache
def byte_names(kind: FrameKind) -> tuple[str, ...]:
    """For each byte of a frame of this kind, the name of its field in `dissect`."""
    return tuple(slot.name for slot in _layout(kind) for _ in slot.offsets)


def dissect(row: Row) -> list[ExplainedField]:
    """Explain every byte of the row once, in order (docs/reference/protocol.md, "Frames")."""
    if isinstance(row, Frame):
        return [_decoded(row, slot) for slot in _layout(row.kind)]
    size, faults = len(row.raw), row.faults
    if size == FRAME_LENGTH and (Fault.BAD_HEADER in faults or Fault.BAD_TAIL in faults):
        return list(_in_step(row))
    if 0 < size < FRAME_LENGTH and Fault.TRUNCATED in faults:
        return list(_spliced(row, Fault.TRUNCATED))
    if size > FRAME_LENGTH and Fault.OVERLONG in faults:
        return list(_spliced(row, Fault.OVERLONG))
    fault = Fault.NOISE if Fault.NOISE in faults else next(iter(faults), None)
    return [_explained(row, range(size), "noise", fault=fault)]


def explain(row: Row) -> list[str]:
    """One sentence for each fault of the row; empty if it has none."""
    kind = row.kind if isinstance(row, Frame) else None
    return [
        TranslatableText(
            "{fault}: {meaning}", fault=fault.value, meaning=_fault_meaning(fault, kind)
        )
        for fault in row.faults
    ]


def explain_readings(row: Row) -> list[str]:
    """One line for each reading of the row, and for their brackets; empty if not computed."""
    texts: list[str] = [_reading_text(one) for one in row.readings or ()]
    if any("(" in one.reading for one in row.readings or ()):
        texts.append(TranslatableText("in brackets: bytes of the rows before and after this one"))
    return texts


class _Slot(NamedTuple):
    offsets: range
    name: str
    meaning: str
    field: Field | None = None


@cache
def _layout(kind: FrameKind | None) -> tuple[_Slot, ...]:
    num = _Slot(range(NUM_OFFSET, NUM_OFFSET + 1), "num", TranslatableText("NUM"))
    if kind is None:
        payload = range(NUM_OFFSET + 1, FRAME_LENGTH - 1)
        inner = [num, _Slot(payload, "payload", TranslatableText("payload"))]
    else:
        inner = [_Slot(field.offsets, field.name, field.meaning, field) for field in kind.fields]
        inner += [] if kind.names_motor else [num]
        if kind.reserved:
            inner.append(_Slot(kind.reserved, "reserve", TranslatableText("reserve")))
    return (
        _Slot(range(1), "header", TranslatableText("header")),
        _Slot(range(CMD_OFFSET, CMD_OFFSET + 1), "cmd", TranslatableText("CMD")),
        *sorted(inner, key=lambda slot: slot.offsets.start),
        _Slot(range(FRAME_LENGTH - 1, FRAME_LENGTH), "tail", TranslatableText("tail")),
    )


def _explained(
    row: Row,
    offsets: range,
    name: str,
    meaning: str = "",
    *,
    value: str = "",
    fault: Fault | None = None,
    note: str = "",
    bits: tuple[ExplainedBit, ...] = (),
    is_raised: bool = False,
) -> ExplainedField:
    if fault not in row.faults:
        fault, note = None, ""
    raw = row.raw[offsets.start : offsets.stop]
    return ExplainedField(offsets, raw, name, value, meaning, fault, note, bits, is_raised)


def _expected(expected: object, found: object) -> TranslatableText:
    return TranslatableText("expected {wanted}, found {found}", wanted=expected, found=found)


def _decoded(row: Frame, slot: _Slot) -> ExplainedField:
    offsets, name, _, field = slot
    if field is not None:
        return _flags(row, field) if field.legal_bits is not None else _number(row, field)
    match name:
        case "cmd":
            return _cmd(row)
        case "reserve" if row.kind is not None:
            return _reserve(row, row.kind)
        case "num" if row.kind is not None:
            meaning = TranslatableText("NUM: any value, it means nothing here")
            return _explained(row, offsets, name, meaning, value=str(row.raw[offsets.start]))
        case "num" | "payload":
            return _explained(row, offsets, name, TranslatableText("unknown under this CMD"))
    return _undecoded(row, slot, offsets)


def _cmd(row: Frame) -> ExplainedField:
    kind = row.kind
    if kind is not None:
        meaning = TranslatableText(
            "CMD: {kind}, {meaning}", kind=kind.name, meaning=TranslatableText(kind.meaning)
        )
        return _explained(row, range(1, 2), "cmd", meaning, value=str(row.cmd))
    legal = sorted(f"{cmd:02X}" for header, cmd in KIND_BY_HEADER_AND_CMD if header == row.raw[0])
    note = TranslatableText(
        "the protocol has no CMD {cmd} for {way}; it has {legal}",
        cmd=f"{row.cmd:02X}",
        way=row.direction.value,
        legal=listed(legal),
    )
    return _explained(
        row, range(1, 2), "cmd", "CMD", value=str(row.cmd), fault=Fault.UNKNOWN_CMD, note=note
    )


def _reserve(row: Frame, kind: FrameKind) -> ExplainedField:
    offsets = kind.reserved
    raw = row.raw[offsets.start : offsets.stop]
    wanted = bytes([kind.reserve or 0x00]) * len(raw)
    texts = {"wanted": spaced_hex(wanted), "found": spaced_hex(raw)}
    if kind.reserve is None:
        meaning = TranslatableText("reserve: no meaning; the protocol states no value")
        note = TranslatableText(
            "expected {wanted} as on the rest of this line, found {found}", **texts
        )
    else:
        meaning = TranslatableText(
            "reserve: no meaning; the protocol shows {byte}", byte=f"{kind.reserve:02X}"
        )
        note = TranslatableText("expected {wanted} as in the protocol, found {found}", **texts)
    fault = None if raw == wanted else Fault.RESERVED_NONZERO
    return _explained(row, offsets, "reserve", meaning, fault=fault, note=note)


def _number(row: Frame, field: Field) -> ExplainedField:
    value = field.read(row.raw)
    meaning = TranslatableText(
        "{meaning} ({range})", meaning=TranslatableText(field.meaning), range=field.range_text
    )
    legal = field.is_legal(value)
    number = _explained(
        row,
        field.offsets,
        field.name,
        meaning,
        value=f"{value} {field.unit}".rstrip(),
        fault=None if legal else field.fault,
        note="" if legal else _expected(field.range_text, value),
    )
    if value and field.erratum:
        return number._replace(note=TranslatableText(field.erratum))
    return number


def _flags(row: Frame, field: Field) -> ExplainedField:
    byte = field.read(row.raw)
    defined, raised = field.legal_bits or 0, byte ^ (field.default or 0)
    note = TranslatableText(
        "bits that the protocol does not define are set: {bits}", bits=f"{byte & ~defined:#04x}"
    )
    bits = (
        ExplainedBit(number, is_set, _has(raised, number), *_bit_meaning(field, number, is_set))
        for number in range(8)
        for is_set in [_has(byte, number)]
    )
    return _explained(
        row,
        field.offsets,
        field.name,
        field.meaning,
        value=field.text(byte),
        fault=None if field.is_legal(byte) else field.fault,
        note=note,
        bits=tuple(bits),
        is_raised=field.raised(byte),
    )


def _has(byte: int, bit: int) -> bool:
    return bool(byte >> bit & 1)


def _bit_meaning(field: Field, number: int, is_set: bool) -> tuple[str, str]:
    if field.legal_bits is not None and not field.legal_bits >> number & 1:
        return TranslatableText("undefined"), TranslatableText("undefined")
    if field.role is Role.ONLINE:
        number = next(motor for motor in MOTORS if motor_bit(motor) == number)
        motor = TranslatableText("motor {number}", number=number)
        return motor, TranslatableText(
            "{motor} {state} (assumption: the protocol does not say which bit is which motor)",
            motor=motor,
            state=TranslatableText("online") if is_set else TranslatableText("not online"),
        )
    return TranslatableText("unknown"), TranslatableText(
        "meaning unknown: the protocol does not say"
    )


def _undecoded(row: Row, slot: _Slot, offsets: range) -> ExplainedField:
    byte = row.raw[offsets.start]
    if slot.name == "tail":
        fault = None if byte == TAIL else Fault.BAD_TAIL
        note = _expected(_TAIL_TEXT, f"{byte:02X}")
        return _explained(row, offsets, "tail", slot.meaning, fault=fault, note=note)
    if slot.name == "header":
        direction = DIRECTION_OF_HEADER.get(byte)
        if direction is not None and isinstance(row, Frame):
            meaning = _HEADER_MEANINGS[direction]
            return _explained(row, offsets, "header", meaning, value=direction.value)
        if direction is not None:
            # In damage the byte may be any byte; the row has no direction.
            return _explained(row, offsets, "header", _LIKE_HEADERS[direction])
        note = _expected(_HEADERS_TEXT, f"{byte:02X}")
        return _explained(row, offsets, "header", slot.meaning, fault=Fault.BAD_HEADER, note=note)
    return _explained(row, offsets, slot.name, slot.meaning)


def _undecoded_slots(
    row: Damage, kind: FrameKind | None, within: range, shift: int = 0
) -> Iterator[ExplainedField]:
    """The slots of a frame, cut to the offsets `within`; the row has them `shift` bytes later."""
    for slot in _layout(kind):
        start = max(slot.offsets.start, within.start) + shift
        stop = min(slot.offsets.stop, within.stop) + shift
        if start < stop:
            yield _undecoded(row, slot, range(start, stop))


def _in_step(row: Damage) -> Iterator[ExplainedField]:
    kind = KIND_BY_HEADER_AND_CMD.get((row.raw[0], row.raw[CMD_OFFSET]))
    for field in _undecoded_slots(row, kind, range(FRAME_LENGTH)):
        if field.name == "cmd" and kind is not None:
            yield field._replace(meaning=TranslatableText("CMD: {kind}", kind=kind.name))
        elif field.name == "payload":
            yield field._replace(meaning=TranslatableText("not decoded"))
        else:
            yield field


def _spliced(row: Damage, fault: Fault) -> Iterator[ExplainedField]:
    """The head of a frame, the bytes that are missing or too many, and its rest."""
    size, note = len(row.raw), ""
    kind, head, rest = _split(row.raw)
    inner = range(head, size - rest)
    if head + rest < min(size, FRAME_LENGTH):
        name = "payload"
        meaning = TranslatableText(
            "{count} bytes where a frame has {length}; no kind of frame fits them",
            count=size,
            length=FRAME_LENGTH,
        )
    elif fault is Fault.TRUNCATED:
        name = "missing"
        last = FRAME_LENGTH - rest - 1
        meaning = TranslatableText(
            "{place} missing: {count} of a frame's {length} bytes, or others in its place",
            place=f"DATA[{head}]" if head == last else f"DATA[{head}] to DATA[{last}]",
            count=FRAME_LENGTH - size,
            length=FRAME_LENGTH,
        )
        note = _next_byte(kind, head) if kind is not None and not rest else ""
    else:
        name = "extra"
        meaning = TranslatableText(
            "{count} bytes too many, here or nearby: {all} where a frame has {length}",
            count=len(inner),
            all=size,
            length=FRAME_LENGTH,
        )
    yield from _undecoded_slots(row, kind, range(head))
    yield _explained(row, inner, name, meaning, fault=fault, note=note)
    ending = range(FRAME_LENGTH - rest, FRAME_LENGTH)
    yield from _undecoded_slots(row, kind, ending, size - FRAME_LENGTH)


def _next_byte(kind: FrameKind, offset: int) -> str:
    """Why a truncated frame may end before an offset: a byte that is not legal there."""
    if offset in kind.open_reserve:
        return TranslatableText(
            "DATA[{offset}] is reserve: where it is constant on the line, "
            "another byte ends the frame here",
            offset=offset,
        )
    legal = FTE_FORMAT.legal_bytes(kind)[offset]
    if legal is None or offset == FRAME_LENGTH - 1:  # with another tail it is `bad_tail`
        return ""
    return TranslatableText(
        "DATA[{offset}] must be {legal}: another byte ends the frame here",
        offset=offset,
        legal=ranges_text(legal),
    )


def ranges_text(numbers: bytes) -> str:
    """Bytes in rising order: `00`, `01 or 03`, `01-04`."""
    starts = [at for at, one in enumerate(numbers) if not at or one != numbers[at - 1] + 1]
    runs = [numbers[start:stop] for start, stop in pairwise([*starts, len(numbers)])]
    texts = (f"{run[0]:02X}" if len(run) == 1 else f"{run[0]:02X}-{run[-1]:02X}" for run in runs)
    return listed(texts, Joint.OR)


def _split(raw: bytes) -> tuple[FrameKind | None, int, int]:
    """The kind of which the bytes hold the longest head and the whole rest, and the sizes of both.

    The kind is None if the head has no CMD. If no kind fits, the head is the header, and the rest
    is the tail, if there is one.
    """
    whole = min(len(raw), FRAME_LENGTH)
    longest = whole if len(raw) < FRAME_LENGTH else whole - 1
    for layouts in _LAYOUTS:
        best: tuple[FrameKind | None, int, int] | None = None
        for kind, legal in layouts:
            head = min(_fitting(raw, legal), longest)
            longer = head > (best[1] if best else 0)
            if longer and head + _fitting(raw[::-1], legal[::-1]) >= whole:
                best = kind if head > CMD_OFFSET else None, head, whole - head
        if best:
            return best
    return None, 1, int(len(raw) > 1 and raw[-1] == TAIL)


def _fitting(raw: bytes, legal: Sequence[bytes | None]) -> int:
    pairs = zip(raw, legal, strict=False)
    return sum(1 for _ in takewhile(lambda pair: pair[1] is None or pair[0] in pair[1], pairs))


def _fault_meaning(fault: Fault, kind: FrameKind | None) -> TranslatableText:
    """The meaning of a fault in a frame of that kind."""
    if fault is not Fault.RESERVED_NONZERO or kind is None:
        return TranslatableText(FAULT_MEANINGS[fault])
    if kind.reserve is None:
        return TranslatableText("the reserve is not 00, unlike on the rest of this line")
    return TranslatableText(
        "the reserve is not {byte}, which the protocol shows there", byte=f"{kind.reserve:02X}"
    )


def _reading_text(one: Reading) -> TranslatableText:
    return TranslatableText(
        "probability {share}: {reading}", share=_share(one.probability), reading=one.reading
    )


def _share(probability: float) -> str:
    """`12.34 %`; one that is nearly 0 or 1 is neither."""
    if probability < _LEAST_SHARE:
        return f"<{100 * _LEAST_SHARE:.2f} %"
    if probability > 1 - _LEAST_SHARE:
        return f">{100 - 100 * _LEAST_SHARE:.2f} %"
    return f"{100 * probability:.2f} %"


# The readings of a span

MOST: Final = 2
"""Readings of a row."""

WHY: Final = "why"
"""The key of the readings in JSON lines."""

CONTEXT: Final = int(FTE_TABLES.widest)
"""Bytes on each side of a row with which it is read; the first row of them is read as a whole."""

LEARNED: Final = 2560
"""Bytes before a row from which the reserve of the line is learned."""

LONGEST: Final = 64
"""Bytes of the longest row that has readings; a longer one is noise."""

_MOST_HELD: Final = 2000
"""Rows that wait for the bytes after a row, at most."""

_MOST_PAST: Final = 1024
"""Rows of all ports that are kept for the rows after them."""

_CERTAIN_AFTER: Final = 2
"""Certain frames after a row with which it is read."""

_MOST_SHOWN: Final = 16
"""Bytes that are written out; of more, the first and the last ones."""
_HEAD: Final = 6
_TAIL: Final = 2

_BYTE_NS: Final = byte_time_ns(DEFAULT_BAUD)


def is_doubtful(faults: tuple[Fault, ...]) -> bool:
    """Whether a row with these faults has readings: it is damaged or ambiguous."""
    return Fault.AMBIGUOUS in faults or status_of(faults) is Status.MALFORMED


class SpanSegment(NamedTuple):
    """A segment of a span."""

    start: int
    stop: int
    is_noise: bool
    """Whether it is a run of noise; otherwise it is a frame, whole or damaged."""


class Path(NamedTuple):
    """Adjacent segments."""

    score: float
    """Of a reading, its probability (0-1); of a path that ends within the bytes to read, the sum
    over all segmentations up to there that have these segments."""
    segments: tuple[SpanSegment, ...]


class SpanReader:
    """The readings of the bytes of a span; offsets count from its first byte."""

    def __init__(self, tables: FrameTables, data: bytes, state: BoundaryState, ending: int) -> None:
        """`ending` is `OPEN`, `CLOSED` or `BOUNDARY`."""
        self._state, self._size = state, len(data)
        self._posterior = ForwardBackward(CandidateSet(tables, data), state, ending)
        self._ending = ending
        candidates = self._posterior.candidates
        self._headers = [int(prefix.start) for prefix in candidates.prefixes]
        self._from = defaultdict[int, dict[int, float]](lambda: defaultdict(float))
        """By start and stop: the scores of frames, whole or damaged."""
        self._after_noise: dict[int, float] = {}
        """By header: the sum over all segmentations after noise that ends there, once needed."""
        for start, stop, score in self._frames():
            if score > 0.0:
                self._from[start][stop] += score

    def _frames(self) -> Iterator[tuple[int, int, float]]:
        """Start, stop and score of each frame, whole or damaged; some occur twice."""
        candidates = self._posterior.candidates
        for prefix in candidates.prefixes:
            start = prefix.start
            for length in range(1, prefix.longest_truncated + 1):
                yield start, start + length, candidates.truncated(prefix, length)
            whole = candidates.full_length(prefix, prefix.whole + prefix.bad_tail)
            yield start, start + candidates.tables.length, whole
            yield start, self._size, self._posterior.cut_off_score(prefix)
        for end in candidates.ends:
            for start in range(end.first, end.stop):
                yield start, end.stop, end.scores[start - end.first]

    def best(self, start: int, stop: int, count: int) -> list[Path]:
        """The most probable readings of the bytes from `start` to `stop`, best first."""
        paths = defaultdict[tuple[int, bool], list[Path]](list)
        """By the offset where they end, and whether they end with noise: the best paths."""
        complete: list[Path] = []

        def keep(path: Path) -> None:
            last = path.segments[-1]
            if last.stop >= stop:
                complete.append(self._with_probability(path))
                return
            kept = paths[last.stop, last.is_noise]
            kept.append(path)
            kept.sort(reverse=True)
            del kept[count:]

        for path in self._entering(start):
            keep(path)
        for at in range(start + 1, stop):
            for after_noise in (False, True):
                for path in paths.pop((at, after_noise), ()):
                    for segment, score in self._leaving(at, after_noise=after_noise):
                        keep(Path(path.score * score, (*path.segments, segment)))
        return sorted(complete, reverse=True)[:count]

    def as_one_frame(self, start: int, stop: int) -> Path | None:
        """The reading of these bytes as one frame, whole or damaged; None if it is impossible."""
        own = (SpanSegment(start, stop, is_noise=False),)
        paths = (path for path in self._entering(start) if path.segments == own)
        return next(map(self._with_probability, paths), None)

    def _with_probability(self, path: Path) -> Path:
        score = path.score * self._after(path.segments[-1])
        return Path(min(1.0, score / self._posterior.total), path.segments)

    def _entering(self, at: int) -> Iterator[Path]:
        """Each segment that contains the byte at an offset, with all that can precede it."""
        forward = self._posterior.forward
        initial = self._initial_scores()
        for start in range(at + 1):
            before_noise = forward.after_frame[start]
            before_frame = before_noise + forward.after_noise[start]
            for segment, score in self._leaving(start, after_noise=False):
                before = before_noise if segment.is_noise else before_frame
                whole = before * score + initial.get(segment, 0.0)
                if segment.stop > at and whole > 0.0:
                    yield Path(whole, (segment,))

    def _initial_scores(self) -> dict[SpanSegment, float]:
        """By segment: the scores of those that began before the span."""
        state, ending = self._state, self._ending
        long = {at: LONG_NOISE[at] * NOISE_ENDS for at in self._headers if at}
        long[self._size] = LONG_NOISE[self._size] * NOISE_AT_END[ending]
        scores = {SpanSegment(0, at, True): state.in_noise * score for at, score in long.items()}
        if state.within_frame:
            candidates = self._posterior.candidates
            longest = int(candidates.tables.length) - 1
            for length, score in enumerate(candidates.first_suffixes(longest)):
                scores[SpanSegment(0, length, False)] = state.within_frame / longest * score
        return scores

    def _leaving(self, start: int, *, after_noise: bool) -> Iterator[tuple[SpanSegment, float]]:
        """Each segment that starts at an offset, with its score."""
        for stop, score in self._from.get(start, {}).items():
            yield SpanSegment(start, stop, is_noise=False), score
        if after_noise or start == self._size:
            return
        for stop in self._headers:
            if stop > start:
                yield SpanSegment(start, stop, is_noise=True), NOISE_TO_HEADER[stop - start]
        to_end = noise_to_end(self._ending, self._size - start)
        yield SpanSegment(start, self._size, is_noise=True), to_end

    def _after(self, last: SpanSegment) -> float:
        """The sum over all segmentations after a segment."""
        backward = self._posterior.backward
        if last.stop == self._size:
            return 1.0
        if not last.is_noise:
            return float(backward[last.stop])
        if last.stop not in self._after_noise:
            following = self._leaving(last.stop, after_noise=True)
            self._after_noise[last.stop] = sum(
                score * self._after(segment) for segment, score in following
            )
        return self._after_noise[last.stop]


# The readings of a row among others


def readings(rows: Sequence[Row], at: int) -> tuple[Reading, ...]:
    """The two best readings of a row among the rows of its port, which are in stream order.

    If the row is a frame, the first is this frame, and the second the best of the others; else the
    more probable one is the first. A row of more than `LONGEST` bytes has none.
    """
    row = rows[at]
    if len(row.raw) > LONGEST:
        return ()
    before, state = _before(rows, at)
    after, ending, _ = _after(rows, at)
    data, own = before + row.raw + after, range(len(before), len(before) + len(row.raw))
    tables = _tables(rows, at)
    reader = SpanReader(tables, data, state, ending)
    found = reader.best(own.start, own.stop, MOST)
    frame = reader.as_one_frame(own.start, own.stop) if isinstance(row, Frame) else None
    if frame is not None:
        found = [frame, *(path for path in found if path.segments != frame.segments)][:MOST]
    return tuple(Reading(_text(tables, data, path, own), path.score) for path in found)


def _tables(rows: Sequence[Row], at: int) -> FrameTables:
    """The tables for the reserve that the line has in the rows before one."""
    learner, first, start = ReserveLearner(FTE_TABLES), at, rows[at].offset - LEARNED
    while first > 0 and rows[first - 1].offset + len(rows[first - 1].raw) > start:
        first -= 1
    for row in rows[first:at]:
        if isinstance(row, Frame) and row.faults in ((), (Fault.RESERVED_NONZERO,)):
            learner.observe(row.raw, 0)
    return learner.tables


def _before(rows: Sequence[Row], at: int) -> tuple[bytes, BoundaryState]:
    """The bytes before a row that are read with it, and what is known of what precedes them."""
    data = b""
    for number in range(at - 1, -1, -1):
        row, following = rows[number], rows[number + 1]
        if not _adjoins(row, following):
            return data, after_silence()
        if _is_certain(row):
            return data, after_certain_frame()
        if _is_silent_between(row, following):
            return data, after_silence()
        data = row.raw + data
        if len(data) > CONTEXT and Fault.NOISE in row.faults:
            return data[-CONTEXT:], in_long_noise()
        if len(data) >= CONTEXT:
            return data, after_silence()
    return data, at_stream_start() if rows[0].offset == 0 else after_silence()


def _after(rows: Sequence[Row], at: int) -> tuple[bytes, int, bool]:
    """The bytes after a row that are read with it, how they end, and whether more rows could change
    this."""
    data, certain = b"", 0
    for row, following in pairwise(rows[at : at + CONTEXT + 1]):
        if not _adjoins(row, following) or _is_silent_between(row, following):
            return data, CLOSED, False
        data += following.raw
        certain = certain + 1 if _is_certain(following) else 0
        if len(data) >= CONTEXT:
            return data[:CONTEXT], OPEN, False
        if certain == _CERTAIN_AFTER:
            return data, BOUNDARY, False
    return data, CLOSED, True


def _is_certain(row: Row) -> bool:
    return isinstance(row, Frame) and row.faults in ((), (Fault.LINE_ERROR,))


def _adjoins(row: Row, following: Row) -> bool:
    return row.offset + len(row.raw) == following.offset


def _is_silent_between(row: Row, following: Row) -> bool:
    if row.t_ns is None or following.t_ns is None:
        return False
    return following.t_ns - row.t_ns - len(row.raw) * _BYTE_NS >= SETTLING_NS


def _text(tables: FrameTables, data: bytes, path: Path, own: range) -> TranslatableText:
    """The segments of a reading; bytes outside the row, whose offsets are `own`, in brackets."""
    texts = (_segment_text(tables, data, segment, own) for segment in path.segments)
    return reduce(
        lambda one, other: TranslatableText("{one} + {other}", one=one, other=other), texts
    )


def _segment_text(
    tables: FrameTables, data: bytes, segment: SpanSegment, own: range
) -> TranslatableText:
    start, stop = segment.start, segment.stop
    inner = range(max(start, own.start), min(stop, own.stop))
    texts = [_hex(data[inner.start : inner.stop])]
    if start < inner.start:
        texts.insert(0, f"({_hex(data[start : inner.start])})")
    if inner.stop < stop:
        texts.append(f"({_hex(data[inner.stop : stop])})")
    name = _name(tables, data, segment)
    return TranslatableText("{name} {bytes}", name=name, bytes=" ".join(texts))


def _hex(raw: bytes) -> str:
    if len(raw) <= _MOST_SHOWN:
        return spaced_hex(raw)
    return f"{spaced_hex(raw[:_HEAD])} … {spaced_hex(raw[-_TAIL:])}"


def _name(tables: FrameTables, data: bytes, segment: SpanSegment) -> str:
    """The kind of a frame, the fault of damage."""
    start, stop = segment.start, segment.stop
    if segment.is_noise:
        return Fault.NOISE.value
    fault = damage_fault(tables, data, start, stop)
    if fault == NOISE:
        return TranslatableText("rest of a frame")
    faults = FAULT_SETS[fault or framed_faults(tables, data, start)]
    kind = None if fault else KIND_BY_HEADER_AND_CMD.get((data[start], data[start + CMD_OFFSET]))
    return " ".join([*([kind.name] if kind else []), *faults])


# The readings of all rows


def with_readings(batches: Iterable[Rows]) -> Iterator[Rows]:
    """The rows of an input with their readings."""
    stage = Readings()
    for rows in batches:
        yield stage.feed(rows)
    yield stage.end()


class Readings:
    """Adds their readings to the doubtful rows of an input; rows wait for the bytes after them."""

    def __init__(self) -> None:
        self._past = NO_ROWS
        self._held = NO_ROWS

    def feed(self, rows: Rows) -> Rows:
        """The next rows; returns the rows that are decided now."""
        return self._decide(rows, is_end=False)

    def end(self) -> Rows:
        """The rows that waited at the end of the input."""
        return self._decide(NO_ROWS, is_end=True)

    def _decide(self, rows: Rows, *, is_end: bool) -> Rows:
        held = Rows.concat([self._held, rows]) if len(self._held) else rows
        if not len(held):
            return held
        found, end = self._readings(held, is_end=is_end)
        decided, self._held = held[:end].with_readings(found), held[end:]
        self._past = Rows.concat([self._past, decided[-_MOST_PAST:]])[-_MOST_PAST:]
        return decided

    def _readings(self, held: Rows, *, is_end: bool) -> tuple[dict[int, tuple[Reading, ...]], int]:
        """The readings of rows by index, and the index up to which they are decided."""
        found: dict[int, tuple[Reading, ...]] = {}
        doubtful = [is_doubtful(one) for one in held.codebook.faults]
        faults = held.buffers["faults"].tolist()
        indices = [at for at, code in enumerate(faults) if doubtful[code]]
        if not indices:
            return found, len(held)
        by_port = defaultdict[str, list[Row]](list)
        for row in self._past:
            by_port[row.port].append(row)
        places = []
        for row in held:
            places.append(len(by_port[row.port]))
            by_port[row.port].append(row)
        for at in indices:
            port = held.codebook.ports[held.buffers["port"][at]]
            own, place = by_port[port], places[at]
            if not is_end and at + _MOST_HELD > len(held) and _after(own, place)[2]:
                return found, at
            found[at] = readings(own, place)
        return found, len(held)
