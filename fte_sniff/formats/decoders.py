"""Decoders for other tools, generated from the frame table.

The code of a decoder that does not depend on the protocol is a template beside this module, with
`@TABLES@` in the place of the facts of the protocol.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from importlib.resources import files
from pprint import pformat
from types import MappingProxyType
from typing import Final

from fte_sniff.formats.pcapng import COMMENT
from fte_sniff.protocol import spec
from fte_sniff.protocol.framer import SETTLING_NS
from fte_sniff.protocol.spec import Fault, Field, FrameKind, Status

# Tables of the frames, for templates

SETTLING_BYTES: Final = SETTLING_NS // spec.byte_time_ns(spec.DEFAULT_BAUD)
"""Byte times of silence after which the begin of a frame is truncated; the framer waits longer."""

_FACTS: Final[dict[str, object]] = {
    "LENGTH": spec.FRAME_LENGTH,
    "TAIL": spec.TAIL,
    "CMD": spec.CMD_OFFSET,
    "DIRECTIONS": {header: str(way) for header, way in spec.DIRECTION_OF_HEADER.items()},
    "NO_KIND": "unknown",
    "UNKNOWN_CMD": str(Fault.UNKNOWN_CMD),
    "RESERVED_NONZERO": str(Fault.RESERVED_NONZERO),
}
"""By their names in the templates."""


def _kinds() -> dict[int, object]:
    """The kinds of frames by header * 256 + CMD."""
    return {
        head << 8 | cmd: _kind(kind) for (head, cmd), kind in spec.KIND_BY_HEADER_AND_CMD.items()
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
                "unit": field.unit,
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


def _filled(template: str, tables: Sequence[str]) -> str:
    text = files(__package__).joinpath(template).read_text("utf-8")
    return text.replace("@TABLES@", "\n".join(tables))


# sigrok


def sigrok_decoder() -> str:
    """A protocol decoder for PulseView and sigrok-cli, a Python module, stacked on `uart`.

    A logic analyser sees both wires on one clock; the decoder shows frames, fields, faults and
    damage of each wire. It runs in sigrok's Python, which has no fte-sniff.
    """
    tables = _FACTS | {
        "SETTLING": SETTLING_BYTES,
        "LINE_ERROR": str(Fault.LINE_ERROR),
        "KINDS": _kinds(),
    }
    lines = [f"{name} = {pformat(value, sort_dicts=False)}" for name, value in tables.items()]
    return _filled("sigrok_template.txt", lines)


# Wireshark


def wireshark_dissector() -> str:
    """A dissector in Lua for Wireshark and tshark, of `decode -o NAME.pcapng` among others."""
    tables = _FACTS | {
        "COMMENT": COMMENT,
        "NOISE": str(Fault.NOISE),
        "STATUS_OK": str(Status.OK),
        "STATUS_SUSPECT": str(Status.SUSPECT),
        "STATUS_MALFORMED": str(Status.MALFORMED),
        "FAULTS": [
            {"name": fault.value, "meaning": fault.meaning, "suspect": fault in spec.SUSPECT_FAULTS}
            for fault in Fault
        ],
        "FIELDS": [_field(field) for field in spec.VALUE_FIELDS],
        "KINDS": _kinds(),
    }
    lines = [f"local {name} = {_lua(value)}" for name, value in tables.items()]
    return _filled("wireshark_template.lua", lines)


def _field(field: Field) -> dict[str, object]:
    """What Wireshark shows of a field; those of a row name have one type."""
    return {
        "name": field.name,
        "type": f"{'int' if field.signed else 'uint'}{8 * field.size}",
        "unit": field.unit,
        "flags": field.legal_bits is not None,
        "meaning": spec.meaning_of(field.name),
    }


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


TOOLS: Final[Mapping[str, Callable[[], str]]] = MappingProxyType(
    {"sigrok": sigrok_decoder, "wireshark": wireshark_dissector}
)
"""By tool, what makes the source of its decoder."""
