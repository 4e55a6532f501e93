"""The frame table: kinds, fields, faults, constants; how a frame is encoded.

A frame (docs/reference/protocol.md, "Frames"), ten bytes, big-endian two's complement,
no checksum:

      0      1     2     3     4     5     6     7     8     9
    +------+-----+-----+-----+-----+-----+-----+-----+-----+------+
    | head | CMD | NUM |            six payload bytes      | tail |
    +------+-----+-----+-----+-----+-----+-----+-----+-----+------+
      AA     00    any   reserve ----------------------->    EE    reset
      AA     01    1-4   rpm       reserve ------------->    EE    speed
      AA     02    1-4   rpm       pulses -------------->    EE    position
      AA     03    any   vx        vy        wz              EE    mecanum
      55   01/03   1-4   rpm       reserve    error onln     EE    speed_feedback
      55     02    1-4   pulses -----------> error onln      EE    position_feedback
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import StrEnum

from fte_sniff.errors import ExplainedWord, TranslatableText, ValueRangeError

FRAME_LENGTH = 10
TAIL = 0xEE
CMD_OFFSET = 1
NUM_OFFSET = 2
MOTORS = range(1, 5)

FEW_BYTES = 30
"""Fewer bytes than this without a frame do not show what is wrong."""

DEFAULT_BAUD = 115_200
"""Bits per second on the controller's line, 8N1."""

BITS_PER_BYTE = 10
"""Bits of one byte on an 8N1 line: start, eight data bits, stop."""


def byte_time_ns(baud: int) -> int:
    """Nanoseconds of one byte at `baud`, 8N1; raises ValueRangeError if that is less than 1."""
    if baud < 1:
        raise ValueRangeError(f"baud {baud} is out of range: 1 or more bits per second")
    return round(BITS_PER_BYTE * 1_000_000_000 / baud)


class Status(StrEnum):
    """How reliable a row is, by the worst of its faults."""

    OK = "ok"
    SUSPECT = "suspect"
    MALFORMED = "malformed"


class Fault(ExplainedWord):
    """What is wrong with a row."""

    UNKNOWN_CMD = "unknown_cmd", "framed, but the protocol has no such CMD for this header"
    BAD_MOTOR = "bad_motor", "framed, but NUM is not 1-4 where a motor is named"
    BAD_HEADER = "bad_header", "ten bytes like a frame, the header wrong"
    BAD_TAIL = "bad_tail", "ten bytes like a frame, the tail wrong"
    TRUNCATED = "truncated", "starts like a frame, bytes are missing"
    OVERLONG = "overlong", "starts and ends like a frame, bytes too many"
    NOISE = "noise", "bytes that belong to no frame, or are the rest of one without its start"
    RESERVED_NONZERO = (
        "reserved_nonzero",
        "the reserve is not 00, unlike on the rest of this line (in speed feedback: unlike in the"
        " protocol)",
    )
    UNDEFINED_FLAGS = "undefined_flags", "ONLINE has one of its bits 4-7 set"
    AMBIGUOUS = "ambiguous", "another reading of these bytes cannot be ruled out"
    LINE_ERROR = "line_error", "the UART reported an error around these bytes"


SUSPECT_FAULTS = frozenset(
    {Fault.RESERVED_NONZERO, Fault.UNDEFINED_FLAGS, Fault.AMBIGUOUS, Fault.LINE_ERROR}
)
"""Faults that leave a row readable; every other fault makes it malformed."""


def status_of(faults: tuple[Fault, ...]) -> Status:
    """The status of a row with these faults."""
    if not faults:
        return Status.OK
    return Status.SUSPECT if SUSPECT_FAULTS.issuperset(faults) else Status.MALFORMED


class Direction(StrEnum):
    """The direction of a frame, given by its header byte."""

    CONTROL = "control"
    FEEDBACK = "feedback"


HEADERS: Mapping[Direction, int] = {Direction.CONTROL: 0xAA, Direction.FEEDBACK: 0x55}

HEADER_BYTES = bytes(HEADERS.values())
"""Every byte that can begin a frame."""

DIRECTION_OF_HEADER: Mapping[int, Direction] = {
    header: direction for direction, header in HEADERS.items()
}


class Role(StrEnum):
    """What a field is about, whatever its name; a frame has at most one field of each role."""

    MOTOR = "motor"
    SPEED = "speed"
    POSITION = "position"
    FORWARD = "forward"
    LEFT = "left"
    ROTATION = "rotation"
    ERRORS = "errors"
    ONLINE = "online"


