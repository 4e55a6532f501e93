"""Inputs of the attacks: recordings, damage to files, bombs, fuzzed streams and settings.

recording   a whole recording, written by the program itself
damaged     any file with a few flips, cuts, copies and claims in it
BOMBS       chunks and records that are small in the file and large in memory or time
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cache
from io import BytesIO
from pathlib import Path
from random import Random
from tempfile import TemporaryDirectory

import lz4.frame
import zstandard

from fte_sniff.capture.simulation import Simulation, parse_parameters
from fte_sniff.protocol.framer import Framer
from fte_sniff.protocol.items import Chunk
from fte_sniff.protocol.rows import Row
from fte_sniff.protocol.spec import DEFAULT_BAUD, KIND_BY_NAME, encode
from fte_sniff.recording.metadata import PortFacts
from fte_sniff.recording.writer import RecordingWriter
from tests.support.columns import entries, fed

MAGIC = b"\x89MCAP0\r\n"
HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, DATA_END = 1, 2, 3, 4, 5, 6, 15
CHUNK_INDEX, ATTACHMENT, METADATA = 8, 9, 12
START_NS = 1_769_860_800_000_000_000
VARIANTS = 12
"""Number of different recordings."""
PORTS = ("/dev/ttyUSB0", "/dev/ttyUSB1")
"""The ports of a recording; the even variants have only the first one."""

CLAIMS = (0, 1, 2**31 - 1, 2**31, 2**32 - 1, 2**40, 2**63 - 1, 2**63, 2**64 - 1)
"""Lengths and positions that a hostile file may claim."""


@cache
def recording(variant: int, port: str = PORTS[0]) -> bytes:
    """A recording of at most 1500 frames per port; the variant decides damage and chunks."""
    random = Random(variant)
    rows: list[Row] = []
    for name in (port, PORTS[1])[: 1 + variant % 2]:
        query = f"seed={variant}&frames={random.randrange(50, 1500)}&flip=0.02&noise=0.02"
        framer = Framer(name, DEFAULT_BAUD)
        for timed in Simulation(parse_parameters(query)):
            rows += fed(framer, Chunk(name, START_NS + timed.t_ns, timed.data))
        rows += list(framer.finish())
    rows.sort(key=lambda row: row.t_ns or 0)
    with TemporaryDirectory() as folder:
        path = Path(folder) / "x.mcap"
        writer = RecordingWriter(path, [PortFacts(port, DEFAULT_BAUD)])
        size = random.randrange(20, 400)
        for start in range(0, len(rows), size):
            writer.write(*entries(rows[start : start + size]))
            writer.flush()
        writer.close()
        return path.read_bytes()


def records(data: bytes) -> list[tuple[int, int, int]]:
    """Opcode, start and end of each record of a whole file."""
    found, at = [], len(MAGIC)
    while at < len(data) - len(MAGIC):
        opcode, length = struct.unpack_from("<BQ", data, at)
        found.append((opcode, at, at + 9 + length))
        at += 9 + length
    return found


def damaged(random: Random, data: bytes) -> bytes:
    """The data with one to eight damages."""
    altered = bytearray(data)
    for _ in range(random.choice((1, 1, 2, 3, 8))):
        _damage(random, altered)
    return bytes(altered)


def _damage(random: Random, data: bytearray) -> None:
    at = random.randrange(len(data) + 1)
    length = min(len(data) - at, int(10 ** random.uniform(0, 3.5)))
    span = slice(at, at + length)
    match random.choice(("flip", "byte", "junk", "zeros", "cut", "copy", "claim", "end")):
        case "flip" if length:
            data[at] ^= 1 << random.randrange(8)
        case "byte" if length:
            data[at] = random.randrange(256)
        case "junk":
            data[span] = random.randbytes(length)
        case "zeros":
            data[span] = bytes(length)
        case "cut":
            del data[span]
        case "copy":
            data[at:at] = data[span] * random.choice((1, 1, 3))
        case "claim":
            data[at : at + 8] = random.choice(CLAIMS).to_bytes(8, "little")
        case "end":
            del data[random.randrange(len(data) * 3 // 4, len(data) + 1) :]


def framed(opcode: int, content: bytes) -> bytes:
    """An MCAP record."""
    return struct.pack("<BQ", opcode, len(content)) + content


def _text(text: str) -> bytes:
    return struct.pack("<I", len(text)) + text.encode()


def _message(channel: int, data: bytes = b"") -> bytes:
    return framed(MESSAGE, struct.pack("<HIQQ", channel, 0, START_NS, START_NS) + data)


def _channel(number: int) -> bytes:
    return framed(
        CHANNEL, struct.pack("<HH", number, 0) + _text(f"/t{number}") + _text("") + bytes(4)
    )


def _repeated(unit: bytes, size: int) -> Iterable[bytes]:
    """About `size` bytes of copies of a unit, in blocks."""
    block = unit * max(1, (1 << 16) // len(unit))
    for _ in range(max(1, size // len(block))):
        yield block


def _zstd(blocks: Iterable[bytes]) -> bytes:
    packed = BytesIO()
    with zstandard.ZstdCompressor(level=9).stream_writer(packed, closefd=False) as writer:
        for block in blocks:
            writer.write(block)
    return packed.getvalue()


def _lz4(blocks: Iterable[bytes]) -> bytes:
    with lz4.frame.LZ4FrameCompressor(block_size=lz4.frame.BLOCKSIZE_MAX4MB) as packer:
        parts = [packer.begin(), *(packer.compress(block) for block in blocks), packer.flush()]
    return b"".join(parts)


def _packed_chunk(random: Random, unit: bytes, size: int, claimed: int | None = None) -> bytes:
    """A chunk of about `size` bytes of copies of a unit; `claimed` is the size that it states."""
    name, pack, limit = random.choice((("zstd", _zstd, 1 << 32), ("lz4", _lz4, 100 << 20)))
    return _chunk_of(name, pack, [*_repeated(unit, min(size, limit))], claimed)


def _chunk_of(
    name: str,
    pack: Callable[[Iterable[bytes]], bytes],
    blocks: Sequence[bytes],
    claimed: int | None = None,
) -> bytes:
    """A chunk of these blocks; equal ones are one object, for a child has its parent's peak."""
    real, packed = sum(map(len, blocks)), pack(blocks)
    head = struct.pack("<QQQI", START_NS, START_NS, real if claimed is None else claimed, 0)
    return framed(CHUNK, head + _text(name) + struct.pack("<Q", len(packed)) + packed)


