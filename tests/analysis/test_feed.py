"""What stands between rows: found at the same places wherever the rows are cut."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from fte_sniff.analysis.feed import BaudChange, GapDetector, MissingRows, StreamChange, shifted
from fte_sniff.protocol import Frame, PortEvent, PortEventKind, Row

RAW = bytes.fromhex("AA00000000000000 00EE".replace(" ", ""))
TIMES = st.lists(st.integers(0, 50), max_size=30).map(sorted)
GAPS = st.lists(st.tuples(st.integers(0, 50), st.integers(0, 9)), max_size=4)


def rows_at(times: list[int]) -> list[Row]:
    return [Frame("p", 10 * at, RAW, t_ns) for at, t_ns in enumerate(times)]


@given(TIMES, GAPS, st.integers(0, 30))
def test_a_stretch_parts_the_rows_before_it_from_those_behind(
    times: list[int], gaps: list[tuple[int, int]], cut: int
) -> None:
    finder = GapDetector()
    assert finder.begin({}, [(first, first + length) for first, length in gaps]) == []
    rows = rows_at(times)
    found: list[StreamChange] = list(finder.seams(rows[:cut]))
    found += shifted(finder.seams(rows[cut:]), len(rows[:cut]))
    places = {seam.place for seam in found}
    for first, length in gaps:
        behind = [at for at, t_ns in enumerate(times) if t_ns > first + length]
        before = [at for at, t_ns in enumerate(times) if t_ns < first]
        if before and behind:
            assert any(before[-1] < place <= behind[0] for place in places)
    for place in places:
        ends = [t_ns for first, length in gaps for t_ns in (first, first + length + 1)]
        assert any(
            (place == 0 or times[place - 1] < t_ns) and t_ns <= times[place] for t_ns in ends
        )


def test_events_stand_before_the_first_row_at_their_time() -> None:
    finder = GapDetector()
    assert finder.begin({"p": 9600}) == [BaudChange(0, "p", 9600)]
    assert finder.begin({"p": 9600}) == []
    events = [
        PortEvent(5, "q", PortEventKind.OPENED, ""),
        PortEvent(20, "p", PortEventKind.LOST, "gone"),
        PortEvent(25, "p", PortEventKind.BAUD_CHANGED, "", 1200),
        PortEvent(25, "q", PortEventKind.BAUD_CHANGED, "", 1200),
        PortEvent(90, "p", PortEventKind.OVERRUN, "", 7),
    ]
    assert finder.seams(rows_at([10, 20, 30]), events) == [
        MissingRows(1, "p"),
        BaudChange(2, "p", 1200),
        MissingRows(3, "p"),
    ]
