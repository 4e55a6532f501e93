"""Owns the line that tells what last happened to a port, or why the rows ended.

It must not know how such things are found out.
"""

from __future__ import annotations

from rich.text import Text
from textual.timer import Timer
from textual.widgets import Static

from fte_sniff.errors import shown
from fte_sniff.protocol import PortEvent, PortEventKind
from fte_sniff.tui.language import _
from fte_sniff.tui.table.cells import clock_text

GOOD = frozenset(
    {
        PortEventKind.OPENED,
        PortEventKind.FOUND_AGAIN,
        PortEventKind.CLOSED,
        PortEventKind.BAUD_CHANGED,
    }
)
"""Events that are no cause for worry."""

SHOWN_S = 8.0
"""How long a notice stays that is no cause for worry."""

_MILLISECONDS = 3


def event_text(event: PortEvent) -> str:
    """The event in one line."""
    when = clock_text(event.t_ns, _MILLISECONDS)
    what = f"{event.port} {_(event_words(event.kind))}"
    return shown(f"{when}  {what}: {event.detail}" if event.detail else f"{when}  {what}")


def event_words(kind: PortEventKind) -> str:
    """What happened, in English."""
    return kind.replace("_", " ")


class NoticeLine(Static):
    """One line, shown only while there is something to tell."""

    def __init__(self) -> None:
        super().__init__()
        self.display = False
        self._clock: Timer | None = None

    def tell(self, words: str, worry: bool) -> None:
        """Show the words: for a while, and what is cause for worry until it is put away."""
        self._stop_clock()
        self.set_class(worry, "-worry")
        self.update(Text(f"{'!' if worry else 'i'} {words}", no_wrap=True, overflow="ellipsis"))
        self.display = True
        if not worry:
            self._clock = self.set_timer(SHOWN_S, self.put_away)

    def tell_progress(self, words: str) -> None:
        """Show how far something is, until something else is told."""
        self.tell(words, worry=False)
        self._stop_clock()

    def tell_event(self, event: PortEvent) -> None:
        """Show a port event."""
        self.tell(event_text(event), event.kind not in GOOD)

    def put_away(self) -> None:
        """Show nothing."""
        self._stop_clock()
        self.display = False

    def _stop_clock(self) -> None:
        if self._clock is not None:
            self._clock.stop()
            self._clock = None
