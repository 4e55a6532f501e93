"""Lines around the table: title, status, keys and notices."""

from __future__ import annotations

import re
from collections.abc import Hashable, Iterable, Sequence
from dataclasses import dataclass
from datetime import UTC, timedelta, tzinfo
from enum import IntEnum, StrEnum
from typing import TYPE_CHECKING, ClassVar, Final

from rich.cells import cell_len
from rich.style import Style
from rich.text import Text
from textual.app import ComposeResult
from textual.binding import Binding
from textual.containers import Vertical
from textual.events import Click
from textual.geometry import Size
from textual.reactive import reactive
from textual.timer import Timer
from textual.widget import Widget

from fte_sniff.analysis.feed import FeedState
from fte_sniff.errors import printable, size_text
from fte_sniff.formats.cell_text import ELLIPSIS, fit, fit_path, wrap
from fte_sniff.protocol import PortEvent, PortEventKind
from fte_sniff.tui.cells import event_text
from fte_sniff.tui.commands import Mode, key_names, rank_of, short_text
from fte_sniff.tui.i18n import _, later

if TYPE_CHECKING:
    from fte_sniff.session.replay import Playback

NAME = "fte-sniff"

WIDE = 72
"""Cells from which on words are not abbreviated."""

MIN_PATH, MIN_NAMES = 14, 14
"""Cells that the path and the names have at least, where they are that long."""


def mode_of(state: FeedState, paused: bool, following: bool, play: Playback | None = None) -> Mode:
    """The mode of a view: LIVE only while the newest rows are in view; WAITING for a lost port.

    FOLLOWING is LIVE for the recording of another program.
    """
    if play is not None:
        return Mode.HELD if play.paused else Mode.PLAYING
    if paused:
        return Mode.PAUSED
    if state.live and state.running:
        newest = Mode.WAITING if state.waiting else Mode.LIVE
        newest = Mode.FOLLOWING if state.follows else newest
        return newest if following else Mode.SCROLLED
    if state.live:
        return Mode.ENDED
    return Mode.LOADING if state.running else Mode.FILE


def badge_text(state: FeedState, mode: Mode, unseen: float) -> str:
    """The mode at the end of the title line."""
    words = _(mode)
    if mode is Mode.PAUSED:
        words = _("PAUSED, {count:,} new", count=unseen)
    elif mode in (Mode.PLAYING, Mode.HELD):
        words = f"{words} {unseen:g}×"
    elif mode is Mode.SCROLLED:
        words = _("SCROLLED +{count:,}", count=unseen)
    elif mode is Mode.LOADING and state.progress is not None:
        words = _("LOADING {share:4.0%}", share=state.progress)
    return f" {words} "


class RecordingSign(StrEnum):
    """What happens to the rows of a capture; the value is the sign before the words."""

    RECORDING = "●"
    NOT_RECORDING = "○"
    STOPPED = "✗"
    """Against the user's will."""
    ENDED = "■"


def recording_sign(state: FeedState) -> RecordingSign | None:
    """What happens to the rows; None for files."""
    if not state.live or state.follows:
        return None
    if state.recording is None:
        stopped = bool(state.files) and state.running
        return RecordingSign.STOPPED if stopped else RecordingSign.NOT_RECORDING
    return RecordingSign.RECORDING if state.running else RecordingSign.ENDED


def recording_text(state: FeedState, elapsed_s: float, *, short: bool = False) -> str:
    """Whether rows are recorded, for how long, and how large the files are; empty for files.

    `short` leaves only the first.
    """
    sign = recording_sign(state)
    words = {
        None: "",
        RecordingSign.RECORDING: _("REC"),
        RecordingSign.NOT_RECORDING: _("not recording") if state.running else _("not recorded"),
        RecordingSign.STOPPED: _("NOT RECORDING"),
        RecordingSign.ENDED: _("recorded"),
    }[sign]
    if state.recording is None or sign is None or short:
        return f" {sign} {words} " if sign else ""
    span = timedelta(seconds=int(elapsed_s))
    # As wide as the widest, so that the title does not move each time.
    return f" {sign} {words} {span} {size_text(state.recorded_bytes):<7} "


def title_parts(
    state: FeedState, mode: Mode, unseen: float, width: int, elapsed_s: float = 0
) -> tuple[str, str, str, str]:
    """Names, state of the recording, its path, and mode: the title line in `width` cells.

    The path is cut first, then the names. `unseen` is the number of rows since a pause, or below
    the window, or the speed of playback; `elapsed_s` the age of the recording.
    """
    badge, recording = (
        badge_text(state, mode, unseen),
        recording_text(state, elapsed_s, short=width < WIDE),
    )
    left = max(0, width - cell_len(badge))
    recording = fit(recording, min(left, cell_len(recording)))
    left -= cell_len(recording)
    path = f" {printable(state.recording)}" if state.recording is not None and recording else ""
    shortest = min(cell_len(path), MIN_PATH)
    names = f" {printable(state.title)} "
    if cell_len(names) + cell_len(NAME) + 1 + cell_len(path) <= left:
        names = f" {NAME} {names}"
    if cell_len(names) + shortest > left:
        names = fit(names, max(min(MIN_NAMES, left), left - shortest))
    left -= cell_len(names)
    path = fit(fit_path(path, left), left) if left >= shortest else " " * left
    if not recording:
        return fit(names, left + cell_len(names)), "", "", badge
    return names, recording, path, badge


