"""Which widget has the focus: after every key of the key table, in every mode, also typed ahead."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Sequence
from itertools import product
from operator import attrgetter
from pathlib import Path
from typing import Any, Final

import pytest
from textual import events
from textual.actions import parse
from textual.pilot import Pilot
from textual.widget import Widget

from docs.picture import idle
from fte_sniff.protocol import Fault, Row
from fte_sniff.tui.app import SniffApp
from fte_sniff.tui.commands import COMMANDS, OPENING
from fte_sniff.tui.panes.top import TopView
from fte_sniff.tui.prompt import PromptField, PromptLine
from fte_sniff.tui.table import RowTable
from tests.slow import first
from tests.tui.conftest import NOON_NS, _speed_rows, play, press, rush, settle

BINDINGS: Final = (*COMMANDS.values(), OPENING)

KEYS: Final = sorted({key for one in BINDINGS for key in one.key.split(",") if key})
"""Every key of the table of commands."""

FIELDS: Final = {
    "f": attrgetter("filters"),
    "slash": attrgetter("search"),
    "colon": attrgetter("goto"),
    "number_sign": attrgetter("notes"),
    "w": attrgetter("export"),
}
"""Keys that open a field."""

LEAVING: Final = ("enter", "escape", "ctrl+c")
"""Keys that leave an open field."""

PAGES: Final = ("question_mark", "ctrl+p", "C", "x", "X")
"""Keys that open a page."""

FEW: Final = (
    *(*FIELDS, *PAGES, "T", "M", "S", "e", "n", "m", "space", "down"),
    *("enter", "escape", "q", "ctrl+c", "ctrl+t"),
)
"""Keys of each kind: of fields, pages, views, panes, rows, modes and the end."""

ABOUT_ROWS: Final = (
    *("e", "E", "a", "A", "slash", "n", "N", "x", "X", "m", "number_sign", "u", "U", "o", "O"),
    *("colon", "v", "y", "Y", "c", "t", "d", "C", "i", "b", "R"),
    *("right_square_bracket", "left_square_bracket"),
    *("right_curly_bracket", "left_curly_bracket"),
)
"""Keys that bring the table back in place of the top view."""

VIEWS: Final = (
    ("table", "detail"),
    ("top", ""),
    *(("table", pane) for pane in ("", "bytes", "motors", "statistics")),
    *(("top", pane) for pane in ("motors", "statistics")),
)
"""The view and the open pane."""


def view_after(view: str, pane: str, key: str) -> str:
    """The view that a key leads to."""
    if view == "table":
        return "top" if key == "T" else "table"
    leaves = key in ("T", "enter", *ABOUT_ROWS) or (key == "escape" and not pane)
    return "table" if leaves else "top"


def view_of(app: SniffApp, view: str) -> Widget:
    return app.query_one(TopView if view == "top" else RowTable)


def line_of(app: SniffApp, key: str) -> PromptLine:
    """The line of the field that a key opens."""
    field: PromptField = FIELDS[key](app)
    return field.line


def has_focus(app: SniffApp, wanted: Widget, pages: int = 0) -> str:
    """What is wrong; empty where `wanted` alone can have the focus, and has it."""
    screen = app.screen_stack[0]
    able = [widget for widget in screen.query("*").results(Widget) if widget.can_focus]
    if screen.focused is not wanted or able != [wanted]:
        return f"{screen.focused} has the focus, {able} can have it, and not {wanted}"
    return "" if len(app.screen_stack) == 1 + pages else f"{app.screen_stack} is open"


def expected(app: SniffApp, view: str, pane: str, key: str) -> tuple[Widget, int]:
    """The widget that has the focus after a key, and the number of open pages."""
    if key in FIELDS:
        return line_of(app, key), 0
    return view_of(app, view_after(view, pane, key)), int(key in PAGES)


async def begin(app: SniffApp, view: str, pane: str = "") -> None:
    """Go to a view and a pane, with nothing else open and no filter, unless they are there."""
    panes = [app._panes.open.NAME] if app._panes.open else []
    if not has_focus(app, view_of(app, view)) and panes == ([pane] if pane else []):
        return
    while len(app.screen_stack) > 1:
        app.screen.dismiss(None)
        await idle(app)
    for field in app.query(PromptField):
        field.close()
    app.workers.cancel_all()
    app.export.job = None
    app.filters.accept("")
    app._table.set_search(None)
    app._table.selection_start = None
    app.playback.stop()
    app._panes.close()
    app._focus.show_top(view == "top")
    if pane:
        app._panes.action_switch(pane)
    await idle(app)


Check = Callable[[SniffApp, Pilot[None]], Awaitable[None]]


def on_rows(feed: Any, check: Check, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Run a check on a screen that stays open, over rows with a fault."""
    monkeypatch.chdir(folder)

    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        rows = _speed_rows(8)
        feed.give(
            [*rows, Row("/dev/ttyUSB0", 80, b"\x01", NOON_NS + 8, (Fault.NOISE,), framed=False)]
        )
        feed.give(_speed_rows(16, start=9))
        await settle(app, pilot)
        # A key typed ahead of the first drawing of the top view finds no line in it.
        await begin(app, "top")
        monkeypatch.setattr(app, "exit", lambda *_args, **_kwargs: None)
        await check(app, pilot)

    play(feed, scenario)


