"""Explain the bytes of a frame or a damaged segment field by field."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import reduce

from fte_sniff.errors import TranslatableText
from fte_sniff.protocol.codec import HEADER_BYTES
from fte_sniff.protocol.framer.predicates import dividing, head_fit, rest_fit
from fte_sniff.protocol.row_schema import spaced_hex
from fte_sniff.protocol.rows import Damage, Frame, Row
from fte_sniff.protocol.spec import (
    CMD_OFFSET,
    DIRECTION_OF_HEADER,
    FAULT_MEANINGS,
    FRAME_LENGTH,
    KIND_BY_HEADER_AND_CMD,
    KINDS,
    NUM_OFFSET,
    TAIL,
    Direction,
    Fault,
    Field,
    FrameKind,
)

_WAY = {
    Direction.CONTROL: TranslatableText("header: control, host to controller"),
    Direction.FEEDBACK: TranslatableText("header: feedback, controller to host"),
}
HEADERS_TEXT = " or ".join(f"{header:02X}" for header in HEADER_BYTES)


@dataclass(frozen=True, slots=True)
class ExplainedBit:
    """One bit of a flag byte."""

    number: int
    """0 is the least significant."""
    is_set: bool
    label: str
    """What it is, in a word or two; the same for neighbours that mean the same."""
    meaning: str


@dataclass(frozen=True, slots=True)
class ExplainedField:
    """Neighbouring bytes of a row that belong together, and what there is to say about them."""

    places: range
    """Offsets within the row; empty where bytes are missing."""
    raw: bytes
    name: str
    """The field's row name, or `header`, `cmd`, `num`, `reserve`, `payload`, `tail`, and in damage
    also `missing`, `extra`, `noise`."""
    value: str = ""
    """The decoded value with its unit; empty where there is none, and always in damage."""
    meaning: str = ""
    """What the part is, with its range where it has one."""
    fault: Fault | None = None
    """The fault that these bytes show."""
    note: str = ""
    """What was expected and what was found, or why other readings were refused."""
    bits: tuple[ExplainedBit, ...] = ()
    """For a flag byte: its bits, from bit 0 up."""


def framed_parts(raw: bytes, kind: FrameKind | None) -> Iterator[ExplainedField]:
    """The parts of ten framed bytes; of no kind where header and CMD name none."""
    yield header_part(raw[0])
    yield _cmd(raw[0], raw[CMD_OFFSET])
    if kind is None:
        yield part_of(
            raw,
            NUM_OFFSET,
            NUM_OFFSET + 1,
            "num",
            meaning=TranslatableText("unknown under this CMD"),
        )
        yield part_of(
            raw, 3, FRAME_LENGTH - 1, "payload", meaning=TranslatableText("unknown under this CMD")
        )
    else:
        for places, field in layout(kind):
            yield _content(raw, places, field)
    yield tail_part(raw, FRAME_LENGTH - 1)


def part_of(
    raw: bytes,
    start: int,
    stop: int,
    name: str,
    *,
    value: str = "",
    meaning: str = "",
    fault: Fault | None = None,
    note: str = "",
    bits: tuple[ExplainedBit, ...] = (),
) -> ExplainedField:
    """The part from `start` to `stop`."""
    return ExplainedField(
        range(start, stop), raw[start:stop], name, value, meaning, fault, note, bits
    )


def header_part(byte: int) -> ExplainedField:
    """The first byte of a frame, right or wrong."""
    direction = DIRECTION_OF_HEADER.get(byte)
    if direction is None:
        note = TranslatableText(
            "expected {wanted}, found {found}", wanted=HEADERS_TEXT, found=f"{byte:02X}"
        )
        return ExplainedField(
            range(1),
            bytes([byte]),
            "header",
            meaning=TranslatableText("header"),
            fault=Fault.BAD_HEADER,
            note=note,
        )
    return ExplainedField(range(1), bytes([byte]), "header", direction.value, _WAY[direction])


def _cmd(header: int, cmd: int) -> ExplainedField:
    places = range(CMD_OFFSET, CMD_OFFSET + 1)
    kind = KIND_BY_HEADER_AND_CMD.get((header, cmd))
    if kind is None:
        legal = ", ".join(
            sorted(f"{c:02X}" for h, c in KIND_BY_HEADER_AND_CMD if h == header or header == -1)
        )
        way = DIRECTION_OF_HEADER[header].value
        note = TranslatableText(
            "the protocol has no CMD {cmd} for {way}; it has {legal}",
            cmd=f"{cmd:02X}",
            way=way,
            legal=legal,
        )
        return ExplainedField(places, bytes([cmd]), "cmd", str(cmd), "CMD", Fault.UNKNOWN_CMD, note)
    return ExplainedField(
        places,
        bytes([cmd]),
        "cmd",
        str(cmd),
        TranslatableText(
            "CMD: {kind}, {meaning}", kind=kind.name, meaning=TranslatableText(kind.meaning)
        ),
    )


def layout(kind: FrameKind) -> Iterator[tuple[range, Field | None]]:
    """The places between CMD and tail, field by field; None for bytes that are no field."""
    place = NUM_OFFSET
    starts = {field.start: field for field in kind.fields}
    while place < FRAME_LENGTH - 1:
        field = starts.get(place)
        stop = field.offsets.stop if field else place + 1
        if field is None and place != NUM_OFFSET:
            while stop < FRAME_LENGTH - 1 and stop not in starts:
                stop += 1
        yield range(place, stop), field
        place = stop


def _content(raw: bytes, places: range, field: Field | None) -> ExplainedField:
    if field is not None:
        return _value(raw, field)
    own = raw[places.start : places.stop]
    if places.start == NUM_OFFSET:
        return ExplainedField(
            places,
            own,
            "num",
            str(own[0]),
            TranslatableText("NUM: any value, it means nothing here"),
        )
    if any(own):
        note = TranslatableText(
            "expected {wanted} as in all examples, found {found}",
            wanted=spaced_hex(bytes(len(own))),
            found=spaced_hex(own),
        )
        return ExplainedField(
            places, own, "reserve", "", TranslatableText("reserve"), Fault.RESERVED_NONZERO, note
        )
    return ExplainedField(
        places,
        own,
        "reserve",
        "",
        TranslatableText("reserve, always 00 in the protocol's examples"),
    )


def _value(raw: bytes, field: Field) -> ExplainedField:
    value = field.read(raw)
    own = raw[field.start : field.start + field.size]
    if field.defined_bits is not None:
        return _flags(own[0], field)
    meaning = TranslatableText(
        "{meaning} ({range})", meaning=TranslatableText(field.meaning), range=field.range_text
    )
    fault, note = None, ""
    if not field.low <= value <= field.high:
        fault, note = (
            Fault.BAD_MOTOR,
            TranslatableText(
                "expected {wanted}, found {found}", wanted=field.range_text, found=value
            ),
        )
    text = f"{value} {field.unit}".rstrip()
    return ExplainedField(field.offsets, own, field.name, text, meaning, fault, note)


def _flags(byte: int, field: Field) -> ExplainedField:
    undefined = byte & ~(field.defined_bits or 0)
    note = TranslatableText(
        "bits that the protocol does not define are set: {bits}", bits=f"{undefined:#04x}"
    )
    return ExplainedField(
        field.offsets,
        bytes([byte]),
        field.name,
        f"0x{byte:02X}",
        field.meaning,
        Fault.UNDEFINED_FLAGS if undefined else None,
        note if undefined else "",
        tuple(
            ExplainedBit(number, bool(byte >> number & 1), *_bit_meaning(field, number))
            for number in range(8)
        ),
    )


def _bit_meaning(field: Field, number: int) -> tuple[str, str]:
    """A label and a sentence."""
    if field.defined_bits is not None and not field.defined_bits >> number & 1:
        return TranslatableText("undefined"), TranslatableText("undefined")
    if field.name == "online":
        motor = TranslatableText("motor {number}", number=number + 1)
        return (
            motor,
            TranslatableText(
                "{motor} online (assumption: the protocol does not say which bit is who)",
                motor=motor,
            ),
        )
    return TranslatableText("unknown"), TranslatableText(
        "meaning unknown: the protocol does not say"
    )


def tail_part(raw: bytes, place: int) -> ExplainedField:
    """The last byte of a frame, right or wrong."""
    fault, note = None, ""
    if raw[place] != TAIL:
        fault, note = (
            Fault.BAD_TAIL,
            TranslatableText(
                "expected {wanted}, found {found}", wanted=f"{TAIL:02X}", found=f"{raw[place]:02X}"
            ),
        )
    return part_of(
        raw, place, place + 1, "tail", meaning=TranslatableText("tail"), fault=fault, note=note
    )


@dataclass(frozen=True, slots=True)
class ExplainedSpan:
    """A damaged frame as the head and the rest of a frame of one kind."""

    kind: FrameKind
    head: int
    """Bytes at the front that fit the frame's first places."""
    rest: int
    """Bytes at the back that fit the frame's last places."""


