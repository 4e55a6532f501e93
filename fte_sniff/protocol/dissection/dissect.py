"""Owns the field-by-field explanation of one row: every byte, what it is, and what is wrong there.

It must not know how it is shown, nor decide anything: the framer has decided, this page explains.
Each byte of a row stands in exactly one part; a part without bytes marks where bytes are missing.
Frames are explained in `anatomy`, damage in `wreckage`.
"""

from __future__ import annotations

from fte_sniff.protocol.dissection.anatomy import Bit, Part, framed_parts
from fte_sniff.protocol.dissection.wreckage import damaged_parts
from fte_sniff.protocol.framer.shapes import dividing
from fte_sniff.protocol.rows import FAULT_MEANINGS, Fault, Frame, Row
from fte_sniff.protocol.structure import HEADER_BYTES
from fte_sniff.protocol.table import FRAME_LENGTH, TAIL
from fte_sniff.said import Said

__all__ = ["Bit", "Part", "dissect", "explain"]


def dissect(row: Row) -> list[Part]:
    """The row's bytes in order, each in exactly one part (PROTOCOL.md, both tables of frames)."""
    if isinstance(row, Frame):
        return list(framed_parts(row.raw, row.kind))
    return list(damaged_parts(row))


def explain(row: Row) -> list[str]:
    """One sentence for each fault of the row: what it means; empty where nothing is wrong."""
    return [_explained(fault, row) for fault in row.faults]


def _explained(fault: Fault, row: Row) -> Said:
    plain = Said("{fault}: {meaning}", fault=fault.value, meaning=Said(FAULT_MEANINGS[fault]))
    return _doubt(plain, row) if fault is Fault.AMBIGUOUS else plain


def _doubt(plain: Said, row: Row) -> Said:
    """With what the row's own bytes tell about the doubt."""
    divided = [place for place in range(1, FRAME_LENGTH - 1) if dividing(row.raw, place)]
    if divided:
        place = next(at for at in range(divided[0], FRAME_LENGTH) if _is_header(row.raw, at))
        return Said(
            "{doubt} (a frame could end before the {byte} at {place}, and another begin)",
            doubt=plain,
            byte=f"{row.raw[place]:02X}",
            place=place,
        )
    if TAIL in row.raw[1 : FRAME_LENGTH - 1]:
        place = row.raw.index(TAIL, 1)
        return Said(
            "{doubt} (a frame could end with the {byte} at {place})",
            doubt=plain,
            byte=f"{TAIL:02X}",
            place=place,
        )
    headers = [place for place in range(1, FRAME_LENGTH) if _is_header(row.raw, place)]
    if headers:
        byte = f"{row.raw[headers[0]]:02X}"
        return Said(
            "{doubt} (a frame could begin with the {byte} at {place})",
            doubt=plain,
            byte=byte,
            place=headers[0],
        )
    return Said("{doubt} (by what stands beside them)", doubt=plain)


def _is_header(raw: bytes, place: int) -> bool:
    return raw[place] in HEADER_BYTES
