"""Streams for property tests: damaged, imitating, repeating, random, nearly legal."""

from __future__ import annotations

from random import Random

from hypothesis import strategies as st

from fte_sniff.protocol import (
    FRAME_LENGTH,
    KINDS,
    Chunk,
    Direction,
    Fault,
    Field,
    FrameKind,
    Framer,
    Row,
)
from fte_sniff.protocol.framer import FTE_TABLES, FrameTables
from fte_sniff.protocol.spec import FTE_FORMAT, NUM_OFFSET, FrameFormat
from tests.protocol.oracle import LINES, UNLEARNED, Oracle
from tests.support.faults import PAYLOADS, damaged_stream, draw_frame


def rows_of(stream: bytes, size: int | None = None) -> list[Row]:
    """The rows of a stream that comes at once, or in chunks of this size."""
    framer, step = Framer("p"), size or max(1, len(stream))
    chunks = (stream[at : at + step] for at in range(0, len(stream), step))
    rows = [row for chunk in chunks for row in framer.feed(Chunk("p", None, chunk))]
    return rows + framer.flush()


_CALM_LINE = tuple(
    map(
        bytes.fromhex,
        (
            "AA 01 01 03 E8 00 00 00 00 EE",
            "AA 02 01 03 E8 00 00 00 0F EE",
            "AA 02 03 AA 55 EE AA 00 EE EE",
            "AA 03 00 EE 55 01 04 00 0F EE",
            "AA 01 01 03 E8",
        ),
    )
)
"""A plain frame, one that ends like feedback, two that could be truncated pairs, and damage."""


def _mostly_calm(seed: int) -> bytes:
    """Enough frames for the line to become calm again after damage."""
    return b"".join(Random(seed).choices(_CALM_LINE, [93, 4, 1, 1, 1], k=250))


imitating = st.sampled_from([0xAA, 0x55, 0xEE, 0x00, 0x01, 0x02, 0x03, 0x0F])
raw_bytes = st.one_of(
    st.binary(max_size=300),
    st.lists(imitating, max_size=300).map(bytes),
    st.builds(
        lambda seed, share, payload: damaged_stream(seed, 40, share, payload)[0],
        st.integers(0, 10_000),
        st.sampled_from([0.05, 0.2, 0.5, 1.0]),
        st.sampled_from(sorted(PAYLOADS)),
    ),
    st.builds(
        lambda before, framed, after: bytes(before) + b"\x55" + framed + b"\xee" + bytes(after),
        st.integers(0, 200),
        st.lists(imitating, min_size=8, max_size=28).map(bytes),
        st.integers(0, 60),
    ),
    st.builds(_mostly_calm, st.integers(0, 10_000)),
    st.builds(lambda unit, times: unit * times, st.binary(min_size=1, max_size=12), st.just(40)),
)

# A second frame format of the same class: other lengths, byte values and kinds


def _number(name: str, start: int, size: int) -> Field:
    high = 1 << 8 * size - 1
    return Field(name, start, size, -high, high - 1, "", name, name)


_ADDRESS = Field("motor", NUM_OFFSET, 1, 1, 8, "", "address", "motor", fault=Fault.BAD_MOTOR)
_STATE = Field("error", 10, 1, 0, 0xFF, "", "state", "error", 0x07, 0x00, Fault.UNDEFINED_FLAGS)

OTHER_FORMAT = FrameFormat(
    length=12,
    headers={Direction.CONTROL: 0xC3, Direction.FEEDBACK: 0x3C},
    tail=0x7E,
    kinds=(
        FrameKind("stop", Direction.CONTROL, (0x10,), (), range(3, 11), "all zero"),
        FrameKind(
            "drive",
            Direction.CONTROL,
            (0x11, 0x12),
            (_ADDRESS, _number("speed", 3, 4), _number("target", 7, 4)),
            range(0),
            "two numbers",
        ),
        FrameKind(
            "axes",
            Direction.CONTROL,
            (0x13,),
            tuple(_number(f"axis_{start}", start, 2) for start in (3, 5, 7)),
            range(9, 11),
            "NUM without meaning",
        ),
        FrameKind(
            "state",
            Direction.FEEDBACK,
            (0x21,),
            (_ADDRESS, _number("position", 3, 4), _STATE),
            range(7, 10),
            "with flags",
        ),
    ),
)
FORMATS = {"fte": FTE_FORMAT, "other": OTHER_FORMAT}
TABLES = {"fte": FTE_TABLES, "other": FrameTables(OTHER_FORMAT)}


