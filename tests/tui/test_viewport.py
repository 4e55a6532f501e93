"""The window onto the rows, without a screen."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fte_sniff.tui.table.viewport import Viewport

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


def test_follows_from_the_start() -> None:
    view = window()
    assert (view.top, view.cursor, view.below) == (90, 99, 0)
    view.refit(150, view.cursor, 0)
    assert (view.top, view.cursor) == (140, 149)


def test_up_leaves_the_end_and_rows_that_come_do_not_move_the_window() -> None:
    view = window()
    view.move(-1)
    view.refit(500, view.cursor, 0)
    assert (view.following, view.top, view.cursor, view.below) == (False, 90, 98, 400)


@pytest.mark.parametrize("way", ["down", "wheel", "follow"])
def test_the_end_is_followed_again(way: str) -> None:
    view = window()
    view.move(-3)
    if way == "down":
        view.move(3)
    elif way == "wheel":
        view.scroll(80)
        assert not view.following
        view.scroll(90)
    else:
        view.follow()
    assert view.following


def test_a_paused_view_is_not_followed_by_moving_down() -> None:
    view = window()
    view.paused = True
    view.move(-3)
    view.move(3)
    assert not view.following


def test_the_window_moves_with_the_cursors_row_when_older_rows_leave() -> None:
    view = window()
    view.jump(50)
    offset = view.cursor - view.top
    view.refit(80, 30, 0)
    assert (view.cursor, view.cursor - view.top) == (30, offset)


def test_a_far_jump_stands_in_the_middle() -> None:
    view = window()
    view.jump(20)
    assert (view.top, view.cursor) == (15, 20)


def test_a_near_jump_moves_the_window_no_more_than_it_must() -> None:
    view = window()
    view.jump(92)
    assert (view.top, view.cursor) == (90, 92)


def test_the_wheel_takes_the_cursor_along_only_as_far_as_it_must() -> None:
    view = window()
    view.scroll(85)
    assert (view.top, view.cursor) == (85, 94)
    view.scroll(88)
    assert (view.top, view.cursor) == (88, 94)
