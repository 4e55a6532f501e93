"""Base class of the controllers, and the parts of the screen that they change."""

from __future__ import annotations

from dataclasses import dataclass

from fte_sniff.tui.focus import Focus
from fte_sniff.tui.options import StartOptions
from fte_sniff.tui.panes.pane import Body
from fte_sniff.tui.panes.switcher import PaneSwitcher
from fte_sniff.tui.status_bar import NoticeLine
from fte_sniff.tui.table import RowTable
from fte_sniff.tui.view_model import ViewModel


@dataclass(frozen=True, slots=True)
class Parts:
    """The parts of the screen that commands change."""

    options: StartOptions
    model: ViewModel
    table: RowTable
    panes: PaneSwitcher
    body: Body
    focus: Focus
    notice: NoticeLine


class ScreenController:
    """What the commands about one concern do: a method `action_...` for each."""

    def __init__(self, parts: Parts) -> None:
        self._options, self._model, self._table = parts.options, parts.model, parts.table
        self._panes, self._body, self._focus = parts.panes, parts.body, parts.focus
        self._notice, self._store = parts.notice, parts.model.store
