"""Title line at the top, status line and key line at the bottom."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import ClassVar

from rich.cells import cell_len
from rich.text import Text
from textual.binding import Binding
from textual.events import Click
from textual.reactive import reactive
from textual.widget import Widget

from fte_sniff.analysis.feed import FeedState
from fte_sniff.errors import printable
from fte_sniff.formats.cell_text import fit, fit_path
from fte_sniff.tui.i18n import _
from fte_sniff.tui.keys import SHOWN_FIRST, key_names

NAME = "fte-sniff"


class Mode(StrEnum):
    """What the view does, as an English word."""

    LOADING = "LOADING"
    LIVE = "LIVE"
    WAITING = "WAITING"
    SCROLLED = "SCROLLED"
    PAUSED = "PAUSED"
    ENDED = "ENDED"
    FILE = "FILE"


def mode_of(state: FeedState, paused: bool, following: bool) -> Mode:
    """The mode of a view: LIVE only while the newest rows are in view; WAITING for a lost port."""
    if paused:
        return Mode.PAUSED
    if state.live and state.running:
        newest = Mode.WAITING if state.waiting else Mode.LIVE
        return newest if following else Mode.SCROLLED
    if state.live:
        return Mode.ENDED
    return Mode.LOADING if state.running else Mode.FILE


def badge_text(state: FeedState, mode: Mode, unseen: int) -> str:
    """The mode at the end of the title line."""
    words = _(mode)
    if mode is Mode.PAUSED:
        words = _("PAUSED, {count:,} new").format(count=unseen)
    elif mode is Mode.SCROLLED:
        words = _("SCROLLED +{count:,}").format(count=unseen)
    elif mode is Mode.LOADING and state.progress is not None:
        words = _("LOADING {share:4.0%}").format(share=state.progress)
    return f" {words} "


def title_text(state: FeedState, mode: Mode, unseen: int, width: int) -> str:
    """The title line in exactly `width` cells; names are cut before the mode is.

    `unseen` is the number of rows since a pause, or below the window.
    """
    badge = badge_text(state, mode, unseen)
    left = max(0, width - cell_len(badge))
    names = f" {printable(state.title)}"
    if cell_len(names) + cell_len(NAME) + 2 < left:
        names = f" {NAME} {names}"
    if state.recording is not None:
        lead = "  " + _("rec") + " "
        rest = left - cell_len(names) - cell_len(lead) - 1
        path = printable(state.recording)
        shortest = min(cell_len(path), 16)
        if rest < shortest:
            names = fit(names, max(0, left - cell_len(lead) - 1 - shortest)).rstrip()
            rest = left - cell_len(names) - cell_len(lead) - 1
        names += f"{lead}{fit_path(path, rest)}"
    return fit(names, left) + badge


class TitleLine(Widget):
    """The line at the top."""

    def __init__(self) -> None:
        super().__init__()
        self._shown: tuple[FeedState, Mode, int] | None = None
        self._line = ""

    def show(self, state: FeedState, mode: Mode, unseen: int) -> None:
        """Draw a changed state."""
        self._shown = (state, mode, unseen)
        line = title_text(state, mode, unseen, self.size.width)
        if line != self._line:
            self._line = line
            self.set_class(mode is Mode.PAUSED, "-paused")
            self.set_class(mode in (Mode.ENDED, Mode.WAITING), "-ended")
            self.refresh()

    def render(self) -> Text:
        """The line, with the mode highlighted at its end."""
        if self._shown is None:
            return Text()
        state, mode, unseen = self._shown
        line = title_text(state, mode, unseen, self.size.width)
        text = Text(line, no_wrap=True, overflow="crop")
        text.stylize("bold reverse", max(0, len(line) - len(badge_text(state, mode, unseen))))
        return text


WIDE = 72
"""Cells from which on words are not abbreviated."""


@dataclass(frozen=True, slots=True)
class StatusCounters:
    """Numbers of the status line."""

    rows: int
    """All rows of the feed."""
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
    """Rows below the window."""
    line_errors: int = 0
    """Errors that UARTs reported."""
    hits: str = ""
    """Text about the hits of the search."""


def status_text(numbers: StatusCounters, width: int) -> str:
    """The status line in exactly `width` cells; the last numbers are left out first."""
    parts = _parts(numbers, abbreviated=width < WIDE)
    if numbers.hits:
        parts.insert(1, numbers.hits)
    if numbers.line_errors:
        parts.append(_("{count:,} line errors").format(count=numbers.line_errors))
    if numbers.not_shown:
        parts.append(_("{count:,} too fast to show").format(count=numbers.not_shown))
    row = _("row {number:,}").format(number=numbers.row_number)
    parts.append(row if numbers.row_number else _("no row shown"))
    if not numbers.following:
        parts.append(_("{count:,} below").format(count=numbers.below))
    line = parts[0]
    for part in parts[1:]:
        if cell_len(line) + cell_len(part) + 2 > width:
            break
        line += "  " + part
    return fit(line, width)


def _parts(numbers: StatusCounters, *, abbreviated: bool) -> list[str]:
    """Rows, rate and malformed rows; abbreviated, the rate is the last."""
    malformed = _("{count:>6,} malformed {share:>6}")
    if abbreviated:
        malformed = _("{count:>5,} bad {share:>5}")
    share = _share_text(numbers.malformed_share, 1 if abbreviated else 2)
    parts = [
        _("{count:>9,} rows").format(count=numbers.rows),
        malformed.format(count=numbers.malformed, share=share),
    ]
    if abbreviated and numbers.frames_per_s is not None:
        parts.append(f"{numbers.frames_per_s:>5,.0f}/s")
    elif numbers.frames_per_s is not None:
        parts.insert(1, _("{rate:>6,.0f} frames/s").format(rate=numbers.frames_per_s))
    return parts


def _share_text(share: float, digits: int) -> str:
    least = 10.0 ** -(digits + 2)
    if 0 < share < least:
        return f"<{least:.{digits}%}"
    return f"{share:.{digits}%}" if share < 1 else "100%"


class StatusLine(Widget):
    """The line of numbers at the bottom."""

    numbers: reactive[StatusCounters | None] = reactive(None)

    def render(self) -> Text:
        """The line."""
        line = status_text(self.numbers, self.size.width) if self.numbers else ""
        return Text(line, no_wrap=True, overflow="crop")


GAP = 1
"""Cells between two keys."""


def fitting_keys(keys: Iterable[Binding], width: int) -> list[Binding]:
    """The most important keys that fit into `width` cells."""
    found, left = [], width + GAP
    for key in sorted(keys, key=_rank):
        cells = GAP + cell_len(_key_text(key))
        if cells <= left:
            found.append(key)
            left -= cells
    return found


def _rank(key: Binding) -> int:
    """Keys that are not in `SHOWN_FIRST`, those of a field, come first."""
    return SHOWN_FIRST.index(key.action) if key.action in SHOWN_FIRST else -1


def _key_text(key: Binding) -> str:
    return f"{key_names(key)} {key.description}"


class KeyLine(Widget):
    """The most important keys, in place of Textual's Footer; a clicked key is pressed."""

    COMPONENT_CLASSES: ClassVar[set[str]] = {"key-line--key"}

    def on_mount(self) -> None:
        """Follow the bindings that are active."""
        self.screen.bindings_updated_signal.subscribe(self, lambda _screen: self.refresh())

    def _fitting(self) -> Sequence[Binding]:
        active = self.screen.active_bindings.values()
        by_action = {one.binding.action: one.binding for one in active if one.binding.show}
        return fitting_keys(by_action.values(), self.size.width)

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
            start, end = end, end + cell_len(_key_text(key))
            if start <= event.x < end:
                self.app.simulate_key(key.key)
                return
            end += GAP
