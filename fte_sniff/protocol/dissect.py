"""Owns the field-by-field explanation of one row: every byte, what it is, and what is wrong there.

It must not know how it is shown, nor decide anything: the framer has decided, this page explains.
Each byte of a row stands in exactly one part; a part without bytes marks where bytes are missing.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from fte_sniff.protocol.columns import spaced_hex
from fte_sniff.protocol.rows import FAULT_MEANINGS, Damage, Fault, Frame, Row
from fte_sniff.protocol.structure import HEADER_BYTES, Split, split_damaged
from fte_sniff.protocol.table import (
    CMD_PLACE,
    DIRECTION_OF_HEADER,
    FRAME_LENGTH,
    KIND_BY_HEADER_AND_CMD,
    KINDS,
    NUM_PLACE,
    TAIL,
    Direction,
    Field,
    FrameKind,
)

_WAY = {
    Direction.CONTROL: "control, host to controller",
    Direction.FEEDBACK: "feedback, controller to host",
}
_HEADERS_TEXT = " or ".join(f"{header:02X}" for header in HEADER_BYTES)


@dataclass(frozen=True, slots=True)
class Bit:
    """One bit of a flag byte."""

    number: int
    """0 is the least significant."""
    is_set: bool
    label: str
    """What it is, in a word or two; the same for neighbours that mean the same."""
    meaning: str


@dataclass(frozen=True, slots=True)
class Part:
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
    bits: tuple[Bit, ...] = ()
    """For a flag byte: its bits, from bit 0 up."""


def dissect(row: Row) -> list[Part]:
    """The row's bytes in order, each in exactly one part (PROTOCOL.md, both tables of frames)."""
    if isinstance(row, Frame):
        return list(_framed(row.raw, row.kind))
    return list(_damaged(row))


def explain(row: Row) -> list[str]:
    """One sentence for each fault of the row: what it means; empty where nothing is wrong."""
    return [f"{fault}: {FAULT_MEANINGS[fault]}" for fault in row.faults]


# Frames


def _framed(raw: bytes, kind: FrameKind | None) -> Iterator[Part]:
    yield _header(raw[0])
    yield _cmd(raw[0], raw[CMD_PLACE])
    if kind is None:
        yield _part(raw, NUM_PLACE, NUM_PLACE + 1, "num", meaning="unknown under this CMD")
        yield _part(raw, 3, FRAME_LENGTH - 1, "payload", meaning="unknown under this CMD")
    else:
        for places, field in _layout(kind):
            yield _content(raw, places, field)
    yield _tail(raw, FRAME_LENGTH - 1)


def _part(
    raw: bytes,
    start: int,
    stop: int,
    name: str,
    *,
    value: str = "",
    meaning: str = "",
    fault: Fault | None = None,
    note: str = "",
    bits: tuple[Bit, ...] = (),
) -> Part:
    return Part(range(start, stop), raw[start:stop], name, value, meaning, fault, note, bits)


def _header(byte: int) -> Part:
    direction = DIRECTION_OF_HEADER.get(byte)
    if direction is None:
        note = f"expected {_HEADERS_TEXT}, found {byte:02X}"
        return Part(
            range(1), bytes([byte]), "header", meaning="header", fault=Fault.BAD_HEADER, note=note
        )
    return Part(range(1), bytes([byte]), "header", direction.value, f"header: {_WAY[direction]}")


def _cmd(header: int, cmd: int) -> Part:
    places = range(CMD_PLACE, CMD_PLACE + 1)
    kind = KIND_BY_HEADER_AND_CMD.get((header, cmd))
    if kind is None:
        legal = ", ".join(
            sorted(f"{c:02X}" for h, c in KIND_BY_HEADER_AND_CMD if h == header or header == -1)
        )
        way = DIRECTION_OF_HEADER[header].value
        note = f"the protocol has no CMD {cmd:02X} for {way}; it has {legal}"
        return Part(places, bytes([cmd]), "cmd", str(cmd), "CMD", Fault.UNKNOWN_CMD, note)
    return Part(places, bytes([cmd]), "cmd", str(cmd), f"CMD: {kind.name}, {kind.meaning}")


