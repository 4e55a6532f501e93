"""The page of findings: the spans of time in which something is wrong, best first."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import tzinfo
from typing import ClassVar

from rich.style import Style
from rich.text import Text

from fte_sniff.analysis.findings import Finding
from fte_sniff.errors import TranslatableText
from fte_sniff.formats.cell_text import clock_text, wrap
from fte_sniff.i18n import _
from fte_sniff.protocol import Status
from fte_sniff.tui.pages import CHOSEN, LINE, Context, Page


def span_of(finding: Finding, zone: tzinfo) -> str:
    """The first and the last time of a finding."""
    first, last = (clock_text(t_ns, 0, zone)[:8] for t_ns in (finding.first_ns, finding.last_ns))
    return f"{first} - {last}"


class FindingsPage(Page):
    """The findings about all rows so far."""

    NAME = "findings"
    SHORT: ClassVar[bool] = True

    def __init__(self) -> None:
        self.found: Sequence[Finding] = ()
        self.coverage: Sequence[TranslatableText] = (
            TranslatableText("the search has not ended yet"),
        )
        """What could not be examined, or if nothing was found, what was examined."""
        self.at = 0

    @property
    def chosen(self) -> Finding | None:
        """The finding to which enter leads; None without findings."""
        return self.found[self.at] if self.found else None

    def take(self, found: Sequence[Finding], coverage: Sequence[TranslatableText]) -> None:
        """Replace the findings; the chosen one stays chosen if a new one continues it."""
        before, self.found, self.coverage = self.chosen, found, coverage
        continued = (at for at, one in enumerate(found) if before and one.continues(before))
        self.at = next(continued, max(0, min(self.at, len(found) - 1)))

    def move(self, by: int) -> bool:
        """Choose the next finding, or the one before."""
        self.at = max(0, min(self.at + by, len(self.found) - 1))
        return bool(self.found)

    def titles(self, context: Context) -> Sequence[str]:
        """Their number, and what enter does."""
        if not self.found:
            return [_("findings")]
        title = _("findings: {count}", count=len(self.found))
        return [f"{title}   {_('enter: its rows   J K: another')}", title]

    def text(self, context: Context) -> Text:
        """The findings, and what could not be examined."""
        width, palette = context.size.width, context.palette
        lines = []
        for number, one in enumerate(self.found):
            when = span_of(one, context.zone)
            indent = len(when) + 4
            first, *more = wrap(_(one.text), max(20, width - indent)) or [""]
            is_chosen = number == self.at
            line = Text(">" if is_chosen else " ").append(" ")
            line.append(when, CHOSEN if is_chosen else palette.muted).append("  ")
            line.append(first, palette.statuses[Status.MALFORMED])
            own = [
                line,
                *(Text(" " * indent + text, palette.statuses[Status.MALFORMED]) for text in more),
            ]
            for part in own:
                part.stylize(Style(meta={LINE: number}))
            lines += own
        remarks = [line for one in self.coverage for line in wrap(_(one), width)]
        return Text("\n").join([*lines, *(Text(line, palette.muted) for line in remarks)])
