"""Streams for tests and benchmarks of the framer: legal frames, and damage to them.

A seeded generator draws everything: the same seed gives the same bytes.

Each frame is damaged with probability p, by one of five kinds with equal chance:

    lost      1-9 adjacent bytes are missing
    inserted  1-4 random bytes are inserted after byte 0-8
    flipped   one bit is inverted
    replaced  2-6 adjacent bytes are random
    junk      1-30 random bytes come before the intact frame

`with_reserve` gives the reserve that the protocol leaves open, and a NUM without a meaning, the
values of some host.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from enum import StrEnum
from random import Random

from fte_sniff.protocol.rows import fault_bits, faults_in
from fte_sniff.protocol.spec import (
    FRAME_LENGTH,
    KIND_BY_HEADER_AND_CMD,
    KINDS,
    NUM_OFFSET,
    Fault,
    Field,
    FrameKind,
    encode,
)

HOSTILE_BYTES = bytes([0xAA, 0x55, 0xEE, 0x00, 0x01, 0x02, 0x03])
HOSTILE_SHARE = 0.3


class Harm(StrEnum):
    """Kind of damage."""

    LOST = "lost"
    INSERTED = "inserted"
    FLIPPED = "flipped"
    REPLACED = "replaced"
    JUNK = "junk"


@dataclass(frozen=True, slots=True)
class Sent:
    """One frame that was sent, and its bytes in the stream."""

    raw: bytes
    """As sent."""
    harm: Harm | None
    before: int
    """Junk bytes before the frame."""
    start: int
    """Offset of its first byte in the stream."""
    arrived: bytes
    """Its bytes in the stream."""

    @property
    def whole(self) -> bool:
        """True if all its bytes are intact."""
        return self.harm is None or self.harm is Harm.JUNK


Draw = Callable[[Random, Field], int]


def ordinary(random: Random, field: Field) -> int:
    """A typical value: around zero, small compared with the field's range."""
    if field.name == "motor":
        return random.randint(field.low, field.high)
    if field.name == "error":
        return 0 if random.random() < 0.98 else random.randrange(16)
    if field.name == "online":
        return 0x0F
    spread = {"rpm": 600, "pulses": 40_000, "wz_mrad_s": 400}.get(field.name, 60)
    value = round(random.gauss(0, spread))
    return max(field.low, min(field.high, value))


def hostile(random: Random, field: Field) -> int:
    """An ordinary value or, in 30 % of the cases, one of bytes that imitate a frame's."""
    if field.size > 1 and random.random() < HOSTILE_SHARE:
        own = bytes(random.choice(HOSTILE_BYTES) for _ in range(field.size))
        return int.from_bytes(own, "big", signed=True)
    return ordinary(random, field)


PAYLOADS: dict[str, Draw] = {"ordinary": ordinary, "hostile": hostile}


def draw_frame(random: Random, draw: Draw, kinds: tuple[FrameKind, ...] = KINDS) -> bytes:
    """One legal frame; a reset is rare, as it is on a real line."""
    kind = random.choice(kinds)
    if kind.name == "reset" and random.random() < 0.9:
        kind = random.choice(kinds)
    values = {field.name: draw(random, field) for field in kind.fields}
    return encode(kind, values, random.choice(kind.cmds))


Fill = Callable[[Random, int, int], bytes]
"""The reserve of one frame, by its number and the bytes in it."""


def _constant(pattern: str) -> Fill:
    raw = bytes.fromhex(pattern)
    return lambda random, number, size: (raw * size)[:size]


RESERVES: dict[str, Fill] = {
    pattern: _constant(pattern) for pattern in ("00", "FF", "EE", "AA", "55", "CD", "AA EE AA EE")
} | {
    "random": lambda random, number, size: random.randbytes(size),
    "counter": lambda random, number, size: number.to_bytes(8, "big")[-size:] if size else b"",
}
"""What hosts leave in the reserve of control frames."""


def with_reserve(random: Random, frames: Iterator[bytes], reserve: str) -> Iterator[bytes]:
    """The frames with a `reserve` of `RESERVES`, and with any NUM where it has no meaning."""
    for number, raw in enumerate(frames):
        kind, changed = KIND_BY_HEADER_AND_CMD[raw[0], raw[1]], bytearray(raw)
        own = kind.reserved if kind.reserve is None else range(0)
        changed[own.start : own.stop] = RESERVES[reserve](random, number, len(own))
        if not kind.names_motor:
            changed[NUM_OFFSET] = random.randrange(256)
        yield bytes(changed)


def _harmed(random: Random, raw: bytes, harm: Harm) -> bytes:
    if harm is Harm.LOST:
        count = random.randint(1, FRAME_LENGTH - 1)
        start = random.randint(0, FRAME_LENGTH - count)
        return raw[:start] + raw[start + count :]
    if harm is Harm.INSERTED:
        after = random.randint(1, FRAME_LENGTH - 1)
        return raw[:after] + random.randbytes(random.randint(1, 4)) + raw[after:]
    if harm is Harm.FLIPPED:
        at = random.randrange(FRAME_LENGTH)
        return raw[:at] + bytes([raw[at] ^ 1 << random.randrange(8)]) + raw[at + 1 :]
    count = random.randint(2, 6)
    start = random.randint(0, FRAME_LENGTH - count)
    return raw[:start] + random.randbytes(count) + raw[start + count :]


def damage(random: Random, frames: Iterator[bytes], share: float) -> tuple[bytes, list[Sent]]:
    """Damage a `share` (0-1) of the frames; return the stream and what was sent."""
    stream, sent = bytearray(), []
    harms = tuple(Harm)
    for raw in frames:
        harm = random.choice(harms) if random.random() < share else None
        before = 0
        arrived = raw
        if harm is Harm.JUNK:
            before = random.randint(1, 30)
            stream += random.randbytes(before)
        elif harm is not None:
            arrived = _harmed(random, raw, harm)
        sent.append(Sent(raw, harm, before, len(stream), arrived))
        stream += arrived
    return bytes(stream), sent


def damaged_stream(
    seed: int, frames: int, share: float, payload: str, reserve: str | None = None
) -> tuple[bytes, list[Sent]]:
    """A stream of `frames` frames with `payload` ("ordinary", "hostile"), `share` damaged.

    With `reserve`, a name in `RESERVES`, frames are as from `with_reserve`; without, as encoded.
    """
    random = Random(f"{seed} {share} {payload}")
    draw = PAYLOADS[payload]
    drawn = (draw_frame(random, draw) for _ in range(frames))
    return damage(random, drawn if reserve is None else with_reserve(random, drawn, reserve), share)


def frame_faults(raw: bytes) -> tuple[Fault, ...]:
    """The faults of ten framed bytes on a line whose reserve is 00, by the frame table."""
    kind = KIND_BY_HEADER_AND_CMD.get((raw[0], raw[1]))
    if kind is None:
        return (Fault.UNKNOWN_CMD,)
    fields = (field for field in kind.fields if not field.is_legal(field.read(raw)))
    faults = {field.fault for field in fields if field.fault}
    if any(raw[kind.reserved.start : kind.reserved.stop]):
        faults.add(Fault.RESERVED_NONZERO)
    return faults_in(fault_bits(faults))
