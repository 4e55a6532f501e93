"""Notices: answers to keys, events that pass, and states that last."""

from __future__ import annotations

import re
from collections.abc import Hashable
from dataclasses import dataclass
from datetime import UTC, tzinfo
from enum import IntEnum

from rich.text import Text
from textual.app import ComposeResult
from textual.containers import Vertical
from textual.geometry import Size
from textual.timer import Timer
from textual.widget import Widget

from fte_sniff.errors import printable
from fte_sniff.formats.cell_text import ELLIPSIS, fit_path, wrap
from fte_sniff.protocol import PortEvent, PortEventKind
from fte_sniff.tui.text import event_text

_PATH = re.compile(r"[!-~]*/[!-~]+")
_LONG_WORD = 12
"""Characters from which on a word may be cut."""

_MIN_PATH = 16


def in_lines(text: str, width: int, max_lines: int) -> list[str]:
    """The text in at most `max_lines` lines; paths are shortened first, then its middle is cut."""
    text = text.strip()
    lines = wrap(text, width)
    if len(lines) <= 1:
        return lines
    for path_width in (width, max(_MIN_PATH, width * max_lines // 3)):
        text = _PATH.sub(lambda path, most=path_width: fit_path(path[0], most), text)  # type: ignore[misc]
        if len(lines := wrap(text, width)) <= max_lines:
            return lines
    kept = len(text)
    while len(lines := wrap(_without_middle(text, kept), width)) > max_lines and kept > 2:
        kept -= 1
    return lines[:max_lines]


def _without_middle(text: str, kept: int) -> str:
    """The text cut to `kept` characters, between words where these are short.

    Three fifths remain of the end, since the fix is there.
    """
    if kept >= len(text):
        return text
    end = max(1, kept * 3 // 5)
    head, tail = text[: max(1, kept - end)], text[len(text) - end :]
    if len(head) - _LONG_WORD < head.rfind(" "):
        head = head[: head.rfind(" ")]
    if -1 < tail.find(" ") < _LONG_WORD:
        tail = tail[tail.find(" ") :]
    return f"{head.rstrip()} {ELLIPSIS} {tail.lstrip()}"


class WrappedText(Widget):
    """A sign and a wrapped text after it, whose lines begin below each other.

    Textual's Static (8.2) begins them below the sign, and cuts the end of a long text, where its
    reason is, not its middle.
    """

    max_lines = 0
    """Limits its height where that is automatic."""

    def __init__(self, classes: str | None = None) -> None:
        super().__init__(classes=classes)
        self._sign, self._text = "", ""

    def show(self, sign: str, text: str) -> None:
        """Show a printable text."""
        if (sign, text) != (self._sign, self._text):
            self._sign, self._text = sign, text
            self.refresh(layout=True)

    def get_content_height(self, container: Size, viewport: Size, width: int) -> int:
        """Lines of the text, at most `max_lines`."""
        return max(1, len(self._lines(width, self.max_lines)))

    def _lines(self, width: int, max_lines: int) -> list[str]:
        return in_lines(self._text, max(1, width - len(self._sign) - 1), max(1, max_lines))

    def render(self) -> Text:
        """The lines, indented by the sign."""
        indent = "\n" + " " * (len(self._sign) + 1)
        lines = self._lines(self.size.width, self.size.height)
        return Text(f"{self._sign} {indent.join(lines)}", no_wrap=True, overflow="crop")


INFO_S = 8.0
"""How long an information stays where no key is pressed, seconds."""

WARNING_S = 30.0

_TINY, _LOW = 12, 20
"""Lines of the terminal below which a notice has one line, and two."""


class Rank(IntEnum):
    """What a notice is about. Of those that are no warnings, the highest is shown."""

    STATE = 0
    EVENT = 1
    ANSWER = 2
    QUESTION = 3
    """What a key asks before it acts."""
    WARNING = 4


@dataclass(frozen=True, slots=True)
class Notice:
    """A text, and what it is about."""

    text: str
    rank: Rank


class NoticeLine(Vertical):
    """A warning and, below it, an information: neither hides the other.

    The newest warning is shown, since it is the news; a warning with a known topic only counts on
    and comes to the top no more. Other notices wait until those above them have gone. An answer
    goes when the next key acts. A terminal with few lines shows an answer before a warning.
    Textual's toasts (8.2) cover rows, go by time or a click, and cannot change.
    """

    def __init__(self) -> None:
        super().__init__()
        self.display = False
        self._warning = WrappedText(classes="-worry")
        self._information = WrappedText()
        self._notices: dict[Hashable, Notice] = {}
        """By topic, the newest topic last."""
        self._expiries: dict[Hashable, Timer] = {}

    def compose(self) -> ComposeResult:
        """The two notices."""
        yield self._warning
        yield self._information

    @property
    def answer(self) -> Notice | None:
        """The answer to the last key, or its question."""
        return self._notices.get(Rank.ANSWER)

    @property
    def asks(self) -> bool:
        """Whether the answer is a question."""
        return self.answer is not None and self.answer.rank is Rank.QUESTION

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
        """Show a warning for a while."""
        self._set(topic or text, text, Rank.WARNING, WARNING_S)

    def pin(self, topic: Hashable, text: str, *, warning: bool = True) -> None:
        """Show until `unpin`, in place of the notice of the same topic."""
        self._set(topic, text, Rank.WARNING if warning else Rank.STATE, None)

    def unpin(self, topic: Hashable) -> None:
        """Remove the notice of a topic."""
        self._stop_timer(topic)
        if self._notices.pop(topic, None) is not None:
            self._update()

    def on_port_event(self, event: PortEvent, zone: tzinfo = UTC) -> None:
        """Show a port event, with its time of day in a zone; a lasting problem stays pinned."""
        text, kinds = event_text(event, zone), PortEventKind
        topic = (event.port, event.kind)
        match event.kind:
            case kinds.OPENED | kinds.FOUND_AGAIN:
                for kind in _LASTING:
                    self.unpin((event.port, kind))
                self.report(text)
            case kinds.CLOSED | kinds.BAUD_CHANGED:
                self.report(text)
            case kind if kind in _LASTING:
                self.pin(topic, text)
            case _:
                self.warn(text, topic)

    def remove_answer(self, notice: Notice | None) -> None:
        """Remove this answer, if there is no other: a key has acted since."""
        if notice is not None and notice is self.answer:
            self.unpin(Rank.ANSWER)

    def dismiss(self) -> None:
        """Remove the warning that is shown, or else the information."""
        shown = self._topmost(warning=True) or self._topmost(warning=False)
        if shown is not None:
            self.unpin(shown)

    def _set(self, topic: Hashable, text: str, rank: Rank, for_s: float | None) -> None:
        if topic in self._notices and rank is not Rank.WARNING:
            del self._notices[topic]
        self._stop_timer(topic)
        self._notices[topic] = Notice(printable(text), rank)
        if for_s is not None:
            self._expiries[topic] = self.set_timer(for_s, lambda: self.unpin(topic))
        self._update()

    def _stop_timer(self, topic: Hashable) -> None:
        timer = self._expiries.pop(topic, None)
        if timer is not None:
            timer.stop()

    def _topmost(self, *, warning: bool) -> Hashable | None:
        """Topic of the newest warning, or of the highest other notice."""
        notices = reversed(self._notices.items())
        topics = [topic for topic, notice in notices if (notice.rank is Rank.WARNING) is warning]
        return max(topics, key=lambda topic: self._notices[topic].rank, default=None)

    def _update(self) -> None:
        height = self.app.size.height
        max_lines = 1 if height < _TINY else 2 if height < _LOW else 3
        self.display = bool(self._notices)
        for widget, sign in ((self._warning, "!"), (self._information, "i")):
            topic = self._topmost(warning=widget is self._warning)
            hidden = widget is self._warning and self.answer is not None and height < _LOW
            widget.display = topic is not None and not hidden
            if topic is not None:
                widget.max_lines = max_lines
                widget.show(sign, self._notices[topic].text)


_LASTING = frozenset(
    {
        PortEventKind.LOST,
        PortEventKind.NOT_OPENED,
        PortEventKind.OVERRUN,
        PortEventKind.NOT_PASSED_ON,
        PortEventKind.WIRING,
    }
)
"""Events whose problem lasts."""
