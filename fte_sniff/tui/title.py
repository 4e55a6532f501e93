"""Owns the top line: what is watched, where it is kept, and the state of the view.

It must not know rows.
"""

from __future__ import annotations

from enum import StrEnum

from rich.cells import cell_len
from rich.text import Text
from textual.widget import Widget

from fte_sniff.analysis.feed import FeedState
from fte_sniff.errors import shown
from fte_sniff.tui.fitting import fit, fit_path
from fte_sniff.tui.language import _

NAME = "fte-sniff"


class Mode(StrEnum):
    """The word for what the view does, in English."""

    LOADING = "LOADING"
    LIVE = "LIVE"
    WAITING = "WAITING"
    SCROLLED = "SCROLLED"
    PAUSED = "PAUSED"
    ENDED = "ENDED"
    FILE = "FILE"


def mode_of(state: FeedState, paused: bool, following: bool) -> Mode:
    """The mode of a view on such a feed; LIVE is said only while the newest rows are in view.

    WAITING is said instead while a port is lost.
    """
    if paused:
        return Mode.PAUSED
    if state.live and state.running:
        newest = Mode.WAITING if state.waiting else Mode.LIVE
        return newest if following else Mode.SCROLLED
    if state.live:
        return Mode.ENDED
    return Mode.LOADING if state.running else Mode.FILE


def badge_text(state: FeedState, mode: Mode, unseen: int) -> str:
    """The state at the line's end."""
    words = _(mode)
    if mode is Mode.PAUSED:
        words = _("PAUSED, {count:,} new").format(count=unseen)
    elif mode is Mode.SCROLLED:
        words = _("SCROLLED +{count:,}").format(count=unseen)
    elif mode is Mode.LOADING and state.progress is not None:
        words = _("LOADING {share:4.0%}").format(share=state.progress)
    return f" {words} "


def title_text(state: FeedState, mode: Mode, unseen: int, width: int) -> str:
    """The line in exactly `width` cells; names are cut before the state is.

    `unseen` is the number of rows that came since a pause, or are below the window.
    """
    badge = badge_text(state, mode, unseen)
    room = max(0, width - cell_len(badge))
    names = f" {shown(state.title)}"
    if cell_len(names) + cell_len(NAME) + 2 < room:
        names = f" {NAME} {names}"
    if state.recording is not None:
        lead = "  " + _("rec") + " "
        rest = room - cell_len(names) - cell_len(lead) - 1
        path = shown(state.recording)
        shortest = min(cell_len(path), 16)
        if rest < shortest:
            names = fit(names, max(0, room - cell_len(lead) - 1 - shortest)).rstrip()
            rest = room - cell_len(names) - cell_len(lead) - 1
        names += f"{lead}{fit_path(path, rest)}"
    return fit(names, room) + badge


class TitleLine(Widget):
    """The top line."""

    def __init__(self) -> None:
        super().__init__()
        self._shown: tuple[FeedState, Mode, int] | None = None
        self._line = ""

    def show(self, state: FeedState, mode: Mode, unseen: int) -> None:
        """Draw this, if it is not what is drawn."""
        self._shown = (state, mode, unseen)
        line = title_text(state, mode, unseen, self.size.width)
        if line != self._line:
            self._line = line
            self.set_class(mode is Mode.PAUSED, "-paused")
            self.set_class(mode in (Mode.ENDED, Mode.WAITING), "-ended")
            self.refresh()

    def render(self) -> Text:
        """The line, with the state set off at its end."""
        if self._shown is None:
            return Text()
        state, mode, unseen = self._shown
        line = title_text(state, mode, unseen, self.size.width)
        text = Text(line, no_wrap=True, overflow="crop")
        text.stylize("bold reverse", max(0, len(line) - len(badge_text(state, mode, unseen))))
        return text
