"""Findings pane: the spans of time in which something is wrong, best first."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from datetime import tzinfo

from rich.text import Text

from fte_sniff.analysis.findings import Finding
from fte_sniff.errors import TranslatableText
from fte_sniff.formats.cell_text import clock_text, wrap
from fte_sniff.protocol import Status
from fte_sniff.tui.i18n import _, later
from fte_sniff.tui.painter import REVERSED, Palette
from fte_sniff.tui.panes.pane import HINT as PANE_HINT
from fte_sniff.tui.panes.pane import Pane, PaneContext

CHOSEN = ">"
"""Sign of the finding to which enter leads."""


def span_of(finding: Finding, zone: tzinfo) -> str:
    """The first and the last time of a finding."""
    first, last = (clock_text(t_ns, 0, zone)[:8] for t_ns in (finding.first_ns, finding.last_ns))
    return f"{first} - {last}"


def finding_lines(
    finding: Finding, width: int, palette: Palette, zone: tzinfo, *, chosen: bool = False
) -> Iterator[Text]:
    """A line, or several where it is long, of a finding."""
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
        self._found: Sequence[Finding] = ()
        self._chosen = 0
        self._moved = False
        """Whether another finding was chosen since the last drawing."""
        self.add_class("-row")

    @property
    def chosen(self) -> Finding | None:
        """The finding to which enter leads; None without findings."""
        return self._found[self._chosen] if self._found else None

    @property
    def hint(self) -> str:
        """Without findings, none can be chosen."""
        return self.HINT if self._found else PANE_HINT

    def scroll_lines(self, by: int) -> None:
        """Choose the next finding (`by` 1) or the one before (-1)."""
        self._chosen = max(0, min(self._chosen + by, len(self._found) - 1))
        self._moved = True

    def draw(self, context: PaneContext) -> None:
        """Draw the findings, and what could not be examined."""
        self._take(context.models.found)
        self.set_title(_("findings: {count}", count=len(self._found)), _("findings"))
        width, palette = self.page_size.width, context.palette
        parts = [
            list(finding_lines(one, width, palette, context.zone, chosen=one is self.chosen))
            for one in self._found
        ]
        coverage = context.models.coverage
        if coverage is None:
            coverage = (TranslatableText("the search has not ended yet"),)
        remarks = [Text(line, palette.muted) for one in coverage for line in wrap(_(one), width)]
        lines = [line for part in (*parts, remarks) for line in part]
        self.set_page(Text("\n").join(lines))
        if self._moved:
            self._moved = False
            start, end = (sum(map(len, parts[:at])) for at in (self._chosen, self._chosen + 1))
            is_last = self._chosen + 1 >= len(parts)
            self.call_after_refresh(self._show_lines, start, len(lines) if is_last else end)

    def _take(self, found: Sequence[Finding]) -> None:
        """Replace the findings; the chosen one stays chosen if a new one continues it."""
        before, self._found = self.chosen, found
        continued = (at for at, one in enumerate(found) if before and one.continues(before))
        self._chosen = next(continued, max(0, min(self._chosen, len(found) - 1)))

    def _show_lines(self, start: int, end: int) -> None:
        """Scroll until these lines can be seen, the first one in any case."""
        top, height = round(self.scroll_y), self.page_size.height
        self.scroll_to(y=min(max(top, end - height), start), animate=False)
