"""Owns the explanation of damage: which bytes are at fault, and why it was read no other way.

It must not know how it is shown, nor decode any value: no damage shows a number.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from functools import reduce

from fte_sniff.protocol.dissection.anatomy import (
    HEADERS_TEXT,
    Part,
    header_part,
    layout,
    part_of,
    tail_part,
)
from fte_sniff.protocol.dissection.splitting import Split, split_damaged
from fte_sniff.protocol.rows import Damage, Fault
from fte_sniff.protocol.structure import HEADER_BYTES
from fte_sniff.protocol.table import (
    CMD_PLACE,
    DIRECTION_OF_HEADER,
    FRAME_LENGTH,
    KIND_BY_HEADER_AND_CMD,
    KINDS,
    NUM_PLACE,
    TAIL,
    Field,
    FrameKind,
)
from fte_sniff.said import Said


def damaged_parts(row: Damage) -> Iterable[Part]:
    """The parts of a row of damage; one of them shows the fault."""
    raw = row.raw
    if Fault.BAD_HEADER in row.faults or Fault.BAD_TAIL in row.faults:
        return _in_step(raw)
    if Fault.TRUNCATED in row.faults or Fault.OVERLONG in row.faults:
        split = split_damaged(raw)
        return _spliced(raw, split) if split else _unfitting(raw, row.faults[0])
    return [part_of(raw, 0, len(raw), "noise", fault=Fault.NOISE, note=_why_noise(raw))]


def _in_step(raw: bytes) -> Iterator[Part]:
    kind = KIND_BY_HEADER_AND_CMD.get((raw[0], raw[CMD_PLACE]))
    yield header_part(raw[0])
    if kind is None:
        yield part_of(raw, CMD_PLACE, NUM_PLACE, "cmd", meaning=Said("CMD"))
        yield part_of(raw, NUM_PLACE, NUM_PLACE + 1, "num", meaning=Said("NUM"))
        yield part_of(raw, 3, FRAME_LENGTH - 1, "payload", meaning=_payload_guess(raw))
    else:
        yield part_of(raw, CMD_PLACE, NUM_PLACE, "cmd", meaning=Said("CMD: {kind}", kind=kind.name))
        yield from (_undecoded(raw, places, field) for places, field in layout(kind))
    yield tail_part(raw, FRAME_LENGTH - 1)


def _payload_guess(raw: bytes) -> str:
    if raw[0] in DIRECTION_OF_HEADER:
        return Said("unknown under this CMD")
    fitting = [kind.name for kind in KINDS if raw[CMD_PLACE] in kind.cmds]
    kinds = Said("not decoded; by its CMD it was {kinds}", kinds=" or ".join(fitting))
    return kinds if fitting else Said("not decoded")


def _undecoded(raw: bytes, places: range, field: Field | None, shift: int = 0) -> Part:
    """The bytes of a field in damage: named, never decoded."""
    if field is not None:
        name, meaning = field.name, field.meaning
    elif places.start == NUM_PLACE:
        name, meaning = "num", Said("NUM")
    else:
        name, meaning = "reserve", Said("reserve")
    return part_of(raw, places.start + shift, places.stop + shift, name, meaning=meaning)


def _spliced(raw: bytes, split: Split) -> Iterator[Part]:
    """A frame that lost bytes or got some put in: its head, the fault, its rest."""
    kind, head = split.kind, split.head
    known = head > CMD_PLACE
    yield from _pieces(raw, kind if known else None, range(head), 0)
    shift = len(raw) - FRAME_LENGTH
    found = FRAME_LENGTH - split.rest
    if shift < 0:
        lost = f"DATA[{head}]" if found - head == 1 else f"DATA[{head}:{found}]"
        note = Said(
            "{place} missing: {count} of a frame's {length} bytes, or others in its place",
            place=lost,
            count=-shift,
            length=FRAME_LENGTH,
        )
        yield Part(
            range(head, head), b"", "missing", meaning=note, fault=Fault.TRUNCATED, note=_end(raw)
        )
    else:
        note = Said(
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
        return Said(
            "expected the tail {wanted} at the end, found {found}",
            wanted=f"{TAIL:02X}",
            found=f"{raw[-1]:02X}",
        )
    return Said(
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
            Said(
                "the first ten bytes end with {found}, not {wanted}",
                found=f"{front:02X}",
                wanted=f"{TAIL:02X}",
            )
        )
    if back not in HEADER_BYTES:
        reasons.append(
            Said(
                "the last ten begin with {found}, not {wanted}",
                found=f"{back:02X}",
                wanted=HEADERS_TEXT,
            )
        )
    return (
        _together(reasons)
        if reasons
        else Said("neither the first nor the last ten bytes fit as well")
    )


def _unfitting(raw: bytes, fault: Fault) -> Iterator[Part]:
    """A header, and perhaps a tail, of which nothing between them tells what it was."""
    yield header_part(raw[0])
    tailed = raw[-1] == TAIL and len(raw) > 1
    stop = len(raw) - tailed
    note = _end(raw) if fault is Fault.TRUNCATED else _why_overlong(raw)
    meaning = Said(
        "{count} bytes where a frame has {length}; no kind of frame fits them",
        count=len(raw),
        length=FRAME_LENGTH,
    )
    name = "missing" if stop == 1 else "payload"
    yield part_of(raw, 1, stop, name, meaning=meaning, fault=fault, note=note)
    if tailed:
        yield tail_part(raw, stop)


def _pieces(raw: bytes, kind: FrameKind | None, places: range, shift: int) -> Iterator[Part]:
    """The parts of a frame that fall into `places`, cut to them; `shift` places later in `raw`."""
    inner = [(range(2, 3), None), (range(3, 9), None)] if kind is None else list(layout(kind))
    whole: list[tuple[range, Field | None, str]] = [
        (range(1), None, Said("header")),
        (range(1, 2), None, Said("cmd")),
        *((r, field, "") for r, field in inner),
        (range(9, 10), None, Said("tail")),
    ]
    for own, field, name in whole:
        cut = range(max(own.start, places.start), min(own.stop, places.stop))
        if not cut:
            continue
        if name:
            yield part_of(raw, cut.start + shift, cut.stop + shift, name, meaning=name)
        elif kind is None and own.start > NUM_PLACE:
            yield part_of(
                raw, cut.start + shift, cut.stop + shift, "payload", meaning=Said("payload")
            )
        else:
            part = _undecoded(raw, own, field)
            yield part_of(raw, cut.start + shift, cut.stop + shift, part.name, meaning=part.meaning)


def _why_noise(raw: bytes) -> str:
    """Why no frame was read here: what each header byte in the noise lacks."""
    places = [place for place, byte in enumerate(raw) if byte in HEADER_BYTES]
    if not places and len(raw) == 1:
        return Said("no header ({headers}) in this byte", headers=HEADERS_TEXT)
    if not places:
        return Said(
            "no header ({headers}) in these {count} bytes", headers=HEADERS_TEXT, count=len(raw)
        )
    shown = [_why_not(raw, place) for place in places[:4]]
    if len(places) > len(shown):
        shown.append(Said("and {count} more headers", count=len(places) - len(shown)))
    return _together(shown)


def _together(reasons: Sequence[Said]) -> Said:
    """Several reasons in one line."""
    return reduce(lambda one, other: Said("{one}; {other}", one=one, other=other), reasons)


def _why_not(raw: bytes, place: int) -> Said:
    header = Said("{byte} at {place}", byte=f"{raw[place]:02X}", place=place)
    if place + FRAME_LENGTH > len(raw):
        return Said(
            "{header}: only {count} bytes before the next row",
            header=header,
            count=len(raw) - place,
        )
    own = raw[place : place + FRAME_LENGTH]
    if own[-1] != TAIL:
        return Said(
            "{header}: no tail {wanted} nine bytes on (found {found})",
            header=header,
            wanted=f"{TAIL:02X}",
            found=f"{own[-1]:02X}",
        )
    if (own[0], own[CMD_PLACE]) not in KIND_BY_HEADER_AND_CMD:
        return Said(
            "{header}: CMD {cmd} unknown, and not in step with frames beside it",
            header=header,
            cmd=f"{own[CMD_PLACE]:02X}",
        )
    return Said(
        "{header}: ten bytes that look like a frame, but out of step with the frames beside it",
        header=header,
    )
