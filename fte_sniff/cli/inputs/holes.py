"""Owns where rows are missing between those that come, though no input tells how many.

It must not know how that is found out, nor what is made of it.
"""

from __future__ import annotations

from fte_sniff.recording.metadata import Stretch

DAMAGED = "the recording was damaged here"
ANOTHER = "another recording begins here"


class Holes:
    """Watches the rows on their way."""

    def __init__(self, found: list[Stretch]) -> None:
        """No row came yet; what is missing is put into `found`."""
        self.found = found
        self._reason = ""
        self._last_ns: int | None = None

    def open(self, reason: str) -> None:
        """Rows are missing behind those that came, if others come."""
        self._reason = reason

    def look(self, times: tuple[int, int] | None) -> None:
        """Rows came: the time of the first of them, and the latest."""
        if times is None:
            return
        first_ns, last_ns = times
        before_ns = self._last_ns
        if self._reason and before_ns is not None and first_ns - before_ns > 1:
            self.found.append(Stretch(None, before_ns + 1, first_ns - 1, self._reason))
        self._reason = ""
        self._last_ns = last_ns if before_ns is None else max(before_ns, last_ns)
