"""Other decoders, for speed comparisons: a regular expression, construct, Kaitai, a state machine.

Each one turns bytes into columns (lists by name). None of them handles damage: where no frame can
be parsed, they continue at the next byte.
"""

from __future__ import annotations

import re
from collections import defaultdict
from io import BytesIO
from struct import Struct as Packed
from typing import Final

import construct as c
import numpy as np
from kaitaistruct import KaitaiStream, KaitaiStruct

Columns = dict[str, list[int]]

CONTROL = c.Struct(
    "header" / c.Const(0xAA, c.Byte),
    "cmd" / c.Byte,
    "num" / c.Byte,
    "body"
    / c.Switch(
        c.this.cmd,
        {
            0: c.Struct("reserve" / c.Bytes(6)),
            1: c.Struct("rpm" / c.Int16sb, "reserve" / c.Bytes(4)),
            2: c.Struct("rpm" / c.Int16sb, "pulses" / c.Int32sb),
            3: c.Struct("vx" / c.Int16sb, "vy" / c.Int16sb, "wz" / c.Int16sb),
        },
        default=c.Error,
    ),
    "tail" / c.Const(0xEE, c.Byte),
)
FEEDBACK = c.Struct(
    "header" / c.Const(0x55, c.Byte),
    "cmd" / c.Byte,
    "num" / c.Byte,
    "body"
    / c.Switch(
        c.this.cmd,
        {
            1: c.Struct("rpm" / c.Int16sb, "reserve" / c.Bytes(2)),
            2: c.Struct("pulses" / c.Int32sb),
            3: c.Struct("rpm" / c.Int16sb, "reserve" / c.Bytes(2)),
        },
        default=c.Error,
    ),
    "error" / c.Byte,
    "online" / c.Byte,
    "tail" / c.Const(0xEE, c.Byte),
)
FRAME = c.Select(CONTROL, FEEDBACK)


PATTERN: Final = re.compile(rb"(?s:\xaa[\x00-\x03].{7}\xee|\x55[\x01-\x03].{7}\xee)")


def with_pattern(data: bytes) -> Columns:
    """One compiled regular expression finds the frames, and numpy reads their columns."""
    frames = np.frombuffer(b"".join(PATTERN.findall(data)), np.uint8).reshape(-1, 10)
    words = frames[:, 3:9].copy()
    return {
        "cmd": frames[:, 1].tolist(),
        "num": frames[:, 2].tolist(),
        "first": words[:, :2].copy().view(">i2")[:, 0].tolist(),
        "second": words[:, 2:6].copy().view(">i4")[:, 0].tolist(),
    }


def with_construct(data: bytes) -> Columns:
    """`construct`, one declarative parser for a frame, tried at each place."""
    columns: Columns = defaultdict(list)
    at = 0
    while at + 10 <= len(data):
        if data[at] not in (0xAA, 0x55):
            at += 1
            continue
        try:
            frame = FRAME.parse(data[at : at + 10])
        except c.ConstructError:
            at += 1
            continue
        columns["offset"].append(at)
        columns["cmd"].append(frame.cmd)
        columns["num"].append(frame.num)
        for name, value in frame.body.items():
            if isinstance(value, int):
                columns[name].append(value)
        at += 10
    return columns


class _KaitaiFrame(KaitaiStruct):  # type: ignore[misc]
    """What Kaitai's compiler makes of such a frame, in its style."""

    def __init__(self, io: KaitaiStream) -> None:
        self._io = io
        self.header = self._io.read_u1()
        self.cmd = self._io.read_u1()
        self.num = self._io.read_u1()
        if self.header == 0x55 and self.cmd == 2:
            self.pulses = self._io.read_s4be()
            self.error, self.online = self._io.read_u1(), self._io.read_u1()
        elif self.header == 0x55 and self.cmd in (1, 3):
            self.rpm = self._io.read_s2be()
            self.reserve = self._io.read_bytes(2)
            self.error, self.online = self._io.read_u1(), self._io.read_u1()
        elif self.header == 0xAA and self.cmd == 2:
            self.rpm, self.pulses = self._io.read_s2be(), self._io.read_s4be()
        elif self.header == 0xAA and self.cmd == 1:
            self.rpm, self.reserve = self._io.read_s2be(), self._io.read_bytes(4)
        elif self.header == 0xAA and self.cmd == 3:
            self.vx, self.vy = self._io.read_s2be(), self._io.read_s2be()
            self.wz = self._io.read_s2be()
        elif self.header == 0xAA and self.cmd == 0:
            self.reserve = self._io.read_bytes(6)
        else:
            raise ValueError
        if self._io.read_u1() != 0xEE:
            raise ValueError


def with_kaitai(data: bytes) -> Columns:
    """The runtime of Kaitai Struct, one frame type, tried at each place."""
    columns: Columns = defaultdict(list)
    stream = KaitaiStream(BytesIO(data))
    at = 0
    while at + 10 <= len(data):
        if data[at] not in (0xAA, 0x55):
            at += 1
            continue
        stream.seek(at)
        try:
            frame = _KaitaiFrame(stream)
        except (ValueError, EOFError):
            at += 1
            continue
        columns["offset"].append(at)
        columns["cmd"].append(frame.cmd)
        columns["num"].append(frame.num)
        for name in ("rpm", "pulses", "vx", "vy", "wz", "error", "online"):
            if name in frame.__dict__:
                columns[name].append(frame.__dict__[name])
        at += 10
    return columns


_VALUES = {
    (0xAA, 1): (Packed(">h4x"), ("rpm",)),
    (0xAA, 2): (Packed(">hi"), ("rpm", "pulses")),
    (0xAA, 3): (Packed(">hhh"), ("vx", "vy", "wz")),
    (0x55, 1): (Packed(">h2xBB"), ("rpm", "error", "online")),
    (0x55, 3): (Packed(">h2xBB"), ("rpm", "error", "online")),
    (0x55, 2): (Packed(">iBB"), ("pulses", "error", "online")),
    (0xAA, 0): (Packed(">6x"), ()),
}


def with_state_machine(data: bytes) -> Columns:
    """A plain byte-by-byte state machine: header, then ten bytes, then the tail; else over."""
    columns: Columns = defaultdict(list)
    frame = bytearray()
    for at, byte in enumerate(data):
        if not frame:
            if byte == 0xAA or byte == 0x55:
                frame.append(byte)
            continue
        frame.append(byte)
        if len(frame) == 2 and (frame[0], byte) not in _VALUES:
            frame.clear()
        elif len(frame) == 10:
            if byte == 0xEE:
                values, names = _VALUES[frame[0], frame[1]]
                columns["offset"].append(at - 9)
                columns["cmd"].append(frame[1])
                columns["num"].append(frame[2])
                for name, value in zip(names, values.unpack_from(frame, 3), strict=True):
                    columns[name].append(value)
            frame.clear()
    return columns
