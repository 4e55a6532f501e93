"""Rows of every shape, for `hypothesis.strategies.from_type(Row)`."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from hypothesis import strategies as st

from fte_sniff.analysis.relations import COMMANDS, FEEDBACK
from fte_sniff.protocol.rows import MOST_BYTES, Row, fault_bits, faults_in
from fte_sniff.protocol.spec import FRAME_LENGTH, HEADERS, KINDS, TAIL, Fault


@pytest.fixture
def feedback_without_flags() -> Iterator[None]:
    """A frame table in which `reset`, which has no field, is feedback."""
    code = [kind.name for kind in KINDS].index("reset")
    for name, of in (("feedback", FEEDBACK), ("command", COMMANDS)):
        of[code] = name == "feedback"
    yield
    FEEDBACK[code], COMMANDS[code] = False, True


PORTS = st.sampled_from(["/dev/ttyUSB0", "COM3", "日志.hex"]) | st.text(max_size=5)
OFFSETS = st.integers(0, 2**62)
TIMES = st.none() | st.integers(-(2**62), 2**62)
DELAYS = st.none() | st.integers(0, 10**12)
FAULTS = st.sets(st.sampled_from(Fault), max_size=3).map(lambda own: faults_in(fault_bits(own)))
FRAME_STARTS = st.sampled_from(
    [(kind.header, cmd) for kind in KINDS for cmd in kind.cmds]
) | st.tuples(st.sampled_from(list(HEADERS.values())), st.integers(0, 255))
INNER = FRAME_LENGTH - 3
FRAME_BYTES = st.builds(
    lambda start, inner: bytes([*start, *inner, TAIL]),
    FRAME_STARTS,
    st.binary(min_size=INNER, max_size=INNER),
)
DAMAGE_BYTES = st.binary(max_size=MOST_BYTES) | FRAME_BYTES

FRAMES = st.builds(Row, PORTS, OFFSETS, FRAME_BYTES, TIMES, FAULTS, st.just(True), DELAYS)
DAMAGES = st.builds(Row, PORTS, OFFSETS, DAMAGE_BYTES, TIMES, FAULTS, st.just(False), DELAYS)
st.register_type_strategy(Row, FRAMES | DAMAGES)
