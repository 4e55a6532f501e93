"""What the parts of the screen that answer keys share."""

from __future__ import annotations

from dataclasses import dataclass

from fte_sniff.tui.line import CommandLine
from fte_sniff.tui.options import StartOptions
from fte_sniff.tui.status import StatusLine
from fte_sniff.tui.table import RowTable
from fte_sniff.tui.view import View


@dataclass(frozen=True, slots=True)
class Parts:
    """The parts of the screen that keys change."""

    options: StartOptions
    view: View
    table: RowTable
    line: CommandLine
    status: StatusLine
