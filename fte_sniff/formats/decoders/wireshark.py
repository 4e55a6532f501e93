"""A dissector in Lua for Wireshark and tshark, of `decode -o NAME.pcapng` among others."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from importlib.resources import files

from fte_sniff.formats.decoders.sigrok import NO_KIND
from fte_sniff.formats.pcapng import COMMENT
from fte_sniff.protocol.spec import (
    CMD_OFFSET,
    DIRECTION_OF_HEADER,
    FAULT_MEANINGS,
    FRAME_LENGTH,
    KIND_BY_HEADER_AND_CMD,
    KINDS,
    SUSPECT_FAULTS,
    TAIL,
    VALUE_FIELDS,
    Fault,
    Field,
    FrameKind,
    Status,
)


def dissector() -> str:
    """The source of the dissector, a Lua script."""
    tables: dict[str, object] = {
        "LENGTH": FRAME_LENGTH,
        "TAIL": TAIL,
        "CMD": CMD_OFFSET,
        "DIRECTIONS": {header: str(way) for header, way in DIRECTION_OF_HEADER.items()},
        "COMMENT": COMMENT,
        "NO_KIND": NO_KIND,
        "UNKNOWN_CMD": str(Fault.UNKNOWN_CMD),
        "RESERVED_NONZERO": str(Fault.RESERVED_NONZERO),
        "NOISE": str(Fault.NOISE),
        "STATUS_OK": str(Status.OK),
        "STATUS_SUSPECT": str(Status.SUSPECT),
        "STATUS_MALFORMED": str(Status.MALFORMED),
        "FAULTS": [
            {"name": str(fault), "meaning": meaning, "suspect": fault in SUSPECT_FAULTS}
            for fault, meaning in FAULT_MEANINGS.items()
        ],
        "FIELDS": [_column(field) for field in VALUE_FIELDS],
        "KINDS": {head << 8 | cmd: _kind(k) for (head, cmd), k in KIND_BY_HEADER_AND_CMD.items()},
    }
    lines = [f"local {name} = {_lua(value)}" for name, value in tables.items()]
    template = files(__package__).joinpath("wireshark_template.lua").read_text("utf-8")
    return template.replace("@TABLES@", "\n".join(lines))


def _column(field: Field) -> dict[str, object]:
    """What Wireshark shows of a field: of all kinds that have it, the widest type."""
    same = [one for kind in KINDS for one in kind.fields if one.name == field.name]
    bits = 8 * max(one.size for one in same)
    return {
        "name": field.name,
        "type": f"{'int' if any(one.signed for one in same) else 'uint'}{bits}",
        "unit": field.unit,
        "flags": field.legal_bits is not None,
        "meaning": ", or ".join(dict.fromkeys(one.meaning for one in same)),
    }


def _kind(kind: FrameKind) -> dict[str, object]:
    return {
        "name": kind.name,
        "reserve": kind.reserve,
        "reserved": [*kind.reserved],
        "fields": [
            {
                "name": field.name,
                "start": field.start,
                "size": field.size,
                "signed": field.signed,
                "flags": field.legal_bits is not None,
                "fault": field.fault and str(field.fault),
                "legal": _legal_bytes(field),
            }
            for field in kind.fields
        ],
    }


def _legal_bytes(field: Field) -> dict[int, bool] | None:
    """The legal bytes of a field that has illegal ones; such a field has one byte."""
    if field.fault is None:
        return None
    return {byte: True for byte in range(256) if field.is_legal(byte)}


def _lua(value: object) -> str:
    """A value as a Lua expression; None is nil."""
    match value:
        case None:
            return "nil"
        case Mapping():
            return f"{{{', '.join(f'[{_lua(key)}] = {_lua(of)}' for key, of in value.items())}}}"
        case str() | bool() | int():
            return json.dumps(value)
        case Sequence():
            return f"{{{', '.join(map(_lua, value))}}}"
        case _:
            raise TypeError(f"{value!r} has no form in Lua")