def _layout(kind: FrameKind) -> Iterator[tuple[range, Field | None]]:
    """The places between CMD and tail, field by field; None for bytes that are no field."""
    place = NUM_PLACE
    starts = {field.start: field for field in kind.fields}
    while place < FRAME_LENGTH - 1:
        field = starts.get(place)
        stop = field.places.stop if field else place + 1
        if field is None and place != NUM_PLACE:
            while stop < FRAME_LENGTH - 1 and stop not in starts:
                stop += 1
        yield range(place, stop), field
        place = stop


def _content(raw: bytes, places: range, field: Field | None) -> Part:
    if field is not None:
        return _value(raw, field)
    own = raw[places.start : places.stop]
    if places.start == NUM_PLACE:
        return Part(places, own, "num", str(own[0]), "NUM: any value, it means nothing here")
    if any(own):
        note = f"expected {spaced_hex(bytes(len(own)))} as in all examples, found {spaced_hex(own)}"
        return Part(places, own, "reserve", "", "reserve", Fault.RESERVED_NONZERO, note)
    return Part(places, own, "reserve", "", "reserve, always 00 in the protocol's examples")


def _value(raw: bytes, field: Field) -> Part:
    value = field.read(raw)
    own = raw[field.start : field.start + field.size]
    if field.defined_bits is not None:
        return _flags(own[0], field)
    meaning = f"{field.meaning} ({field.range_text})"
    fault, note = None, ""
    if not field.low <= value <= field.high:
        fault, note = Fault.BAD_MOTOR, f"expected {field.range_text}, found {value}"
    text = f"{value} {field.unit}".rstrip()
    return Part(field.places, own, field.name, text, meaning, fault, note)


def _flags(byte: int, field: Field) -> Part:
    undefined = byte & ~(field.defined_bits or 0)
    note = f"bits that the protocol does not define are set: {undefined:#04x}" if undefined else ""
    return Part(
        field.places,
        bytes([byte]),
        field.name,
        f"0x{byte:02X}",
        field.meaning,
        Fault.UNDEFINED_FLAGS if undefined else None,
        note,
        tuple(
            Bit(number, bool(byte >> number & 1), *_bit_meaning(field, number))
            for number in range(8)
        ),
    )


def _bit_meaning(field: Field, number: int) -> tuple[str, str]:
    """A label and a sentence."""
    if field.defined_bits is not None and not field.defined_bits >> number & 1:
        return "undefined", "undefined"
    if field.name == "online":
        motor = f"motor {number + 1}"
        return (
            motor,
            f"{motor} online (assumption: the protocol does not say which bit is who)",
        )
    return "unknown", "meaning unknown: the protocol does not say"


def _tail(raw: bytes, place: int) -> Part:
    byte = raw[place]
    if byte != TAIL:
        note = f"expected {TAIL:02X}, found {byte:02X}"
        return _part(raw, place, place + 1, "tail", meaning="tail", fault=Fault.BAD_TAIL, note=note)
    return _part(raw, place, place + 1, "tail", meaning="tail")


# Damage


def _damaged(row: Damage) -> Iterable[Part]:
    raw = row.raw
    if len(raw) == FRAME_LENGTH and (
        Fault.BAD_HEADER in row.faults or Fault.BAD_TAIL in row.faults
    ):
        return _in_step(raw)
    if Fault.TRUNCATED in row.faults or Fault.OVERLONG in row.faults:
        split = split_damaged(raw)
        if split is not None:
            return _spliced(raw, split)
    return [_noise(raw)]


def _in_step(raw: bytes) -> Iterator[Part]:
    kind = KIND_BY_HEADER_AND_CMD.get((raw[0], raw[CMD_PLACE]))
    yield _header(raw[0])
    if kind is None:
        yield _part(raw, CMD_PLACE, NUM_PLACE, "cmd", meaning="CMD")
        yield _part(raw, NUM_PLACE, NUM_PLACE + 1, "num", meaning="NUM")
        yield _part(raw, 3, FRAME_LENGTH - 1, "payload", meaning=_payload_guess(raw))
    else:
        yield _part(raw, CMD_PLACE, NUM_PLACE, "cmd", meaning=f"CMD: {kind.name}")
        yield from (_undecoded(raw, places, field) for places, field in _layout(kind))
    yield _tail(raw, FRAME_LENGTH - 1)


def _payload_guess(raw: bytes) -> str:
    if raw[0] in DIRECTION_OF_HEADER:
        return "unknown under this CMD"
    fitting = [kind.name for kind in KINDS if raw[CMD_PLACE] in kind.cmds]
    return f"not decoded; by its CMD it was {' or '.join(fitting)}" if fitting else "not decoded"


