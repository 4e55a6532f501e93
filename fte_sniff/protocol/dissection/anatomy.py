"""Owns the explanation of one frame, field by field: every byte, what it is, what is wrong there.

It must not know of rows or damage, nor how it is shown.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from fte_sniff.protocol.columns import spaced_hex
from fte_sniff.protocol.rows import Fault
from fte_sniff.protocol.structure import HEADER_BYTES
from fte_sniff.protocol.table import (
    CMD_PLACE,
    DIRECTION_OF_HEADER,
    FRAME_LENGTH,
    KIND_BY_HEADER_AND_CMD,
    NUM_PLACE,
    TAIL,
    Direction,
    Field,
    FrameKind,
)
from fte_sniff.said import Said

_WAY = {
    Direction.CONTROL: Said("header: control, host to controller"),
    Direction.FEEDBACK: Said("header: feedback, controller to host"),
}
HEADERS_TEXT = " or ".join(f"{header:02X}" for header in HEADER_BYTES)


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


def framed_parts(raw: bytes, kind: FrameKind | None) -> Iterator[Part]:
    """The parts of ten framed bytes; of no kind where header and CMD name none."""
    yield header_part(raw[0])
    yield _cmd(raw[0], raw[CMD_PLACE])
    if kind is None:
        yield part_of(raw, NUM_PLACE, NUM_PLACE + 1, "num", meaning=Said("unknown under this CMD"))
        yield part_of(raw, 3, FRAME_LENGTH - 1, "payload", meaning=Said("unknown under this CMD"))
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
    bits: tuple[Bit, ...] = (),
) -> Part:
    """The part from `start` to `stop`."""
    return Part(range(start, stop), raw[start:stop], name, value, meaning, fault, note, bits)


def header_part(byte: int) -> Part:
    """The first byte of a frame, right or wrong."""
    direction = DIRECTION_OF_HEADER.get(byte)
    if direction is None:
        note = Said("expected {wanted}, found {found}", wanted=HEADERS_TEXT, found=f"{byte:02X}")
        return Part(
            range(1),
            bytes([byte]),
            "header",
            meaning=Said("header"),
            fault=Fault.BAD_HEADER,
            note=note,
        )
    return Part(range(1), bytes([byte]), "header", direction.value, _WAY[direction])


def _cmd(header: int, cmd: int) -> Part:
    places = range(CMD_PLACE, CMD_PLACE + 1)
    kind = KIND_BY_HEADER_AND_CMD.get((header, cmd))
    if kind is None:
        legal = ", ".join(
            sorted(f"{c:02X}" for h, c in KIND_BY_HEADER_AND_CMD if h == header or header == -1)
        )
        way = DIRECTION_OF_HEADER[header].value
        note = Said(
            "the protocol has no CMD {cmd} for {way}; it has {legal}",
            cmd=f"{cmd:02X}",
            way=way,
            legal=legal,
        )
        return Part(places, bytes([cmd]), "cmd", str(cmd), "CMD", Fault.UNKNOWN_CMD, note)
    return Part(
        places,
        bytes([cmd]),
        "cmd",
        str(cmd),
        Said("CMD: {kind}, {meaning}", kind=kind.name, meaning=Said(kind.meaning)),
    )


def layout(kind: FrameKind) -> Iterator[tuple[range, Field | None]]:
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
        return Part(places, own, "num", str(own[0]), Said("NUM: any value, it means nothing here"))
    if any(own):
        note = Said(
            "expected {wanted} as in all examples, found {found}",
            wanted=spaced_hex(bytes(len(own))),
            found=spaced_hex(own),
        )
        return Part(places, own, "reserve", "", Said("reserve"), Fault.RESERVED_NONZERO, note)
    return Part(places, own, "reserve", "", Said("reserve, always 00 in the protocol's examples"))


def _value(raw: bytes, field: Field) -> Part:
    value = field.read(raw)
    own = raw[field.start : field.start + field.size]
    if field.defined_bits is not None:
        return _flags(own[0], field)
    meaning = Said("{meaning} ({range})", meaning=Said(field.meaning), range=field.range_text)
    fault, note = None, ""
    if not field.low <= value <= field.high:
        fault, note = (
            Fault.BAD_MOTOR,
            Said("expected {wanted}, found {found}", wanted=field.range_text, found=value),
        )
    text = f"{value} {field.unit}".rstrip()
    return Part(field.places, own, field.name, text, meaning, fault, note)


def _flags(byte: int, field: Field) -> Part:
    undefined = byte & ~(field.defined_bits or 0)
    note = Said("bits that the protocol does not define are set: {bits}", bits=f"{undefined:#04x}")
    return Part(
        field.places,
        bytes([byte]),
        field.name,
        f"0x{byte:02X}",
        field.meaning,
        Fault.UNDEFINED_FLAGS if undefined else None,
        note if undefined else "",
        tuple(
            Bit(number, bool(byte >> number & 1), *_bit_meaning(field, number))
            for number in range(8)
        ),
    )


def _bit_meaning(field: Field, number: int) -> tuple[str, str]:
    """A label and a sentence."""
    if field.defined_bits is not None and not field.defined_bits >> number & 1:
        return Said("undefined"), Said("undefined")
    if field.name == "online":
        motor = Said("motor {number}", number=number + 1)
        return (
            motor,
            Said(
                "{motor} online (assumption: the protocol does not say which bit is who)",
                motor=motor,
            ),
        )
    return Said("unknown"), Said("meaning unknown: the protocol does not say")


def tail_part(raw: bytes, place: int) -> Part:
    """The last byte of a frame, right or wrong."""
    fault, note = None, ""
    if raw[place] != TAIL:
        fault, note = (
            Fault.BAD_TAIL,
            Said(
                "expected {wanted}, found {found}", wanted=f"{TAIL:02X}", found=f"{raw[place]:02X}"
            ),
        )
    return part_of(raw, place, place + 1, "tail", meaning=Said("tail"), fault=fault, note=note)
