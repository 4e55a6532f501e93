"""Owns the bottom line of keys: those that can be pressed now, the most important first, all whole.

It must not know what a key does, nor any key; `keys` does.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import ClassVar

from rich.cells import cell_len
from rich.text import Text
from textual.binding import Binding
from textual.events import Click
from textual.widget import Widget

from fte_sniff.tui.keys import SHOWN_FIRST, key_names

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
