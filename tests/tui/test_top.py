"""The top view: one line for each kind and motor."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import pytest
from rich.cells import cell_len
from textual.pilot import Pilot

from fte_sniff.analysis.live_models import LiveModels, ShownStreams
from fte_sniff.analysis.row_store import RowStore
from fte_sniff.analysis.statistics import LineSetup
from fte_sniff.protocol import KIND_BY_NAME, Fault, Row, encode
from fte_sniff.protocol.rows import Rows
from fte_sniff.tui.app import SniffApp
from fte_sniff.tui.filters import parse_filter
from fte_sniff.tui.panes import switcher
from fte_sniff.tui.panes.statistics import StatisticsPane
from fte_sniff.tui.panes.top import COLUMNS, TopView, columns_for
from tests.slow import first
from tests.tui.conftest import NOON_NS, lines, page, play, press, rush, settle, table, until

MS = 1_000_000


def frame(at_ms: int, name: str, port: str = "p", **values: int) -> Row:
    kind = KIND_BY_NAME[name]
    zeros = {field.name: 0 for field in kind.fields if field.legal_bits is None}
    raw = encode(kind, zeros | values)
    return Row(port, 10 * at_ms, raw, NOON_NS + at_ms * MS)


def drive(seconds: int = 3) -> list[Row]:
    """Commands and answers after 5 ms, at 10 Hz; motor 2 answers only every second command."""
    rows: list[Row] = []
    for at in range(0, seconds * 1000, 100):
        for motor in (1, 2):
            start = at + 20 * motor
            rows.append(frame(start, "speed", motor=motor, rpm=at % 500 + motor))
            if motor == 1 or at % 200 == 0:
                rows.append(frame(start + 5, "speed_feedback", motor=motor, rpm=at % 500))
    return rows


def line_of(app: SniffApp, *starts: str) -> str:
    (found,) = [line for line in lines(app) if line.split()[: len(starts)] == [*starts]]
    return found


def keys(app: SniffApp) -> list[str]:
    """Kind and motor of every line, in display order."""
    top = app.query_one(TopView)
    return [f"{line.stats.kind.name} {line.stats.motor or ''}".strip() for line in top._lines]


async def open_top(app: SniffApp, pilot: Pilot[None]) -> None:
    await press(app, pilot, "T")
    await settle(app, pilot)
    app._panes.redraw()
    await settle(app, pilot)


def test_a_line_has_what_its_kind_and_motor_do(feed: Any) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        feed.give(drive())
        feed.state = replace(feed.state, running=False, live=False)
        await settle(app, pilot)
        await open_top(app, pilot)
        words = line_of(app, "speed", "2").split()
        #                kind   motor  values     target actual rate
        assert words[:6] == ["speed", "2", "rpm=402", "402", "300", "ø10.0/s"]
        text = line_of(app, "speed", "2")
        assert "100 ms" in text
        assert "5 ms" in text
        assert " 14 " in text
        drawn = app.query_one(TopView).render_line(2).text
        assert drawn.endswith("AA 01 02 01 92 00 00 00 00 EE")
        assert line_of(app, "speed_feedback", "1").split()[-11] != "online"
        assert "online" in line_of(app, "speed_feedback", "1")
        assert any(block in line_of(app, "speed", "1") for block in "▁▂▃▄▅▆▇█")

    play(feed, scenario, (200, 30))


@pytest.mark.parametrize("width", first(2, [40, 200, 80, 120, 160]))
def test_all_lines_of_all_motors_fit_24_lines(feed: Any, width: int) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        feed.give(
            [
                frame(1000 * motor + at, name, motor=motor)
                for motor in (1, 2, 3, 4)
                for at, name in enumerate(
                    ("speed", "position", "speed_feedback", "position_feedback")
                )
            ]
        )
        feed.give([frame(9000, "reset"), frame(9001, "mecanum", vx_cm_s=-500)])
        await settle(app, pilot)
        await open_top(app, pilot)
        assert len(keys(app)) == 18
        text = page(app)
        for name in ("reset", "mecanum", "position"):
            assert name in text
        top = app.query_one(TopView)
        assert not top.show_vertical_scrollbar
        if width >= 80:
            head = top.render_line(0).text.split()
            assert head[:3] == ["kind", "motor", "values"]
            assert {"rate", "Δt", "count", "flags"} <= set(head)
        assert all(top.render_line(y).cell_length == width for y in range(20))

    play(feed, scenario, (width, 24))


@pytest.mark.parametrize("ports", [1, 2])
def test_columns_come_with_the_width_whole_and_never_go(ports: int) -> None:
    before: set[str] = set()
    for width in range(18, 280):
        columns = columns_for(width, ports)
        assert all(cells >= column.width for column, cells in columns)
        assert sum(cells + 1 for _column, cells in columns) <= width
        heads = {column.head for column, _cells in columns}
        assert before <= heads
        before = heads
    assert len(before) == len(COLUMNS) - (ports == 1)
    assert {column.head for column, _ in columns_for(40, 1)} == {"kind", "motor", "values"}
    assert {column.head for column, _ in columns_for(120, 1)} >= {"target", "unanswered"}


def test_lines_are_sorted_by_any_column_and_stay_otherwise(feed: Any) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        feed.give([*drive(), frame(4000, "reset")])
        # Rates of a running capture fall, and the lines are sorted again only every two seconds.
        feed.state = replace(feed.state, running=False, live=False)
        await settle(app, pilot)
        await open_top(app, pilot)
        usual = keys(app)
        assert usual[0] == "reset"
        seen = set()
        for _column in COLUMNS:
            await press(app, pilot, "full_stop")
            await settle(app, pilot)
            top = app.query_one(TopView)
            column = top._sort
            if column is not None:
                assert "▼" in top.render_line(0).text or "▲" in top.render_line(0).text
                values = [column.key(line) for line in top._lines]
                known = [value for value in values if value is not None]
                assert known == sorted(known, reverse=column.number)
                assert values[: len(known)] == known
                await press(app, pilot, "I")
                values = [column.key(line) for line in top._lines]
                known = [value for value in values if value is not None]
                assert known == sorted(known, reverse=not column.number)
                seen.add(column.head)
        assert len(seen) >= 12
        while app.query_one(TopView)._sort is not None:
            await press(app, pilot, "comma")
        assert keys(app) == usual

    play(feed, scenario, (200, 30))


def test_the_mouse_sorts_and_chooses(feed: Any) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        feed.give(drive())
        await settle(app, pilot)
        await open_top(app, pilot)
        at = app.query_one(TopView).render_line(0).text.index("count")
        await pilot.click(TopView, offset=(at, 0))
        assert keys(app)[0] in ("speed 1", "speed 2", "speed_feedback 1")
        assert keys(app)[-1] == "speed_feedback 2"
        await pilot.click(TopView, offset=(5, 4), times=2)
        await settle(app, pilot)
        assert not app.query_one(TopView).display
        assert app.filters.current == "kind = 'speed_feedback' AND motor = 2"

    play(feed, scenario)


def test_enter_shows_the_rows_of_the_line_and_the_key_again_the_lines_of_the_filter(
    feed: Any,
) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        feed.give(drive())
        await settle(app, pilot)
        await open_top(app, pilot)
        assert not table(app).display
        assert app.focused is app.query_one(TopView)
        await press(app, pilot, "down", "enter")
        await settle(app, pilot)
        assert app.focused is table(app)
        assert app.filters.current == "kind = 'speed' AND motor = 2"
        assert table(app).viewport.count == 30
        await open_top(app, pilot)
        assert keys(app) == ["speed 2"]
        assert line_of(app, "speed", "2").split()[-1] == "30"
        feed.give([frame(3000 + at, "speed", motor=2, rpm=at) for at in range(7)])
        await open_filtered(app, pilot)
        assert line_of(app, "speed", "2").split()[-1] == "37"
        await press(app, pilot, "F")
        await open_filtered(app, pilot)
        assert len(keys(app)) == 4
        await press(app, pilot, "escape")
        assert table(app).display

    async def open_filtered(app: SniffApp, pilot: Pilot[None]) -> None:
        await settle(app, pilot)
        app._panes.redraw()
        await settle(app, pilot)

    play(feed, scenario)


def test_enter_typed_ahead_does_not_choose_from_the_lines_of_an_earlier_filter(feed: Any) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        await press(app, pilot, "T")
        app.filters.accept("noise")
        await settle(app, pilot)
        await press(app, pilot, "T", "F")
        await rush(app, pilot, "T", "enter")
        assert app.filters.current.startswith("kind = 'speed'")
        assert not app.query_one(TopView).display

    play(feed, scenario, rows=30)


@pytest.mark.parametrize(
    ("key", "stays"),
    first(2, [("e", False), ("S", True), ("i", False), ("b", False), ("M", True), ("space", True)]),
)
def test_keys_about_rows_bring_the_table_back(feed: Any, key: str, stays: bool) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        feed.give([*drive(), Row("p", 0, b"\x01", NOON_NS, (Fault.NOISE,), framed=False), *drive()])
        await settle(app, pilot)
        await open_top(app, pilot)
        await press(app, pilot, key)
        await settle(app, pilot)
        assert app.query_one(TopView).display is stays
        assert table(app).display is not stays
        if key == "S":
            assert app.query_one(StatisticsPane).display

    play(feed, scenario)


def test_a_pause_freezes_the_lines(feed: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also when a search for findings ends meanwhile, which draws the open pane."""
    monkeypatch.setattr(switcher, "FINDINGS_EVERY_NS", 0)

    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        feed.give(drive())
        await settle(app, pilot)
        await open_top(app, pilot)
        await until(app, pilot, lambda: keys(app))
        await press(app, pilot, "space")
        before = app._panes._searched
        feed.give([frame(4000, "reset")])
        await until(app, pilot, lambda: app._panes._searched > before)
        await app.workers.wait_for_complete()
        for _ in range(3):
            app._panes._drawn_at_ns.clear()
            await settle(app, pilot)
        assert "reset" not in keys(app)
        await press(app, pilot, "M")  # the top view becomes smaller
        await pilot.resize_terminal(200, 60)
        await settle(app, pilot)
        top = app.query_one(TopView)
        assert top.virtual_size.width == top.scrollable_size.width
        assert "reset" not in keys(app)
        await press(app, pilot, "M", "space")
        app._panes._drawn_at_ns.clear()
        await settle(app, pilot)
        assert "reset" in keys(app)

    play(feed, scenario)


