"""The table: viewport, marks, columns, cells and lines of text."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.cells import cell_len
from rich.style import Style

from fte_sniff.analysis.search import Search
from fte_sniff.formats.cell_text import (
    clock_text,
    elapsed_text,
    fit,
    fit_path,
    fit_right,
    short_names,
)
from fte_sniff.protocol import COLUMNS, KIND_BY_NAME, KINDS, Fault, Row, Status, encode, record
from fte_sniff.protocol.columns import LOOKS, ORDER_MARK
from fte_sniff.protocol.rows import Rows
from fte_sniff.tui.cells import DELTA, ORDER, VALUES, TableView, layout_for, short_kind, value_parts
from fte_sniff.tui.painter import DARK, LIGHT, Painter, Palette, RowCell
from fte_sniff.tui.panes.row import DetailLayout, detail_text
from fte_sniff.tui.table import RowMarks, ScrollScale, Viewport

PORTS = st.text(max_size=30)
TIMES = st.one_of(st.none(), st.integers(0, 2**63 - 1))
FAULTS = st.lists(st.sampled_from(list(Fault)), unique=True, max_size=3).map(tuple)
FRAMES = st.builds(
    Row, PORTS, st.integers(0, 2**40), st.binary(min_size=10, max_size=10), TIMES, FAULTS
).filter(lambda row: row.raw[0] in (0xAA, 0x55))
KIND_FRAMES = st.builds(
    lambda kind, end, port: Row(
        port, 0, encode(kind, {field.name: getattr(field, end) for field in kind.fields}), 0
    ),
    st.sampled_from(KINDS),
    st.sampled_from(("low", "high")),
    PORTS,
)
DAMAGE = st.builds(
    Row, PORTS, st.integers(0, 2**40), st.binary(max_size=16), TIMES, FAULTS, st.just(False)
)
ANY_ROW = st.one_of(FRAMES, KIND_FRAMES, DAMAGE)


def short_values(row: Row, width: int = 1000) -> str:
    kind = row.kind if row.framed else None
    parts = [] if kind is None else value_parts(kind, row.raw, width)
    return " ".join(text for text, _field in parts)


def cell_of(row: Row) -> RowCell:
    return RowCell(row, time_ns=row.t_ns)


def look_of(ports: int) -> TableView:
    return TableView(tuple(f"/dev/ttyUSB{number}" for number in range(ports)))


@given(st.text(), st.integers(0, 40))
def test_fitted_text_has_exactly_its_width(text: str, width: int) -> None:
    printable = "".join(c if c.isprintable() else "?" for c in text)
    assert cell_len(fit(printable, width)) == width
    assert cell_len(fit_right(printable, width)) == width
    assert cell_len(fit_path(printable, width)) <= max(width, 0)


def test_a_path_keeps_its_end() -> None:
    assert fit_path("/home/ana/captures/run-7.mcap", 12) == "…/run-7.mcap"
    assert fit_path("run-7.mcap", 12) == "run-7.mcap"


def test_wide_characters_take_two_cells() -> None:
    assert fit("串口一", 7) == "串口一 "
    assert fit("串口一号", 6) == "串口 …"


def test_the_table_has_every_column_of_the_contract_once() -> None:
    assert sorted(ORDER) == sorted([DELTA, *(column.name for column in COLUMNS)])


@pytest.mark.parametrize(
    ("width", "ports", "last"),
    [(79, 1, "raw"), (79, 2, "raw"), (119, 2, "raw"), (139, 1, "faults"), (205, 1, "cmd")],
)
def test_what_fits_without_moving_sideways(width: int, ports: int, last: str) -> None:
    assert layout_for(width, look_of(ports)).end_of(last) <= width


def test_the_port_is_shown_only_where_there_are_several() -> None:
    assert "port" not in {column.name for column in layout_for(80, TableView()).columns}
    assert "port" in {column.name for column in layout_for(80, look_of(2)).columns}


@given(ANY_ROW, st.sampled_from((40, 80, 200)), st.sampled_from((1, 2)))
def test_every_cell_has_its_columns_width(row: Row, width: int, ports: int) -> None:
    values = {**record(row), VALUES: short_values(row), DELTA: row.t_ns}
    for column in layout_for(width, look_of(ports)).columns:
        cell = column.cell(values[column.name])
        assert cell_len(cell) == column.width
        assert cell.isprintable()


@given(
    ANY_ROW,
    st.integers(0, 240),
    st.sampled_from((1, 2)),
    st.integers(0, 16),
    st.sampled_from((DARK, LIGHT)),
)
def test_every_line_fills_the_window_and_has_styles(
    row: Row, width: int, ports: int, hidden: int, palette: Palette
) -> None:
    painter = Painter(layout_for(width, look_of(ports)), palette, width, hidden)
    for strip in (painter.row(cell_of(row), Style.null()), painter.head(Style.null())):
        assert strip.cell_length == width
        assert all(isinstance(segment.style, Style) for segment in strip)
        assert strip.text.isprintable()


def painted(row: Row, width: int, hidden: int = 0) -> str:
    return (
        Painter(layout_for(width, TableView()), DARK, width, hidden)
        .row(cell_of(row), Style.null())
        .text
    )


def test_a_line_at_eighty_cells(speed_rows: Callable[..., list[Row]]) -> None:
    [row] = speed_rows(1, start=1234)
    assert painted(row, 79) == (
        "  12:00:01.234 speed       motor=3 rpm=1234      AA 01 03 04 D2 00 00 00 00 EE "
    )


def test_a_suspect_row_names_its_faults_at_eighty_cells(odd_rows: list[Row]) -> None:
    suspect = next(row for row in odd_rows if row.status is Status.SUSPECT)
    assert painted(suspect, 79) == (
        "? 12:00:00.000 speed       reserved_nonzero M1 1 AA 01 01 00 01 00 00 07 00 EE "
    )
    assert "reserved_nonzero motor=1 rpm=1 " in painted(suspect, 119)
    assert "AA 01 01 00 01 00 00 07 00 EE reserved_nonzero" in painted(suspect, 139)


@pytest.mark.parametrize(
    ("values", "text"),
    [
        ({"motor": 1, "rpm": -5}, "motor=1 rpm=-5"),
        ({"motor": 1, "rpm": 5, "error": 4, "online": 3}, "motor=1 rpm=5 error=04 online=03"),
    ],
)
def test_flags_stand_among_the_values_only_where_they_are_out_of_order(
    values: dict[str, int], text: str
) -> None:
    raw = encode(KIND_BY_NAME["speed_feedback"], values)
    assert short_values(Row("p", 0, raw, None)) == text


@given(KIND_FRAMES)
def test_the_longest_values_fit_where_there_is_room(row: Row) -> None:
    assert short_values(row) in painted(row, 128)


def test_ports_are_distinguished_by_their_ends() -> None:
    names = tuple(f"/home/ana/captures/run-{n}.mcap" for n in (1, 2))
    columns = layout_for(80, TableView(names)).columns
    [port] = [column for column in columns if column.name == "port"]
    assert [port.cell(name) for name in names] == ["run-1.mcap", "run-2.mcap"]


def test_damage_takes_the_place_of_values_where_the_table_is_narrow(odd_rows: list[Row]) -> None:
    damage = odd_rows[3]
    assert painted(damage, 79).rstrip() == (
        "! 12:00:00.000 bad_tail                          AA 01 01 00 01 00 00 00 00 EF"
    )
    wide = painted(damage, 199)
    assert wide.count("AA 01 01 00 01 00 00 00 00 EF") == wide.count("bad_tail") == 1


def test_long_damage_is_shown_by_its_length(odd_rows: list[Row]) -> None:
    assert "1024 bytes" in painted(odd_rows[5], 110)


def test_time_stays_when_columns_are_moved_out(speed_rows: Callable[..., list[Row]]) -> None:
    [row] = speed_rows(1, start=1234)
    assert painted(row, 79, hidden=1).startswith("  12:00:01.234 motor=3 ")
    assert painted(row, 170, hidden=3).startswith("  12:00:01.234 AA 01 03 ")


@pytest.mark.parametrize("width", [30, 40, 60, 80, 119, 160, 240])
def test_damaged_rows_name_their_fault_at_every_width(odd_rows: list[Row], width: int) -> None:
    for row in odd_rows:
        text = painted(row, width).replace("…", "")
        assert any(row.faults[0][:8] in part for part in text.split()), text


def test_the_head_shows_on_which_side_there_are_more_columns() -> None:
    def head(hidden: int) -> str:
        return Painter(layout_for(79, TableView()), DARK, 79, hidden).head(Style.null()).text

    assert head(0).startswith("  time UTC     kind ")
    assert head(0).endswith(">")
    assert head(2).startswith("  time UTC    <raw ")
    last = layout_for(79, TableView()).max_hidden(79)
    assert head(last).rstrip().endswith("cmd")
    assert head(last - 1).endswith(">")


@given(ANY_ROW, st.integers(0, 240), st.integers(0, 6))
def test_a_cell_at_the_edge_is_whole_or_marked_as_cut(row: Row, width: int, hidden: int) -> None:
    seen = layout_for(width, TableView()).without(hidden).within(width)
    assert seen.width <= max(width, 1)
    values = {**record(row), VALUES: short_values(row), DELTA: row.t_ns}
    for column in seen.columns:
        cell, whole = (one.cell(values[column.name]).strip() for one in (column, column.sized(99)))
        assert cell == whole or "…" in cell or column.name in ("time", "kind", VALUES, DELTA)


@pytest.mark.parametrize(
    ("width", "offset"), [(141, ""), (143, "11…"), (145, "11800"), (152, "11800"), (159, "11800")]
)
def test_an_offset_is_never_another_number(width: int, offset: str) -> None:
    row = Row("p", 11800, bytes.fromhex("AA0000000000000000EE"), 1)
    assert painted(row, width)[139:].split()[:1] == offset.split()


@pytest.mark.parametrize(
    ("raw", "sign"),
    [
        ("55010400000000080FEE", "^"),
        ("550104000000000007EE", "^"),
        ("55020400000000000FEE", " "),
        ("AA0204000000000807EE", " "),
    ],
)
def test_a_sound_frame_with_raised_flags_has_a_sign(raw: str, sign: str) -> None:
    row = Row("p", 0, bytes.fromhex(raw), 1)
    assert painted(row, 80)[0] == sign
    assert painted(replace(row, faults=(Fault.RESERVED_NONZERO,)), 80)[0] == "?"
    strip = Painter(layout_for(80, TableView()), DARK, 80).row(cell_of(row), Style.null())
    colours = {
        segment.style.color.name for segment in strip if segment.style and segment.style.color
    }
    assert (DARK.raised.color.name in colours) == (sign == "^")


def test_every_status_that_is_not_in_order_has_a_mark_of_its_own(odd_rows: list[Row]) -> None:
    marks = {row.status: painted(row, 80)[0] for row in odd_rows}
    assert marks == {Status.MALFORMED: "!", Status.SUSPECT: "?"}
    assert len({look.mark for look in LOOKS.values()}) == len(Status)


@pytest.mark.parametrize("palette", [DARK, LIGHT])
def test_every_kind_and_status_has_a_style(palette: Palette) -> None:
    assert set(palette.kinds) == {kind.name for kind in KINDS}
    assert set(palette.statuses) == set(palette.marks) == set(Status)
    styles = [palette.kinds[kind.name] for kind in KINDS]
    assert len(set(styles)) == len(KINDS)


def test_the_clock_is_utc() -> None:
    assert clock_text(1_769_860_800_123_456_789, 9) == "12:00:00.123456789"


def test_a_row_whose_order_is_not_certain_has_a_sign_that_the_pane_explains() -> None:
    row = Row("p", 0, bytes.fromhex("AA0000000000000000EE"), 1, unordered=True)
    assert painted(row, 80)[0] == ORDER_MARK
    assert painted(replace(row, faults=(Fault.AMBIGUOUS,)), 80)[0] == LOOKS[Status.SUSPECT].mark
    assert (
        f"{ORDER_MARK} the order with rows of the other port"
        in detail_text(row, DARK, DetailLayout(80, bit_lines=False)).plain
    )


@pytest.mark.parametrize(
    ("width", "text"),
    [
        (40, "motor=2 rpm=-863 pulses=-863"),
        (23, "M2 rpm=-863 pulses=-863"),
        (22, "M2 r=-863 p=-863"),
        (15, "M2 -863 -863"),
        (3, "M2 -863 -863"),
    ],
)
def test_values_have_the_longest_form_that_fits(width: int, text: str) -> None:
    raw = encode(KIND_BY_NAME["position"], {"motor": 2, "rpm": -863, "pulses": -863})
    assert short_values(Row("p", 0, raw, None), width) == text


@given(KIND_FRAMES, st.integers(0, 60))
def test_values_are_found_in_every_form(row: Row, width: int) -> None:
    assert row.kind is not None
    text = short_values(row, width)
    short = short_kind(row.kind.name, max(width, 11))
    for typed in filter(None, (text, short)):
        assert Search.parse(typed).matches(Rows.of([row])).all()


@pytest.mark.parametrize(
    ("width", "text"),
    [(17, "position_feedback"), (11, "position fb"), (8, "posit fb"), (3, " fb"), (0, "")],
)
def test_a_kind_that_is_cut_is_still_marked_as_feedback(width: int, text: str) -> None:
    assert short_kind("position_feedback", width) == text
    assert short_kind("position", 6) == "posit…"


@pytest.mark.parametrize(
    ("ns", "width", "text"),
    [
        (435_123, 12, "+0.000435"),
        (-1_500_000_000, 12, "-1.500000"),
        (0, 9, "+0.000000"),
        (123_456_000_000, 9, "+123.456"),
        (86_400_000_000_000, 7, "+86400"),
    ],
)
def test_distances_in_time_have_as_many_digits_as_fit(ns: int, width: int, text: str) -> None:
    assert elapsed_text(ns, width) == text


NAMES = st.lists(st.text("ab/_01 :", min_size=1, max_size=20), min_size=1, max_size=5, unique=True)


@given(NAMES, st.integers(3, 14))
def test_short_port_names_fit_and_are_not_alike(names: list[str], width: int) -> None:
    short = short_names(names, width)
    assert list(short) == names
    assert all(cell_len(name) <= width for name in short.values())
    assert len(set(short.values())) == len(names)


@pytest.mark.parametrize(
    ("names", "width", "short"),
    [
        (["/dev/ttyUSB0", "/dev/ttyUSB1"], 12, ["ttyUSB0", "ttyUSB1"]),
        (["/dev/ttyUSB0", "/dev/ttyUSB1"], 4, ["t…B0", "t…B1"]),
        (
            ["/dev/serial/by-id/usb-A-if00", "/dev/serial/by-id/usb-B-if00"],
            9,
            ["…b-A-if00", "…b-B-if00"],
        ),
        (["sim://?seed=1", "sim://?seed=2"], 12, ["seed=1", "seed=2"]),
        (["COM7"], 12, ["COM7"]),
    ],
)
def test_port_names_keep_the_part_that_differs(
    names: list[str], width: int, short: list[str]
) -> None:
    assert list(short_names(names, width).values()) == short


@given(st.integers(0, 10**8), st.integers(1, 80), st.floats(0, 1))
def test_the_scale_of_the_scroll_bar_keeps_ends_and_order(
    count: int, height: int, share: float
) -> None:
    scale = ScrollScale(count, height)
    last = max(0, count - height)
    top = round(share * last)
    assert scale.total <= max(height * 64, 0)
    assert scale.unit_of(0) == scale.row_of(0) == 0
    assert scale.unit_of(last) == max(0, scale.total - height)
    assert scale.row_of(scale.unit_of(last)) == last
    assert 0 <= scale.unit_of(top) <= scale.unit_of(last)
    assert abs(scale.row_of(scale.unit_of(top)) - top) <= last / max(1, scale.total - height) + 1


STEPS = st.lists(
    st.one_of(
        st.tuples(st.just("resize"), st.integers(-1, 30)),
        st.tuples(st.just("come"), st.integers(0, 100)),
        st.tuples(st.just("leave"), st.integers(0, 100)),
        st.tuples(st.just("move"), st.integers(-200, 200)),
        st.tuples(st.just("jump"), st.integers(-5, 500)),
        st.tuples(st.just("scroll"), st.integers(-50, 500)),
        st.tuples(st.just("follow"), st.just(0)),
        st.tuples(st.just("pause"), st.just(0)),
    ),
    max_size=60,
)


def act(view: Viewport, step: tuple[str, int]) -> None:
    name, number = step
    match name:
        case "resize":
            view.resize(number)
        case "come" if view.paused:
            view.refit(view.count, view.cursor, view.waiting + number)
        case "come":
            view.refit(view.count + number, view.cursor, 0)
        case "leave":
            gone = min(number, view.count)
            view.refit(view.count - gone, max(0, view.cursor - gone), view.waiting)
        case "move":
            view.move(number)
        case "jump":
            view.jump(number)
        case "scroll":
            view.scroll(number)
        case "follow":
            view.follow()
            view.refit(view.count + view.waiting, view.cursor, 0)
        case "pause":
            view.paused = not view.paused


@given(STEPS)
def test_window_and_cursor_are_always_on_rows(steps: list[tuple[str, int]]) -> None:
    view = Viewport()
    for step in steps:
        act(view, step)
        assert 0 <= view.top <= view.last_top
        assert 0 <= view.cursor <= max(0, view.count - 1)
        if view.height and view.count:
            assert view.top <= view.cursor < view.top + view.height
        if view.following and not view.paused:
            assert (view.cursor, view.top) == (max(0, view.count - 1), view.last_top)


def window(count: int = 100, height: int = 10) -> Viewport:
    view = Viewport()
    view.resize(height)
    view.refit(count, 0, 0)
    return view


@pytest.mark.parametrize(
    ("steps", "following", "top", "cursor"),
    [
        ([], True, 90, 99),
        ([("come", 50)], True, 140, 149),
        ([("move", -1), ("come", 400)], False, 90, 98),
        ([("move", -3), ("move", 3)], True, 90, 99),
        ([("move", -3), ("follow", 0)], True, 90, 99),
        ([("pause", 0), ("move", -3), ("move", 3)], False, 90, 99),
        # A far jump is in the middle, a near one moves the window no more than it must.
        ([("jump", 20)], False, 15, 20),
        ([("jump", 92)], False, 90, 92),
        # The window moves with the cursor's row when older rows leave.
        ([("jump", 50), ("leave", 20)], False, 25, 30),
        # The wheel takes the cursor along only as far as it must, and ends at the end.
        ([("scroll", 85)], False, 85, 94),
        ([("scroll", 85), ("scroll", 88)], False, 88, 94),
        ([("scroll", 85), ("scroll", 90)], True, 90, 99),
    ],
)
def test_steps_lead_to_a_window(
    steps: list[tuple[str, int]], following: bool, top: int, cursor: int
) -> None:
    view = window()
    for step in steps:
        act(view, step)
    assert (view.following, view.top, view.cursor) == (following, top, cursor)
    assert view.below == view.count - top - view.height


INDICES = st.lists(st.integers(0, 30), max_size=40)


@given(INDICES, st.integers(0, 30), st.integers(0, 30))
def test_marks_are_a_set_that_knows_its_order(toggled: list[int], here: int, first: int) -> None:
    marks, expected, latest = RowMarks(), set[int](), list[int]()
    for index in toggled:
        if marks.pop(index, None) is None:
            marks[index] = ""
        expected ^= {index}
        latest = [*(one for one in latest if one != index), *([index] if index in expected else [])]
    for index in range(31):
        assert (index in marks) == (index in expected)
    assert len(marks) == len(expected)
    assert marks.latest == (latest[-1] if latest else None)
    assert list(marks.beyond(here, 1)) == sorted(one for one in expected if one > here)
    below = sorted((one for one in expected if one < here), reverse=True)
    assert list(marks.beyond(here, -1)) == below
    marks.forget_before(first)
    assert [index in marks for index in range(31)] == [
        index in expected and index >= first for index in range(31)
    ]
    assert marks.latest == next((one for one in reversed(latest) if one >= first), None)
