"""When the screen looks: the clock leaves out what the feed brought about, and keys come first."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fte_sniff.tui import view_model as rhythm
from fte_sniff.tui.view_model import PollInterval
from tests.tui.conftest import ListFeed


class Resting(ListFeed):
    """A feed that can be asked to rest."""

    rests = 0

    def rest(self) -> None:
        self.rests += 1


@given(st.lists(st.booleans()))
def test_a_strike_of_the_clock_is_left_out_behind_a_wake(wakes: list[bool]) -> None:
    looks = PollInterval(ListFeed())
    for woken in wakes:
        if woken:
            looks.woken()
        assert looks.strike() is not woken


@pytest.mark.parametrize(("keys_ns", "come"), [(0, False), (3_600_000_000_000, True)])
def test_a_key_holds_for_a_while_and_lets_the_feed_rest(
    monkeypatch: pytest.MonkeyPatch, keys_ns: int, come: bool
) -> None:
    monkeypatch.setattr(rhythm, "KEYS_NS", keys_ns)
    feed = Resting()
    looks = PollInterval(feed)
    assert not looks.keys_come
    looks.key()
    assert looks.keys_come is come
    assert feed.rests == 1


def test_a_feed_that_cannot_wake_nor_rest_is_looked_at_by_the_clock() -> None:
    looks = PollInterval(ListFeed())
    looks.listen(pytest.fail)
    looks.key()
    looks.end()
    assert looks.strike()
