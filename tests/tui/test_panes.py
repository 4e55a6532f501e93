"""The panes, on the screen and as text."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.cells import cell_len
from rich.style import Style
from textual.pilot import Pilot
from textual.widgets import Static

from fte_sniff.analysis.counters import EnvelopeColumns
from fte_sniff.analysis.facts import Facts
from fte_sniff.analysis.live_models import LiveModels
from fte_sniff.analysis.motors import FLAGS_IN_ORDER, MotorEvents, Motors
from fte_sniff.analysis.plots import Traces
from fte_sniff.analysis.row_store import RowStore
from fte_sniff.analysis.statistics import LineSetup
from fte_sniff.formats.cell_text import rate_text, share_text, short_number, sparkline
from fte_sniff.protocol import (
    KIND_BY_NAME,
    Fault,
    PortEvent,
    PortEventKind,
    Row,
    encode,
    spaced_hex,
)
from fte_sniff.protocol import rows as columns
from fte_sniff.tui import i18n
from fte_sniff.tui.app import LOW, SniffApp
from fte_sniff.tui.cells import event_words, span_text, turns_text
from fte_sniff.tui.i18n import LANGUAGES, set_language
from fte_sniff.tui.options import SHARES, Choices, PaneLayout, StartOptions
from fte_sniff.tui.painter import DARK, LIGHT
from fte_sniff.tui.panes.motors import SECOND_NS, WINDOWS_NS, MotorsPane, MotorsView, grid
from fte_sniff.tui.panes.pane import Pane
from fte_sniff.tui.panes.plot import (
    SCALE_CELLS,
    Canvas,
    Curves,
    dots_across,
    plot,
    time_axis,
)
from fte_sniff.tui.panes.row import (
    CONTEXT_LINES,
    BytesPane,
    DetailLayout,
    DetailPane,
    detail_text,
    dump,
    neighbours,
)
from fte_sniff.tui.panes.statistics import StatisticsPage, StatisticsPane
from fte_sniff.tui.panes.switcher import STEP_SHARE
from fte_sniff.tui.table import TableHeader
from tests.analysis import conftest
from tests.slow import first
from tests.support.columns import read_rows
from tests.tui.conftest import (
    NOON_NS,
    STEP_NS,
    Rows,
    page,
    play,
    press,
    settle,
    table,
    until,
)


def test_the_pane_explains_the_cursors_row(
    feed: Any, speed_rows: Rows, odd_rows: list[Row]
) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        feed.give([*speed_rows(40), odd_rows[3]])
        await settle(app, pilot)
        await press(app, pilot, "enter")
        feed.give(speed_rows(40, start=40))
        await settle(app, pilot)
        assert "expected EE, found EF" in page(app)
        assert "SCROLLED" in page(app)
        await press(app, pilot, "up")
        await settle(app, pilot)
        assert "expected EE" not in page(app)
        assert "39 RPM" in page(app)
        await press(app, pilot, "escape")
        await pilot.pause()
        assert "39 RPM" not in page(app)

    play(feed, scenario)


def test_the_pane_is_as_tall_as_its_words_up_to_half_the_screen(
    feed: Any, speed_rows: Rows, odd_rows: list[Row]
) -> None:
    heights = []

    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        feed.give([odd_rows[4], *speed_rows(40), odd_rows[5]])
        await settle(app, pilot)
        await press(app, pilot, "enter")
        for key in ("end", "up", "home"):
            await press(app, pilot, key)
            await settle(app, pilot)
            heights.append(app.query_one(DetailPane).outer_size.height)

    play(feed, scenario, (150, 60))
    assert 28 <= heights[0] <= 30
    assert heights[2] < heights[1] < 12


PANES = {"i": DetailPane, "enter": DetailPane, "b": BytesPane, "M": MotorsPane, "S": StatisticsPane}


def feedback_rows(count: int) -> list[Row]:
    rows: list[Row] = []
    for number in range(count):
        name = "speed" if number % 2 else "speed_feedback"
        raw = encode(KIND_BY_NAME[name], {"motor": 1 + number // 2 % 4, "rpm": number})
        rows.append(Row("/dev/ttyUSB0", 10 * number, raw, NOON_NS + number * STEP_NS))
    return rows


def shown(app: SniffApp) -> list[type[Pane]]:
    return [type(pane) for pane in app.query(Pane) if pane.display]


def test_the_motors_of_an_old_row_name_the_row(feed: Any) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        feed.give(feedback_rows(400))
        await settle(app, pilot)
        await press(app, pilot, "M")
        pane = app.query_one(MotorsPane)
        for width in (40, 100):
            await pilot.resize_terminal(width, 24)
            await press(app, pilot, "G")
            app._panes.redraw()
            assert "as of" not in str(pane.border_title)
            await press(app, pilot, "g")
            app._panes.redraw()
            assert "as of row 1, 12:00:00.000 - G: end" in str(pane.border_title)

    play(feed, scenario)


@pytest.mark.parametrize("size", first(1, [((40, 12),), ((80, 24),), ((200, 60),)]))
def test_a_key_opens_a_pane_and_the_table_stays(feed: Any, size: tuple[int, int]) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        feed.give(feedback_rows(400))
        await settle(app, pilot)
        for key, pane in PANES.items():
            await press(app, pilot, key)
            await settle(app, pilot)
            assert shown(app) == [pane]
            assert app.focused is table(app)
            assert table(app).size.height >= (2 if size[1] < LOW else 3)
            cursor = table(app).cursor_row
            await press(app, pilot, "k")
            assert table(app).cursor_row != cursor
            await press(app, pilot, key)
            assert shown(app) == []
            await press(app, pilot, key, "escape", "escape")
            assert shown(app) == []
            assert app.is_running
        for key in "ibMSiMb":
            await press(app, pilot, key)
            assert shown(app) == [PANES[key]]

    play(feed, scenario, size)


def test_a_pane_about_rows_that_stay_is_drawn_once(feed: Any) -> None:
    refreshed = []

    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        feed.give(feedback_rows(400))
        feed.state = replace(feed.state, live=False, running=False)
        await settle(app, pilot)
        for key, kind in PANES.items():
            await press(app, pilot, key)
            await settle(app, pilot)
            await until(app, pilot, lambda: not app._panes.models_pending)
            for _ in range(10):  # the statistics are complete some drawings after the last row
                app._panes._drawn_at_ns.clear()
                await settle(app, pilot)
            refreshed.clear()
            pane = app.query_one(kind)
            with pytest.MonkeyPatch.context() as patch:
                patch.setattr(pane, "refresh", lambda *_args, **_options: refreshed.append(1))
                for _ in range(20):
                    app._panes._drawn_at_ns.clear()
                    await settle(app, pilot)
            assert not refreshed, key
            await press(app, pilot, key)

    play(feed, scenario)


@pytest.mark.parametrize("size", first(1, [((20, 6),), ((40, 12),), ((80, 24),)]))
def test_every_pane_opens_on_nothing_and_on_everything_odd(
    feed: Any, odd_rows: list[Row], size: tuple[int, int]
) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        for rows in ([], odd_rows):
            feed.give(rows)
            await settle(app, pilot)
            for key in PANES:
                await press(app, pilot, "G", key)
                await settle(app, pilot)
                assert len(shown(app)) == 1
                for _ in rows:
                    await press(app, pilot, "k", "J", "z")
                await press(app, pilot, key)
        assert app.is_running

    play(feed, scenario, size, frames=True)


def test_panes_are_about_the_cursor_and_the_newest_while_the_end_is_followed(feed: Any) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        async def shown_after(*keys: str) -> str:
            await press(app, pilot, *keys)
            await settle(app, pilot)
            app._panes.redraw()
            await settle(app, pilot)
            return page(app)

        feed.give(feedback_rows(400))
        assert "392 RPM" in await shown_after("M")
        text = await shown_after("g", "j", "j", "j")
        assert "now    0 RPM" in text
        assert "now    2 RPM" in text
        assert text.count("– RPM") == 2
        assert "392 RPM" in await shown_after("G")
        assert "bytes around offset 3,990" in await shown_after("b")
        assert "bytes around offset 0" in await shown_after("g")

    play(feed, scenario, (120, 48))


def test_the_window_of_time_and_the_range_of_a_plot_are_changed(feed: Any) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        feed.give(feedback_rows(40))
        await press(app, pilot, "M")
        await settle(app, pilot)
        assert "motors, 10 s:" in page(app)
        for keys, window in ("ZZ", "60 s"), ("z" * 8, "1 s"), ("Z" * 14, "4 h"):
            await press(app, pilot, *keys)
            await settle(app, pilot)
            assert f"motors, {window}:" in page(app)
        for full_range in (False, True, False):
            assert ("full range" in page(app)) is full_range
            await press(app, pilot, "r")

    play(feed, scenario, (120, 40))


def test_after_the_end_no_pane_shows_a_rate_as_current(feed: Any, speed_rows: Rows) -> None:
    keys = {"S": ("lately", "mean"), "M": (" now", "at the end, 12:00:"), "T": (" rate ", "ø")}

    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        feed.give(speed_rows(200))
        for key, (current, _ended) in keys.items():
            await press(app, pilot, key)
            await until(app, pilot, lambda current=current: current in page(app))
            assert "ø" not in page(app)
            await press(app, pilot, key)
        feed.end("unplugged")
        for key, (current, ended) in keys.items():
            await press(app, pilot, key)
            await until(app, pilot, lambda ended=ended: ended in page(app))
            assert "ended: unplugged" in page(app)
            assert (current in page(app)) == (key == "T")
            await press(app, pilot, key)

    play(feed, scenario, (120, 40))


def test_a_pane_about_all_rows_opens_where_it_was_scrolled_to(
    feed: Any, odd_rows: list[Row]
) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        feed.give(odd_rows)
        await settle(app, pilot)
        await press(app, pilot, "g")
        for key, kind, y in (("S", StatisticsPane, 2), ("i", DetailPane, 0)):
            await press(app, pilot, key)
            pane: Pane = app.query_one(kind)
            await until(app, pilot, lambda pane=pane: pane.max_scroll_y > 2)
            await press(app, pilot, "J", "J", key, key)
            await until(app, pilot, lambda pane=pane, y=y: pane.scroll_y == y)

    play(feed, scenario, (60, 16))


def test_the_pane_scrolls_by_keys_and_every_bit_can_be_read_on_the_smallest_screen(
    feed: Any,
) -> None:
    raw = encode(KIND_BY_NAME["speed_feedback"], {"motor": 2, "rpm": 5, "error": 2, "online": 11})
    feed.give([Row("p", 0, raw, NOON_NS)])

    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        await press(app, pilot, "i")
        await settle(app, pilot)
        seen = page(app)
        for _ in range(30):
            await press(app, pilot, "J")
            seen += page(app)
        assert "bits 7-0: unknown 00000010" in seen
        assert "motor 4 1, motor 3 0" in seen
        assert "tail" in page(app)
        await press(app, pilot, *["K"] * 30)
        assert "speed_feedback  2026" in page(app)

    play(feed, scenario)


def test_line_errors_of_the_port_are_counted(feed: Any) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        feed.give(feedback_rows(40))
        for number in range(3):
            feed.emit(PortEvent(NOON_NS + number, "/dev/ttyUSB0", PortEventKind.LINE_ERROR, "x"))
        await settle(app, pilot)
        await press(app, pilot, "escape", "S")
        await settle(app, pilot)
        assert "port events: line error 3 (last" in page(app)

    play(feed, scenario, (80, 40))


def test_rows_go_on_to_be_counted_while_no_pane_is_open(feed: Any, speed_rows: Rows) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        for start in range(0, 40_000, 10_000):
            feed.give(speed_rows(10_000, start=start))
            await settle(app, pilot)
        await press(app, pilot, "S")
        for _ in range(20):
            await settle(app, pilot)
            app._panes.redraw()
        assert "40,000 rows, 400,000 bytes" in page(app)

    play(feed, scenario)


ANY_ROWS = st.lists(
    conftest.FRAMES | conftest.DAMAGES,
    max_size=12,
)  # fmt: skip
WIDTHS = st.sampled_from([8, 20, 40, 79, 120, 199])


@given(
    ANY_ROWS,
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
    store.append(columns.Rows.of(rows))
    models = LiveModels(store, bench, 4)
    models.step(100)
    palette = data.draw(st.sampled_from([DARK, LIGHT]))
    index = data.draw(st.integers(0, max(0, len(rows) - 1)))
    motors = models.motors_at(index) if rows else models.motors
    assert motors is not None
    now = rows[index].t_ns if rows else None
    traces, events = models.past(index, (now or 0) - window_ns)
    look = MotorsView(tuple(motors.states(now)), traces, events, now, window_ns, bench)
    page = StatisticsPage(models, now, width, palette)
    for text in (grid(look, width, height, palette), page.text):
        assert all(line.cell_len <= width for line in text.split("\n"))
    if rows:
        near = neighbours(store, index, 100, 100)
        assert rows[index] in near
        drawn = dump(rows[index], near, width, palette).plain
        assert drawn or not rows[index].raw


FRAME = bytes.fromhex("AA010103E800000000EE")


def _rows(lengths: list[int], ports: str = "p") -> list[Row]:
    rows: list[Row] = []
    offsets = dict.fromkeys(ports, 0)
    for number, length in enumerate(lengths):
        port = ports[number % len(ports)]
        at = offsets[port]
        offsets[port] += length
        if length == 10:
            rows.append(Row(port, at, FRAME, None))
        else:
            raw = bytes((at + n) % 256 for n in range(length))
            rows.append(Row(port, at, raw, None, (Fault.NOISE,), framed=False))
    return rows


def _store(rows: list[Row]) -> RowStore:
    store = RowStore(10_000, 16)
    store.append(columns.Rows.of(rows))
    return store


LENGTHS = st.lists(st.sampled_from([1, 3, 10, 10, 10, 40]), min_size=1, max_size=80)


@given(LENGTHS, st.data(), st.sampled_from(["p", "pq"]), st.sampled_from([38, 50, 79, 150]))
def test_the_bytes_around_a_row_stand_at_their_offsets(
    lengths: list[int], data: st.DataObject, ports: str, width: int
) -> None:
    rows = _rows(lengths, ports)
    index = data.draw(st.integers(0, len(rows) - 1))
    row = rows[index]
    stream = b"".join(other.raw for other in rows if other.port == row.port)
    near = neighbours(_store(rows), index, 200, 200)
    assert b"".join(other.raw for other in near) in stream
    assert near[0].offset <= max(0, row.offset - 200)
    text = dump(row, near, width, DARK).plain
    abreast = {38: 8, 50: 8, 79: 16, 150: 32}[width]
    own, inside = bytearray(), False
    for line in text.split("\n"):
        assert len(line) <= width
        start, signs = int(line[:12].replace(",", "")), line[13 : 13 + 3 * abreast + 1]
        for place in range(abreast):
            sign, digits = signs[3 * place], signs[3 * place + 1 : 3 * place + 3]
            inside = sign == "<" or (inside and sign != ">")
            if digits != "··":
                assert int(digits, 16) == stream[start + place]
                own += bytes([int(digits, 16)] if inside else [])
        inside = inside and signs[-1] != ">"
    assert bytes(own) == row.raw


def test_the_row_is_held_by_brackets_and_others_begin_with_a_bar() -> None:
    rows = _rows([10, 10, 10])
    lines = dump(rows[1], rows, 79, DARK).plain.split("\n")
    assert lines[0].startswith("           0 |AA 01 01 03 E8 00 00 00 00 EE<AA 01 01 03 E8 00 ")
    assert lines[1].startswith("          16  00 00 00 EE>AA 01")
    assert lines[0].endswith("................")


@pytest.mark.parametrize("width", [50, 79, 150])
@pytest.mark.parametrize("at", range(8))
def test_each_bracket_stands_once(at: int, width: int) -> None:
    rows = _rows([6, 10, 10, 10, 10, 10, 10, 10])
    drawn = dump(rows[at], rows, width, DARK).plain
    end = 13 + 3 * {50: 8, 79: 16, 150: 32}[width] + 1
    signs = "".join(line[:end] for line in drawn.split("\n"))
    assert (signs.count("<"), signs.count(">")) == (1, 1)


def test_what_the_store_does_not_have_is_dots() -> None:
    rows = _rows([10] * 30)
    del rows[3:9]
    text = dump(rows[3], rows, 79, DARK).plain
    assert re.search(r"··(·|\s)+··<AA", text)


def test_rows_of_other_ports_are_not_neighbours() -> None:
    rows = _rows([10] * 40, "pq")
    near = neighbours(_store(rows), 20, 30, 30)
    assert {row.port for row in near} == {"p"}
    assert len(near) == 7


def test_a_row_that_left_has_no_neighbours() -> None:
    store = RowStore(5, 2)
    store.append(columns.Rows.of(_rows([10] * 9)))
    with pytest.raises(IndexError):
        neighbours(store, 2, 100, 100)
    assert neighbours(store, 5, 100, 100)[0].offset == 40


def _page(
    rows: Sequence[Row], width: int, now_ns: int | None = NOON_NS, behind: Sequence[Row] = ()
) -> StatisticsPage:
    store = RowStore()
    store.append(columns.Rows.of(rows))
    models = LiveModels(store, LineSetup())
    assert models.step(len(rows))
    store.append(columns.Rows.of(behind))
    return StatisticsPage(models, now_ns, width, DARK)


def test_the_numbers_of_an_even_stream(speed_rows: Rows) -> None:
    text = _page(speed_rows(4000), 200, NOON_NS + 3_999_000_000).text.plain
    assert "/dev/ttyUSB0  4,000 rows, 40,000 bytes" in text
    assert "86.8 % of the time used, at 115,200 baud" in text
    assert "longest silence 132 µs" in text
    assert "3,999 < 1 ms" in text
    (line,) = [line for line in text.split("\n") if "speed 3" in line]
    cells = line.split()
    assert cells[:5] == ["speed", "3", "1,000", "250.0/s", "250.0/s"]
    assert "no faults" in text


def test_faults_are_counted_with_the_signs_of_the_table(odd_rows: list[Row]) -> None:
    lines = _page(odd_rows, 100).text.plain.split("\n")
    counts = {line[:21].strip(): line[21:31].strip() for line in lines if line[:1] in {"!", "?"}}
    assert counts["! noise"] == "2"
    assert counts["? reserved_nonzero"] == "1"
    assert counts["! truncated"] == "1"


def feedback(at_ms: int, motor: int, error: int = 0, online: int = 0x0F) -> Row:
    values = {"motor": motor, "rpm": 5, "error": error, "online": online}
    raw = encode(KIND_BY_NAME["speed_feedback"], values)
    return Row("p", 10 * at_ms, raw, NOON_NS + at_ms * 1_000_000)


def test_flags_of_a_motor_are_shown_as_in_stats() -> None:
    rows = [feedback(at, 1 + at % 4) for at in range(100)]
    assert FLAGS_IN_ORDER in _page(rows, 100).text.plain
    rows += [feedback(at, 1 + at % 4, 8 if at % 4 == 3 else 0, 7) for at in range(100, 123)]
    lines = _page(rows, 100).text.plain.split("\n")
    assert "^ motor 4: ERROR bit 3 set in 5 frames, 12:00:00.103 to 12:00:00.119" in lines
    seen = "23 frames, 12:00:00.100 to 12:00:00.122; lost once"
    assert f"^ bit 3 of ONLINE (taken as motor 4) was 0 in {seen}" in lines
    assert not [line for line in lines if "motor 3" in line or FLAGS_IN_ORDER in line]


def test_raised_flags_of_all_motors_do_not_push_the_rates_out() -> None:
    rows = [feedback(at, 1 + at % 4, 1 << at % 8, 0) for at in range(800)]
    rows += [feedback(at, 1 + at % 4, 1 << (at + 1) % 8, 0) for at in range(800, 1600)]
    lines = _page(rows, 80).text.plain.split("\n")
    assert sum("ERROR bit" in line for line in lines) == 16
    assert lines[0].startswith("^ ERROR was set or ONLINE missing: motors 1, 2, 3, 4;")
    one = _page([feedback(1, 1, 1)], 80).text.plain
    assert one.startswith("^ ERROR was set or ONLINE missing: motor 1;")
    rates = [at for at, line in enumerate(lines) if "speed_feedback" in line]
    assert len(rates) == 4
    assert max(rates) < 12


@pytest.mark.parametrize(("step_ms", "cell"), [(1, "▇"), (10, "▁")])
def test_the_use_of_the_line_is_a_share_of_the_whole_line(step_ms: int, cell: str) -> None:
    rows = [feedback(at, 1) for at in range(0, 3000, step_ms)]
    (line,) = [line for line in _page(rows, 80).text.plain.split("\n") if "use over time" in line]
    assert set(line.split(" ")[-1]) == {cell}


def test_without_feedback_no_flags_are_shown(speed_rows: Rows) -> None:
    assert "ONLINE" not in _page(speed_rows(10), 100).text.plain


def test_a_single_row_has_no_share_of_the_time() -> None:
    text = _page([feedback(0, 1)], 80).text.plain
    assert "too few rows for rates" in text
    assert "of the time used" not in text


def test_without_times_no_rates_are_shown() -> None:
    text = _page([Row("p", 0, b"x", None, (Fault.NOISE,), framed=False)], 100, None).text.plain
    assert "no times" in text
    assert "%" not in text


def test_port_events_and_unread_rows_are_shown(speed_rows: Rows) -> None:
    reported = _page(speed_rows(10), 100, behind=speed_rows(1234, start=10))
    event = PortEvent(NOON_NS, "/dev/ttyUSB0", PortEventKind.LINE_ERROR, "parity")
    reported.models.statistics.observe_events([event] * 3)
    text = reported.text.plain
    assert "port events: line error 3 (last 12:00:00.000)" in text
    assert "1,234 rows to go" in text


@pytest.mark.parametrize("language", LANGUAGES)
@pytest.mark.parametrize("width", [40, 60, 80, 200])
def test_port_events_are_wrapped_and_not_cut(speed_rows: Rows, language: str, width: int) -> None:
    page = _page(speed_rows(100), width)
    events = [PortEvent(NOON_NS, "/dev/ttyUSB0", kind, "") for kind in PortEventKind]
    page.models.statistics.observe_events(events * 1234)
    set_language(language)
    text = page.text.plain
    whole = i18n._("{event} {count:,} (last {time})")
    for kind in PortEventKind:
        shown = whole.format(event=i18n._(event_words(kind)), count=1234, time="12:00:00.000")
        assert "".join(shown.split()) in "".join(text.split())
    set_language("en")
    assert all(cell_len(line) <= width for line in text.split("\n"))


def test_the_details_show_every_byte_once(odd_rows: list[Row]) -> None:
    for row in odd_rows:
        text = detail_text(row, DARK, DetailLayout(200, bit_lines=False)).plain
        shown = [line[2:50] for line in text.split("\n")[1:]]
        digits = "".join(
            pair for line in shown for pair in line.split("  ")[0].split() if len(pair) == 2
        )
        assert row.raw.hex().upper() in digits.replace(" ", "")


@pytest.mark.parametrize("width", [1, 20, 40, 79, 199])
def test_the_details_keep_to_their_room(odd_rows: list[Row], width: int) -> None:
    for row in odd_rows:
        for line in detail_text(row, DARK, DetailLayout(width, bit_lines=True)).plain.split("\n"):
            assert cell_len(line) <= max(width, 15)


@pytest.mark.parametrize("width", [40, 79])
def test_the_details_cut_no_word(odd_rows: list[Row], width: int) -> None:
    for row in odd_rows:
        narrow, wide = (
            detail_text(row, DARK, DetailLayout(room, bit_lines=True)).plain
            for room in (width, 400)
        )
        assert sorted(narrow.split()) == sorted(wide.split())


def test_every_line_of_noise_is_marked(odd_rows: list[Row]) -> None:
    text = detail_text(odd_rows[5], DARK, DetailLayout(79, bit_lines=False)).plain
    name, *behind = text[text.index("! " + " " * 12 + "noise") :].split("\n")
    assert "noise" in name
    digits = [line[2:] for line in behind if line.startswith("! ")]
    assert bytes.fromhex("".join(digits)) == odd_rows[5].raw
    assert behind[: len(digits)] == [f"! {line}" for line in digits]


def test_the_details_explain_a_fault_and_its_place(odd_rows: list[Row]) -> None:
    text = detail_text(odd_rows[3], DARK, DetailLayout(80, bit_lines=False)).plain
    assert "! bad_tail: " in text
    assert "expected EE, found EF" in text
    assert spaced_hex(odd_rows[3].raw[5:9]) in text


def test_flags_are_shown_bit_by_bit_where_there_is_room() -> None:
    from fte_sniff.protocol import KIND_BY_NAME, Row, encode

    raw = encode(KIND_BY_NAME["speed_feedback"], {"motor": 1, "rpm": 5, "online": 0x0B})
    tight = detail_text(Row("p", 0, raw, None), DARK, DetailLayout(80, bit_lines=False)).plain
    roomy = detail_text(Row("p", 0, raw, None), DARK, DetailLayout(80, bit_lines=True)).plain
    assert "00001011" in tight
    assert "bit 2" not in tight
    assert "bit 2 is 0: motor 3" in roomy


STROKE = Style(color="red")


def _row(name: str, at_s: float | None, **values: int) -> Row:
    time = None if at_s is None else NOON_NS + round(at_s * SECOND_NS)
    return Row("p", 0, encode(KIND_BY_NAME[name], values), time)


def _look(rows: Sequence[Row], at_s: float | None, bench: LineSetup | None = None) -> MotorsView:
    facts = Facts()
    batch = columns.Rows.concat([facts.feed(columns.Rows.of(rows)), facts.interrupt()])
    motors, traces, events = Motors(), Traces(), MotorEvents()
    motors.observe(batch)
    traces.observe(batch)
    events.observe(batch, motors)
    events.observe_facts(batch)
    now = None if at_s is None else NOON_NS + round(at_s * SECOND_NS)
    states, setup = tuple(motors.states(now)), bench or LineSetup()
    return MotorsView(states, traces, events, now, 10 * SECOND_NS, setup)


def _drive() -> list[Row]:
    rows: list[Row] = []
    for number in range(100):
        at = number / 10
        rows.append(_row("speed", at, motor=1, rpm=1000))
        rows.append(_row("speed_feedback", at + 0.004, motor=1, rpm=990 + number % 3, error=4))
    rows.append(_row("speed_feedback", 9.95, motor=1, rpm=991, error=0))
    rows.append(_row("position", 9.96, motor=2, rpm=600, pulses=-5000))
    return rows


@pytest.mark.parametrize("size", [(20, 3), (40, 4), (40, 30), (79, 15), (118, 20), (199, 37)])
@pytest.mark.parametrize(
    "rows", [[], _drive(), [_row("mecanum", None, vx_cm_s=1, vy_cm_s=2, wz_mrad_s=3)]]
)
def test_the_grid_is_as_wide_as_there_is_room_and_has_every_motor(
    size: tuple[int, int], rows: list[Row]
) -> None:
    at_s = 10.0 if rows and rows[0].t_ns is not None else None
    text = grid(_look(rows, at_s), *size, DARK)
    lines = text.split("\n")
    assert all(line.cell_len <= size[0] for line in lines)
    heads = [text.plain.count(f"motor {number} online ") for number in range(1, 5)]
    if size == (79, 15):
        assert heads == [1, 0, 0, 0]
    elif size[0] >= 68:
        assert heads == [1] * 4
        assert len(lines) <= max(size[1], 28)


def test_a_card_shows_target_and_feedback() -> None:
    page = grid(_look(_drive(), 9.97), 199, 37, DARK).plain
    assert "motor 1 online error 00 bit 2 cleared 12:00:09 " in page
    assert "target speed 1000 RPM" in page
    assert "now    991 RPM" in page
    assert "10.0/s commands, last 10 s: 0 of 100 unanswered" in page
    assert "10.5/s feedback, 4 ms after, p99 4 ms" in page
    assert "error bit 2 is 0 since 12:00:09.950" in page
    assert "target position -5000 pulses 600 RPM" in page


def test_a_bit_is_shown_as_set_or_cleared() -> None:
    rows = [_row("speed_feedback", at, motor=1, rpm=0, error=8 * (at > 1)) for at in (0, 1, 2, 3)]
    assert "error 08 bit 3 set 12:00:02.000" in grid(_look(rows, 3), 199, 37, DARK).plain
    assert "error 08 since 12:00:02" in grid(_look(rows, 3), 79, 22, DARK).plain


@pytest.mark.parametrize("cut", [1, 2, 3, 7])
def test_a_target_is_dated_by_its_first_command_wherever_batches_are_cut(cut: int) -> None:
    rows = [
        _row("speed", 0, motor=1, rpm=0),
        _row("speed", 1, motor=1, rpm=500),
        _row("speed", 2, motor=2, rpm=7),
        _row("speed", 3.5, motor=1, rpm=0),
        _row("speed", 4, motor=1, rpm=0),
        _row("speed_feedback", 4.5, motor=1, rpm=3),
        _row("speed", 5, motor=1, rpm=0),
    ]
    motors = Motors()
    for start in range(0, len(rows), cut):
        motors.observe(columns.Rows.of(rows[start : start + cut]))
    first, second, *_ = motors.states(NOON_NS + 5 * SECOND_NS)
    assert first.target is not None
    assert second.target is not None
    assert first.target.since_ns == NOON_NS + 3_500_000_000
    assert first.target.t_ns == NOON_NS + 5 * SECOND_NS
    assert second.target.since_ns == NOON_NS + 2 * SECOND_NS
    assert "target speed 0 RPM since 12:00:03.5\n" in grid(_look(rows, 5), 60, 40, DARK).plain


@pytest.mark.parametrize("height", [4, 6, 8, 9, 12, 17])
def test_a_low_and_narrow_pane_uses_all_its_lines(height: int) -> None:
    lines = grid(_look(_drive(), 9.97), 38, height, DARK).plain.split("\n")
    assert len(lines) == height
    assert all(lines)
    heads = [line for line in lines if "online" in line]
    assert len(heads) == 4
    if height >= 12:
        assert "target speed 1000 RPM since 12:00:00.0" in lines


def _troubled() -> list[Row]:
    """Three motors that answer, and motor 3, of which answers are lost, late and damaged."""
    rows: list[Row] = []
    for number in range(400):
        at, motor = number / 40, 1 + number % 4
        rows.append(_row("speed", at, motor=motor, rpm=100))
        bad = number // 4 % 4 if motor == 3 and number > 100 else 0
        answer = _row("speed_feedback", at + (0.02 if bad == 2 else 0.003), motor=motor, rpm=99)
        if bad == 3:
            damaged = (Fault.TRUNCATED,)
            answer = Row(
                answer.port, answer.offset, answer.raw[:-1], answer.t_ns, damaged, framed=False
            )
        if bad != 1:
            rows.append(answer)
    return rows


@pytest.mark.parametrize("size", [(38, 30), (78, 17), (118, 30), (199, 37)])
def test_lanes_have_a_tick_for_every_event_of_the_window(size: tuple[int, int]) -> None:
    view = replace(_look(_troubled(), 9.99), chosen=3)
    page = grid(view, *size, DARK).plain
    assert "last 10 s: 37 of 99 unanswered" in page
    lanes = {line.split()[0]: line for line in page.split("\n") if re.match(r" *[x!>^] \d", line)}
    assert lanes.keys() == {"x", "!", ">"}
    assert [int(lanes[sign].split()[1]) for sign in "x!>"] == [37, 19, 19]
    assert all(set(line[SCALE_CELLS:]) == {sign, " "} for sign, line in lanes.items())
    one_line = grid(view, size[0], 9, DARK).plain.split("\n")
    assert any(set(line[SCALE_CELLS:]) >= {"x"} for line in one_line)


def test_a_low_pane_shows_the_motor_with_the_most_events() -> None:
    assert grid(_look(_troubled(), 9.99), 78, 17, DARK).plain.startswith("motor 3")
    sound = replace(_look(_drive()[:20], 0.9), of_row=2)
    assert grid(sound, 78, 17, DARK).plain.startswith("motor 1")


@pytest.mark.parametrize("size", [(78, 17), (118, 18)])
def test_one_lane_for_several_kinds_of_events_has_their_signs(size: tuple[int, int]) -> None:
    text = grid(_look(_troubled(), 9.97), *size, DARK).plain
    labels = re.findall(r"(?m)(?:^|  ) *(\S+ ?\d+) ", text)
    signs = {sign for label in labels for sign in label if not sign.isdigit()} - {" "}
    assert {"x", "!"} <= signs


def test_title_of_a_pane_has_the_keys_that_fit_and_always_that_it_closes(feed: Any) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        feed.give(_troubled())
        await settle(app, pilot)
        await press(app, pilot, "k")
        for width, height in ((80, 24), (118, 30), (60, 20)):
            await pilot.resize_terminal(width, height)
            for key in ("b", "M", "i", "S", "exclamation_mark"):
                await press(app, pilot, key)
                await settle(app, pilot)
                (pane,) = [pane for pane in app.query(Pane) if pane.display]
                title = str(pane.border_title)
                assert cell_len(title) <= width - 4
                assert "esc: close" in title

    play(feed, scenario)


def test_an_unknown_value_is_a_dash() -> None:
    page = grid(_look([_row("reset", 0)], 0.5), 199, 37, DARK).plain
    assert page.count("– RPM") == page.count("– pulses") == 4
    assert page.count("online – error –") == 4
    assert page.count("0 feedback") == 4
    assert " 0 RPM" not in page


def test_a_rate_that_is_not_known_is_not_a_dash_before_the_commands() -> None:
    view = replace(_look(_drive(), 9.97), states=_look(_drive(), None).states)
    page = grid(view, 199, 37, DARK).plain
    assert "100 commands, last 10 s: 0 of 100 unanswered" in page
    assert "101 feedback, 4 ms after, p99 4 ms" in page
    assert not re.search("– (commands|feedback)", page)


def test_an_old_value_shows_its_age_and_an_open_command_its_wait() -> None:
    page = grid(_look(_drive(), 12.0), 199, 37, DARK).plain
    assert "now    991 RPM 2.05 s ago" in page
    assert "no answer for 2.04 s" in page


def test_pulses_are_turns_too_where_the_line_setup_has_the_number() -> None:
    rows = [_row("position_feedback", 1, motor=3, pulses=10_000)]
    setup = LineSetup(resolution=500, gear_ratio=20)
    assert "10000 pulses 1.000 turns" in grid(_look(rows, 1, setup), 199, 37, DARK).plain
    detail = detail_text(rows[0], DARK, DetailLayout(80, bit_lines=False), setup).plain
    assert "10000 pulses, 1.000 turns" in detail
    assert "turns" not in grid(_look(rows, 1), 199, 37, DARK).plain


@pytest.mark.parametrize(
    ("size", "axes", "beside"),
    [
        ((199, 37), [4], False),
        ((80, 24), [2, 2], False),
        ((80, 16), [1], False),
        ((120, 20), [3, 2], True),
    ],
)
def test_speed_and_position_are_side_by_side_where_lines_are_few(
    size: tuple[int, int], axes: list[int], beside: bool
) -> None:
    rows = [_row("speed_feedback", at, motor=1, rpm=190 * at) for at in (0, 1)]
    rows += [_row("position_feedback", at, motor=1, pulses=1900 * at) for at in (0, 1)]
    lines = grid(_look(rows, 2), *size, DARK).plain.split("\n")
    for text in ("╵-10 s", "╵-5 s"):
        assert [line.count(text) for line in lines if text in line] == axes
    assert any(" 190 " in line and " 1900 " in line for line in lines[5:]) is beside


def _spans(columns: int, at: dict[int, tuple[float, float]]) -> EnvelopeColumns:
    low, high = np.full(columns, np.nan), np.full(columns, np.nan)
    for column, (least, most) in at.items():
        low[column], high[column] = least, most
    return EnvelopeColumns(low, high, high.copy())


def _curves(
    reported: dict[int, tuple[float, float]],
    asked: dict[int, tuple[float, float]],
    otherwise: Sequence[int] = (),
    standing: float | None = None,
) -> Curves:
    columns = dots_across(28)
    other = np.zeros(columns, np.bool_)
    other[list(otherwise)] = True
    return Curves(
        _spans(columns, asked), _spans(columns, reported), other, standing, 0.1 * SECOND_NS
    )


def _drawn(curves: Curves, full_range: bool = True) -> list[str]:
    return [line.plain for line in plot(curves, STROKE, DARK, 28, 4, full_range=full_range)]


def test_in_the_full_range_a_spike_of_one_column_is_seen_from_top_to_bottom() -> None:
    lines = _drawn(_curves(dict.fromkeys(range(40), (0, 0)) | {20: (0, 1000)}, {}))
    assert all(line[8 + 10] != " " for line in lines)
    assert all(line[8 + 15] == " " for line in lines[:-1])
    assert lines[0].startswith("   1000 ")
    assert lines[-1].startswith("      0 ")


@pytest.mark.parametrize("wave", [0, 20], ids=["flat", "wave"])
@pytest.mark.parametrize("spike", [30, 1000, 2**30, -5, -(2**30)])
def test_an_outlier_is_a_marker_at_the_edge_and_all_else_stays(wave: int, spike: int) -> None:
    calm = {n: (n % 10 * wave, n % 10 * wave) for n in range(40)}
    wild = _curves(calm | {20: (min(0, spike), max(0, spike))}, {})
    lines, before = _drawn(wild, full_range=False), _drawn(_curves(calm, {}), full_range=False)
    if abs(spike) < 9 * wave:
        assert not {"▲", "▼"} & set("".join(lines))
        return
    edge, sign = (0, "▲") if spike > 0 else (-1, "▼")
    assert lines[edge][8 + 10] == sign
    assert "".join(lines).count(sign) == 1 + bool(wave)
    assert [line[: 8 + 9] for line in lines if sign not in line[:8]] == [
        line[: 8 + 9] for line, other in zip(before, lines, strict=True) if sign not in other[:8]
    ]
    full = _drawn(wild)
    assert sign not in "".join(full)
    assert short_number(abs(spike)) in "".join(full)


def test_a_value_that_swings_faster_than_the_columns_is_drawn_in_full() -> None:
    """The last values of the columns are in the middle of a range that nothing else is near."""
    swing = _curves(dict.fromkeys(range(40), (-1500, 1499)), {})
    middle = EnvelopeColumns(
        swing.feedback.low, swing.feedback.high, np.where(swing.feedback.low < 0, 3.0, np.nan)
    )
    lines = _drawn(replace(swing, feedback=middle), full_range=False)
    assert lines[0].startswith("   1499 ")
    assert lines[-1].startswith("  -1500 ")
    assert not {"▲", "▼"} & set("".join(lines))


def test_a_step_and_a_target_that_is_sent_once_are_not_outliers() -> None:
    step = _curves(
        {n: (0, 0) if n < 36 else (900, 900) for n in range(40)}, {0: (0, 0), 35: (900, 900)}
    )
    lines = _drawn(step, full_range=False)
    assert lines[0].startswith("    900 ")
    assert not {"▲", "▼"} & set("".join(lines))


@pytest.mark.parametrize("every", [1, 2, 4])
@pytest.mark.parametrize("flip", [4096, -4096])
def test_one_command_with_a_flipped_bit_is_a_marker_at_the_edge(every: int, flip: int) -> None:
    ramp = {column: column * 5 for column in range(0, 40, every)}
    for column in [*ramp][2:-1]:
        sent = ramp | {column: ramp[column] + flip}
        curves = _curves({}, {at: (value, value) for at, value in sent.items()}, standing=0)
        lines = _drawn(curves, full_range=False)
        edge, sign = (0, "▲") if flip > 0 else (-1, "▼")
        assert lines[edge][8 + column // 2] == sign
        ends = {int(line[:7]) for line in (lines[0], lines[-1])}
        assert max(map(abs, ends)) <= 40 * 5
        assert sign + short_number(sent[column]) in "".join(lines)
        # The target before is drawn in its place: only the step to the next one is higher.
        drawn = [
            "".join(line[8 + column // 2] for line in lines) for column in (column, column + 1)
        ]
        assert all(sum(cell not in " ▲▼" for cell in cells) <= 2 for cells in drawn)
        assert sign not in "".join(_drawn(curves))


@pytest.mark.parametrize(
    "sent",
    [
        {0: 0, 13: 1000, 26: 0},
        {0: 0, 7: 1000, 14: 0, 21: -1000, 28: 500, 35: 0},
        dict.fromkeys(range(10), 0) | {10: 1000} | dict.fromkeys(range(25, 40), 0),
        dict.fromkeys(range(39), 0) | {39: 1000},
        {n: n * 200 for n in range(6)},
    ],
    ids=["there and back", "to and fro", "one that was held", "the last", "ramp"],
)
def test_targets_that_the_host_may_have_meant_are_in_the_scale(sent: dict[int, int]) -> None:
    curves = _curves({}, {at: (value, value) for at, value in sent.items()})
    lines = _drawn(curves, full_range=False)
    assert not {"▲", "▼"} & set("".join(lines))
    assert lines == _drawn(curves)


def test_the_flipped_command_of_a_sample_does_not_flatten_its_motor(samples: Path) -> None:
    rows = read_rows(samples / "damaged.mcap")
    view = replace(_look(rows, None), now_ns=rows[-1].t_ns)
    page = grid(view, 199, 37, DARK).plain
    assert "▲4336" in page
    assert " 4336" not in page
    full = grid(replace(view, full_range=True), 199, 37, DARK).plain
    assert "▲" not in full
    assert " 4336" in full


def test_target_and_actual_are_both_seen_where_they_are_the_same() -> None:
    same = dict.fromkeys(range(40), (5, 5))
    lines = plot(_curves(same, same), STROKE, DARK, 28, 4)
    assert {STROKE, DARK.target} <= {span.style for line in lines for span in line.spans}


def test_a_short_change_of_the_target_is_drawn_in_any_column() -> None:
    for column in range(1, 39):
        asked = {0: (0, 0), column: (0, 900), column + 1: (0, 0)}
        assert _drawn(_curves({}, asked))[0][8 + column // 2] != " "


@pytest.mark.parametrize(("width", "texts"), [(60, 3), (30, 3), (24, 2), (16, 1), (9, 0)])
def test_the_time_axis_has_what_fits(width: int, texts: int) -> None:
    axis = time_axis(width, "10 s", "5 s", "now", Style()).plain
    found = [text for text in ("╵-10 s", "╵-5 s", "now╵") if text in axis]
    assert len(found) == texts
    assert cell_len(axis) == width
    if texts == 3:
        assert axis.index("╵-5 s") == 8 + (width - 8) // 2


def test_feedback_is_held_for_a_second_and_a_target_until_the_next() -> None:
    reported = _drawn(_curves({0: (5, 5)}, {}))[2][8:]
    assert reported[:5].strip()
    assert not reported[6:].strip()
    asked = _drawn(_curves({}, {0: (5, 5)}))[2][8:]
    assert asked[-4:].strip()
    ended = _drawn(_curves({}, {0: (5, 5)}, otherwise=[20]))[2][8:]
    assert ended[8:10].strip()
    assert not ended[10:].strip()


def test_what_was_asked_before_stands_from_the_left() -> None:
    assert _drawn(_curves({}, {}, standing=7.0))[2][8:].strip()
    assert not "".join(_drawn(_curves({}, {}))).strip()


def test_the_line_and_the_dots_differ_without_colour() -> None:
    reported = "".join(_drawn(_curves(dict.fromkeys(range(40), (5, 5)), {})))
    asked = "".join(_drawn(_curves({}, dict.fromkeys(range(40), (5, 5)))))
    assert reported != asked
    dots = [
        sum(bin(ord(sign) - 0x2800).count("1") for sign in text if sign >= "⠀")
        for text in (reported, asked)
    ]
    assert dots[0] == 40
    assert dots[1] == 20


def test_a_target_of_another_mode_does_not_stand() -> None:
    rows = [
        _row("speed", 0, motor=1, rpm=500),
        _row("speed_feedback", 0.1, motor=1, rpm=500),
        _row("position", 30, motor=1, rpm=500, pulses=7),
        _row("mecanum", 32, vx_cm_s=1, vy_cm_s=0, wz_mrad_s=0),
        _row("speed_feedback", 33, motor=1, rpm=480),
    ]
    late = _look(rows, 33)
    state = late.states[0]
    assert (
        late.curves(state, "rpm", 40).first_target is None
        or late.curves(state, "rpm", 40).target_ended.any()
    )
    assert late.curves(state, "rpm", 40).first_target == 500
    assert late.curves(state, "pulses", 40).first_target is None
    assert late.curves(state, "pulses", 40).target_ended.sum() == 1


def test_each_dot_has_its_bit() -> None:
    dots = {(0, 0): "⠁", (1, 0): "⠂", (2, 0): "⠄", (3, 0): "⡀",
            (0, 1): "⠈", (1, 1): "⠐", (2, 1): "⠠", (3, 1): "⢀"}  # fmt: skip
    for place, character in dots.items():
        canvas = Canvas(1, 1)
        canvas.dots[place] = True
        assert canvas.cells.tolist() == [[ord(character)]]


@given(st.lists(st.tuples(st.floats(-9, 20), st.floats(0, 9)) | st.none(), min_size=6, max_size=6))
def test_bars_reach_from_low_to_high_and_are_kept_on_the_canvas(
    bars: list[tuple[float, float] | None],
) -> None:
    canvas = Canvas(3, 2)
    low = np.array([np.nan if bar is None else bar[0] for bar in bars])
    canvas.bars(low, low + [0 if bar is None else bar[1] for bar in bars])
    for column, bar in enumerate(bars):
        places = {7 - int(row) for row in np.flatnonzero(canvas.dots[:, column])}
        if bar is None:
            assert not places
        else:
            ends = [min(7, max(0, round(end))) for end in (bar[0], bar[0] + bar[1])]
            assert places == set(range(ends[0], ends[1] + 1))


@pytest.mark.parametrize(
    ("ns", "text"),
    [
        (None, "–"),
        (0, "0 ns"),
        (999, "999 ns"),
        (1_000, "1 µs"),
        (86_800, "86.8 µs"),
        (999_600, "1 ms"),
        (2_150_000, "2.15 ms"),
        (150_000_000, "150 ms"),
        (90_000_000_000, "90 s"),
        (600_000_000_000, "10 min"),
        (14_400_000_000_000, "4 h"),
        (864_000_000_000_000, "10 days"),
    ],
)
def test_durations(ns: float | None, text: str) -> None:
    assert span_text(ns) == text


@given(st.integers(0, 2**62))
def test_a_duration_is_short_and_never_an_exponent(ns: int) -> None:
    assert len(span_text(ns)) <= 11
    assert "e+" not in span_text(ns)


@given(st.integers(-(2**31), 2**31))
def test_a_scale_has_at_most_six_cells(value: int) -> None:
    assert len(short_number(value)) <= 6
    assert "e" not in short_number(value)


def test_what_is_not_known_is_a_dash_and_what_there_is_little_of_is_not_0() -> None:
    assert (rate_text(None), share_text(None)) == ("–", "–")
    assert (rate_text(0), share_text(0)) == ("0.0/s", "0.0 %")
    assert (rate_text(1234.5), share_text(0.0001)) == ("1,234/s", "<0.1 %")
    assert (rate_text(0.03), rate_text(0.05)) == ("<0.1/s", "0.1/s")
    assert turns_text(5, LineSetup()) == ""
    assert turns_text(-1500, LineSetup(resolution=500, gear_ratio=2)) == "-1.500 turns"


@given(st.lists(st.floats(0, 1e6), max_size=50), st.integers(0, 60))
def test_a_sparkline_leaves_a_cell_empty_only_where_there_is_nothing(
    values: list[float], width: int
) -> None:
    line = sparkline(values, width)
    assert cell_len(line) == min(width, len(values))
    assert (line.strip() == "") == (not any(values) or width == 0)
    if line and any(values):
        assert "█" in line


def divider(app: SniffApp) -> Pane:
    return next(pane for pane in app.query(Pane) if pane.display)


def test_the_divider_stays_where_it_is_moved(feed: Any) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        feed.give(feedback_rows(400))
        await press(app, pilot, "M")
        await settle(app, pilot)
        before = divider(app).region.y
        await press(app, pilot, "minus", "minus", "minus")
        await settle(app, pilot)
        moved = divider(app).region.y
        assert moved > before
        await press(app, pilot, "S")
        await settle(app, pilot)
        assert divider(app).region.y == moved
        for _ in range(len(SHARES) // STEP_SHARE + 1):
            await press(app, pilot, "plus")
            await settle(app, pilot)
        assert table(app).size.height >= 3
        assert app.choices.panes == PaneLayout(height=SHARES[-1])

    play(feed, scenario)


def test_a_wide_terminal_has_the_pane_beside_the_table(feed: Any) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        feed.give(feedback_rows(400))
        await press(app, pilot, "i")
        await settle(app, pilot)
        pane = divider(app)
        assert pane.region.y == app.query_one(TableHeader).region.y
        assert pane.region.x == table(app).region.right
        assert "byte by byte" in page(app)
        await press(app, pilot, "minus")
        await settle(app, pilot)
        assert pane.region.x == pytest.approx(200 - 2 * 37, abs=1)
        assert app.choices.panes == PaneLayout(beside=True, width=37)
        await press(app, pilot, "b")
        table(app).jump(200)
        await settle(app, pilot)
        pane = divider(app)
        assert pane.region.height - len(bytes_lines(app)) <= 3, "it fills its height"
        await pilot.resize_terminal(100, 30)
        await settle(app, pilot)
        assert pane.region.x == 0
        assert pane.region.y > 10
        assert len(bytes_lines(app)) == 2 * CONTEXT_LINES + 1

    play(feed, scenario, (200, 40))


def bytes_lines(app: SniffApp) -> list[str]:
    """The lines of the bytes pane."""
    return str(app.query_one(BytesPane).query_one(Static).content).splitlines()


def test_the_panes_begin_where_they_were(feed: Any) -> None:
    choices = Choices(pane_beside=True, pane_width=30)

    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        await press(app, pilot, "S")
        await settle(app, pilot)
        assert divider(app).region.x == pytest.approx(140, abs=1)

    play(feed, scenario, (200, 40), options=StartOptions(choices=choices))


def test_the_lowest_pane_has_four_lines(feed: Any) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        await press(app, pilot, "S")
        await settle(app, pilot)
        assert divider(app).content_size.height >= 4
        app._notice.warn("the port is lost")
        await settle(app, pilot)
        assert divider(app).content_size.height >= 4
        assert table(app).size.height >= 3

    choices = Choices(pane_height=SHARES.start)
    play(feed, scenario, (80, 24), options=StartOptions(choices=choices))


def test_a_narrow_terminal_shows_from_which_width_a_pane_is_beside(feed: Any) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        await press(app, pilot, "M", "L")
        assert "from 160 columns on" in page(app)
        assert app.choices.panes == PaneLayout()

    play(feed, scenario, (159, 40))
