"""Which files and rows: `--from` and `--to`, folders and patterns, what gives rows times."""

from __future__ import annotations

from datetime import timedelta, timezone
from pathlib import Path

import pytest

from fte_sniff.cli.input_files import time_range
from fte_sniff.errors import UsageError
from fte_sniff.protocol import PortEvent, PortEventKind, Row, iso_time
from fte_sniff.recording.metadata import PortFacts
from fte_sniff.recording.writer import RecordingWriter
from tests.support.columns import entries, read_rows

SECOND = 10**9
FIRST = 1_769_860_800 * SECOND + 500_000_000
"""2026-01-31T12:00:00.5Z"""
LAST = FIRST + 60 * SECOND


@pytest.mark.parametrize(
    ("text", "t_ns"),
    [
        ("2026-01-31T12:00:05Z", FIRST + 4_500_000_000),
        ("2026-01-31 12:00:05", FIRST + 4_500_000_000),
        ("2026-01-31T20:00:05+08:00", FIRST + 4_500_000_000),
        ("2026-01-31T12:00:05.000000001Z", FIRST + 4_500_000_001),
        ("2026-01-31", FIRST - FIRST % (86400 * SECOND)),
        ("12:00:05", FIRST + 4_500_000_000),
        ("12:01", FIRST + 59_500_000_000),
        ("20:00:05+08:00", FIRST + 4_500_000_000),
        ("12:00:05.25", FIRST + 4_750_000_000),
        ("+10s", FIRST + 10 * SECOND),
        ("+1.5s", FIRST + 1_500_000_000),
        ("+1m30s", FIRST + 90 * SECOND),
        ("+250ms", FIRST + 250_000_000),
        ("+7ns", FIRST + 7),
        ("-10s", LAST - 10 * SECOND),
    ],
)
def test_a_time_can_be_written_so(text: str, t_ns: int) -> None:
    later, earlier = (LAST + 1, LAST + 3600 * SECOND), (FIRST, LAST)
    span = time_range(text, None, [later[:0] or None, earlier])
    assert span is not None
    assert iso_time(span.first_ns) == iso_time(t_ns)
    assert time_range(None, text, [earlier]).end_ns == t_ns


@pytest.mark.parametrize("since", ["20:00:05", "2026-01-31 20:00:05", "12:00:05Z"])
def test_a_time_without_zone_is_of_the_given_zone(since: str) -> None:
    zone = timezone(timedelta(hours=8))
    span = time_range(since, "20:00:10", [(FIRST, LAST)], zone)
    assert (span.first_ns, span.end_ns) == (FIRST + 4_500_000_000, FIRST + 9_500_000_000)


def test_several_inputs_count_from_their_first_row_to_their_last() -> None:
    span = time_range("+1s", "-1s", [(FIRST + SECOND, LAST), None, (FIRST, FIRST + 2 * SECOND)])
    assert (span.first_ns, span.end_ns) == (FIRST + SECOND, LAST - SECOND)


DAY = 86400 * SECOND


@pytest.mark.parametrize(
    ("since", "until", "end"),
    [
        ("12:00:20", "12:00:30", "2026-01-31T12:00:30"),
        (None, "11:00", "2026-01-31T11:00:00"),
        (None, "9999-12-31", "2262-04-11T23:47:16"),
        (None, "+99999999999999999999s", "2262-04-11T23:47:16"),
    ],
)
def test_the_end_is_a_time_as_the_beginning(since: str | None, until: str, end: str) -> None:
    span = time_range(since, until, [(FIRST, LAST)])
    assert span is not None
    assert iso_time(span.end_ns)[:19] == end


def test_a_time_of_day_before_the_beginning_is_refused_with_the_way_to_write_another_day() -> None:
    with pytest.raises(UsageError, match="write another day as 2026-01-31T12:00"):
        time_range("23:59:58", "00:00:02", [(FIRST, LAST)])


def test_a_length_beyond_all_times_lets_all_rows_pass() -> None:
    assert time_range("-99999999999999999999s", None, [(FIRST, LAST)]).first_ns <= FIRST


def _with_events(path: Path, samples: Path) -> list[Row]:
    """A recording whose port was opened long before its first row, and closed long after."""
    rows = read_rows(samples / "clean.mcap")
    times = [row.t_ns for row in rows if row.t_ns is not None]
    with RecordingWriter(path, [PortFacts("p")]) as writer:
        writer.write(*entries([PortEvent(min(times) - DAY, "p", PortEventKind.OPENED, "")]))
        writer.flush()
        for at in range(0, len(rows), 100):
            writer.write(*entries(rows[at : at + 100]))
            writer.flush()
        writer.write(*entries([PortEvent(max(times) + DAY, "p", PortEventKind.LOST, "")]))
    return rows


@pytest.mark.parametrize("cut", [0, 100])
def test_relative_times_count_from_rows_not_from_what_happened_to_the_port(
    run, samples: Path, tmp_path: Path, cut: int
) -> None:
    path = tmp_path / "events.mcap"
    rows = _with_events(path, samples)
    if cut:
        path.write_bytes(path.read_bytes()[:-cut])
    first = rows[0].t_ns
    known = [row.t_ns - first for row in rows]
    for options, count in (
        (["--from", "+10s"], sum(at >= 10 * SECOND for at in known)),
        (["--from", "-1s"], sum(at >= known[-1] - SECOND for at in known)),
        (["--to", "+1s"], sum(at < SECOND for at in known)),
        (["--to", "-1s"], sum(at < known[-1] - SECOND for at in known)),
    ):
        assert 0 < count < len(rows)
        done = run("decode", path, "--format", "csv", *options)
        assert len(done.stdout.splitlines()) == 1 + count, options
        assert f"rows       {count:,}, " in run("stats", path, *options).stdout
