"""The lines of text above and below the rows: title, and status with the news."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from datetime import UTC, timedelta, tzinfo
from enum import IntEnum, StrEnum
from typing import Final

from rich.cells import cell_len
from rich.style import Style
from rich.text import Text
from textual.timer import Timer
from textual.widgets import Static

from fte_sniff.analysis.feed import FeedState
from fte_sniff.errors import printable, size_text
from fte_sniff.formats.cell_text import fit, fit_path
from fte_sniff.i18n import _
from fte_sniff.protocol import PortEvent, PortEventKind
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
    PAUSED = "PAUSED"
    ENDED = "ENDED"
    FILE = "FILE"


def mode_of(state: FeedState, *, paused: bool, at_end: bool) -> Mode:
    """The mode: LIVE only while the newest rows are in view; WAITING for a lost port.

    FOLLOWING is LIVE for the recording of another program.
    """
    if paused:
        return Mode.PAUSED
    if state.live and state.running:
        if not at_end:
            return Mode.SCROLLED
        newest = Mode.WAITING if state.waiting else Mode.LIVE
        return Mode.FOLLOWING if state.follows else newest
    if state.live:
        return Mode.ENDED
    return Mode.LOADING if state.running else Mode.FILE


def badge_text(state: FeedState, mode: Mode, unseen: int) -> str:
    """The mode at the end of the title; `unseen` rows came since a pause, or are below."""
    words = _(mode)
    if mode is Mode.PAUSED:
        words = _("PAUSED, {count:,} new", count=unseen)
    elif mode is Mode.SCROLLED:
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

    FLASH_S: Final = 0.5

    def show(self, state: FeedState, badge: str, elapsed_s: float) -> None:
        """Show a state."""
        line = title_text(state, badge, self.size.width, int(elapsed_s))
        if line != self.content:
            self.update(line, layout=False)

    def flash(self) -> None:
        """Draw the line in other colours for a moment."""
        self.add_class("-alert")
        self.set_timer(self.FLASH_S, lambda: self.remove_class("-alert"))


INFO_S: Final = 8.0
"""How long an answer stays where no key is pressed, seconds."""


class Rank(IntEnum):
    """What a notice is about; that with the highest rank is shown, of equal ones the newest."""

    STATE = 0
    """Shown while it lasts."""
    EVENT = 1
    """Shown for a while."""
    WARNING = 2
    """Shown until esc."""
    ANSWER = 3
    """Shown until the next key."""
    QUESTION = 4
    """What a key asks before it acts."""


@dataclass(frozen=True, slots=True)
class Notice:
    """A text, and what it is about."""

    text: str
    rank: Rank


class StatusLine(Static):
    """The numbers, or in their place the most important news."""

    def __init__(self) -> None:
        super().__init__()
        self._notices: dict[Hashable, Notice] = {}
        """By topic, the newest last."""
        self._expiries: dict[Hashable, Timer] = {}
        self._numbers = Text()

    @property
    def answer(self) -> Notice | None:
        """The answer to the last key, or its question."""
        return self._notices.get(Rank.ANSWER)

    @property
    def asks(self) -> bool:
        """Whether the answer is a question."""
        return self.answer is not None and self.answer.rank is Rank.QUESTION

    def show(self, parts: Sequence[Text]) -> None:
        """Show numbers, as many as fit."""
        line = Text(" ").append_text(parts[0])
        for part in parts[1:]:
            if line.cell_len + part.cell_len + 3 > self.size.width:
                break
            line.append("   ").append_text(part)
        self._numbers = line
        self._update()

    def inform(self, text: str) -> None:
        """Show what a key did."""
        self._set(Rank.ANSWER, text, Rank.ANSWER, INFO_S)

    def ask(self, text: str) -> None:
        """Show a question, which the same key confirms while it `asks`."""
        self._set(Rank.ANSWER, text, Rank.QUESTION, INFO_S)

    def report(self, text: str) -> None:
        """Show for a while what happened without a key."""
        self._set(Rank.EVENT, text, Rank.EVENT, INFO_S)

    def warn(self, text: str, topic: Hashable | None = None) -> None:
        """Show a warning until esc."""
        self._set(topic or text, text, Rank.WARNING, None)

    def pin(self, topic: Hashable, text: str) -> None:
        """Show a state until `unpin`."""
        self._set(topic, text, Rank.STATE, None)

    def unpin(self, topic: Hashable) -> None:
        """Remove the notice of a topic."""
        if topic in self._expiries:
            self._expiries.pop(topic).stop()
        if self._notices.pop(topic, None) is not None:
            self._update()

    def on_port_event(self, event: PortEvent, zone: tzinfo = UTC) -> None:
        """Show a port event, with its time of day in a zone."""
        text, topic = event_text(event, zone), (event.port, event.kind)
        match event.kind:
            case PortEventKind.OPENED | PortEventKind.CLOSED:
                pass  # the table has a line for it
            case PortEventKind.FOUND_AGAIN | PortEventKind.BYTES_AGAIN | PortEventKind.BAUD_CHANGED:
                for kind in (PortEventKind.LOST, PortEventKind.SILENT):
                    self.unpin((event.port, kind))
                self.report(text)
            case _:
                self.warn(text, topic)

    def remove_answer(self, notice: Notice | None) -> None:
        """Remove this answer, if it is the present one: a key has acted since."""
        if notice is not None and notice is self.answer:
            self.unpin(Rank.ANSWER)

    def dismiss(self) -> bool:
        """Remove the notice that is shown; returns whether there was one."""
        topic = self._topmost
        self.unpin(topic)
        return topic is not None

    def _set(self, topic: Hashable, text: str, rank: Rank, for_s: float | None) -> None:
        self.unpin(topic)
        self._notices[topic] = Notice(printable(text), rank)
        if for_s is not None:
            self._expiries[topic] = self.set_timer(for_s, lambda: self.unpin(topic))
        self._update()

    @property
    def _topmost(self) -> Hashable | None:
        newest_first = reversed([*self._notices])
        return max(newest_first, key=lambda topic: self._notices[topic].rank, default=None)

    def _update(self) -> None:
        topic = self._topmost
        notice = None if topic is None else self._notices[topic]
        is_warning = notice is not None and notice.rank is Rank.WARNING
        self.set_class(is_warning, "-worry")
        line = self._numbers
        if notice is not None:
            others = sum(one.rank is Rank.WARNING for one in self._notices.values()) - is_warning
            more = _("(esc: {count:,} more)", count=others) if is_warning and others else ""
            sign = "!" if is_warning else "i"
            line = Text(f" {sign} {notice.text} {more}".rstrip())
        if line != self.content:
            lines_stay = notice is None and "\n" not in line.plain
            self.update(line, layout=not lines_stay or self.size.height != 1)
