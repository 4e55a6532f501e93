"""Explain a row: its bytes field by field.

The framer decides what is wrong with a row; its decision is `row.faults`. The explanation follows
it: each fault is shown at the bytes that have it, and no other fault is reported. Rows read from a
file carry the same faults and get the same explanation.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from typing import NamedTuple

from fte_sniff.errors import Joint, TranslatableText, listed
from fte_sniff.protocol.columns import spaced_hex
from fte_sniff.protocol.rows import Row
from fte_sniff.protocol.spec import (
    CMD_OFFSET,
    DIRECTION_OF_HEADER,
    FRAME_LENGTH,
    HEADER_BYTES,
    KIND_BY_HEADER_AND_CMD,
    MOTORS,
    NUM_OFFSET,
    TAIL,
    Direction,
    Fault,
    Field,
    FrameKind,
    Role,
    motor_bit,
)

_HEADER_MEANINGS = {
    Direction.CONTROL: TranslatableText("header: control, host to controller"),
    Direction.FEEDBACK: TranslatableText("header: feedback, controller to host"),
}


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
    """With a fault, what was expected and what was found; without one, the field's erratum."""
    bits: tuple[ExplainedBit, ...] = ()
    """The bits of a flag byte, from bit 0 up."""
    is_raised: bool = False
    """Whether it is a flag byte that differs from its default."""


_SHAPES = {Fault.BAD_HEADER, Fault.BAD_TAIL, Fault.TRUNCATED, Fault.OVERLONG}
"""Faults of bytes that are like a frame; all other bytes without a frame are noise."""


def dissect(row: Row) -> list[ExplainedField]:
    """Explain every byte of the row once, in order (docs/reference/protocol.md, "Frames").

    Damage has no values: a missing byte may have been anywhere.
    """
    raw, size = row.raw, len(row.raw)
    if not row.framed and _SHAPES.isdisjoint(row.faults):
        fault = Fault.NOISE if Fault.NOISE in row.faults else None
        return [ExplainedField(range(size), raw, "noise", fault=fault)]
    slots = _layout(raw[0], raw[CMD_OFFSET] if size > CMD_OFFSET else None)
    fields = [_explained(row, slot) for slot in slots if slot.offsets.start < size]
    return fields if size == FRAME_LENGTH else [*fields, _length_damage(row)]


def explain(row: Row) -> list[str]:
    """One sentence for each fault of the row; empty if it has none."""
    form = "{fault}: {meaning}"
    return [
        TranslatableText(form, fault=one.value, meaning=TranslatableText(one.meaning))
        for one in row.faults
    ]


class _Slot(NamedTuple):
    """Adjacent bytes of a frame with one meaning."""

    offsets: range
    name: str
    meaning: str
    legal: bytes = b""
    """The bytes without a fault."""
    fault: Fault | None = None
    """The fault of another byte; None if each byte is legal."""
    field: Field | None = None


@cache
def _layout(header: int, cmd: int | None) -> tuple[_Slot, ...]:
    """The slots of a frame by its first bytes; without a kind, its inner bytes mean nothing."""
    kind = None if cmd is None else KIND_BY_HEADER_AND_CMD.get((header, cmd))
    cmds = bytes(sorted(cmd for head, cmd in KIND_BY_HEADER_AND_CMD if head == header))
    name, meaning = TranslatableText("header"), TranslatableText("CMD")
    if direction := DIRECTION_OF_HEADER.get(header):
        name = _HEADER_MEANINGS[direction]
    if kind is not None:
        meaning = TranslatableText(
            "CMD: {kind}, {meaning}", kind=kind.name, meaning=TranslatableText(kind.meaning)
        )
    tail = range(FRAME_LENGTH - 1, FRAME_LENGTH)
    slots = [
        _Slot(range(1), "header", name, HEADER_BYTES, Fault.BAD_HEADER),
        _Slot(range(CMD_OFFSET, CMD_OFFSET + 1), "cmd", meaning, cmds, Fault.UNKNOWN_CMD),
        *_inner_slots(kind),
        _Slot(tail, "tail", TranslatableText("tail"), bytes([TAIL]), Fault.BAD_TAIL),
    ]
    return tuple(sorted(slots, key=lambda slot: slot.offsets.start))