def test_changed_bytes_fade(feed: Any) -> None:
    ages = []

    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        feed.give([frame(0, "speed", motor=1, rpm=0x0100), frame(1, "speed", motor=1, rpm=0x0101)])
        feed.state = replace(feed.state, running=False, live=False)
        await settle(app, pilot)
        await open_top(app, pilot)
        for _ in range(8):
            (line,) = app.query_one(TopView)._lines
            ages.append(line.ages[4])
            assert line.ages[3] == 4
            app._panes._drawn_at_ns.clear()
            await settle(app, pilot)
        assert not app.query_one(TopView).is_behind

    play(feed, scenario)
    assert ages == sorted(ages)
    assert ages[0] < 4
    assert ages[-1] == 4


def test_a_raised_flag_is_seen_in_words_and_by_its_sign(feed: Any) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        feed.give([frame(0, "speed_feedback", motor=2, error=4, online=0x0D)])
        await settle(app, pilot)
        await open_top(app, pilot)
        (text,) = [line for line in lines(app) if line.startswith("^speed")]
        assert "error 04" in text or "E04" in text
        assert "OFFLINE" in text

    play(feed, scenario, (120, 24))


def _shown(rows: Sequence[Row], text: str) -> dict[str, int]:
    store = RowStore(100, 7)
    store.view.set_filter(parse_filter(text))
    shown = ShownStreams(store)
    for start in range(0, len(rows), 5):
        store.append(Rows.of(rows[start : start + 5]))
        while not store.view.filter_step():
            pass
        while not shown.step(3):
            pass
    return {f"{one.kind.name} {one.motor}": one.count for one in shown.stats(None)}


