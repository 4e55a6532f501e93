"""Findings pane: the spans of time in which something is wrong, best first."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from datetime import tzinfo

from rich.text import Text

from fte_sniff.analysis.findings import Finding
from fte_sniff.formats.cell_text import clock_text, wrap
from fte_sniff.protocol import Status
from fte_sniff.tui.i18n import _, later
from fte_sniff.tui.panes.pane import Pane, PaneContext
from fte_sniff.tui.table.theme import REVERSED, Palette

CHOSEN = ">"
"""Sign of the finding to which enter leads."""


def span_of(finding: Finding, zone: tzinfo) -> str:
    """The first and the last time of a finding."""
    first, last = (clock_text(t_ns, 0, zone)[:8] for t_ns in (finding.first_ns, finding.last_ns))
    return f"{first} - {last}"


def findings_text(
    found: Sequence[Finding], chosen: int, width: int, palette: Palette, zone: tzinfo
) -> Text:
    """A line, or several where it is long, for each finding."""
    if not found:
        return Text(_("nothing that stands out was found so far"), style=palette.muted)
    lines: list[Text] = []
    for number, finding in enumerate(found):
        lines += _lines_of(finding, number == chosen, width, palette, zone)
    return Text("\n").join(lines)


def _lines_of(
    finding: Finding, chosen: bool, width: int, palette: Palette, zone: tzinfo
) -> Iterator[Text]:
    when = span_of(finding, zone)
    indent = len(when) + 4
    first, *more = wrap(_(finding.text), max(20, width - indent)) or [""]
    mark = CHOSEN if chosen else " "
    style = palette.statuses[Status.MALFORMED]
    line = Text.assemble(f"{mark} ", (when, REVERSED if chosen else palette.muted), "  ")
    yield line.append(first, style)
    for text in more:
        yield Text(" " * indent + text, style=style)


class FindingsPane(Pane):
    """The findings about all rows so far."""

    NAME = "findings"
    REDRAW_S = 0.5
    HINT = later("enter: its rows   J K: next   esc: close")

    def __init__(self) -> None:
        super().__init__()
        self.chosen = 0
        """Number of the finding to which enter leads."""
        self.add_class("-row")

    def scroll_lines(self, by: int) -> bool:
        """Choose the next finding (`by` 1) or the one before (-1)."""
        self.chosen = max(0, self.chosen + by)
        return True

    def draw(self, context: PaneContext) -> None:
        """Draw the list."""
        found = context.models.found
        self.chosen = min(self.chosen, max(0, len(found) - 1))
        self.set_title(_("findings: {count}", count=len(found)), _("findings"))
        width, palette = self.page_size.width, context.palette
        self.set_page_of(findings_text, found, self.chosen, width, palette, context.zone)