def _inner_slots(kind: FrameKind | None) -> Iterator[_Slot]:
    num = range(NUM_OFFSET, NUM_OFFSET + 1)
    if kind is None:
        unknown = TranslatableText("unknown under this CMD")
        yield _Slot(num, "num", unknown)
        yield _Slot(range(num.stop, FRAME_LENGTH - 1), "payload", unknown)
        return
    legal = kind.legal_bytes()
    for field in kind.fields:
        meaning = TranslatableText(field.meaning)
        if field.legal_bits is None:
            form = "{meaning} ({range})"
            meaning = TranslatableText(form, meaning=meaning, range=field.range_text)
        own = legal[field.start] or b""
        yield _Slot(field.offsets, field.name, meaning, own, field.fault, field)
    if not kind.names_motor:
        yield _Slot(num, "num", TranslatableText("NUM: any value, it means nothing here"))
    if kind.reserved:
        meaning = TranslatableText("reserve: no meaning; the protocol states no value")
        if kind.reserve is not None:
            meaning = TranslatableText(
                "reserve: no meaning; the protocol shows {byte}", byte=f"{kind.reserve:02X}"
            )
        usual = bytes([kind.reserve or 0])
        yield _Slot(kind.reserved, "reserve", meaning, usual, Fault.RESERVED_NONZERO)


def _explained(row: Row, slot: _Slot) -> ExplainedField:
    """The bytes of the row in a slot; they have a fault only if the row has it."""
    offsets, name, meaning, legal, fault, field = slot
    raw = row.raw[offsets.start : offsets.stop]
    found = ExplainedField(range(offsets.start, offsets.start + len(raw)), raw, name, "", meaning)
    if fault in row.faults and not set(legal).issuperset(raw):
        note = TranslatableText(
            "expected {wanted}, found {found}", wanted=_wanted(legal, raw), found=spaced_hex(raw)
        )
        found = found._replace(fault=fault, note=note)
    if not row.framed:
        return found
    if name == "header":
        return found._replace(value=DIRECTION_OF_HEADER[raw[0]].value)
    if field is None:
        return found._replace(value=str(raw[0]) if name in {"cmd", "num"} else "")
    value = field.read(row.raw)
    if value and field.erratum:
        found = found._replace(note=TranslatableText(field.erratum))
    if field.legal_bits is not None:
        found = found._replace(bits=tuple(_bits(field, value)), is_raised=field.raised(value))
    return found._replace(value=f"{field.text(value)} {field.unit}".rstrip())


def _wanted(legal: bytes, raw: bytes) -> str:
    """The legal bytes of a slot in words: `00 00`, `00-0F`, `AA or 55`."""
    if len(legal) == 1:
        return spaced_hex(legal * len(raw))
    if 2 < len(legal) == max(legal) - min(legal) + 1:
        return f"{min(legal):02X}-{max(legal):02X}"
    return listed((f"{byte:02X}" for byte in legal), Joint.OR)


def _bits(field: Field, value: int) -> Iterator[ExplainedBit]:
    """The bits of a flag byte, from bit 0 up."""
    raised = value ^ (field.default or 0)
    for bit in range(8):
        is_set = bool(value >> bit & 1)
        yield ExplainedBit(bit, is_set, bool(raised >> bit & 1), *_bit_meaning(field, bit, is_set))


def _bit_meaning(field: Field, bit: int, is_set: bool) -> tuple[str, str]:
    """The label and the meaning of a bit of a flag byte."""
    if not (field.legal_bits or 0) >> bit & 1:
        return TranslatableText("undefined"), TranslatableText("undefined")
    if field.role is not Role.ONLINE:
        unknown = TranslatableText("meaning unknown: the protocol does not say")
        return TranslatableText("unknown"), unknown
    number = next(motor for motor in MOTORS if motor_bit(motor) == bit)
    motor = TranslatableText("motor {number}", number=number)
    return motor, TranslatableText(
        "{motor} {state} (assumption: the protocol does not say which bit is which motor)",
        motor=motor,
        state=TranslatableText("online") if is_set else TranslatableText("not online"),
    )


def _length_damage(row: Row) -> ExplainedField:
    """What is missing at the end of a row, or too much there: it may have been anywhere before."""
    count, fault = len(row.raw), Fault.OVERLONG
    offsets, name = range(FRAME_LENGTH, count), "extra"
    meaning = TranslatableText("{count} bytes too many, here or before", count=count - FRAME_LENGTH)
    if count < FRAME_LENGTH:
        offsets, name, fault = range(count, count), "missing", Fault.TRUNCATED
        meaning = TranslatableText(
            "{count} of a frame's {length} bytes are missing, here or before",
            count=FRAME_LENGTH - count,
            length=FRAME_LENGTH,
        )
    known = fault if fault in row.faults else None
    return ExplainedField(offsets, row.raw[FRAME_LENGTH:], name, meaning=meaning, fault=known)
