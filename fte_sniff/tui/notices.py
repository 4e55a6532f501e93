"""Notices: temporary ones about keys and events, pinned ones about lasting states."""

from __future__ import annotations

import re
from dataclasses import dataclass
from datetime import UTC, tzinfo

from rich.text import Text
from textual.geometry import Size
from textual.timer import Timer
from textual.widget import Widget

from fte_sniff.formats.cell_text import ELLIPSIS, fit_path, wrap
from fte_sniff.protocol import PortEvent, PortEventKind
from fte_sniff.tui.text import event_text

_PATH = re.compile(r"[!-~]*/[!-~]+")
_LONG_WORD = 12
"""Characters from which on a word may be cut."""

_MIN_PATH = 16
"""Cells of a shortened path."""


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
    """A sign and a wrapped text after it."""

    def __init__(self, max_lines: int = 0, classes: str | None = None) -> None:
        """`max_lines` limits its height where that is automatic."""
        super().__init__(classes=classes)
        self.max_lines = max_lines
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
"""How long a warning stays, seconds."""

_TINY, _LOW = 12, 20
"""Lines of the terminal below which a notice has one line, and two."""


@dataclass(frozen=True, slots=True)
class Notice:
    """A text, and whether it is a warning."""

    text: str
    warning: bool


class NoticeLine(WrappedText):
    """The temporary notice, or else the latest pinned one.

    temporary  about a key: until the next key acts, or for a while; a warning stays longer
    pinned     about a state, one per topic: until it is unpinned or dismissed

    A new pinned notice replaces the temporary one, except an information a warning. A pinned
    notice that only counts on leaves the temporary one.
    """

    def __init__(self) -> None:
        super().__init__()
        self.display = False
        self.temporary: Notice | None = None
        self._pinned: dict[str, Notice] = {}
        self._timer: Timer | None = None

    def inform(self, text: str) -> None:
        """Show for a while what a key did, or another information."""
        self._set_temporary(Notice(text, warning=False), INFO_S)

    def warn(self, text: str) -> None:
        """Show a warning for a while."""
        self._set_temporary(Notice(text, warning=True), WARNING_S)

    def pin(self, topic: str, text: str, warning: bool = True, counts: bool = False) -> None:
        """Show until `unpin`, in place of the pinned notice of the same topic.

        counts: a warning that differs from the one before in its numbers only.
        """
        before = self._pinned.pop(topic, None)
        notice = self._pinned[topic] = Notice(text, warning)
        is_new = notice != before if warning and not counts else before is None
        if is_new and self.temporary is not None and warning >= self.temporary.warning:
            self._set_temporary(None)
        self._update()

    def unpin(self, topic: str) -> None:
        """Remove the pinned notice of a topic."""
        if self._pinned.pop(topic, None) is not None:
            self._update()

    def on_port_event(self, event: PortEvent, zone: tzinfo = UTC) -> None:
        """Show a port event, with its time of day in a zone; a lasting problem stays pinned."""
        text = event_text(event, zone)
        kinds = PortEventKind
        match event.kind:
            case kinds.OPENED | kinds.FOUND_AGAIN:
                self.unpin(event.port)
                self.inform(text)
            case kinds.CLOSED | kinds.BAUD_CHANGED:
                self.inform(text)
            case kinds.LOST | kinds.NOT_OPENED | kinds.OVERRUN | kinds.NOT_PASSED_ON | kinds.WIRING:
                self.pin(event.port, text)
            case _:
                self.warn(text)

    def remove_info(self, notice: Notice | None) -> None:
        """Remove this notice, if it is shown and no warning: a key has acted since."""
        if notice is not None and notice is self.temporary and not notice.warning:
            self._set_temporary(None)

    def dismiss(self) -> None:
        """Remove the notice that is shown."""
        if self.temporary is None and self._pinned:
            self._pinned.popitem()
        self._set_temporary(None)

    def _set_temporary(self, notice: Notice | None, for_s: float = 0) -> None:
        if self._timer is not None:
            self._timer.stop()
            self._timer = None
        self.temporary = notice
        if notice is not None:
            self._timer = self.set_timer(for_s, lambda: self._set_temporary(None))
        self._update()

    def _update(self) -> None:
        notice = self.temporary or next(reversed(self._pinned.values()), None)
        self.display = notice is not None
        if notice is not None:
            height = self.app.size.height
            self.max_lines = 1 if height < _TINY else 2 if height < _LOW else 3
            self.set_class(notice.warning, "-worry")
            self.show("!" if notice.warning else "i", notice.text)