def _kinds_of(raw: bytes) -> tuple[FrameKind, ...]:
    """The kinds that bytes starting with a header can be of, from what is left of header and CMD.

    With a CMD that the header knows this is one kind; otherwise every kind with this header.
    """
    named = KIND_BY_HEADER_AND_CMD.get((raw[0], raw[CMD_OFFSET])) if len(raw) > 1 else None
    return (named,) if named else tuple(kind for kind in KINDS if kind.header == raw[0])


def split_damaged(raw: bytes) -> ExplainedSpan | None:
    """The best reading of `raw` as one frame that lost bytes or got some put in.

    The head is at least the header, and is taken as long as it fits; the rest is what remains,
    for a truncated frame, and as much of a frame as is missing, for an overlong one.
    """
    best: ExplainedSpan | None = None
    for kind in (*_kinds_of(raw), *(kind for kind in KINDS if kind.header == raw[0])):
        number = KINDS.index(kind)
        fitting = int(head_fit(raw, 0, len(raw), number))
        ending = int(rest_fit(raw, 0, len(raw), number))
        whole = min(len(raw), FRAME_LENGTH)
        head = min(fitting, whole if len(raw) < FRAME_LENGTH else whole - 1)
        if head and head + ending >= whole and (best is None or head > best.head):
            best = ExplainedSpan(kind, head, whole - head)
    return best