def title_text(
    state: FeedState, mode: Mode, unseen: float, width: int, elapsed_s: float = 0
) -> str:
    """The title line in exactly `width` cells."""
    return "".join(title_parts(state, mode, unseen, width, elapsed_s))


RECORDING_STYLES: Final = {
    RecordingSign.RECORDING: Style(color="#ffffff", bgcolor="#c01020", bold=True),
    RecordingSign.STOPPED: Style(color="#ffffff", bgcolor="#b84a00", bold=True, blink=True),
}
"""Styles of the state of the recording; other states have that of the line."""


FLASH_S: Final = 0.5
"""How long an alert changes the title's colours, seconds."""


class TitleLine(Widget):
    """The line at the top.

    Textual's Header centres one title. This line has names at the left, the recording and the mode
    at the right, and cuts the names first. A change takes 5.3 ms there and 2.3 ms here.
    """

    def __init__(self) -> None:
        super().__init__()
        self._shown: tuple[FeedState, Mode, float, float] | None = None
        self._line = ""

    def flash(self) -> None:
        """Draw the line in other colours for a moment."""
        self.add_class("-alert")
        self.set_timer(FLASH_S, lambda: self.remove_class("-alert"))

    def show(self, state: FeedState, mode: Mode, unseen: float, elapsed_s: float = 0) -> None:
        """Draw a changed state; the arguments are those of `title_text`."""
        self._shown = (state, mode, unseen, elapsed_s)
        line = title_text(state, mode, unseen, self.size.width, elapsed_s)
        if line != self._line:
            self._line = line
            self.refresh()

    def render(self) -> Text:
        """The line, with the recording and the mode highlighted."""
        if self._shown is None:
            return Text()
        state, mode, unseen, elapsed_s = self._shown
        names, recording, path, badge = title_parts(state, mode, unseen, self.size.width, elapsed_s)
        style = RECORDING_STYLES.get(recording_sign(state) or RecordingSign.ENDED, "bold")
        parts = (names, (recording, style), path, (badge, "bold reverse"))
        return Text.assemble(*parts, no_wrap=True, overflow="crop")


@dataclass(frozen=True, slots=True)
class StatusCounters:
    """Numbers of the status line."""

    rows: int
    frames_per_s: float | None
    """None without times."""
    malformed: int
    """Malformed rows among those that reached the screen."""
    malformed_share: float
    """Their share, 0 to 1."""
    not_shown: int
    """Rows that came too fast for the screen."""
    row_number: int
    """Number of the cursor's row among those shown, from 1; 0 without a row."""
    following: bool
    below: int
    line_errors: int = 0
    """Errors that UARTs reported."""
    hits: str = ""
    is_mean: bool = False
    """Whether the rate is that of all rows, not the current one."""
    filtered: bool = False
    """Whether a filter hides rows; the counts are of all rows."""
    health: str = ""
    """How the motors answered lately."""
    time: str = ""
    """The time that the top view shows, in place of the number of the row."""


def status_text(numbers: StatusCounters, width: int) -> str:
    """The status line in exactly `width` cells; the last numbers are left out first."""
    parts = _parts(numbers, abbreviated=width < (WITH_HEALTH if numbers.health else WIDE))
    if numbers.time:
        parts.insert(1, numbers.time)
    if numbers.hits:
        parts.insert(1, numbers.hits)
    if numbers.line_errors:
        parts.append(_("{count:,} line errors", count=numbers.line_errors))
    if numbers.not_shown:
        parts.append(_("{count:,} too fast to show", count=numbers.not_shown))
    if numbers.health:
        parts.append(numbers.health)
    row = _("shown row {number:,}") if numbers.filtered else _("row {number:,}")
    row = row.format(number=numbers.row_number) if numbers.row_number else _("no row shown")
    if not numbers.time:
        parts.append(row)
    if numbers.below and not numbers.following and not numbers.time:
        parts.append(_("{count:,} below", count=numbers.below))
    line = parts[0]
    for part in parts[1:]:
        if cell_len(line) + cell_len(part) + 2 > width:
            break
        line += "  " + part
    return fit(line, width)


WITH_HEALTH: Final = 110
"""Cells from which on words are not abbreviated beside the health of the motors."""

RATE, MEAN_RATE = "{rate:>5,.0f}/s", "ø {rate:>3,.0f}/s"


