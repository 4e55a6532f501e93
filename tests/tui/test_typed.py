"""Keys that are typed ahead do what they do when they are typed slowly."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence

from hypothesis import HealthCheck, given
from hypothesis import strategies as st

from fte_sniff.tui.app import SniffApp
from tests.examples import examples
from tests.tui.conftest import CHARACTERS, ListFeed, lines, noise, play, press, settle, speed_rows
from tests.waiting import BOUND_S

KEYS = (
    *("f", "slash", "colon", "C", "x", "number_sign", "m", "enter", "escape", "backspace", "tab"),
    *("M", "T", "i", "exclamation_mark", "question_mark", "1", "e", "n", "space", "d", "v", "F"),
    *("up", "down", "G", "g", "right", "J", "t", "right_square_bracket", "space", "z", "a", "w"),
)
"""Keys that open and close lines, pages, and panes, and keys that mean something in several."""


def shown_after(keys: Sequence[str], *, at_once: bool) -> tuple[list[str], object]:
    """What is on the screen after some keys, without what depends on the time."""
    found: list[str] = []
    feed = ListFeed(live=False)
    feed.give([*speed_rows(40), noise(40, 400), *speed_rows(40, 41)])
    feed.end()

    async def scenario(app: SniffApp) -> None:
        # A file with findings opens with them, once they were looked for.
        async with asyncio.timeout(BOUND_S):
            while app._searched != app.view.store.known:
                await asyncio.sleep(0.02)
        await app.workers.wait_for_complete()
        await settle(app)
        for some in [" ".join(keys)] if at_once else keys:
            if app.is_running:
                await press(app, some)
        if app.is_running:
            found.extend(lines(app))

    app = play(feed, scenario)
    return found, (app.filters.current, app.table.viewport.cursor, app.pane.page is None)


@examples(14, suppress_health_check=list(HealthCheck))
@given(st.lists(st.sampled_from(KEYS), min_size=2, max_size=9))
def test_keys_at_once_do_what_they_do_slowly(keys: list[str]) -> None:
    assert shown_after(keys, at_once=True) == shown_after(keys, at_once=False)


def test_a_line_that_is_typed_ahead_arrives_whole(feed: ListFeed) -> None:
    feed.give(speed_rows(40))

    async def scenario(app: SniffApp) -> None:
        for keys, filtered in (
            ("C enter f 'motor = 1' enter", "motor = 1"),
            ("question_mark escape f 'motor = 1' enter", "motor = 1"),
            ("f 'motor = 2' enter f ctrl+u 'motor = 3' enter M", "motor = 3"),
            ("slash 'speed' enter f 'motor = 4' enter", "motor = 4"),
            ("f 'moter' enter ctrl+u 'motor = 1' enter", "motor = 1"),
            ("ctrl+p escape f 'motor = 1' enter", "motor = 1"),
            ("f 'motor = 1' enter F f 'motor = 2' escape", ""),
        ):
            await press(app, keys)
            assert app.filters.current == filtered, keys
            await press(app, "escape escape F")

    play(feed, scenario)


def test_characters_of_the_tests_are_those_of_the_keys() -> None:
    assert all(len(character) == 1 for character in CHARACTERS.values())