def _zeros(random: Random) -> bytes:
    return _packed_chunk(random, bytes(1 << 16), random.choice((50, 700, 2500)) << 20)


def _empty_messages(random: Random) -> bytes:
    # A record takes half a microsecond to read: the time follows the unpacked size.
    unit = _message(random.choice((0, 1, 2, 60_000)))
    return _packed_chunk(random, unit, random.choice((40, 200)) << 20)


def _large_message(random: Random) -> bytes:
    size = random.choice((20, 120)) << 20
    name, pack = random.choice((("zstd", _zstd), ("lz4", _lz4)))
    start = _message(1)
    head = start[:1] + struct.pack("<Q", len(start) - 9 + size) + start[9:]
    return _chunk_of(name, pack, [head, *[bytes(1 << 20)] * (size >> 20)])


def _many_channels(random: Random) -> bytes:
    units = b"".join(map(_channel, range(1000, 1000 + random.choice((500, 30_000)))))
    return _packed_chunk(random, units, len(units))


def _many_chunks(random: Random) -> bytes:
    unit = random.choice((bytes(64), _message(1)))
    return _packed_chunk(random, unit, 16 << 20) * random.choice((4, 25))


def _claimed_size(random: Random) -> bytes:
    return _packed_chunk(random, _message(1), 1 << 20, random.choice(CLAIMS))


def _metadata(random: Random) -> bytes:
    entries = b"".join(_text(f"k{n}") + _text("v") for n in range(random.choice((10, 40_000))))
    return framed(METADATA, _text("fte-sniff") + struct.pack("<I", len(entries)) + entries)


