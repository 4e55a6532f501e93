"""Rows of every shape, for `hypothesis.strategies.from_type(Frame)` and `from_type(Damage)`."""

from __future__ import annotations

from hypothesis import strategies as st

from fte_sniff.protocol import FRAME_LENGTH, HEADERS, KINDS, TAIL, Damage, Fault, Frame

PORTS = st.sampled_from(["/dev/ttyUSB0", "COM3", "日志.hex"]) | st.text(max_size=5)
OFFSETS = st.integers(0, 2**62)
TIMES = st.none() | st.integers(-(2**62), 2**62)
DELAYS = st.none() | st.integers(0, 10**12)
FAULTS = st.lists(st.sampled_from(Fault), unique=True, max_size=3).map(tuple)
FRAME_STARTS = st.sampled_from(
    [(kind.header, cmd) for kind in KINDS for cmd in kind.cmds]
) | st.tuples(st.sampled_from(list(HEADERS.values())), st.integers(0, 255))
INNER = FRAME_LENGTH - 3
FRAME_BYTES = st.builds(
    lambda start, inner: bytes([*start, *inner, TAIL]),
    FRAME_STARTS,
    st.binary(min_size=INNER, max_size=INNER),
)
DAMAGE_BYTES = st.binary(max_size=40) | st.binary(min_size=1024, max_size=1024) | FRAME_BYTES

st.register_type_strategy(
    Frame, st.builds(Frame, PORTS, OFFSETS, FRAME_BYTES, TIMES, FAULTS, DELAYS)
)
st.register_type_strategy(
    Damage, st.builds(Damage, PORTS, OFFSETS, DAMAGE_BYTES, TIMES, FAULTS, DELAYS)
)
