"""The screen on a terminal behind a slow link."""

from __future__ import annotations

from pathlib import Path
from time import monotonic, sleep

import pytest

from tests.cli.terminals import terminal
from tests.waiting import while_waiting

pytestmark = pytest.mark.terminal

LINK_BYTES_S = 11_520
"""Those of a console of 115200 baud."""

PIECE = 128

ANSWERED_S = 4.0
"""Seconds within which a key has an answer: two for the promise, and as many for a slow machine."""


def test_key_is_answered_on_a_slow_link(environment: dict[str, str], tmp_path: Path) -> None:
    command = ("live", "--no-record", "sim://?seed=1&rate=1100")
    with terminal(environment, tmp_path, *command) as screen:

        def carry(until: str) -> float:
            """Carry output at the rate of the link until it has a text; returns the seconds."""
            start, since_s = len(screen.drawn), monotonic()
            for _ in while_waiting(lambda: f"{until} after {screen.drawn[-500:]!r}"):
                screen.draw(PIECE)
                sleep(PIECE / LINK_BYTES_S)  # the link's rate
                if until.encode() in screen.drawn[start:]:
                    break
            return monotonic() - since_s

        carry("LIVE")
        found = []
        for shown in ("SCROLLED", "LIVE", "SCROLLED"):
            for _ in range(20):
                carry("\x1b")  # rows come
            screen.type(" ")
            found.append(carry(shown))
        screen.type("Q")
        carry("\x1b[?1049l")
    assert min(found) < ANSWERED_S
