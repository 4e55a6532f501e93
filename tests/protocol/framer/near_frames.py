"""Owns bytes that are frames, or nearly: every kind, with what imitates its ends in its payload.

It must not know how frames are found. For tests of shapes: each of them holds, and is missed by
little, in a good share of the places.
"""

from __future__ import annotations

from random import Random

from hypothesis import strategies as st

from fte_sniff.protocol import FRAME_LENGTH, KINDS
from fte_sniff.protocol.codec import legal_bytes
from fte_sniff.protocol.spec import NUM_OFFSET

IMITATING = bytes.fromhex("AA 55 EE 00 01 02 03 04 05 0F 10 7F FF")
"""Values that mean something at some place, and their neighbours."""

_ENDS = tuple(
    map(bytes.fromhex, ("EE AA", "EE 55", "AA 01 01", "55 03 00", "AA 02 05", "AA 09 01"))
)
"""Where a frame could end within another, or begin, or not quite."""


def _legal(random: Random) -> bytearray:
    kind = random.choice(KINDS)
    calm = random.random() < 0.5
    free = bytes(random.choices([0x00, 0x0F, 0x11, 0x80], [2, 1, 1, 1], k=FRAME_LENGTH))
    if not calm:
        free = bytes(random.choices(IMITATING, k=FRAME_LENGTH))
    raw = bytearray(
        free[place] if legal is None else random.choice(legal)
        for place, legal in enumerate(legal_bytes(kind))
    )
    if legal_bytes(kind)[NUM_OFFSET] is None and random.random() < 0.5:
        raw[NUM_OFFSET] = 0
    return raw


def near_frame(random: Random) -> bytes:
    """A legal frame, or one in which something was changed."""
    raw = _legal(random)
    change = random.random()
    if change < 0.1:
        raw[-3:-1] = b"\x00\x0f"
    elif change < 0.25:
        end = random.choice(_ENDS)
        place = random.randrange(1, FRAME_LENGTH - len(end))
        raw[place : place + len(end)] = end
    elif change < 0.35:
        raw[NUM_OFFSET] = random.choice(IMITATING)
    elif change < 0.5:
        raw[random.randrange(FRAME_LENGTH)] = random.choice(IMITATING)
    elif change < 0.55:
        raw[random.randrange(FRAME_LENGTH)] = random.randrange(256)
    return bytes(raw)


def near_frames_of(seed: int) -> bytes:
    """Some of them in step, or with something between."""
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
