"""The search for findings in the rows of a view."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

from fte_sniff.analysis.findings import Finding, Findings
from fte_sniff.analysis.model import StreamChange
from fte_sniff.analysis.whole.store import STEP_ROWS, RowStore
from fte_sniff.errors import TranslatableText
from fte_sniff.protocol import Gap, PortEvent
from fte_sniff.protocol.items import BaudChange

RECENT_NS: Final = 300_000_000_000
"""The last time of a capture, in which findings are looked for alone: what is rare in hours may
stand out there."""


class Examined(NamedTuple):
    """The findings, best first, and what could not be examined."""

    findings: Sequence[Finding]
    coverage: Sequence[TranslatableText]


class Examiner:
    """Counts the rows of a store as they come, and looks for findings; used by one thread."""

    def __init__(self, store: RowStore) -> None:
        self._store, self._findings = store, Findings.of_facts()
        self._done = self._marks = 0
        """Rows and marks of the store that are counted."""

    def search(self, *, lives: bool) -> Examined:
        """Count what is new, and look for findings; `lives` is whether rows may follow."""
        store, findings = self._store, self._findings
        end, marks = store.known, store.marks[self._marks :]
        self._marks += len(marks)
        findings.observe_events([one.what for one in marks if isinstance(one.what, PortEvent)])
        for start in range(self._done, end, STEP_ROWS):
            stop = min(end, start + STEP_ROWS)
            changes = [
                StreamChange(one.index - start, one.what)
                for one in store.marks
                if start <= one.index < stop and isinstance(one.what, Gap | BaudChange)
            ]
            findings.observe(store.batch(start, stop), changes)
        self._done, findings.grows = end, lives
        found, _recent = findings.found_and_recent(RECENT_NS if lives else 0)
        return Examined(found, findings.coverage(found))