def damaged_parts(row: Damage) -> Iterable[ExplainedField]:
    """The parts of a row of damage; one of them shows the fault."""
    raw = row.raw
    if Fault.BAD_HEADER in row.faults or Fault.BAD_TAIL in row.faults:
        return _in_step(raw)
    if Fault.TRUNCATED in row.faults or Fault.OVERLONG in row.faults:
        split = split_damaged(raw)
        return _spliced(raw, split) if split else _unfitting(raw, row.faults[0])
    return [part_of(raw, 0, len(raw), "noise", fault=Fault.NOISE, note=_why_noise(raw))]


def _in_step(raw: bytes) -> Iterator[ExplainedField]:
    kind = KIND_BY_HEADER_AND_CMD.get((raw[0], raw[CMD_OFFSET]))
    yield header_part(raw[0])
    if kind is None:
        yield part_of(raw, CMD_OFFSET, NUM_OFFSET, "cmd", meaning=TranslatableText("CMD"))
        yield part_of(raw, NUM_OFFSET, NUM_OFFSET + 1, "num", meaning=TranslatableText("NUM"))
        yield part_of(raw, 3, FRAME_LENGTH - 1, "payload", meaning=_payload_guess(raw))
    else:
        yield part_of(
            raw,
            CMD_OFFSET,
            NUM_OFFSET,
            "cmd",
            meaning=TranslatableText("CMD: {kind}", kind=kind.name),
        )
        yield from (_undecoded(raw, places, field) for places, field in layout(kind))
    yield tail_part(raw, FRAME_LENGTH - 1)


def _payload_guess(raw: bytes) -> str:
    if raw[0] in DIRECTION_OF_HEADER:
        return TranslatableText("unknown under this CMD")
    fitting = [kind.name for kind in KINDS if raw[CMD_OFFSET] in kind.cmds]
    kinds = TranslatableText("not decoded; by its CMD it was {kinds}", kinds=" or ".join(fitting))
    return kinds if fitting else TranslatableText("not decoded")


def _undecoded(raw: bytes, places: range, field: Field | None, shift: int = 0) -> ExplainedField:
    """The bytes of a field in damage: named, never decoded."""
    if field is not None:
        name, meaning = field.name, field.meaning
    elif places.start == NUM_OFFSET:
        name, meaning = "num", TranslatableText("NUM")
    else:
        name, meaning = "reserve", TranslatableText("reserve")
    return part_of(raw, places.start + shift, places.stop + shift, name, meaning=meaning)


