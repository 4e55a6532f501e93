"""Whatever the rows are, the panes have something to say, within the room that they have."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from fte_sniff.analysis.live_models import LiveModels
from fte_sniff.analysis.row_store import RowStore
from fte_sniff.analysis.statistics import LineSetup
from fte_sniff.protocol import Damage, Frame, Row
from fte_sniff.tui.panes.bytes import dump, neighbours
from fte_sniff.tui.panes.motors import WINDOWS_NS, MotorsView, grid
from fte_sniff.tui.panes.statistics import StatisticsText, page
from fte_sniff.tui.table.theme import DARK, LIGHT
from tests.analysis import conftest

ROWS = st.lists(
    st.from_type(Frame) | st.builds(Damage, conftest.PORTS, conftest.OFFSETS,
                                    conftest.DAMAGE_BYTES, conftest.TIMES, conftest.FAULTS),
    max_size=12,
)  # fmt: skip
WIDTHS = st.sampled_from([8, 20, 40, 79, 120, 199])


@given(
    ROWS,
    st.data(),
    WIDTHS,
    st.integers(1, 40),
    st.sampled_from(WINDOWS_NS),
    st.sampled_from(
        [LineSetup(), LineSetup(resolution=1e-300, gear_ratio=1e-9), LineSetup(50, 1e300, 1e9)]
    ),
)
def test_every_line_of_every_pane_fits(
    rows: list[Row], data: st.DataObject, width: int, height: int, window_ns: int, bench: LineSetup
) -> None:
    store = RowStore(100, 3)
    store.append(rows)
    models = LiveModels(store, bench, 4)
    models.step(100)
    palette = data.draw(st.sampled_from([DARK, LIGHT]))
    index = data.draw(st.integers(0, max(0, len(rows) - 1)))
    motors = models.motors_at(index) if rows else models.motors
    assert motors is not None
    now = rows[index].t_ns if rows else None
    traces = models.traces_at(index, (now or 0) - window_ns)
    look = MotorsView(tuple(motors.states(now)), traces, now, window_ns, bench)
    flags = models.flags.stats()
    told = StatisticsText(models.statistics, flags, now, models.pending, models.missed)
    for text in (grid(look, width, height, palette), page(told, width, palette)):
        assert all(line.cell_len <= width for line in text.split("\n"))
    if rows:
        near = neighbours(store, index, 100)
        assert rows[index] in near
        drawn = dump(rows[index], near, width, palette).plain
        assert drawn or not rows[index].raw