@dataclass(frozen=True, slots=True)
class Field:
    """One field of a frame: big-endian, two's complement if its range has negative values."""

    name: str
    """The row name (a column, a filter field, a schema field)."""
    start: int
    """Offset of the first byte in the frame."""
    size: int
    """Bytes: 1, 2 or 4."""
    low: int
    high: int
    """`low` and `high` are the lowest and the highest legal value."""
    unit: str
    """Unit of one count; empty for numbers and bit fields."""
    meaning: str
    option: str
    """The short name on the command line."""
    legal_bits: int | None = None
    """For a bit field: the bits that may be set."""
    default: int | None = None
    """The value used if the user gives none; None if one must be given."""
    fault: Fault | None = None
    """The fault of a frame with an illegal value; None if every value of the type is legal."""
    role: Role | None = None
    """What it is about, where some code must know. The kind says whether it is a target."""
    erratum: str = ""
    """Where the document contradicts itself about values other than 0: what holds, in one line."""

    @property
    def signed(self) -> bool:
        """Whether the field is two's complement."""
        return self.low < 0

    @property
    def offsets(self) -> range:
        """The offsets of the field's bytes in the frame."""
        return range(self.start, self.start + self.size)

    def read(self, raw: bytes) -> int:
        """Decode the field from the bytes of a frame."""
        return int.from_bytes(raw[self.start : self.start + self.size], "big", signed=self.signed)

    def is_legal(self, value: int) -> bool:
        """Whether the value is in range, with no other bit set than the legal ones."""
        return self.low <= value <= self.high and not (
            self.legal_bits is not None and value & ~self.legal_bits
        )

    def to_bytes(self, value: int) -> bytes:
        """Encode `value`; illegal bits of a bit field are accepted.

        Raises ValueRangeError, which names field, range and unit, if it is out of range.
        """
        if not self.low <= value <= self.high:
            raise ValueRangeError(f"{self.name} {value} is out of range: {self.range_text}")
        return value.to_bytes(self.size, "big", signed=self.signed)

    def raised(self, value: int) -> bool:
        """Whether a bit field differs from its default; always false for a number."""
        return self.legal_bits is not None and value != self.default

    def text(self, value: int) -> str:
        """Format a value without its unit: bit fields in hex, numbers in decimal."""
        return f"{value}" if self.legal_bits is None else f"0x{value:02X}"

    @property
    def range_text(self) -> str:
        """The legal range with its unit, for messages and help: `-32768..32767 RPM`."""
        return f"{self.low}..{self.high} {self.unit}".rstrip()


@dataclass(frozen=True, slots=True)
class FrameKind:
    """One kind of frame: the header and CMDs that name it, and the meaning of its bytes."""

    name: str
    """The value of the row's `kind`."""
    direction: Direction
    cmds: tuple[int, ...]
    """The CMD values that name this kind; `encode` uses the first by default."""
    fields: tuple[Field, ...]
    """By offset; NUM is one of them only if it is a motor number."""
    reserved: range
    """The offsets without a meaning."""
    meaning: str
    reserve: int | None = None
    """The byte that the protocol document prints there; None if it states none: any is legal."""

    @property
    def header(self) -> int:
        """The header byte."""
        return HEADERS[self.direction]

    @property
    def names_motor(self) -> bool:
        """Whether NUM is a motor number; otherwise it has no meaning, and any value is legal."""
        return any(field.start == NUM_OFFSET for field in self.fields)

    @property
    def subject(self) -> str | None:
        """The main value: the last field with a unit, a speed or a position; None without one."""
        return next((field.name for field in reversed(self.fields) if field.unit), None)

    def legal_bytes(self) -> list[bytes | None]:
        """For each offset the legal bytes; None where every byte is legal.

        Fields of several bytes have no illegal values, so bytes can be judged one by one.
        """
        legal: list[bytes | None] = [None] * FRAME_LENGTH
        legal[0], legal[-1] = bytes([self.header]), bytes([TAIL])
        legal[CMD_OFFSET] = bytes(self.cmds)
        if self.reserve is not None:
            own = [bytes([self.reserve])] * len(self.reserved)
            legal[self.reserved.start : self.reserved.stop] = own
        for field in self.fields:
            if field.fault:
                legal[field.start] = bytes(byte for byte in range(256) if field.is_legal(byte))
        return legal

    def raised(self, raw: bytes) -> bool:
        """Whether a bit field of a frame's bytes differs from its default."""
        return any(field.raised(field.read(raw)) for field in self.fields)

    def field(self, name: str) -> Field | None:
        """The field of that row name, or None."""
        return next((field for field in self.fields if field.name == name), None)


def motor_bit(motor: int) -> int:
    """The bit of ONLINE that is a motor's.

    An assumption: the document says only that 0F is four motors online.
    """
    return motor - MOTORS[0]


def online_bit_text(motor: int) -> TranslatableText:
    """Name a motor's bit of ONLINE, and say that the motor is an assumption."""
    return TranslatableText(
        "bit {bit} of ONLINE (taken as motor {motor})", bit=motor_bit(motor), motor=motor
    )


def _int16(name: str, start: int, unit: str, meaning: str, option: str, role: Role) -> Field:
    return Field(name, start, 2, -(2**15), 2**15 - 1, unit, meaning, option, role=role)


def _position(start: int, meaning: str) -> Field:
    ends = -(2**31), 2**31 - 1
    return Field("pulses", start, 4, *ends, "pulses", meaning, "pulses", role=Role.POSITION)


