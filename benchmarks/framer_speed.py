"""Speed of framing and decoding bytes in bulk, against other decoders and a copy of the memory.

    python -m benchmarks.framer_speed [--megabytes 2] [--sizes 1 10 100] [--live] [--slowest]

"re" is one compiled regular expression that finds sound frames, and numpy; it labels no damage.
"Bulk" is the path of `stats` and `decode` on files: the framer's rows are drained as `Rows`, in
pieces of the commands' size, and numpy reads the kind and every field of each row. All decoders get
the same bytes in the same run (the slow ones a part of them); each number is the best of three, in
seconds of a core, so that other programs do not count. The memory copy is that of the same bytes;
small ones stay in the processor's cache, so compare `--megabytes 2` with `--megabytes 100`. Needs
`construct` and `kaitaistruct`.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from random import Random
from time import process_time

from benchmarks.rival_decoders import with_construct, with_kaitai, with_pattern, with_state_machine
from fte_sniff.capture.source import BATCH_S
from fte_sniff.protocol.framer import Framer
from fte_sniff.protocol.items import Chunk
from fte_sniff.protocol.spec import DEFAULT_BAUD, VALUE_FIELDS, byte_time_ns
from fte_sniff.session.framing import SPAN_BYTES, rows_of_chunks
from tests.support.faults import damaged_stream

SLOW_PART = 200_000
"""Bytes that the slow decoders get."""


def wrong_baud(size: int) -> bytes:
    """What a line at half the rate looks like: few values, long runs of ones and zeros."""
    random = Random(3)
    values = bytes([0x00, 0x80, 0xC0, 0xE0, 0xF0, 0xF8, 0xFE, 0xFF, 0x78, 0x66, 0x9E, 0xE6])
    return bytes(random.choices(values, k=size))


def streams(size: int) -> dict[str, bytes]:
    """Every stream, `size` bytes of it or a little less."""

    def damaged(share: float, payload: str) -> bytes:
        stream, _ = damaged_stream(1, min(size, 2_000_000) // 10, share, payload)
        return (stream * (size // len(stream) + 1))[:size]

    return {
        "clean": damaged(0, "ordinary"),
        "1 % damaged": damaged(0.01, "ordinary"),
        "20 % damaged": damaged(0.2, "ordinary"),
        "20 % hostile": damaged(0.2, "hostile"),
        "random": Random(2).randbytes(size),
        "all AA": b"\xaa" * size,
        "wrong baud": wrong_baud(size),
    }


def speed(decode: Callable[[bytes], object], data: bytes, times: int = 3) -> float:
    """Megabytes in a second of a core, the best of `times`."""
    best = float("inf")
    for _ in range(times):
        began = process_time()
        decode(data)
        best = min(best, process_time() - began)
    return len(data) / best / 1e6


def in_bulk(data: bytes) -> None:
    """Frame the bytes, and decode the kind and the fields of every row."""
    starts = range(0, len(data), SPAN_BYTES)
    pieces = (Chunk("bench", None, data[at : at + SPAN_BYTES]) for at in starts)
    for rows in rows_of_chunks(pieces, lambda _: None):
        for field in VALUE_FIELDS:
            rows.field(field.name)


def compare(size: int) -> None:
    print(f"MB in a second of a core, {size / 1e6:g} MB")
    names = ("bulk", "re", "state m.", "construct", "kaitai", "copy")
    print(f"{'':14}{''.join(f'{name:>10}' for name in names)}   bulk/…")
    for name, data in streams(size).items():
        part = data[:SLOW_PART]
        bulk = speed(in_bulk, data)
        pattern = speed(with_pattern, data)
        machine = speed(with_state_machine, part)
        slow = speed(with_construct, part, 1)
        kaitai = speed(with_kaitai, part, 1)
        copy = speed(bytearray, data)
        speeds = "".join(f"{one:10.3g}" for one in (bulk, pattern, machine, slow, kaitai, copy))
        print(
            f"{name:14}{speeds}   re {bulk / pattern:.2f}x  machine {bulk / machine:.2f}x"
            f"  construct {bulk / slow:.1f}x  copy 1/{copy / bulk:.0f}",
            flush=True,
        )


def growth(sizes: list[int]) -> None:
    """Seconds of a core by size: linear, if a line's numbers grow as the sizes do."""
    for megabytes in sizes:
        for name, data in streams(megabytes * 1_000_000).items():
            began = process_time()
            in_bulk(data)
            print(f"{megabytes:4} MB {name:14}{process_time() - began:8.3f} s", flush=True)


