"""Explain a row: its bytes field by field.

The framer decides what is wrong with a row; its decision is `row.faults`. The explanation follows
it: each fault is shown at the bytes that have it, and no other fault is reported. Rows read from a
file carry the same faults and get the same explanation.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from typing import Any, NamedTuple

from fte_sniff.errors import Joint, TranslatableText, listed
from fte_sniff.protocol.columns import spaced_hex
from fte_sniff.protocol.rows import Row
from fte_sniff.protocol.spec import (
    CMD_OFFSET,
    DIRECTION_OF_HEADER,
    FAULT_MEANINGS,
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
_HEADERS = [f"{header:02X}" for header in HEADER_BYTES]


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


def dissect(row: Row) -> list[ExplainedField]:
    """Explain every byte of the row once, in order (docs/reference/protocol.md, "Frames")."""
    size, faults = len(row.raw), row.faults
    if row.framed:
        return [_decoded(row, slot) for slot in _layout(row.kind)]
    kind = KIND_BY_HEADER_AND_CMD.get((row.raw[0], (row.raw + b"\0")[CMD_OFFSET]))
    if size == FRAME_LENGTH and (Fault.BAD_HEADER in faults or Fault.BAD_TAIL in faults):
        return [*_undecoded(row, kind)]
    length_fault = Fault.TRUNCATED if size < FRAME_LENGTH else Fault.OVERLONG
    if length_fault in faults and size != FRAME_LENGTH:
        return [*_undecoded(row, kind), _length_damage(row, length_fault)]
    fault = Fault.NOISE if Fault.NOISE in faults else next(iter(faults), None)
    return [_explained(row, range(size), "noise", fault=fault)]


def explain(row: Row) -> list[str]:
    """One sentence for each fault of the row; empty if it has none."""
    return [
        TranslatableText(
            "{fault}: {meaning}",
            fault=fault.value,
            meaning=TranslatableText(FAULT_MEANINGS[fault]),
        )
        for fault in row.faults
    ]


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
    row: Row, offsets: range, name: str, meaning: str = "", **more: Any
) -> ExplainedField:
    """Adjacent bytes of the row; a fault that the row does not have is left out, with its note."""
    raw = row.raw[offsets.start : offsets.stop]
    found = ExplainedField(offsets, raw, name, meaning=meaning, **more)
    return found if found.fault in row.faults else found._replace(fault=None, note="")


def _expected(expected: object, found: object) -> TranslatableText:
    return TranslatableText("expected {wanted}, found {found}", wanted=expected, found=found)


def _decoded(row: Row, slot: _Slot) -> ExplainedField:
    offsets, name, _, field = slot
    kind, byte = row.kind, row.raw[offsets.start]
    if field is not None:
        return _flags(row, field) if field.legal_bits is not None else _number(row, field)
    if name == "cmd":
        return _cmd(row, kind)
    if name == "header":
        direction = DIRECTION_OF_HEADER[byte]
        meaning = _HEADER_MEANINGS[direction]
        return _explained(row, offsets, name, meaning, value=direction.value)
    if name == "tail":
        return _explained(row, offsets, name, slot.meaning)
    if kind is None:
        return _explained(row, offsets, name, TranslatableText("unknown under this CMD"))
    if name == "reserve":
        return _reserve(row, kind)
    meaning = TranslatableText("NUM: any value, it means nothing here")
    return _explained(row, offsets, name, meaning, value=str(byte))


def _cmd(row: Row, kind: FrameKind | None) -> ExplainedField:
    meaning, cmds = "CMD", [cmd for head, cmd in KIND_BY_HEADER_AND_CMD if head == row.raw[0]]
    if kind is not None:
        meaning = TranslatableText(
            "CMD: {kind}, {meaning}", kind=kind.name, meaning=TranslatableText(kind.meaning)
        )
    note = _expected(listed((f"{cmd:02X}" for cmd in sorted(cmds)), Joint.OR), f"{row.cmd:02X}")
    fault = None if kind else Fault.UNKNOWN_CMD
    return _explained(row, range(1, 2), "cmd", meaning, value=str(row.cmd), fault=fault, note=note)


def _reserve(row: Row, kind: FrameKind) -> ExplainedField:
    offsets = kind.reserved
    raw = row.raw[offsets.start : offsets.stop]
    wanted = bytes([kind.reserve or 0x00]) * len(raw)
    meaning = TranslatableText("reserve: no meaning; the protocol states no value")
    if kind.reserve is not None:
        meaning = TranslatableText(
            "reserve: no meaning; the protocol shows {byte}", byte=f"{kind.reserve:02X}"
        )
    note = _expected(spaced_hex(wanted), spaced_hex(raw))
    fault = None if raw == wanted else Fault.RESERVED_NONZERO
    return _explained(row, offsets, "reserve", meaning, fault=fault, note=note)


def _number(row: Row, field: Field) -> ExplainedField:
    value = field.read(row.raw)
    meaning = TranslatableText(
        "{meaning} ({range})", meaning=TranslatableText(field.meaning), range=field.range_text
    )
    number = _explained(
        row,
        field.offsets,
        field.name,
        meaning,
        value=f"{value} {field.unit}".rstrip(),
        fault=None if field.is_legal(value) else field.fault,
        note=_expected(field.range_text, value),
    )
    erratum = TranslatableText(field.erratum) if value and field.erratum else ""
    return number._replace(note=erratum or number.note)


def _flags(row: Row, field: Field) -> ExplainedField:
    byte = field.read(row.raw)
    defined, raised = field.legal_bits or 0, byte ^ (field.default or 0)
    note = TranslatableText(
        "bits that the protocol does not define are set: {bits}", bits=f"{byte & ~defined:#04x}"
    )
    bits = (
        ExplainedBit(bit, _has(byte, bit), _has(raised, bit), *_bit_meaning(field, byte, bit))
        for bit in range(8)
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


def _bit_meaning(field: Field, byte: int, bit: int) -> tuple[str, str]:
    """The label and the meaning of a bit of a flag byte."""
    if not _has(field.legal_bits or 0, bit):
        return TranslatableText("undefined"), TranslatableText("undefined")
    if field.role is not Role.ONLINE:
        unknown = TranslatableText("meaning unknown: the protocol does not say")
        return TranslatableText("unknown"), unknown
    number = next(motor for motor in MOTORS if motor_bit(motor) == bit)
    motor = TranslatableText("motor {number}", number=number)
    return motor, TranslatableText(
        "{motor} {state} (assumption: the protocol does not say which bit is which motor)",
        motor=motor,
        state=TranslatableText("online") if _has(byte, bit) else TranslatableText("not online"),
    )


def _undecoded(row: Row, kind: FrameKind | None) -> Iterator[ExplainedField]:
    """A damaged frame as far as it has bytes: only a wrong header or tail is at fault."""
    limited = {"header": (Fault.BAD_HEADER, _HEADERS), "tail": (Fault.BAD_TAIL, [f"{TAIL:02X}"])}
    for slot in _layout(kind):
        offsets = range(slot.offsets.start, min(slot.offsets.stop, len(row.raw)))
        if offsets:
            byte = f"{row.raw[offsets.start]:02X}"
            fault, wanted = limited.get(slot.name, (None, [byte]))
            own = None if byte in wanted else fault
            note = _expected(listed(wanted, Joint.OR), byte)
            yield _explained(row, offsets, slot.name, slot.meaning, fault=own, note=note)


def _length_damage(row: Row, fault: Fault) -> ExplainedField:
    """What is missing at the end of a row, or too much there: it may have been anywhere before."""
    count = len(row.raw)
    if fault is Fault.TRUNCATED:
        meaning = TranslatableText(
            "{count} of a frame's {length} bytes are missing, here or before",
            count=FRAME_LENGTH - count,
            length=FRAME_LENGTH,
        )
        return _explained(row, range(count, count), "missing", meaning, fault=fault)
    meaning = TranslatableText("{count} bytes too many, here or before", count=count - FRAME_LENGTH)
    return _explained(row, range(FRAME_LENGTH, count), "extra", meaning, fault=fault)
