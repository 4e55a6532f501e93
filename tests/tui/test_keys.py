"""Every key in every mode, the focus, the footer, and the help."""

from __future__ import annotations

import pytest
from textual.pilot import Pilot
from textual.widget import Widget
from textual.widgets import Footer

from fte_sniff.i18n import set_language
from fte_sniff.tui.app import SniffApp
from fte_sniff.tui.commands import COMMANDS, SECTIONS
from fte_sniff.tui.help import PAGES, help_text
from fte_sniff.tui.pages import text_of
from tests.slow import crossed
from tests.tui.conftest import (
    ListFeed,
    lines,
    noise,
    page,
    play,
    press,
    settle,
    speed_rows,
    talk,
    until,
)

ENDING = {"q", "Q", "ctrl+z", "ctrl+c"}
KEYS = sorted({key for one in COMMANDS.values() for key in one.keys.split(",") if key} - ENDING)
MODES = ("M", "f", "", "T", "i", "exclamation_mark", "question_mark", "space", "tab", "v", "x", "C")


PARTS = len(MODES)
"""Into which the keys are divided, as all of them take longer than a test may on a busy machine."""


@pytest.mark.parametrize(("mode", "part"), crossed(MODES, range(PARTS)))
def test_every_key_in_every_mode_leaves_the_keys_with_one_part(
    feed: ListFeed, mode: str, part: int
) -> None:
    feed.give([*speed_rows(20), noise(20, 200)])

    async def scenario(app: SniffApp) -> None:
        for key in KEYS[part::PARTS]:
            await press(app, f"{mode} {key}")
            focused = app.screen_stack[0].focused
            if app.line.question is not None:
                assert focused is app.line.input, key
            else:
                assert focused in (app.table, app.strip, app.pane), key
            await press(app, "escape escape escape")
            assert (app.line.question, len(app.screen_stack)) == (None, 1), key

    play(feed, scenario)


def test_no_key_fails_without_rows(feed: ListFeed) -> None:
    async def scenario(app: SniffApp) -> None:
        await press(app, " ".join(f"{key} escape" for key in KEYS))
        assert "nothing came yet" in page(app)

    play(feed, scenario)


def test_tab_goes_from_motors_to_table_to_pane(feed: ListFeed) -> None:
    feed.give(talk(2))

    async def scenario(app: SniffApp) -> None:
        await press(app, "M")
        order = []
        for _ in range(4):
            order.append(app.focused)
            await press(app, "tab")
        assert order == [app.table, app.pane, app.strip, app.table]
        await press(app, "escape")
        assert app.focused is not app.pane

    play(feed, scenario)


def test_enter_on_a_motor_filters(feed: ListFeed) -> None:
    feed.give(talk(2))

    async def scenario(app: SniffApp) -> None:
        await press(app, "tab down down enter")
        assert app.filters.current == "motor = 3"

    play(feed, scenario)


def test_the_footer_has_only_keys_that_work(feed: ListFeed) -> None:
    async def scenario(app: SniffApp) -> None:
        def footer() -> str:
            return lines(app)[app.query_one(Footer).region.y]

        await until(app, "Filter")
        assert "Fault" not in footer()
        feed.give(speed_rows(9))
        await press(app, "")
        assert "Fault" not in footer()
        await press(app, "e")
        await until(app, "not now: the next row with a fault")
        feed.give([noise(9, 1)])
        await press(app, "")
        await until(app, "e Fault")
        assert "Next" not in footer()
        await press(app, "slash 'speed' enter")
        await until(app, "n Next")
        await press(app, "f")
        await until(app, "^s Save")
        assert "Quit" not in footer()

    play(feed, scenario, (140, 24))


@pytest.mark.parametrize("width", [40, 60, 80])
def test_no_key_in_the_footer_is_cut(feed: ListFeed, width: int) -> None:
    feed.give([*speed_rows(9), noise(9, 1)])
    shorts = tuple(one.short for one in COMMANDS.values() if one.short)

    async def scenario(app: SniffApp) -> None:
        for keys in ("", "f 'motor = 1' enter", "slash 'speed' enter", "F g"):
            await press(app, keys)
            await settle(app)
            footer = lines(app)[app.query_one(Footer).region.y]
            assert footer.endswith(shorts), footer
            assert len(footer) > width - 20

    play(feed, scenario, (width, 24))


async def click(app: SniffApp, widget: Widget, at: tuple[int, int], times: int) -> None:
    await Pilot(app).click(widget, offset=at, times=times)
    await settle(app)


def test_a_double_click_does_what_enter_does(feed: ListFeed) -> None:
    feed.give(talk(2))

    async def scenario(app: SniffApp) -> None:
        await click(app, app.strip, (5, 2), 2)
        assert app.filters.current == "motor = 3"
        await click(app, app.table, (5, 2), 2)
        assert "the row, byte by byte" in page(app)
        await press(app, "F T")
        await click(app, app.pane, (5, 3), 1)
        assert app.focused is app.pane
        await click(app, app.pane, (5, 3), 2)
        assert "kind = 'speed' AND motor = 2" in app.filters.current

    play(feed, scenario, (100, 40))


def test_a_click_on_the_rows_leaves_the_line(feed: ListFeed) -> None:
    feed.give(talk(2))

    async def scenario(app: SniffApp) -> None:
        await press(app, "f 'mo'")
        await click(app, app.table, (5, 2), 1)
        assert (app.line.question, app.focused) == (None, app.table)

    play(feed, scenario)


def test_help_has_all_keys_and_fits() -> None:
    set_language("en")
    for width in (40, 76, 100):
        text = text_of(help_text(0), width=width).plain
        assert max(map(len, text.splitlines())) <= width
    for _heading, commands in SECTIONS:
        for command in commands:
            assert " ".join(command.meaning.split()) in " ".join(text.split())
    assert len(PAGES) == 2


def test_help_turns_to_the_filters_and_back(feed: ListFeed) -> None:
    async def scenario(app: SniffApp) -> None:
        await press(app, "question_mark")
        assert "Keys and signs" in page(app)
        await press(app, "tab")
        assert "motor = 1 AND" in page(app)
        await press(app, "escape f")
        assert app.line.question is not None

    play(feed, scenario)


def test_a_second_q_stops_a_recording(feed: ListFeed) -> None:
    async def scenario(app: SniffApp) -> None:
        await press(app, "q")
        assert "press q or ^c again" in page(app)
        await press(app, "down")
        assert "press q" not in page(app)
        assert app.is_running
        await press(app, "q q")

    assert play(feed, scenario).return_code == 0