def _attachments(random: Random) -> bytes:
    """Attachments with a wrong checksum, some with a chunk inside."""
    inner = random.choice((b"", _packed_chunk(random, _message(1), 1 << 20)))
    head = struct.pack("<QQ", START_NS, START_NS) + _text("a") + _text("text/plain")
    content = head + struct.pack("<Q", len(inner)) + inner + bytes(4)
    return framed(ATTACHMENT, content) * random.choice((1, 50, 5_000 if not inner else 50))


def _overlapping_chunks(random: Random) -> bytes:
    """A chunk whose length reaches over the next ones, again and again."""
    inner = _packed_chunk(random, _message(1), 1 << 16)
    longer = struct.pack("<BQ", CHUNK, random.choice((2, 30)) * len(inner)) + inner[9:]
    return longer * random.choice((10, 300))


def _many_ports(random: Random) -> bytes:
    """Channels of a topic of fte-sniff, each of another port."""
    units = []
    for number in range(1_000, 1_000 + random.choice((300, 9_000))):
        facts = _text("port") + _text(f"/dev/tty{number}") + _text("baud") + _text("115200")
        known = _text("/fte/malformed") + _text("protobuf") + struct.pack("<I", len(facts)) + facts
        units.append(framed(CHANNEL, struct.pack("<HH", number, 1) + known))
    return b"".join(units)


def _claimed_record(random: Random) -> bytes:
    opcode = random.choice((0, 3, 4, 5, 6, 9, 12, 0x80, 0xFF))
    return struct.pack("<BQ", opcode, random.choice(CLAIMS)) + random.randbytes(40)


BOMBS: Mapping[str, Callable[[Random], bytes]] = {
    "zeros": _zeros,
    "empty messages": _empty_messages,
    "large message": _large_message,
    "many channels": _many_channels,
    "many chunks": _many_chunks,
    "claimed size": _claimed_size,
    "metadata": _metadata,
    "claimed record": _claimed_record,
    "attachments": _attachments,
    "overlap": _overlapping_chunks,
    "many ports": _many_ports,
}


def with_bomb(random: Random, data: bytes, bomb: bytes) -> bytes:
    """A recording without its summary, with a bomb before, between or after its chunks."""
    parts = [(opcode, data[start:end]) for opcode, start, end in records(data)]
    ends = [n for n, (opcode, _) in enumerate(parts) if opcode == DATA_END]
    content = [part for _, part in parts[: ends[0]]]
    chunks = [n for n, (opcode, _) in enumerate(parts[: ends[0]]) if opcode == CHUNK]
    content.insert(random.choice((*chunks, len(content))), bomb)
    end = framed(DATA_END, bytes(4)) + framed(FOOTER, bytes(20))
    return MAGIC + b"".join(content) + end + MAGIC


def repeated_index(random: Random, data: bytes) -> bytes:
    """A recording whose summary lists one chunk again and again."""
    parts = [(opcode, data[start:end]) for opcode, start, end in records(data)]
    index = next(part for opcode, part in parts if opcode == CHUNK_INDEX)
    ends = [n for n, (opcode, _) in enumerate(parts) if opcode == DATA_END]
    body = MAGIC + b"".join(part for _, part in parts[: ends[0] + 1])
    summary = index * (random.randrange(1000, 500_000) // len(index))
    footer = framed(FOOTER, struct.pack("<QQI", len(body), 0, 0))
    return body + summary + footer + MAGIC


def numbered_frame(number: int) -> bytes:
    """A frame that no other number has."""
    values = {"motor": 1 + number % 4, "pulses": number, "rpm": 100}
    return encode(KIND_BY_NAME["position"], values)


def noisy_frame(random: Random, number: int) -> bytes:
    """A frame, or what a bad line makes of it."""
    frame = bytearray(numbered_frame(number))
    match random.randrange(8):
        case 0:
            frame[random.randrange(10)] ^= 1 << random.randrange(8)
        case 1:
            del frame[random.randrange(10) :]
        case 2:
            frame += random.randbytes(random.choice((1, 10, 400)))
        case 3:
            frame = bytearray(random.choice((b"\xaa", b"\x55", b"\xee", b"\0")) * 20)
    return bytes(frame)