def test_every_command_has_an_owner_with_its_method(feed: Any) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        for run in COMMANDS:
            owner, name, _parameters = parse(run)
            assert callable(getattr(app._owners[owner], f"action_{name}", None)), run

    play(feed, scenario)


@pytest.mark.parametrize(("view", "pane"), first(2, VIEWS))
def test_every_key_leads_to_its_widget(
    feed: Any, view: str, pane: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def check(app: SniffApp, pilot: Pilot[None]) -> None:
        wrong = {}
        for key in KEYS:
            await begin(app, view, pane)
            await press(app, pilot, key)
            wrong[key] = has_focus(app, *expected(app, view, pane, key))
        assert {key: text for key, text in wrong.items() if text} == {}

    on_rows(feed, check, tmp_path, monkeypatch)


@pytest.mark.parametrize(
    ("ahead", "view", "keys"),
    first(
        1,
        [
            (("T", "f", "escape"), "top", FEW),
            (("T", "f", "escape"), "top", KEYS),
            (("T",), "top", KEYS),
            (("slash", "escape"), "table", KEYS),
            (("T", "slash", "enter"), "table", KEYS),
            (("T", "enter"), "table", KEYS),
        ],
    ),
)
def test_every_key_typed_ahead_leads_to_its_widget(
    feed: Any,
    ahead: tuple[str, ...],
    view: str,
    keys: Sequence[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    async def check(app: SniffApp, pilot: Pilot[None]) -> None:
        wrong = {}
        for key in keys:
            await begin(app, "table")
            await rush(app, pilot, *ahead, key)
            wrong[key] = has_focus(app, *expected(app, view, "", key))
        assert {key: text for key, text in wrong.items() if text} == {}

    on_rows(feed, check, tmp_path, monkeypatch)


@pytest.mark.parametrize(("opener", "view"), first(1, product(FIELDS, ("top", "table"))))
def test_every_key_but_three_stays_in_an_open_field(
    feed: Any, opener: str, view: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Typed ahead: the field is not on the screen yet when the key comes."""

    async def check(app: SniffApp, pilot: Pilot[None]) -> None:
        wrong = {}
        for key in KEYS:
            if not line_of(app, opener).can_focus or key in LEAVING:
                await begin(app, view)
                await rush(app, pilot, opener, key)
            else:
                await press(app, pilot, key)
            left = key in LEAVING
            back = view_of(app, view_after(view, "", opener))
            wrong[key] = has_focus(app, back if left else line_of(app, opener))
        assert {key: text for key, text in wrong.items() if text} == {}

    on_rows(feed, check, tmp_path, monkeypatch)


@pytest.mark.parametrize(("opener", "view"), first(1, product(PAGES, ("table", "top"))))
def test_no_key_of_a_page_moves_the_focus_behind_it(
    feed: Any, opener: str, view: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def check(app: SniffApp, pilot: Pilot[None]) -> None:
        wrong = {}
        for key in KEYS:
            if len(app.screen_stack) == 1 or key == "enter":
                await begin(app, view)
                await rush(app, pilot, opener, key)
            else:
                await press(app, pilot, key)
            back: Widget = view_of(app, view_after(view, "", opener))
            if (opener, key) == ("ctrl+p", "enter"):
                back = line_of(app, "f")  # the first command of the list
            wrong[key] = has_focus(app, back, len(app.screen_stack) - 1)
        assert {key: text for key, text in wrong.items() if text} == {}

    on_rows(feed, check, tmp_path, monkeypatch)


def test_a_line_typed_in_the_top_view_is_text_and_no_command(
    feed: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def check(app: SniffApp, pilot: Pilot[None]) -> None:
        for opener, send in product(("slash", "colon"), (press, rush)):
            await begin(app, "top")
            await send(app, pilot, opener, *"mum")
            assert line_of(app, opener).value == "mum"
            assert not app._table.marks

    on_rows(feed, check, tmp_path, monkeypatch)


def test_clicks_tab_and_the_window_leave_the_focus_where_it_is(
    feed: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def check(app: SniffApp, pilot: Pilot[None]) -> None:
        for view in ("table", "top"):
            await begin(app, view, "motors")
            widget = view_of(app, view)
            for target in ("TitleLine", "StatusLine", "MotorsPane", type(widget)):
                await pilot.click(target, offset=(1, 1) if target == "MotorsPane" else (60, 0))
                await press(app, pilot, "escape" if len(app.screen_stack) > 1 else "tab")
                for field in app.query(PromptField):
                    field.close()
                app.post_message(events.AppBlur())
                await settle(app, pilot)
                app.post_message(events.AppFocus())
                await press(app, pilot, "shift+tab")
                assert not has_focus(app, widget), target

    on_rows(feed, check, tmp_path, monkeypatch)


def test_a_click_on_a_field_at_rest_leaves_the_open_one(
    feed: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def check(app: SniffApp, pilot: Pilot[None]) -> None:
        app.filters.accept("motor = 1")
        await press(app, pilot, "slash", *"AA")
        await pilot.click("FilterField .asked", offset=(30, 0))
        assert not has_focus(app, line_of(app, "f"))
        assert not app.search.display

    on_rows(feed, check, tmp_path, monkeypatch)
