"""The screen on a terminal behind a slow link."""

from __future__ import annotations

import signal
from pathlib import Path
from statistics import median
from time import sleep

import pytest

from fte_sniff.tui.terminal import ANSWER, QUERY
from tests.cli.terminals import Terminal, terminal
from tests.waiting import while_waiting

pytestmark = pytest.mark.terminal

LINK_BYTES_S = 20_000
PIECE = 256


class SlowLink:
    """A terminal that is read at the rate of the link, and answers what reaches it."""

    def __init__(self, screen: Terminal) -> None:
        self._screen, self._answered = screen, 0

    def carry(self, *, until: str) -> int:
        """Carry output until it has a text; returns its bytes."""
        start = len(self._screen.drawn)
        for _ in while_waiting(lambda: f"{until} after {self._screen.drawn[-500:]!r}"):
            self._carry_piece()
            if until.encode() in self._screen.drawn[start:]:
                break
        return len(self._screen.drawn) - start

    def carry_frames(self, count: int) -> None:
        """Carry output until the terminal has answered so many queries."""
        wanted = self._answered + count
        for _ in while_waiting(lambda: f"{count} queries"):
            self._carry_piece()
            if self._answered >= wanted:
                break

    def _carry_piece(self) -> None:
        self._screen.draw(PIECE)
        sleep(PIECE / LINK_BYTES_S)  # the link's rate
        asked = self._screen.drawn.count(QUERY.encode())
        self._screen.type(ANSWER * (asked - self._answered))
        self._answered = asked


def test_key_is_drawn_before_a_second_of_output_on_a_slow_link(
    environment: dict[str, str], tmp_path: Path
) -> None:
    command = ("live", "--no-record", "sim://?seed=1&rate=1100")
    with terminal(environment, tmp_path, *command) as screen:
        link = SlowLink(screen)
        link.carry(until="LIVE")
        link.carry_frames(5)
        found = []
        for _ in range(2):
            for shown in ("PAUSED", "LIVE"):
                screen.type(" ")
                found.append(link.carry(until=shown))
                link.carry_frames(2)
        screen.process.send_signal(signal.SIGTERM)
        screen.ended()
    assert median(found) < LINK_BYTES_S
    assert QUERY.encode() not in screen.drawn[screen.drawn.rfind(b"\x1b[?1049l") :]