def _spliced(raw: bytes, split: ExplainedSpan) -> Iterator[ExplainedField]:
    """A frame that lost bytes or got some put in: its head, the fault, its rest."""
    kind, head = split.kind, split.head
    known = head > CMD_OFFSET
    yield from _pieces(raw, kind if known else None, range(head), 0)
    shift = len(raw) - FRAME_LENGTH
    found = FRAME_LENGTH - split.rest
    if shift < 0:
        lost = f"DATA[{head}]" if found - head == 1 else f"DATA[{head}:{found}]"
        note = TranslatableText(
            "{place} missing: {count} of a frame's {length} bytes, or others in its place",
            place=lost,
            count=-shift,
            length=FRAME_LENGTH,
        )
        yield ExplainedField(
            range(head, head), b"", "missing", meaning=note, fault=Fault.TRUNCATED, note=_end(raw)
        )
    else:
        note = TranslatableText(
            "{count} bytes too many, here or nearby: {all} where a frame has {length}",
            count=shift,
            all=len(raw),
            length=FRAME_LENGTH,
        )
        extra = range(head, head + shift)
        yield part_of(
            raw,
            extra.start,
            extra.stop,
            "extra",
            meaning=note,
            fault=Fault.OVERLONG,
            note=_why_overlong(raw),
        )
    yield from _pieces(raw, kind if known else None, range(found, FRAME_LENGTH), shift)


def _end(raw: bytes) -> str:
    """Why the bytes are no whole frame."""
    if raw[-1] != TAIL:
        return TranslatableText(
            "expected the tail {wanted} at the end, found {found}",
            wanted=f"{TAIL:02X}",
            found=f"{raw[-1]:02X}",
        )
    return TranslatableText(
        "the tail {byte} is at {place}, not at {wanted}",
        byte=f"{TAIL:02X}",
        place=len(raw) - 1,
        wanted=FRAME_LENGTH - 1,
    )


def _why_overlong(raw: bytes) -> str:
    """Why no whole frame was read at the front or the back."""
    front, back = raw[FRAME_LENGTH - 1], raw[-FRAME_LENGTH]
    reasons = []
    if front != TAIL:
        reasons.append(
            TranslatableText(
                "the first ten bytes end with {found}, not {wanted}",
                found=f"{front:02X}",
                wanted=f"{TAIL:02X}",
            )
        )
    if back not in HEADER_BYTES:
        reasons.append(
            TranslatableText(
                "the last ten begin with {found}, not {wanted}",
                found=f"{back:02X}",
                wanted=HEADERS_TEXT,
            )
        )
    return (
        _together(reasons)
        if reasons
        else TranslatableText("neither the first nor the last ten bytes fit as well")
    )


def _unfitting(raw: bytes, fault: Fault) -> Iterator[ExplainedField]:
    """A header, and perhaps a tail, of which nothing between them tells what it was."""
    yield header_part(raw[0])
    tailed = raw[-1] == TAIL and len(raw) > 1
    stop = len(raw) - tailed
    note = _end(raw) if fault is Fault.TRUNCATED else _why_overlong(raw)
    meaning = TranslatableText(
        "{count} bytes where a frame has {length}; no kind of frame fits them",
        count=len(raw),
        length=FRAME_LENGTH,
    )
    name = "missing" if stop == 1 else "payload"
    yield part_of(raw, 1, stop, name, meaning=meaning, fault=fault, note=note)
    if tailed:
        yield tail_part(raw, stop)


def _pieces(
    raw: bytes, kind: FrameKind | None, places: range, shift: int
) -> Iterator[ExplainedField]:
    """The parts of a frame that fall into `places`, cut to them; `shift` places later in `raw`."""
    inner = [(range(2, 3), None), (range(3, 9), None)] if kind is None else list(layout(kind))
    whole: list[tuple[range, Field | None, str]] = [
        (range(1), None, TranslatableText("header")),
        (range(1, 2), None, TranslatableText("cmd")),
        *((r, field, "") for r, field in inner),
        (range(9, 10), None, TranslatableText("tail")),
    ]
    for own, field, name in whole:
        cut = range(max(own.start, places.start), min(own.stop, places.stop))
        if not cut:
            continue
        if name:
            yield part_of(raw, cut.start + shift, cut.stop + shift, name, meaning=name)
        elif kind is None and own.start > NUM_OFFSET:
            yield part_of(
                raw,
                cut.start + shift,
                cut.stop + shift,
                "payload",
                meaning=TranslatableText("payload"),
            )
        else:
            part = _undecoded(raw, own, field)
            yield part_of(raw, cut.start + shift, cut.stop + shift, part.name, meaning=part.meaning)


