"""Relative times of `--from` and `--to` count from rows."""

from __future__ import annotations

from pathlib import Path

import pytest

from fte_sniff.protocol.items import PortEvent, PortEventKind
from fte_sniff.protocol.rows import Row
from fte_sniff.recording.metadata import PortFacts
from fte_sniff.recording.writer import RecordingWriter
from tests.support.columns import entries, read_rows

SECOND = 10**9
DAY = 86400 * SECOND


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
