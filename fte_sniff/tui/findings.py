"""The page of findings: the spans of time in which something is wrong, best first."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import tzinfo
from typing import ClassVar

from rich.table import Table
from rich.text import Text

from fte_sniff.analysis.findings import Finding
from fte_sniff.errors import TranslatableText
from fte_sniff.formats.cell_text import clock_text
from fte_sniff.i18n import _
from fte_sniff.protocol.spec import Status
from fte_sniff.tui.pages import Context, ListPage, text_of
from fte_sniff.tui.painter import REVERSED


def span_of(finding: Finding, zone: tzinfo) -> str:
    """The first and the last time of a finding."""
    first, last = (clock_text(t_ns, 0, zone)[:8] for t_ns in (finding.first_ns, finding.last_ns))
    return f"{first} - {last}"


class FindingsPage(ListPage[Finding]):
    """The findings about all rows so far."""

    NAME = "findings"
    SHORT: ClassVar[bool] = True

    def __init__(self) -> None:
        super().__init__()
        self.coverage: Sequence[TranslatableText] = (
            TranslatableText("the search has not ended yet"),
        )
        """What could not be examined, or if nothing was found, what was examined."""

    def take(self, found: Sequence[Finding], coverage: Sequence[TranslatableText]) -> None:
        """Replace the findings; the chosen one stays chosen if a new one continues it."""
        before, self.listed, self.coverage = self.chosen, found, coverage
        continued = (at for at, one in enumerate(found) if before and one.continues(before))
        self.choose(next(continued, self.at))

    def title(self, context: Context) -> str:
        """Their number, and what enter does."""
        title = _("findings: {count}", count=len(self.listed)) if self.listed else _("findings")
        return f"{title}   {_('enter: its rows   J K: another')}" if self.listed else title

    def text(self, context: Context) -> Text:
        """The findings, and what could not be examined."""
        palette, table = context.table.palette, Table.grid(padding=(0, 2, 0, 0))
        wrong = palette.statuses[Status.MALFORMED]
        for number, one in enumerate(self.listed):
            is_chosen = number == self.at
            sign, when = ">" if is_chosen else " ", span_of(one, context.table.look.shown_zone)
            look = REVERSED if is_chosen else palette.muted
            table.add_row(sign, Text(when, look), Text(_(one.text), wrong), style=self.meta(number))
        remarks = (Text(_(one), palette.muted) for one in self.coverage)
        return text_of(table, *remarks, width=context.size.width)
