"""pcapng files: each row is a packet with its bytes, time, port and direction."""

from __future__ import annotations

from io import BytesIO
from struct import unpack_from

from hypothesis import given
from hypothesis import strategies as st

from fte_sniff.formats.pcapng import PcapngWriter
from fte_sniff.protocol import KIND_BY_NAME, Chunk, Framer, encode

CONTROL = encode(KIND_BY_NAME["speed"], {"motor": 1, "rpm": 100})
FEEDBACK = encode(KIND_BY_NAME["speed_feedback"], {"motor": 1, "rpm": 7, "error": 0, "online": 15})


def blocks_of(data: bytes) -> list[tuple[int, bytes]]:
    """Type and body of each block; the lengths before and behind it are equal."""
    found, at = list[tuple[int, bytes]](), 0
    while at < len(data):
        kind, size = unpack_from("<II", data, at)
        assert unpack_from("<I", data, at + size - 4) == (size,)
        found.append((kind, data[at + 8 : at + size - 4]))
        at += size
    return found


def options_of(body: bytes, at: int) -> dict[int, bytes]:
    found = dict[int, bytes]()
    while at < len(body):
        code, size = unpack_from("<HH", body, at)
        found[code] = body[at + 4 : at + 4 + size]
        at += 4 + size + -size % 4
    return found


def written(port: str, data: bytes) -> list[tuple[int, bytes]]:
    framer, stream = Framer(port), BytesIO()
    framer.push(Chunk(port, 10**18, data))
    framer.end()
    PcapngWriter(stream, {port: 115_200}).write(framer.drain())
    return blocks_of(stream.getvalue())


@given(st.text(max_size=20), st.sampled_from([1, 20_000]))
def test_name_of_any_length_is_that_of_the_port(port: str, times: int) -> None:
    _, (kind, description), *packets = written(port * times, CONTROL)
    name = options_of(description, 8).get(2, b"")
    assert kind == 1
    assert name == (port * times).encode("utf-8", "backslashreplace")[: 2**16 - 1]
    assert len(packets) == 1


def test_direction_of_a_packet_is_that_of_its_frame() -> None:
    packets = [body for kind, body in written("p", CONTROL + FEEDBACK + b"\x13\x37") if kind == 6]
    directions = []
    for body in packets:
        (size,) = unpack_from("<I", body, 12)
        directions.append(unpack_from("<I", options_of(body, 20 + size + -size % 4)[2])[0])
    assert directions == [2, 1, 0], "outbound, inbound, unknown"
    assert all(raw in body for raw, body in zip((CONTROL, FEEDBACK), packets, strict=False))