def draw_format_frame(random: Random, frame_format: FrameFormat) -> bytes:
    """One legal frame with ordinary values, encoded without the codec."""
    kind = random.choice(frame_format.kinds)
    raw = bytearray(frame_format.length)
    raw[0], raw[1] = frame_format.header(kind), random.choice(kind.cmds)
    raw[-1] = frame_format.tail
    for field in kind.fields:
        value = round(random.gauss(0, 600))
        if field.default is not None:
            value = field.default
        elif field.fault is not None:
            value = random.randint(field.low, field.high)
        raw[field.start : field.start + field.size] = field.to_bytes(value)
    return bytes(raw)


def _with_damage(seed: int, frame_format: FrameFormat, share: float) -> bytes:
    random, stream = Random(seed), b""
    for _ in range(40):
        raw = draw_format_frame(random, frame_format)
        if random.random() < share:
            start, count = random.randrange(len(raw)), random.randint(0, len(raw) - 1)
            extra = random.randbytes(random.randint(0, 4))
            raw = raw[:start] + extra + raw[start + count :]
        stream += raw
    return stream


def streams_of(name: str) -> st.SearchStrategy[bytes]:
    """Streams of all sorts for a frame format."""
    if name == "fte":
        return raw_bytes
    frame_format = FORMATS[name]
    special = [*frame_format.headers.values(), frame_format.tail, 0, 1, 8, 0x10, 0x11, 0x13, 0x21]
    return st.one_of(
        st.binary(max_size=300),
        st.lists(st.sampled_from(special), max_size=300).map(bytes),
        st.builds(
            lambda seed, share: _with_damage(seed, frame_format, share),
            st.integers(0, 10_000),
            st.sampled_from([0.05, 0.2, 0.5, 1.0]),
        ),
        st.builds(
            lambda before, own, after: bytes(before) + own + bytes(after),
            st.integers(0, 200),
            st.lists(st.sampled_from(special), min_size=8, max_size=28).map(bytes),
            st.integers(0, 60),
        ),
        st.builds(
            lambda unit, times: unit * times, st.binary(min_size=1, max_size=14), st.just(40)
        ),
    )


# Frames and nearly legal frames, for the predicates: each holds or nearly holds at many offsets


def unambiguous_frame(seed: int, line: Oracle = UNLEARNED) -> bytes:
    """A frame that is unambiguous on a line, and the bytes after it that decide this."""
    random = Random(seed)
    while True:
        raw = draw_frame(random, PAYLOADS["ordinary"]) + bytes(4)
        if line.UNAMBIGUOUS.match(raw):
            return raw


IMITATING = bytes.fromhex("AA 55 EE 00 01 02 03 04 05 0F 10 7F FF")
"""Values with a meaning at some offset, and their neighbours."""

_ENDS = tuple(
    map(bytes.fromhex, ("EE AA", "EE 55", "AA 01 01", "55 03 00", "AA 02 05", "AA 09 01"))
)
"""Bytes where a frame could end or start within another one, or nearly."""


def _legal(random: Random) -> bytearray:
    kind = random.choice(KINDS)
    quiet = random.random() < 0.5
    free = bytes(random.choices([0x00, 0x0F, 0x11, 0x80], [2, 1, 1, 1], k=FRAME_LENGTH))
    if not quiet:
        free = bytes(random.choices(IMITATING, k=FRAME_LENGTH))
    raw = bytearray(
        free[offset] if legal is None else random.choice(legal)
        for offset, legal in enumerate(random.choice(list(LINES.values())).legal_bytes(kind))
    )
    if not kind.names_motor and random.random() < 0.5:
        raw[NUM_OFFSET] = 0
    return raw


def near_frame(random: Random) -> bytes:
    """A legal frame, or one with a change."""
    raw = _legal(random)
    change = random.random()
    if change < 0.1:
        raw[-3:-1] = b"\x00\x0f"
    elif change < 0.25:
        end = random.choice(_ENDS)
        offset = random.randrange(1, FRAME_LENGTH - len(end))
        raw[offset : offset + len(end)] = end
    elif change < 0.35:
        raw[NUM_OFFSET] = random.choice(IMITATING)
    elif change < 0.5:
        raw[random.randrange(FRAME_LENGTH)] = random.choice(IMITATING)
    elif change < 0.55:
        raw[random.randrange(FRAME_LENGTH)] = random.randrange(256)
    return bytes(raw)


def near_frames_of(seed: int) -> bytes:
    """Several near frames, in step or with bytes between them."""
    random, stream = Random(seed), b""
    for _ in range(random.randint(1, 16)):
        stream += near_frame(random)
        if random.random() < 0.3:
            stream += bytes(random.choices(IMITATING, k=random.randint(1, 6)))
    return stream[random.choice([0, 0, 1, 4]) :]


near_frames = st.one_of(
    st.integers(0, 1_000_000).map(near_frames_of),
    st.integers(0, 1_000_000).map(near_frames_of),
    st.lists(st.sampled_from(list(IMITATING)), min_size=FRAME_LENGTH, max_size=40).map(bytes),
)