def _flags(name: str, start: int, meaning: str, role: Role, legal_bits: int, default: int) -> Field:
    fault = None if legal_bits == 0xFF else Fault.UNDEFINED_FLAGS
    return Field(name, start, 1, 0, 0xFF, "", meaning, name, legal_bits, default, fault, role)


_MOTOR = Field(
    "motor", NUM_OFFSET, 1, MOTORS[0], MOTORS[-1], "", "motor (driver) number", "motor",
    fault=Fault.BAD_MOTOR, role=Role.MOTOR,
)  # fmt: skip
_TARGET, _LIMIT, _PRESENT = (
    _int16("rpm", 3, "RPM", meaning, "rpm", Role.SPEED)
    for meaning in ("target speed", "speed limit", "present speed")
)
_ERROR = _flags(
    "error", 7, "error flags; 00 is all normal, single bits are undocumented", Role.ERRORS, 0xFF, 0
)
_ONLINE = _flags("online", 8, "online flags; 0F is four motors online", Role.ONLINE, 0x0F, 0x0F)
_FORWARD = _int16("vx_cm_s", 3, "cm/s", "chassis speed, + is forward", "vx", Role.FORWARD)
_LEFT = replace(
    _int16("vy_cm_s", 5, "cm/s", "chassis speed, + is left", "vy", Role.LEFT),
    erratum="LR: + is left by the document's rule; its example calls +10 right (erratum 3)",
)
_ROTATION = _int16(
    "wz_mrad_s", 7, "mrad/s", "chassis rotation, the sign is the direction", "wz", Role.ROTATION
)
_GOAL = _position(5, "target position, the sign is the direction")
_PLACE = _position(3, "present position")

_CONTROL, _FEEDBACK = Direction
KINDS: tuple[FrameKind, ...] = (
    FrameKind("reset", _CONTROL, (0,), (), range(3, 9), "reset all motors"),
    FrameKind(
        "speed", _CONTROL, (1,), (_MOTOR, _TARGET), range(5, 9), "turn one motor at a speed"
    ),
    FrameKind(
        "position", _CONTROL, (2,), (_MOTOR, _LIMIT, _GOAL), range(0),
        "turn one motor to a position",
    ),
    FrameKind(
        "mecanum", _CONTROL, (3,), (_FORWARD, _LEFT, _ROTATION), range(0),
        "drive the mecanum chassis",
    ),
    FrameKind(
        "speed_feedback", _FEEDBACK, (1, 3), (_MOTOR, _PRESENT, _ERROR, _ONLINE), range(5, 7),
        "present speed of one motor (CMD 01 in speed mode, 03 in mecanum mode)", reserve=0,
    ),
    FrameKind(
        "position_feedback", _FEEDBACK, (2,), (_MOTOR, _PLACE, _ERROR, _ONLINE), range(0),
        "present position of one motor",
    ),
)  # fmt: skip
"""Every kind of frame; a new kind is one entry here."""

KIND_BY_NAME: Mapping[str, FrameKind] = {kind.name: kind for kind in KINDS}

KIND_BY_HEADER_AND_CMD: Mapping[tuple[int, int], FrameKind] = {
    (kind.header, cmd): kind for kind in KINDS for cmd in kind.cmds
}


def encode(kind: FrameKind, values: Mapping[str, int], cmd: int | None = None) -> bytes:
    """Encode a frame of `kind` (docs/reference/protocol.md, "Frames").

    `values` are by row name; fields with a default are optional. `cmd` is by default the first of
    the kind's CMDs. Raises ValueRangeError if a value is missing, illegal, or not of this kind.
    """
    if cmd is None:
        cmd = kind.cmds[0]
    elif cmd not in kind.cmds:
        legal = " or ".join(map(str, kind.cmds))
        raise ValueRangeError(f"cmd {cmd} is out of range: {kind.name} has cmd {legal}")
    unknown = set(values) - {field.name for field in kind.fields}
    if unknown:
        raise ValueRangeError(f"{kind.name} has no {', '.join(sorted(unknown))}")
    raw = bytearray(FRAME_LENGTH)
    raw[0], raw[CMD_OFFSET], raw[-1] = kind.header, cmd, TAIL
    for field in kind.fields:
        value = values.get(field.name, field.default)
        if value is None:
            raise ValueRangeError(f"{kind.name} needs {field.name} ({field.range_text})")
        raw[field.start : field.start + field.size] = field.to_bytes(value)
    return bytes(raw)


_FIELDS = [field for kind in KINDS for field in kind.fields]


def meaning_of(name: str) -> str:
    """What the fields of a row name mean, in all kinds that have one."""
    return ", or ".join(dict.fromkeys(one.meaning for one in _FIELDS if one.name == name))


FIELD_BY_NAME: Mapping[str, Field] = {
    name: next(field for field in _FIELDS if field.name == name)
    for name in dict.fromkeys(field.name for field in _FIELDS)
}
VALUE_FIELDS = tuple(FIELD_BY_NAME.values())
"""The first field of each row name, in the order of `KINDS`."""

NAME_OF_ROLE: Mapping[Role, str] = {field.role: field.name for field in VALUE_FIELDS if field.role}
"""The row name of each role; fields of a role have the same name in every kind."""