def _undecoded(raw: bytes, places: range, field: Field | None, shift: int = 0) -> Part:
    """The bytes of a field in damage: named, never decoded."""
    if field is not None:
        name, meaning = field.name, field.meaning
    elif places.start == NUM_PLACE:
        name, meaning = "num", "NUM"
    else:
        name, meaning = "reserve", "reserve"
    return _part(raw, places.start + shift, places.stop + shift, name, meaning=meaning)


def _spliced(raw: bytes, split: Split) -> Iterator[Part]:
    """A frame that lost bytes or got some put in: its head, the fault, its rest."""
    kind, head = split.kind, split.head
    known = head > CMD_PLACE
    yield from _pieces(raw, kind if known else None, range(head), 0)
    shift = len(raw) - FRAME_LENGTH
    found = FRAME_LENGTH - split.rest
    if shift < 0:
        lost = f"DATA[{head}]" if found - head == 1 else f"DATA[{head}:{found}]"
        note = f"{lost} missing: {-shift} of a frame's {FRAME_LENGTH} bytes, or others in its place"
        yield Part(
            range(head, head), b"", "missing", meaning=note, fault=Fault.TRUNCATED, note=_end(raw)
        )
    else:
        note = f"{shift} bytes too many, here or nearby: {len(raw)} where a frame has 10"
        extra = range(head, head + shift)
        yield Part(extra, raw[head : head + shift], "extra", meaning=note, fault=Fault.OVERLONG)
    yield from _pieces(raw, kind if known else None, range(found, FRAME_LENGTH), shift)


def _end(raw: bytes) -> str:
    if raw[-1] == TAIL:
        return ""
    return f"expected the tail {TAIL:02X} at the end, found {raw[-1]:02X}"


def _pieces(raw: bytes, kind: FrameKind | None, places: range, shift: int) -> Iterator[Part]:
    """The parts of a frame that fall into `places`, cut to them; `shift` places later in `raw`."""
    inner = [(range(2, 3), None), (range(3, 9), None)] if kind is None else list(_layout(kind))
    whole: list[tuple[range, Field | None, str]] = [
        (range(1), None, "header"),
        (range(1, 2), None, "cmd"),
        *((r, field, "") for r, field in inner),
        (range(9, 10), None, "tail"),
    ]
    for own, field, name in whole:
        cut = range(max(own.start, places.start), min(own.stop, places.stop))
        if not cut:
            continue
        if name:
            yield _part(raw, cut.start + shift, cut.stop + shift, name, meaning=name)
        elif kind is None and own.start > NUM_PLACE:
            yield _part(raw, cut.start + shift, cut.stop + shift, "payload", meaning="payload")
        else:
            part = _undecoded(raw, own, field)
            yield _part(raw, cut.start + shift, cut.stop + shift, part.name, meaning=part.meaning)


def _noise(raw: bytes) -> Part:
    return _part(raw, 0, len(raw), "noise", fault=Fault.NOISE, note=_why_noise(raw))


def _why_noise(raw: bytes) -> str:
    """Why no frame was read here: what each header byte in the noise lacks."""
    places = [place for place, byte in enumerate(raw) if byte in HEADER_BYTES]
    if not places:
        return f"no header ({_HEADERS_TEXT}) in these {len(raw)} bytes"
    shown = [_why_not(raw, place) for place in places[:4]]
    more = f"; and {len(places) - 4} more headers" if len(places) > 4 else ""
    return "; ".join(shown) + more


def _why_not(raw: bytes, place: int) -> str:
    header = f"{raw[place]:02X} at {place}"
    if place + FRAME_LENGTH > len(raw):
        return f"{header}: only {len(raw) - place} bytes before the next row"
    own = raw[place : place + FRAME_LENGTH]
    if own[-1] != TAIL:
        return f"{header}: no tail {TAIL:02X} nine bytes on (found {own[-1]:02X})"
    if (own[0], own[CMD_PLACE]) not in KIND_BY_HEADER_AND_CMD:
        return f"{header}: CMD {own[CMD_PLACE]:02X} unknown, and not in step with frames beside it"
    return f"{header}: ten bytes that look like a frame, but out of step with the frames beside it"
