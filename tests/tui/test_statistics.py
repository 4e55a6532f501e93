"""The pane of statistics as text."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import pytest

from fte_sniff.analysis.fields import Decoded
from fte_sniff.analysis.motor_stats import FlagCounts
from fte_sniff.analysis.motors import motor_rows
from fte_sniff.analysis.statistics import LineSetup, Statistics
from fte_sniff.protocol import (
    KIND_BY_NAME,
    Damage,
    Fault,
    Frame,
    PortEvent,
    PortEventKind,
    Row,
    encode,
)
from fte_sniff.row_batch import Codebook, RowBatch
from fte_sniff.tui.panes.statistics import ALL_IN_ORDER, StatisticsText, page
from fte_sniff.tui.table.theme import DARK

from .conftest import NOON_NS

Rows = Callable[..., list[Row]]


def _told(rows: Sequence[Row], now_ns: int | None = NOON_NS, behind: int = 0) -> StatisticsText:
    statistics, codebook = Statistics(LineSetup()), Codebook()
    decoded = Decoded(RowBatch.from_rows(rows, codebook))
    statistics.observe(decoded, codebook)
    flags = FlagCounts()
    flags.observe(decoded, motor_rows(decoded))
    return StatisticsText(statistics, flags.stats(), now_ns, behind, 0)


@pytest.mark.parametrize("width", [10, 40, 80, 200])
def test_every_line_fits(width: int, speed_rows: Rows, odd_rows: list[Row]) -> None:
    for rows in ([], odd_rows, [*speed_rows(1000), *odd_rows]):
        for line in page(_told(rows), width, DARK).split("\n"):
            assert line.cell_len <= width


def test_the_numbers_of_an_even_stream(speed_rows: Rows) -> None:
    text = page(_told(speed_rows(4000), NOON_NS + 3_999_000_000), 200, DARK).plain
    assert "/dev/ttyUSB0  4,000 rows, 40,000 bytes" in text
    assert "86.8 % of the time used, at 115,200 baud" in text
    assert "longest silence 132 µs" in text
    assert "3,999 < 1 ms" in text
    (line,) = [line for line in text.split("\n") if "speed 3" in line]
    cells = line.split()
    assert cells[:5] == ["speed", "3", "1,000", "250.0/s", "250.0/s"]
    assert "no faults" in text


def test_faults_are_counted_with_the_signs_of_the_table(odd_rows: list[Row]) -> None:
    lines = page(_told(odd_rows), 100, DARK).plain.split("\n")
    counts = {line[:21].strip(): line[21:31].strip() for line in lines if line[:1] in {"!", "?"}}
    assert counts["! noise"] == "2"
    assert counts["? reserved_nonzero"] == "1"
    assert counts["! truncated"] == "1"


def feedback(at_ms: int, motor: int, error: int = 0, online: int = 0x0F) -> Row:
    values = {"motor": motor, "rpm": 5, "error": error, "online": online}
    raw = encode(KIND_BY_NAME["speed_feedback"], values)
    return Frame("p", 10 * at_ms, raw, NOON_NS + at_ms * 1_000_000)


def test_what_flag_bytes_told_of_a_motor_is_told_as_stats_does() -> None:
    rows = [feedback(at, 1 + at % 4) for at in range(100)]
    assert ALL_IN_ORDER in page(_told(rows), 100, DARK).plain
    rows += [feedback(at, 1 + at % 4, 8 if at % 4 == 3 else 0, 7) for at in range(100, 123)]
    lines = page(_told(rows), 100, DARK).plain.split("\n")
    assert "^ motor 4: ERROR bit 3 set in 5 frames, 12:00:00.103 to 12:00:00.119" in lines
    assert "^ motor 4: not ONLINE in 23 frames, 12:00:00.100 to 12:00:00.122; lost once" in lines
    assert not [line for line in lines if "motor 3:" in line or ALL_IN_ORDER in line]


def test_where_nothing_was_told_back_nothing_is_said_of_flags(speed_rows: Rows) -> None:
    assert "ONLINE" not in page(_told(speed_rows(10)), 100, DARK).plain


def test_without_times_it_says_so_and_tells_no_rates() -> None:
    text = page(_told([Damage("p", 0, b"x", None, (Fault.NOISE,))], None), 100, DARK).plain
    assert "no times" in text
    assert "%" not in text


def test_port_events_and_what_is_still_to_be_read_are_told(speed_rows: Rows) -> None:
    told = _told(speed_rows(10), behind=1234)
    event = PortEvent(NOON_NS, "/dev/ttyUSB0", PortEventKind.LINE_ERROR, "parity")
    told.statistics.observe_events([event] * 3)
    text = page(told, 100, DARK).plain
    assert "port events: line error 3 (last 12:00:00.000)" in text
    assert "1,234 rows to go" in text