def _why_noise(raw: bytes) -> str:
    """Why no frame was read here: what each header byte in the noise lacks."""
    places = [place for place, byte in enumerate(raw) if byte in HEADER_BYTES]
    if not places and len(raw) == 1:
        return TranslatableText("no header ({headers}) in this byte", headers=HEADERS_TEXT)
    if not places:
        return TranslatableText(
            "no header ({headers}) in these {count} bytes", headers=HEADERS_TEXT, count=len(raw)
        )
    shown = [_why_not(raw, place) for place in places[:4]]
    if len(places) > len(shown):
        shown.append(TranslatableText("and {count} more headers", count=len(places) - len(shown)))
    return _together(shown)


def _together(reasons: Sequence[TranslatableText]) -> TranslatableText:
    """Several reasons in one line."""
    return reduce(
        lambda one, other: TranslatableText("{one}; {other}", one=one, other=other), reasons
    )


def _why_not(raw: bytes, place: int) -> TranslatableText:
    header = TranslatableText("{byte} at {place}", byte=f"{raw[place]:02X}", place=place)
    if place + FRAME_LENGTH > len(raw):
        return TranslatableText(
            "{header}: only {count} bytes before the next row",
            header=header,
            count=len(raw) - place,
        )
    own = raw[place : place + FRAME_LENGTH]
    if own[-1] != TAIL:
        return TranslatableText(
            "{header}: no tail {wanted} nine bytes on (found {found})",
            header=header,
            wanted=f"{TAIL:02X}",
            found=f"{own[-1]:02X}",
        )
    if (own[0], own[CMD_OFFSET]) not in KIND_BY_HEADER_AND_CMD:
        return TranslatableText(
            "{header}: CMD {cmd} unknown, and not in step with frames beside it",
            header=header,
            cmd=f"{own[CMD_OFFSET]:02X}",
        )
    return TranslatableText(
        "{header}: ten bytes that look like a frame, but out of step with the frames beside it",
        header=header,
    )


__all__ = ["ExplainedBit", "ExplainedField", "dissect", "explain"]


def dissect(row: Row) -> list[ExplainedField]:
    """The row's bytes in order, each in exactly one part (PROTOCOL.md, both tables of frames)."""
    if isinstance(row, Frame):
        return list(framed_parts(row.raw, row.kind))
    return list(damaged_parts(row))


def explain(row: Row) -> list[str]:
    """One sentence for each fault of the row: what it means; empty where nothing is wrong."""
    return [_explained(fault, row) for fault in row.faults]


def _explained(fault: Fault, row: Row) -> TranslatableText:
    plain = TranslatableText(
        "{fault}: {meaning}", fault=fault.value, meaning=TranslatableText(FAULT_MEANINGS[fault])
    )
    return _doubt(plain, row) if fault is Fault.AMBIGUOUS else plain


def _doubt(plain: TranslatableText, row: Row) -> TranslatableText:
    """With what the row's own bytes tell about the doubt."""
    divided = [place for place in range(1, FRAME_LENGTH - 1) if dividing(row.raw, place)]
    if divided:
        place = next(at for at in range(divided[0], FRAME_LENGTH) if _is_header(row.raw, at))
        return TranslatableText(
            "{doubt} (a frame could end before the {byte} at {place}, and another begin)",
            doubt=plain,
            byte=f"{row.raw[place]:02X}",
            place=place,
        )
    if TAIL in row.raw[1 : FRAME_LENGTH - 1]:
        place = row.raw.index(TAIL, 1)
        return TranslatableText(
            "{doubt} (a frame could end with the {byte} at {place})",
            doubt=plain,
            byte=f"{TAIL:02X}",
            place=place,
        )
    headers = [place for place in range(1, FRAME_LENGTH) if _is_header(row.raw, place)]
    if headers:
        byte = f"{row.raw[headers[0]]:02X}"
        return TranslatableText(
            "{doubt} (a frame could begin with the {byte} at {place})",
            doubt=plain,
            byte=byte,
            place=headers[0],
        )
    return TranslatableText("{doubt} (by what stands beside them)", doubt=plain)


def _is_header(raw: bytes, place: int) -> bool:
    return raw[place] in HEADER_BYTES