def live() -> None:
    """The framer's share of a core on two wires at line rate, drained as a capture does.

    Reads have 1 to 16 bytes.
    """
    byte_ns = byte_time_ns(DEFAULT_BAUD)
    for share, payload in (
        (0.0, "ordinary"),
        (0.01, "ordinary"),
        (0.2, "ordinary"),
        (0.2, "hostile"),
    ):
        stream, _ = damaged_stream(4, 11_520, share, payload)
        random, at, now = Random(5), 0, 10**18
        chunks = []
        while at < len(stream):
            size = random.randint(1, 16)
            now += size * byte_ns
            chunks.append(Chunk("bench", now, stream[at : at + size]))
            at += size
        used = min(_processor_time(chunks, DRAIN_NS) for _ in range(3))
        line = len(stream) * byte_ns / 1e9
        print(f"live, {share:.0%} {payload}: {2 * used / line:.2%} of a core for two wires")


DRAIN_NS = int(BATCH_S * 1e9)
"""Time between two drains of a live line."""


def _processor_time(chunks: list[Chunk], drain_ns: int = 0) -> float:
    """Seconds of a core for framing all of them."""
    framer, began, drained_ns = Framer("bench"), process_time(), 0
    for chunk in chunks:
        framer.push(chunk)
        if (chunk.t_ns or 0) >= drained_ns + drain_ns:
            drained_ns = chunk.t_ns or 0
            framer.drain()
    framer.finish()
    return process_time() - began


SLOWEST = {
    "two readings": "AA 02 03 EE 55 02 01 03 E8 EE",
    "undecidable": "AA 02 03 EE AA 02 01 03 E8 EE",
    "header, tail": "AA EE",
    "headers, tails": "AA AA AA AA AA AA AA AA AA EE EE EE EE EE EE EE EE EE",
    "stubs": "55 02",
}
"""What takes longest, repeated: bytes that begin and end as many frames as can be."""
SEARCHED = bytes.fromhex("AA AA 55 EE EE 00 01 02 03")
"""The bytes of which the search makes units."""


def slowest(tries: int = 200) -> None:
    """Kilobytes in a second of a core; at line rate, 11.5 come in a second."""
    for name, unit in SLOWEST.items():
        print(f"{name:15}{_kilobytes_a_second(bytes.fromhex(unit)):8.1f} kB/s", flush=True)
    random = Random(3)
    mixed = bytes(random.choices(b"\xaa\x55\xee", k=20_000))
    print(f"any of them    {_kilobytes_a_second(mixed):8.1f} kB/s", flush=True)
    found = {unit: _kilobytes_a_second(unit) for unit in map(bytes.fromhex, SLOWEST.values())}
    for _ in range(tries):
        unit = bytearray(random.choice(sorted(found, key=lambda unit: found[unit])[:5]))
        for _ in range(random.randint(1, 3)):
            at, byte = random.randrange(len(unit)), random.choice(SEARCHED)
            unit[at : at + random.randint(0, 1)] = bytes([byte] * random.randint(0, 2))
        if len(unit) > 1:
            found[bytes(unit)] = _kilobytes_a_second(bytes(unit), 1)
    unit = min(found, key=lambda unit: found[unit])
    speed = _kilobytes_a_second(unit)
    print(f"slowest of {len(found)} units: {speed:.1f} kB/s, {unit.hex(' ').upper()}")


def _kilobytes_a_second(unit: bytes, times: int = 3) -> float:
    data = (unit * (20_000 // len(unit) + 1))[:20_000]
    return 20 / min(_processor_time([Chunk("bench", None, data)]) for _ in range(times))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--megabytes", type=float, default=2)
    parser.add_argument("--sizes", type=int, nargs="*", default=[])
    parser.add_argument("--live", action="store_true")
    parser.add_argument("--slowest", action="store_true")
    chosen = parser.parse_args()
    compare(int(chosen.megabytes * 1_000_000))
    if chosen.sizes:
        growth(chosen.sizes)
    if chosen.live:
        live()
    if chosen.slowest:
        slowest()


if __name__ == "__main__":
    main()