def _parts(numbers: StatusCounters, *, abbreviated: bool) -> list[str]:
    """Rows, rate and malformed rows; abbreviated, the rate is the last."""
    malformed = _("{count:>6,} malformed {share:>6}")
    if abbreviated:
        malformed = _("{count:>5,} bad {share:>5}")
    share = _share_text(numbers.malformed_share, 1 if abbreviated else 2)
    rows = later("all {count:,} rows") if numbers.filtered else later("{count:>9,} rows")
    parts = [
        _(rows, count=numbers.rows),
        malformed.format(count=numbers.malformed, share=share),
    ]
    rate = numbers.frames_per_s
    if rate is not None and abbreviated:
        form = MEAN_RATE if numbers.is_mean else RATE
        parts.append(form.format(rate=rate))
    elif rate is not None:
        form = _("{rate:>6,.0f} frames/s mean") if numbers.is_mean else _("{rate:>6,.0f} frames/s")
        parts.insert(1, form.format(rate=rate))
    return parts


def _share_text(share: float, digits: int) -> str:
    least = 10.0 ** -(digits + 2)
    if 0 < share < least:
        return f"<{least:.{digits}%}"
    return f"{share:.{digits}%}" if share < 1 else "100%"


class StatusLine(Widget):
    """The line of numbers at the bottom.

    Textual's Static draws a text that is given; this line chooses the numbers that fit its width
    each time it is drawn. A change takes 2.2 ms with both.
    """

    numbers: reactive[StatusCounters | None] = reactive(None)

    def render(self) -> Text:
        """The line."""
        line = status_text(self.numbers, self.size.width) if self.numbers else ""
        return Text(line, no_wrap=True, overflow="crop")


GAP = 2


def fitting_keys(keys: Iterable[Binding], width: int, mode: Mode = Mode.LIVE) -> list[Binding]:
    """The most important keys that fit into `width` cells."""
    found, left = [], width + GAP
    for key in sorted(keys, key=rank_of):
        cells = GAP + cell_len(f"{key_names(key)} {short_text(key, mode)}")
        if cells <= left:
            found.append(key)
            left -= cells
    return found


class KeyLine(Widget):
    """The most important keys; a clicked key is pressed.

    Textual's Footer (8.2) cuts the last keys where they do not fit, not the least important, and is
    composed again when the keys change: 14 keys take 55 ms there and 3 ms here.
    """

    COMPONENT_CLASSES: ClassVar[set[str]] = {"key-line--key"}
    mode: reactive[Mode] = reactive(Mode.LIVE)

    def on_mount(self) -> None:
        """Follow the bindings that are active."""
        self.screen.bindings_updated_signal.subscribe(self, lambda _screen: self.refresh())

    def _fitting(self) -> Sequence[Binding]:
        active = self.screen.active_bindings.values()
        by_action = {one.binding.action: one.binding for one in active if one.binding.show}
        return fitting_keys(by_action.values(), self.size.width, self.mode)

    def render(self) -> Text:
        """The line."""
        style = self.get_component_rich_style("key-line--key", partial=True)
        keys = [
            Text.assemble((key_names(key), style), " ", short_text(key, self.mode))
            for key in self._fitting()
        ]
        line = Text(" " * GAP).join(keys)
        line.no_wrap, line.overflow = True, "crop"
        return line

    def on_click(self, event: Click) -> None:
        """Press the key that was clicked."""
        event.stop()
        end = 0
        for key in self._fitting():
            text = short_text(key, self.mode)
            start, end = end, end + cell_len(f"{key_names(key)} {text}")
            if start <= event.x < end:
                self.app.simulate_key(key.key)
                return
            end += GAP


_PATH = re.compile(r"[!-~]*/[!-~]+")
_LONG_WORD = 12
"""Characters from which on a word may be cut."""

_LEAST_PATH = 16
"""Cells of a path in a notice."""


def in_lines(text: str, width: int, max_lines: int) -> list[str]:
    """The text in at most `max_lines` lines; paths are shortened first, then its middle is cut."""
    text = text.strip()
    lines = wrap(text, width)
    if len(lines) <= 1:
        return lines
    for path_width in (width, max(_LEAST_PATH, width * max_lines // 3)):
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
    """What a notice is about. Of those that are not warnings, the highest is shown."""

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
            case kinds.BYTES_AGAIN:
                self.unpin((event.port, kinds.SILENT))
                self.report(text)
            case kinds.CLOSED | kinds.BAUD_CHANGED:
                self.report(text)
            case kind if kind in _LASTING:
                self.pin(topic, text)
            case _:
                self.warn(text, topic)

    def remove_answer(self, notice: Notice | None) -> None:
        """Remove this answer, if it is the only one: a key has acted since."""
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
        PortEventKind.SHARED,
        PortEventKind.SILENT,
    }
)
"""Events whose problem lasts."""
