"""Owns the names of what actions work on: the widgets of the screen and the watched rows.

It must not make them; the screen does. Nor does it know any key.
"""

from __future__ import annotations

from abc import abstractmethod

from textual.app import App
from textual.worker import WorkType

from fte_sniff.session.save import Saving
from fte_sniff.tui.abstract import AbstractMeta
from fte_sniff.tui.notices import NoticeLine
from fte_sniff.tui.opening import Opening
from fte_sniff.tui.panes import Panes
from fte_sniff.tui.prompt.filter import FilterField
from fte_sniff.tui.prompt.goto import GotoField
from fte_sniff.tui.prompt.save import SaveField
from fte_sniff.tui.prompt.search import SearchField
from fte_sniff.tui.table.widget import RowTable
from fte_sniff.tui.watched import Watched


class Parts(App[None], metaclass=AbstractMeta):
    """A screen whose parts have been made."""

    _opening: Opening
    _watched: Watched
    _table: RowTable
    _panes: Panes
    _notice: NoticeLine
    _filter_field: FilterField
    _goto_field: GotoField
    _search_field: SearchField
    _save_field: SaveField
    _filters_before: list[str]
    """Filters that stood before, the latest last; an empty one shows all."""
    _saving: Saving | None
    """The file that is being written, if there is one."""

    def _tell(self, words: str) -> None:
        """Tell for a while what a key did, or why it did nothing."""
        self._notice.tell(words)

    def _work(self, group: str, work: WorkType[None]) -> None:
        """Do something beside the screen; what was done in its group before ends."""
        self.run_worker(work, group=group, exclusive=True)

    @abstractmethod
    def _show_state(self) -> None:
        """Draw the lines around the table, where they changed."""

    @abstractmethod
    def _unselect(self) -> bool:
        """End the selection; whether there was one."""
