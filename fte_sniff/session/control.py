"""What a capture sends to its view: its state, whenever that has changed; never rows.

The view shows the last one. What it sends itself is one line: the request to stop.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Final

from fte_sniff.errors import FteSniffError, TranslatableText
from fte_sniff.recording.recorder import Outcome

REPORTED_LEFTOVER: Final = 2**20
"""This many waiting bytes take over a second to write, and are reported."""


@dataclass(frozen=True, slots=True)
class CaptureState:
    """State of a capture."""

    recordings: tuple[Path, ...] = ()
    """All files of the recording, in order; several after rotation or a failed write. They go with
    the program where the user wants none. Empty until the ports and the first one are open."""
    recording: Path | None = None
    """The current file; None while no file can be made."""
    device: str | None = None
    """The device that host programs open, for a bridge."""
    error: FteSniffError | None = None
    """The latest error of the recording; at the end, what failed in all."""
    is_ended: bool = False
    """Whether the capture is over and its file is closed."""
    reason: str | None = None
    """Why it ended, in one line; None if it was requested."""
    outcome: Outcome | None = None
    """What was recorded, once the capture process has ended by itself."""
    rows: int = 0
    """All rows so far."""
    unrecorded: int = 0
    """Rows of them that are not in the file yet."""
    waiting: int = 0
    """Bytes that were read and are in no row yet."""
    is_slow: bool = False
    """Whether a write takes long."""
    is_ending: bool = False
    """Whether no more bytes are read."""
    bytes: int = 0
    """Size of all files."""
    turns: int = 0
    """How often the capture has looked for bytes; it grows on a silent line too."""

    @property
    def started(self) -> bool:
        """Whether the ports and the recording are open."""
        return bool(self.recordings)

    @property
    def remaining(self) -> TranslatableText:
        """What is not in the file yet: `512 rows and 1,024 bytes not yet in rows`."""
        rows = TranslatableText("{rows:,} rows", rows=self.unrecorded)
        if not self.waiting:
            return rows
        return TranslatableText(
            "{rows} and {bytes:,} bytes not yet in rows", rows=rows, bytes=self.waiting
        )

    @property
    def backlog(self) -> TranslatableText | None:
        """What the end waits for; None if nothing."""
        if self.is_slow and self.is_ending:
            return TranslatableText(
                "writing is slow, as the disk or the processor is busy: {what} are not written yet",
                what=self.remaining,
            )
        if self.is_ending and self.waiting >= REPORTED_LEFTOVER:
            return TranslatableText(
                "writing received data: {bytes:,} bytes left", bytes=self.waiting
            )
        return None
