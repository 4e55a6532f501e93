"""Notice line."""

from __future__ import annotations

import re
from dataclasses import dataclass
from datetime import UTC, tzinfo

from rich.text import Text
from textual.geometry import Size
from textual.timer import Timer
from textual.widget import Widget

from fte_sniff.errors import printable
from fte_sniff.protocol import PortEvent, PortEventKind
from fte_sniff.tui.i18n import _, later
from fte_sniff.tui.text import ELLIPSIS, clock_text, fit_path, wrap

_PATH = re.compile(r"[!-~]*/[!-~]+")
_LONG_WORD = 12
"""Characters of a word that may be cut apart."""

_SHORTEST_PATH = 16
"""Cells that a path is left with."""


def in_lines(text: str, width: int, most: int) -> list[str]:
    """The text in at most `most` lines of `width` cells: paths give way first, then its middle."""
    text = text.strip()
    lines = wrap(text, width)
    if len(lines) <= 1:
        return lines
    for room in (width, max(_SHORTEST_PATH, width * most // 3)):
        text = _with_short_paths(text, room)
        if len(lines := wrap(text, width)) <= most:
            return lines
    kept = len(text)
    while len(lines := wrap(_without_middle(text, kept), width)) > most and kept > 2:
        kept -= 1
    return lines[:most]


def _with_short_paths(text: str, room: int) -> str:
    return _PATH.sub(lambda path: fit_path(path[0], room), text)


def _without_middle(text: str, kept: int) -> str:
    """The text short of its middle, so many characters of it; between words, where they are short.

    The way out needs more words than what it is about.
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


class Sentence(Widget):
    """A sign and a sentence behind it, in as many lines as there are."""

    def __init__(self, most: int = 0, classes: str | None = None) -> None:
        """`most` is how many lines it takes where its height is left to it."""
        super().__init__(classes=classes)
        self.most = most
        self._sign, self._words = "", ""

    def say(self, sign: str, words: str) -> None:
        """Show this from now on; `words` have no control characters."""
        if (sign, words) != (self._sign, self._words):
            self._sign, self._words = sign, words
            self.refresh(layout=True)

    def get_content_height(self, container: Size, viewport: Size, width: int) -> int:
        """As many lines as the sentence needs, up to the most."""
        return max(1, len(self._lines(width, self.most)))

    def _lines(self, width: int, most: int) -> list[str]:
        return in_lines(self._words, max(1, width - len(self._sign) - 1), max(1, most))

    def render(self) -> Text:
        """The lines, all behind the sign."""
        indent = "\n" + " " * (len(self._sign) + 1)
        lines = self._lines(self.size.width, self.size.height)
        return Text(f"{self._sign} {indent.join(lines)}", no_wrap=True, overflow="crop")


GOOD = frozenset(
    {
        PortEventKind.OPENED,
        PortEventKind.FOUND_AGAIN,
        PortEventKind.CLOSED,
        PortEventKind.BAUD_CHANGED,
    }
)
"""Events that are no cause for worry."""

LASTING = frozenset(
    {
        PortEventKind.LOST,
        PortEventKind.NOT_OPENED,
        PortEventKind.OVERRUN,
        PortEventKind.NOT_PASSED_ON,
        PortEventKind.WIRING,
    }
)
"""Events that have to be seen, by whoever looks at the screen next."""

BACK = frozenset({PortEventKind.OPENED, PortEventKind.FOUND_AGAIN})
"""Events after which all is well with a port again."""

SHOWN_S = 8.0
"""How long a passing notice stays that is no cause for worry, where no key is pressed."""

WARNED_S = 30.0
"""How long one stays that is."""

_TINY, _LOW = 12, 20
"""Lines of a screen below which a notice has one line, and two."""

_MILLISECONDS = 3


WITH_DETAIL = later("{event}: {detail}")


def event_text(event: PortEvent, zone: tzinfo = UTC) -> str:
    """The event in one line, its time of day in a zone."""
    when = clock_text(event.t_ns, _MILLISECONDS, zone)
    what = f"{event.port} {_(event_words(event.kind))}"
    if event.detail:
        what = _(WITH_DETAIL).format(event=what, detail=_(event.detail))
    return printable(f"{when}  {what}")


def event_words(kind: PortEventKind) -> str:
    """What happened, in English."""
    return kind.replace("_", " ")


@dataclass(frozen=True, slots=True)
class Notice:
    """What is told, and whether it is cause for worry."""

    words: str
    worry: bool


class NoticeLine(Sentence):
    """The notice that holds now: a passing one, else the latest of those that stand.

    passing    what a key did, or why it did nothing: until the next key does something, or for
               a while; an error longer, whatever is done meanwhile
    standing   what holds until it is told that it does no more, at most one about each thing

    What is new is told at once: a worry that stands ends whatever passes, and all else that stands
    ends what passes and is no worry.
    """

    def __init__(self) -> None:
        super().__init__()
        self.display = False
        self.passing: Notice | None = None
        self._standing: dict[str, Notice] = {}
        self._clock: Timer | None = None

    def tell(self, words: str) -> None:
        """Tell what a key did, or something that is no cause for worry."""
        self._pass(Notice(words, worry=False), SHOWN_S)

    def warn(self, words: str) -> None:
        """Tell what went wrong, where it does not stay so."""
        self._pass(Notice(words, worry=True), WARNED_S)

    def hold(self, about: str, words: str, worry: bool = True) -> None:
        """Tell what holds until `release`, in place of what stood about the same thing."""
        before = self._standing.pop(about, None)
        notice = self._standing[about] = Notice(words, worry)
        if notice != before if worry else before is None:
            self._give_way(notice)
        self._show()

    def _give_way(self, to: Notice) -> None:
        """What passes ends for a notice that is newer and at least as grave."""
        if self.passing is not None and to.worry >= self.passing.worry:
            self._pass(None)

    def release(self, about: str) -> None:
        """What stands about this holds no more."""
        if self._standing.pop(about, None) is not None:
            self._show()

    def tell_event(self, event: PortEvent, zone: tzinfo = UTC) -> None:
        """Tell a port event, its time of day in a zone."""
        words = event_text(event, zone)
        if event.kind in BACK:
            self.release(event.port)
        if event.kind in LASTING:
            self.hold(event.port, words)
        elif event.kind in GOOD:
            self.tell(words)
        else:
            self.warn(words)

    def pass_by(self, notice: Notice | None) -> None:
        """A key did something while this was passing: it holds no more, if it is no worry."""
        if notice is not None and notice is self.passing and not notice.worry:
            self._pass(None)

    def put_away(self) -> None:
        """Take the notice that is shown for read."""
        if self.passing is None and self._standing:
            self._standing.popitem()
        self._pass(None)

    def _pass(self, notice: Notice | None, for_s: float = 0) -> None:
        if self._clock is not None:
            self._clock.stop()
            self._clock = None
        self.passing = notice
        if notice is not None:
            self._clock = self.set_timer(for_s, lambda: self._pass(None))
        self._show()

    def _show(self) -> None:
        notice = self.passing or next(reversed(self._standing.values()), None)
        self.display = notice is not None
        if notice is not None:
            self.most = _most_lines(self.app.size.height)
            self.set_class(notice.worry, "-worry")
            self.say("!" if notice.worry else "i", notice.words)


def _most_lines(height: int) -> int:
    """Lines that a notice may take of a screen that has so many."""
    return 1 if height < _TINY else 2 if height < _LOW else 3
