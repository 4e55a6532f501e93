"""The lines of text above and below the rows: title, and status with the news."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from datetime import UTC, timedelta, tzinfo
from enum import StrEnum
from itertools import accumulate, islice
from typing import Any, Final

from rich.cells import cell_len
from rich.style import Style
from rich.text import Text
from textual.app import ComposeResult
from textual.binding import Binding
from textual.screen import Screen
from textual.timer import Timer
from textual.widgets import Footer, Static

from fte_sniff.analysis.feed import FeedState
from fte_sniff.errors import printable, size_text
from fte_sniff.formats.cell_text import fit, fit_path
from fte_sniff.i18n import _
from fte_sniff.protocol.items import PortEvent, PortEventKind
from fte_sniff.tui.cells import event_text

NAME: Final = "fte-sniff"

WIDE: Final = 72
"""Cells from which on the title has the time and the size of a recording."""

MIN_NAMES: Final = 14
"""Cells that the path and the names have at least, where they are that long."""


class Mode(StrEnum):
    """What the view does, as an English word."""

    LOADING = "LOADING"
    LIVE = "LIVE"
    FOLLOWING = "FOLLOWING"
    WAITING = "WAITING"
    SCROLLED = "SCROLLED"
    ENDED = "ENDED"
    FILE = "FILE"


def mode_of(state: FeedState, *, at_end: bool) -> Mode:
    """The mode: LIVE only while the end is followed; WAITING for a lost port.

    FOLLOWING is LIVE for the recording of another program.
    """
    if state.live and state.running:
        if not at_end:
            return Mode.SCROLLED
        newest = Mode.WAITING if state.waiting else Mode.LIVE
        return Mode.FOLLOWING if state.follows else newest
    if state.live:
        return Mode.ENDED
    return Mode.LOADING if state.running else Mode.FILE


def badge_text(state: FeedState, mode: Mode, unseen: int) -> str:
    """The mode at the end of the title; `unseen` rows are below."""
    words = _(mode)
    if mode is Mode.SCROLLED:
        words = _("SCROLLED +{count:,}", count=unseen)
    elif mode is Mode.LOADING and state.progress is not None:
        words = _("LOADING {share:4.0%}", share=state.progress)
    return f" {words} "


_RECORDING: Final = Style(color="#ffffff", bgcolor="#c01020", bold=True)
_STOPPED: Final = Style(color="#ffffff", bgcolor="#b84a00", bold=True)


def recording_text(state: FeedState, elapsed_s: float, *, short: bool = False) -> Text:
    """Whether rows are recorded, for how long, and how large the files are; empty for files."""
    if not state.live or state.follows:
        return Text()
    if state.recording is None:
        if state.files and state.running:
            return Text(f" ✗ {_('NOT RECORDING')} ", _STOPPED)
        return Text(f" ○ {_('not recording') if state.running else _('not recorded')} ")
    words = f" ● {_('REC')}" if state.running else f" ■ {_('recorded')}"
    if not short:
        span = timedelta(seconds=int(elapsed_s))
        # As wide as the widest, so that the title does not move each time.
        words += f" {span}  {size_text(state.recorded_bytes):<7}"
    return Text(f"{words} ", _RECORDING if state.running else "")


def title_text(state: FeedState, badge: str, width: int, elapsed_s: float = 0) -> Text:
    """Names, recording with its path, and mode in `width` cells; the path is cut first."""
    recording = recording_text(state, elapsed_s, short=width < WIDE)
    recording.truncate(max(0, width - cell_len(badge)))
    left = max(0, width - cell_len(badge) - recording.cell_len)
    path = f" {printable(state.recording)}" if state.recording is not None else ""
    names = f" {printable(state.title)}  "
    if cell_len(f"{NAME} {names}{path}") < left:
        names = f" {NAME} {names}"
    if cell_len(names) + min(cell_len(path), MIN_NAMES) > left:
        names = fit(names, max(0, left - min(cell_len(path), MIN_NAMES)))
    left -= cell_len(names)
    text = Text.assemble(names, recording, fit(fit_path(path, left), left), (badge, "bold reverse"))
    text.no_wrap, text.overflow = True, "crop"
    return text


class TitleLine(Static):
    """The line at the top."""

    def show(self, state: FeedState, badge: str, elapsed_s: float) -> None:
        """Show a state."""
        line = title_text(state, badge, self.size.width, int(elapsed_s))
        if line != self.content:
            self.update(line, layout=False)


LINE: Final = "line"
"""Topic of what continues the line that is typed, before which warnings wait."""

INFO_S: Final = 8.0
"""How long an answer stays where no key is pressed, seconds."""


class StatusLine(Static):
    """One line: the answer to a key, else the newest warning, else a state, else the numbers."""

    def __init__(self) -> None:
        super().__init__()
        self.answers = 0
        """Answers so far."""
        self.asks = False
        """Whether the answer is a question, which the same key confirms."""
        self._answer, self._numbers, self._beside = "", Text(), ""
        self._warnings: dict[Hashable, str] = {}
        """By topic, the newest last; shown until esc."""
        self._states: dict[Hashable, str] = {}
        """By topic; shown while they last."""
        self._expiry: Timer | None = None

    def show(self, parts: Sequence[Text], *, chosen: bool = False) -> None:
        """Show numbers, as many as fit; the first also beside a warning, if the user chose it."""
        self._beside = f"   {parts[0]}" if chosen else ""
        line = Text(" ").append_text(parts[0])
        for part in parts[1:]:
            if line.cell_len + part.cell_len + 3 > self.size.width:
                break
            line.append("   ").append_text(part)
        self._numbers = line
        self._update()

    def inform(self, text: str, *, asks: bool = False) -> None:
        """Show for a while what a key did, or what it asks."""
        if self._expiry is not None:
            self._expiry.stop()
        self.answers += 1
        self._answer, self.asks = printable(text), asks
        self._expiry = self.set_timer(INFO_S, lambda: self.inform("")) if text else None
        self._update()

    def warn(self, text: str, topic: Hashable | None = None) -> None:
        """Show a warning until esc: one line, and all of its text at the mouse."""
        self._warnings[topic or text] = printable(text)
        self._update()

    def warns(self, topic: Hashable) -> bool:
        """Whether the warning of a topic waits for esc."""
        return topic in self._warnings

    def pin(self, topic: Hashable, text: str) -> None:
        """Show a state until it is forgotten."""
        self._states[topic] = printable(text)
        self._update()

    def forget(self, topic: Hashable) -> None:
        """Remove the warning or the state of a topic."""
        self._warnings.pop(topic, None)
        self._states.pop(topic, None)
        self._update()

    def on_port_event(self, event: PortEvent, zone: tzinfo = UTC) -> None:
        """Show a port event, with its time of day in a zone; until esc where bytes are missing.

        What happens to a port replaces what happened to it before.
        """
        text = event_text(event, zone)
        match event.kind:
            case PortEventKind.OPENED | PortEventKind.CLOSED:
                pass  # the table has a line for it
            case PortEventKind.LOST | PortEventKind.SILENT | PortEventKind.WIRING:
                self.warn(text, event.port)
            case PortEventKind.FOUND_AGAIN | PortEventKind.BYTES_AGAIN | PortEventKind.BAUD_CHANGED:
                self.warn(text, event.port) if self.warns(event.port) else self.inform(text)
            case _:
                self.warn(text, (event.port, event.kind))

    def dismiss(self) -> bool:
        """Remove what is shown in place of the numbers; returns whether there was anything."""
        if self._answer:
            self.inform("")
            return True
        shown = self._warnings or self._states
        if shown:
            shown.popitem()
            self._update()
            return True
        return False

    def _update(self) -> None:
        warnings = [*self._warnings.values()]
        is_warning = bool(warnings) and not self._answer and LINE not in self._states
        self.set_class(is_warning, "-worry")
        line = self._numbers
        if is_warning:
            others = len(warnings) - 1
            more = (_(" (esc: {count:,} more)", count=others) if others else "") + self._beside
            line = Text(f" ! {fit(warnings[-1], self.size.width - 3 - cell_len(more))}{more}")
        elif text := self._answer or next(reversed(self._states.values()), ""):
            line = Text(f" i {text}")
        if line != self.content:
            self.tooltip = warnings[-1] if is_warning else None
            is_one = line is self._numbers
            self.update(line, layout=not is_one or self.size.height != 1)


class KeyLine(Footer):
    """The keys that work now, as many as fit; composed again only where these have changed."""

    _shown: tuple[Sequence[Binding], int] = (), 0

    def compose(self) -> ComposeResult:
        """The first keys, none of them cut."""
        keys, width = self._shown
        texts = {one.action: f"{self.app.get_key_display(one)} {one.description}" for one in keys}
        ends = accumulate(cell_len(f"{text} ") for text in texts.values())
        return islice(super().compose(), sum(end <= width + 1 for end in ends))

    def bindings_changed(self, screen: Screen[Any]) -> None:
        """Show the keys that work now."""
        keys = [one.binding for one in screen.active_bindings.values() if one.binding.show]
        shown = keys, self.app.size.width
        if shown != self._shown and self.app.app_focus:
            self._shown = shown
            super().bindings_changed(screen)
