"""Rows of a host that polls motors, and random captures, for tests of the analyses."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

from hypothesis import strategies as st

from fte_sniff.analysis.segments import SEGMENT_ROWS, Segments
from fte_sniff.analysis.table import Table
from fte_sniff.protocol.items import BaudChange, Gap, GapKind, PortEvent, PortEventKind
from fte_sniff.protocol.rows import Item, Row
from fte_sniff.protocol.spec import KIND_BY_NAME, Fault, encode
from tests.support.columns import rows_from

MS = 1_000_000
SECOND = 1_000_000_000
START = 1_700_000_000 * SECOND


def frame(kind: str, at_ms: float | None, port: str = "a", **values: int) -> Row:
    """A frame at a time after `START`, by default of motor 1 without an error."""
    fields = {field.name for field in KIND_BY_NAME[kind].fields}
    known = dict.fromkeys(fields, 0) | {"motor": 1, "online": 15} | values
    raw = encode(KIND_BY_NAME[kind], {name: known[name] for name in fields})
    return Row(port, 0, raw, None if at_ms is None else START + int(at_ms * MS))


def damage(at_ms: float | None, raw: bytes = b"\x01\x02", port: str = "a") -> Row:
    """Noise at a time after `START`."""
    t_ns = None if at_ms is None else START + int(at_ms * MS)
    return Row(port, 0, raw, t_ns, (Fault.NOISE,), framed=False)


def polled(
    count: int, period_ms: float = 50, delay_ms: float = 3, motors: Sequence[int] = (1, 2, 3, 4)
) -> list[Row]:
    """Commands to motors and their answers."""
    found = list[Row]()
    for number in range(count):
        for motor in motors:
            at = number * period_ms + motor * period_ms / 8
            found.append(frame("speed", at, motor=motor, rpm=100))
            found.append(frame("speed_feedback", at + delay_ms, motor=motor, rpm=100))
    return sorted(found, key=lambda row: row.t_ns or 0)


def talk_with_feedback_without_flags(seconds: int) -> list[Row]:
    """Commands and answers, and behind each answer four frames without a field."""
    rows = polled(20 * seconds)
    for number in range(20 * seconds):
        rows += [frame("reset", number * 50 + 45 + by) for by in range(4)]
    return sorted(rows, key=lambda row: row.t_ns or 0)


def table_of(items: Sequence[Row | Item]) -> Table:
    """One table of rows and what is between them."""
    cutter = Segments(most=2**62)
    cutter.begin("file")
    for item in items_of(items):
        assert not list(cutter.push(item))
    return cutter.rest()


def segments(items: Iterable[Item], most: int = SEGMENT_ROWS) -> Iterator[Table]:
    """The tables of one input without a name."""
    cutter = Segments(most)
    for item in items:
        yield from cutter.push(item)
    yield cutter.rest()


def items_of(steps: Sequence[Row | Item]) -> list[Item]:
    """Rows one after the other as one item."""
    found, waiting = list[Item](), list[Row]()
    for step in steps:
        if isinstance(step, Row):
            waiting.append(step)
            continue
        if waiting:
            found.append(rows_from(waiting))
            waiting = []
        found.append(step)
    return [*found, rows_from(waiting)] if waiting else found


_FRAMES = st.one_of(
    st.tuples(st.just("reset"), st.just({})),
    st.tuples(st.just("mecanum"), st.fixed_dictionaries({"vx_cm_s": st.integers(-9, 9)})),
    st.tuples(
        st.sampled_from(["speed", "position"]),
        st.fixed_dictionaries({"motor": st.integers(1, 3), "rpm": st.integers(-9, 9)}),
    ),
    st.tuples(
        st.sampled_from(["speed_feedback", "position_feedback"]),
        st.fixed_dictionaries(
            {
                "motor": st.integers(1, 3),
                "error": st.integers(0, 3),
                "online": st.sampled_from([15, 15, 14, 12]),
            }
        ),
    ),
)


@st.composite
def captures(draw: st.DrawFn) -> list[Row | Item]:
    """Rows of two ports, with or without times that mostly rise; gaps, events, other speeds."""
    steps, t_ms, is_timed = list[Row | Item](), 0, draw(st.integers(0, 9)) > 0
    for number in range(draw(st.integers(0, 40))):
        port = draw(st.sampled_from("ab"))
        what = draw(st.sampled_from(["frame"] * 12 + ["damage", "gap", "baud", "event"]))
        t_ms += draw(st.sampled_from([1, 3, 3, 3, 30, 70, 400, 1100, -1]))
        match what:
            case "frame":
                kind, values = draw(_FRAMES)
                steps.append(frame(kind, t_ms if is_timed else None, port, **values))
            case "damage":
                raw = draw(st.sampled_from([b"\x01\x02", b"\xaa\x01\x02\x00", b"\x55\x01"]))
                steps.append(damage(t_ms if is_timed else None, raw, port))
            case "gap":
                kind_ = draw(st.sampled_from([GapKind.PORT, GapKind.OTHER_RECORDING]))
                lost = draw(st.sampled_from([None, True, False]))
                steps.append(Gap(kind_, port_lost=lost, reason=str(number)))
            case "baud":
                steps.append(BaudChange(port, draw(st.sampled_from([9600, 115_200]))))
            case _:
                kind__ = draw(st.sampled_from([PortEventKind.LINE_ERROR, PortEventKind.OVERRUN]))
                steps.append(PortEvent(START + t_ms * MS, port, kind__, "", count=2))
    return steps
