"""The screen on a terminal behind a slow link."""

from __future__ import annotations

from pathlib import Path
from time import sleep

import pytest

from tests.cli.terminals import terminal
from tests.waiting import while_waiting

pytestmark = pytest.mark.terminal

LINK_BYTES_S = 11_520
"""Those of a console of 115200 baud."""

PIECE = 128

ANSWERED_BYTES = 3 * LINK_BYTES_S // 2
"""Most bytes until a key has an answer: those of three quarters of the two seconds."""

ANSWERS = (
    (" ", "SCROLLED"),
    (" ", "LIVE"),
    ("?", "Keys and signs"),
    ("\x1b", "LIVE"),
    ("k", "SCROLLED"),
    ("G", "LIVE"),
    ("f", " filter "),
    ("\x1b", "Streams"),
)
"""Keys, and what answers them."""


def test_key_is_answered_on_a_slow_link(environment: dict[str, str], tmp_path: Path) -> None:
    command = ("live", "--no-record", "sim://?seed=1&rate=1100")
    with terminal(environment, tmp_path, *command) as screen:

        def carry(until: str) -> int:
            """Carry output at the rate of the link until it has a text; returns the bytes."""
            start = len(screen.drawn)
            for _ in while_waiting(lambda: f"{until} after {screen.drawn[-500:]!r}"):
                screen.draw(PIECE)
                sleep(PIECE / LINK_BYTES_S)  # the link's rate
                if until.encode() in screen.drawn[start:]:
                    break
            return len(screen.drawn) - start

        carry("LIVE")
        found = dict.fromkeys(ANSWERS, 2 * ANSWERED_BYTES)
        for key, shown in ANSWERS * 2:  # a slow machine may delay one
            for _ in range(20):
                carry("\x1b")  # rows come
            screen.type(key)
            found[key, shown] = min(found[key, shown], carry(shown))
        screen.type("Q")
        carry("\x1b[?1049l")
    assert max(found.values()) < ANSWERED_BYTES, found
