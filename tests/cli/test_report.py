"""The bins of a report: a spike of one row is seen, however long the recording is."""

from __future__ import annotations

from pathlib import Path

import pytest

from fte_sniff.analysis import statistics
from fte_sniff.analysis.table import EMPTY
from fte_sniff.protocol import KIND_BY_NAME, Row, encode
from fte_sniff.protocol.rows import Rows
from fte_sniff.recording.metadata import PortFacts
from fte_sniff.recording.reader import Recording
from fte_sniff.session.inputs import InputReading, recording_input
from fte_sniff.session.measured import Measurement
from tests.support.recorded_rows import write_recording

pytestmark = pytest.mark.extra
report_page = pytest.importorskip("fte_sniff.cli.report_page")

SPIKE = 7_001


@pytest.mark.parametrize("most_rows", [500, 100_000])
def test_bins_of_hours_keep_a_spike_and_stay_few(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, most_rows: int
) -> None:
    monkeypatch.setattr(report_page, "_MOST_ROWS", most_rows)
    raws = [
        encode(KIND_BY_NAME["speed"], {"motor": 1, "rpm": 900 if at == SPIKE else 5})
        for at in range(10_000)
    ]
    rows = [Row("p", 10 * at, raw, 10**18 + at * 10**9) for at, raw in enumerate(raws)]
    path = tmp_path / "a.mcap"
    write_recording(path, [PortFacts("p")], [Rows.of(rows)], {}, [])
    bins, measurement = report_page.Bins(), Measurement(statistics.ANALYSIS)
    bins.observe(EMPTY)
    measurement.also = bins.observe
    measurement.read(InputReading([recording_input(Recording(path))]))
    values = bins.values()
    assert report_page.BINS / 2 <= len(values) <= report_page.BINS + 1
    (spike,) = values.filter(values["rpm_high"] == 900)["bin"]
    assert abs(spike - rows[SPIKE].t_ns) <= 10 * 10**9
    assert (values["rpm_low"].min(), values["rpm_high"].min()) == (5, 5)
