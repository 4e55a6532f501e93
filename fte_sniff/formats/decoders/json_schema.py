"""The JSON Schema of the JSON lines, from the column table and the frame table."""

from __future__ import annotations

import json

from fte_sniff.protocol import COLUMNS, KINDS, Fault, Status, status_of
from fte_sniff.protocol.columns import Column, ColumnType
from fte_sniff.protocol.dissect import MOST, WHY
from fte_sniff.protocol.rows import Reading
from fte_sniff.protocol.spec import VALUE_FIELDS, Field, FrameKind

DIALECT = "https://json-schema.org/draft/2020-12/schema"


_WHY = {
    "description": "the best two readings of a damaged or ambiguous row, with --why",
    "type": "array",
    "maxItems": MOST,
    "items": {
        "type": "object",
        "properties": {
            "reading": {"type": "string"},
            "probability": {"type": "number", "minimum": 0, "maximum": 1},
        },
        "required": [*Reading._fields],
        "additionalProperties": False,
    },
}


def schema() -> str:
    """The schema of one line, as JSON text."""
    whole = {
        "$schema": DIALECT,
        "title": "A row of fte-sniff",
        "description": "One JSON line of `fte-sniff decode --format jsonl`.",
        "type": "object",
        "properties": {column.name: _property(column) for column in COLUMNS} | {WHY: _WHY},
        "required": [column.name for column in COLUMNS],
        "additionalProperties": False,
        "allOf": [*map(_rule_of_kind, (*KINDS, None)), *map(_rule_of_fault, Fault), _ok_rule()],
    }
    return json.dumps(whole, indent=2) + "\n"


def _property(column: Column) -> dict[str, object]:
    return {"description": column.meaning} | _type(column)


def _type(column: Column) -> dict[str, object]:
    match column.type:
        case ColumnType.TIME:
            return {"type": ["string", "null"], "format": "date-time"}
        case ColumnType.TEXT:
            return {"type": ["string", "null"]}
        case ColumnType.WORD:
            return {"enum": [*column.words, None]}
        case ColumnType.WORDS:
            return {"type": "array", "items": {"enum": [*column.words]}, "uniqueItems": True}
        case ColumnType.INT:
            low = -(1 << column.bits - 1) if column.signed else 0
            high = (1 << column.bits - column.signed) - 1
            return {"type": ["integer", "null"], "minimum": low, "maximum": high}
        case ColumnType.REAL:
            return {"type": ["number", "null"], "minimum": 0}
        case ColumnType.BOOL:
            return {"type": ["boolean", "null"]}
        case ColumnType.HEX:
            return {"type": "string", "pattern": "^([0-9A-F]{2})+$"}


def _rule_of_kind(kind: FrameKind | None) -> dict[str, object]:
    """Which values a frame of a kind has; None is a row without a kind."""
    own = {} if kind is None else {field.name: _range(field) for field in kind.fields}
    others = {field.name: {"type": "null"} for field in VALUE_FIELDS if field.name not in own}
    heads = (
        {}
        if kind is None
        else {
            "direction": {"const": str(kind.direction)},
            "cmd": {"enum": [*kind.cmds]},
        }
    )
    return _when({"kind": {"const": kind and kind.name}}, heads | own | others)


def _range(field: Field) -> dict[str, object]:
    """The values of a field on the wire, also the illegal ones, which have a fault."""
    bits = 8 * field.size
    low = -(1 << bits - 1) if field.signed else 0
    return {"type": "integer", "minimum": low, "maximum": (1 << bits - field.signed) - 1}


def _rule_of_fault(fault: Fault) -> dict[str, object]:
    """That a fault gives a row its status, or a worse one."""
    own = status_of((fault,))
    allowed = [status for status in Status if status in {own, Status.MALFORMED}]
    return _when({"faults": {"contains": {"const": str(fault)}}}, {"status": {"enum": allowed}})


def _ok_rule() -> dict[str, object]:
    return _when({"faults": {"maxItems": 0}}, {"status": {"const": str(Status.OK)}})


def _when(condition: dict[str, object], rule: dict[str, object]) -> dict[str, object]:
    return {"if": {"properties": condition}, "then": {"properties": rule}}
