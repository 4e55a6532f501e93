"""The windows of a report: a spike of one row is seen, however long the recording is."""

from __future__ import annotations

import pytest

from fte_sniff.analysis.segments import summed
from fte_sniff.protocol.rows import Row
from fte_sniff.protocol.spec import KIND_BY_NAME, encode
from tests.analysis.captures import segments
from tests.support.columns import rows_from

pytestmark = pytest.mark.extra
report_page = pytest.importorskip("fte_sniff.cli.report_page")

SPIKE = 7_001


@pytest.mark.parametrize("most", [500, 100_000])
def test_windows_of_hours_keep_a_spike_and_stay_few(most: int) -> None:
    raws = [
        encode(KIND_BY_NAME["speed"], {"motor": 1, "rpm": 900 if at == SPIKE else 5})
        for at in range(10_000)
    ]
    rows = [Row("p", 10 * at, raw, 10**18 + at * 10**9) for at, raw in enumerate(raws)]
    items = [rows_from(rows[at : at + 100]) for at in range(0, len(rows), 100)]
    counts = summed([report_page.counted(one) for one in segments(items, most)])
    values = report_page.in_few(counts["plot values"])
    assert report_page.MOST_WINDOWS / 2 <= len(values) <= report_page.MOST_WINDOWS + 1
    (spike,) = values.filter(values["greatest rpm"] == 900)["window"]
    assert abs(spike - rows[SPIKE].t_ns) <= 10 * 10**9
    assert (values["least rpm"].min(), values["greatest rpm"].min()) == (5, 5)
