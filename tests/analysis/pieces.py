"""Captures with gaps and changes of speed, and their pieces as other models observe them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from enum import Enum
from typing import Any

import numpy as np
from hypothesis import strategies as st

from fte_sniff.analysis.model import StreamChange
from fte_sniff.protocol import KIND_BY_NAME, Fault, FrameKind, Gap, GapKind, Row, encode
from fte_sniff.protocol.items import BaudChange
from fte_sniff.protocol.rows import Rows

MS = 1_000_000
PORTS = ("a", "b")

Step = Row | Gap | BaudChange
"""What comes next in a capture."""

_FRAMES = st.one_of(
    st.tuples(st.just("reset"), st.just({})),
    st.tuples(
        st.sampled_from(["speed", "position"]),
        st.fixed_dictionaries({"motor": st.integers(1, 2), "rpm": st.integers(-9, 9)}),
    ),
    st.tuples(
        st.sampled_from(["speed_feedback", "position_feedback"]),
        st.fixed_dictionaries(
            {
                "motor": st.integers(1, 2),
                "error": st.integers(0, 3),
                "online": st.sampled_from([15, 15, 14, 12]),
            }
        ),
    ),
)


def _row(kind: str, values: dict[str, int], port: str, t_ns: int | None, offset: int) -> Row:
    fields = {field.name for field in KIND_BY_NAME[kind].fields}
    known = {name: value for name, value in values.items() if name in fields}
    raw = encode(KIND_BY_NAME[kind], dict.fromkeys(fields, 1) | known)
    return Row(port, offset, raw, t_ns)


@st.composite
def captures(draw: st.DrawFn) -> list[Step]:
    """Rows of two ports, mostly by rising times, some without; with gaps and other speeds."""
    steps: list[Step] = []
    t_ns = 10**18
    for number in range(draw(st.integers(0, 25))):
        port = draw(st.sampled_from(PORTS))
        what = draw(st.sampled_from(["frame"] * 10 + ["damage", "gap", "baud"]))
        t_ns += draw(st.sampled_from([MS, 3 * MS, 3 * MS, 70 * MS, 10**9, -MS]))
        at = None if draw(st.integers(0, 19)) == 0 else t_ns
        if what == "frame":
            steps.append(_row(*draw(_FRAMES), port, at, 10 * number))
        elif what == "damage":
            steps.append(Row(port, 10 * number, b"\x01\x02", at, (Fault.NOISE,), framed=False))
        elif what == "gap":
            kind = draw(st.sampled_from([GapKind.PORT, GapKind.OTHER_RECORDING]))
            steps.append(Gap(kind, port=draw(st.sampled_from([None, *PORTS]))))
        else:
            steps.append(BaudChange(port, draw(st.sampled_from([9600, 115_200]))))
    return steps


def pieces_of(steps: Sequence[Step], cuts: Sequence[int]) -> Iterator[Sequence[Step]]:
    """The pieces between cuts; some may be empty."""
    ends = sorted(min(at, len(steps)) for at in cuts)
    for start, end in zip([0, *ends], [*ends, len(steps)], strict=True):
        yield steps[start:end]


def observe(model: Any, steps: Sequence[Step]) -> None:
    """Let a model observe steps as one batch."""
    rows: list[Row] = []
    changes: list[StreamChange] = []
    for step in steps:
        if isinstance(step, Row):
            rows.append(step)
        else:
            changes.append(StreamChange(len(rows), step))
    model.observe(Rows.of(rows), changes)


def bauds_after(steps: Sequence[Step]) -> list[Step]:
    """The speeds of the ports after some steps, as the next piece begins."""
    found = {step.port: step for step in steps if isinstance(step, BaudChange)}
    return [*found.values()]


def state_of(value: Any) -> Any:
    """All of an object's state as plain values that can be compared."""
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, dict):
        return {str(key): state_of(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [state_of(item) for item in value]
    names = getattr(type(value), "__slots__", None) or getattr(value, "__dict__", None)
    if names is None or isinstance(value, int | float | str | Enum | FrameKind):
        return value
    return {name: state_of(getattr(value, name)) for name in names}
