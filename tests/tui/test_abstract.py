"""What only a part of the screen can know is not forgotten in one."""

from __future__ import annotations

import pytest

from fte_sniff.tui.actions import Parts
from fte_sniff.tui.panes.pane import Pane
from fte_sniff.tui.table.widget import Scrolling


@pytest.mark.parametrize(
    ("unfinished", "arguments"), [(Parts, ()), (Pane, ("keys",)), (Scrolling, ())]
)
def test_a_class_that_leaves_something_open_makes_nothing(
    unfinished: type[object], arguments: tuple[str, ...]
) -> None:
    with pytest.raises(TypeError, match="abstract"):
        unfinished(*arguments)
