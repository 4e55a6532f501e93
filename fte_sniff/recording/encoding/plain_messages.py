"""Owns a quick way to the messages of sound frames, which are most of a recording.

It must not encode anything else, nor anything differently: the bytes are those that protobuf makes.

All messages of sound frames of one kind are equally long on the wire: what is the same in all of
them is encoded once, and only the numbers that differ are put in between.

    const  offset  const  read_delay_ns  const  raw  const  cmd  const  value  const  value ...
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import nan
from operator import attrgetter
from typing import Any, TypeAlias

from fte_sniff.protocol import Frame, FrameKind
from fte_sniff.recording.encoding.wire import SOUND_LACKS, WireField, laid

_Get: TypeAlias = Callable[[Frame], Any]


@dataclass(frozen=True, slots=True)
class PlainForm:
    """How sound frames of one kind become messages."""

    pack: Callable[..., bytes]
    """Packs constant parts and numbers in turn."""
    parts: tuple[tuple[bytes, _Get], ...]
    """Each constant part, and where the number behind it comes from."""
    rest: bytes
    """The constant part behind the last number."""

    def encode(self, row: Frame) -> bytes:
        """The message of a row that has a read delay, no faults, and its message's own time."""
        values: list[Any] = []
        for constant, get in self.parts:
            values += (constant, get(row))
        return self.pack(*values, self.rest)


def plain_form(message: Any, kind: FrameKind, fixed: Mapping[str, int]) -> PlainForm:
    """The form of a kind's messages.

    Args:
        message: the protobuf class.
        kind: of the frames.
        fixed: the numbers of fields that are the same in all of them; other fields of the message
            that a frame of this kind does not have are NaN.
    """
    parts: list[tuple[bytes, _Get]] = []
    layout, constant = "<", b""
    for field in laid(message.DESCRIPTOR.fields, SOUND_LACKS - fixed.keys()):
        get = _getter(field.name, kind)
        if get is not None:
            constant += field.tag
            layout += f"{len(constant)}s{_struct_code(field)}"
            parts.append((constant, get))
            constant = b""
        elif field.name in fixed:
            constant += field.tag + struct.pack(f"<{field.code}", fixed[field.name])
        else:
            constant += field.tag + struct.pack(f"<{field.code}", nan)
    layout += f"{len(constant)}s"
    return PlainForm(struct.Struct(layout).pack, tuple(parts), constant)


def _struct_code(field: WireField) -> str:
    return f"{field.size}s" if field.code == "s" else field.code


def _getter(name: str, kind: FrameKind) -> _Get | None:
    """Where the number of a message's field comes from; None where a frame does not have it."""
    if name in ("offset", "read_delay_ns", "raw", "cmd"):
        return attrgetter(name)
    field = kind.field(name)
    if field is None:
        return None
    read = field.read
    return lambda row: read(row.raw)