def test_streams_of_a_filter_are_those_of_its_rows() -> None:
    rows = [frame(at, "speed", motor=1 + at % 4, rpm=at) for at in range(90)]
    assert _shown(rows, "rpm >= 45 AND motor = 2") == {"speed 2": 12}
    assert sum(_shown(rows, "rpm >= 45").values()) == 45
    assert _shown(rows, "rpm > 1000") == {}


def test_a_new_filter_counts_from_the_start() -> None:
    store = RowStore()
    store.append(Rows.of([frame(at, "speed", motor=1 + at % 2, rpm=at) for at in range(100)]))
    store.view.set_filter(parse_filter("rpm < 10"))
    shown = ShownStreams(store)
    for text, count in (("rpm < 10", 10), ("rpm < 50", 50), ("motor = 1", 50)):
        store.view.set_filter(parse_filter(text))
        assert not shown.step(1000) or not store.view.pending
        store.view.filter_step()
        assert shown.step(1000)
        assert sum(one.count for one in shown.stats(None)) == count


def test_rows_that_are_hidden_again_are_counted_no_more() -> None:
    store = RowStore()
    store.append(Rows.of([frame(at, "speed", motor=1 + at % 2, rpm=at) for at in range(100)]))
    store.view.set_filter(parse_filter("motor = 1"))
    store.view.filter_step()
    shown = ShownStreams(store)
    for limit, count in ((None, 50), (0, 0), (40, 20), (10, 5), (None, 50)):
        store.limit = limit
        assert shown.step(1000)
        assert shown.pending == 0
        assert sum(one.count for one in shown.stats(None)) == count


def test_commands_are_counted_by_their_cmd() -> None:
    rows = [
        frame(0, "speed", motor=1, rpm=1),
        frame(2, "speed_feedback", motor=1, rpm=1),
        frame(10, "position", motor=1, rpm=1, pulses=5),
        frame(20, "position", motor=1, rpm=1, pulses=6),
        frame(24, "position_feedback", motor=1, pulses=6),
        frame(30, "speed", motor=1, rpm=1),
    ]
    for step in (1, 6):
        store = RowStore()
        store.append(Rows.of(rows))
        models = LiveModels(store, LineSetup())
        while not models.step(step):
            pass
        answers = models.motors.states(None)[0].answers
        found = {cmd: (one.answered, one.unanswered) for cmd, one in answers.items()}
        assert found == {1: (1, 0), 2: (1, 1)}
        assert answers[2].delay_p50_ns == 4 * MS


def test_a_narrow_view_is_cut_and_not_broken(feed: Any) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        feed.give(drive(1))
        await settle(app, pilot)
        await open_top(app, pilot)
        top = app.query_one(TopView)
        for width in (10, 15, 21, 30, 39):
            await pilot.resize_terminal(width, 12)
            await settle(app, pilot)
            room = top.scrollable_size.width
            assert all(cell_len(top.render_line(y).text) == room for y in range(8))

    play(feed, scenario)
