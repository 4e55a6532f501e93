"""What the parts of the screen that answer keys share."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from fte_sniff.tui.line import CommandLine
from fte_sniff.tui.options import StartOptions
from fte_sniff.tui.status import StatusLine
from fte_sniff.tui.table import RowTable
from fte_sniff.tui.view import View

if TYPE_CHECKING:
    from fte_sniff.analysis.findings import Finding


@dataclass(frozen=True, slots=True)
class Parts:
    """The parts of the screen that keys change."""

    options: StartOptions
    view: View
    table: RowTable
    line: CommandLine
    status: StatusLine
    look_at: Callable[[Finding | None], None]
    """Looks at the span of a finding, or no longer."""
