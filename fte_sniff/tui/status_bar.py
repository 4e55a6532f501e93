"""Title, status and key lines."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import ClassVar

from rich.cells import cell_len
from rich.text import Text
from textual.binding import Binding
from textual.events import Click
from textual.widget import Widget

from fte_sniff.analysis.feed import FeedState
from fte_sniff.errors import printable
from fte_sniff.tui.i18n import _
from fte_sniff.tui.keys import SHOWN_FIRST, key_names
from fte_sniff.tui.text import fit, fit_path

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
    names = f" {printable(state.title)}"
    if cell_len(names) + cell_len(NAME) + 2 < room:
        names = f" {NAME} {names}"
    if state.recording is not None:
        lead = "  " + _("rec") + " "
        rest = room - cell_len(names) - cell_len(lead) - 1
        path = printable(state.recording)
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


ROOMY = 72
"""Cells from which on there is room for whole words."""


@dataclass(frozen=True, slots=True)
class StatusCounters:
    """What the bottom line tells."""

    rows: int
    """All rows that came."""
    frames_per_s: float | None
    """None where there are no times to count by."""
    malformed: int
    """Malformed rows among those that reached the view."""
    malformed_share: float
    """Their share, 0 to 1."""
    not_shown: int
    """Rows that came too fast for the view."""
    place: int
    """The cursor's row among those shown, from 1; 0 where there is none."""
    following: bool
    below: int
    """Rows behind the end of the window."""
    line_errors: int = 0
    """Errors that UARTs reported."""
    hits: str = ""
    """How many rows have what is looked for; empty where nothing is."""


def status_text(numbers: StatusCounters, width: int) -> str:
    """The line in exactly `width` cells; where it is narrow, the last parts are left out first."""
    parts = _parts(numbers) if width >= ROOMY else _short_parts(numbers)
    if numbers.hits:
        parts.insert(1, numbers.hits)
    if numbers.line_errors:
        parts.append(_("{count:,} line errors").format(count=numbers.line_errors))
    if numbers.not_shown:
        parts.append(_("{count:,} too fast to show").format(count=numbers.not_shown))
    place = _("row {number:,}").format(number=numbers.place)
    parts.append(place if numbers.place else _("no row shown"))
    if not numbers.following:
        parts.append(_("{count:,} below").format(count=numbers.below))
    line = parts[0]
    for part in parts[1:]:
        if cell_len(line) + cell_len(part) + 2 > width:
            break
        line += "  " + part
    return fit(line, width)


def _parts(numbers: StatusCounters) -> list[str]:
    per_s = numbers.frames_per_s
    rate = [] if per_s is None else [_("{rate:>6,.0f} frames/s").format(rate=per_s)]
    malformed = _("{count:>6,} malformed {share:>6}").format(
        count=numbers.malformed, share=_share(numbers, 2)
    )
    return [_("{count:>9,} rows").format(count=numbers.rows), *rate, malformed]


def _short_parts(numbers: StatusCounters) -> list[str]:
    """The same in few cells, the rate last."""
    rate = [] if numbers.frames_per_s is None else [f"{numbers.frames_per_s:>5,.0f}/s"]
    malformed = _("{count:>5,} bad {share:>5}").format(
        count=numbers.malformed, share=_share(numbers, 1)
    )
    return [_("{count:>9,} rows").format(count=numbers.rows), malformed, *rate]


def _share(numbers: StatusCounters, digits: int) -> str:
    share, least = numbers.malformed_share, 10.0 ** -(digits + 2)
    if 0 < share < least:
        return f"<{least:.{digits}%}"
    return f"{share:.{digits}%}" if share < 1 else "100%"


class StatusLine(Widget):
    """The bottom line."""

    def __init__(self) -> None:
        super().__init__()
        self._numbers: StatusCounters | None = None

    def show(self, numbers: StatusCounters) -> None:
        """Draw these, if they are not what is drawn."""
        if numbers != self._numbers:
            self._numbers = numbers
            self.refresh()

    def render(self) -> Text:
        """The line."""
        if self._numbers is None:
            return Text()
        return Text(status_text(self._numbers, self.size.width), no_wrap=True, overflow="crop")


GAP = 1
"""Cells between two keys."""


def fitting(keys: Iterable[Binding], width: int) -> list[Binding]:
    """The most important of these keys that stand side by side, whole, in so many cells."""
    found, room = [], width + GAP
    for key in sorted(keys, key=_rank):
        taken = GAP + cell_len(_words(key))
        if taken <= room:
            found.append(key)
            room -= taken
    return found


def _rank(key: Binding) -> int:
    """Keys of a field, which no table knows, come first."""
    return SHOWN_FIRST.index(key.action) if key.action in SHOWN_FIRST else -1


def _words(key: Binding) -> str:
    return f"{key_names(key)} {key.description}"


class KeyLine(Widget):
    """The keys at the bottom; one that is clicked is pressed."""

    COMPONENT_CLASSES: ClassVar[set[str]] = {"key-line--key"}

    def on_mount(self) -> None:
        """Change with the keys that can be pressed."""
        self.screen.bindings_updated_signal.subscribe(self, lambda _screen: self.refresh())

    def _fitting(self) -> Sequence[Binding]:
        active = self.screen.active_bindings.values()
        by_action = {one.binding.action: one.binding for one in active if one.binding.show}
        return fitting(by_action.values(), self.size.width)

    def render(self) -> Text:
        """The line."""
        style = self.get_component_rich_style("key-line--key", partial=True)
        keys = [
            Text.assemble((key_names(key), style), " ", key.description) for key in self._fitting()
        ]
        line = Text(" " * GAP).join(keys)
        line.no_wrap, line.overflow = True, "crop"
        return line

    def on_click(self, event: Click) -> None:
        """Press the key that was clicked."""
        event.stop()
        end = 0
        for key in self._fitting():
            start, end = end, end + cell_len(_words(key))
            if start <= event.x < end:
                self.app.simulate_key(key.key)
                return
            end += GAP
