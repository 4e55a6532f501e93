"""Owns what a capture is to do, in a form that can be handed to another process.

It must not know how it is done.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from fte_sniff.capture.source import Wiring
from fte_sniff.recording.output_file import Existing
from fte_sniff.recording.retention import Keeping


@dataclass(frozen=True, slots=True)
class CapturePlan:
    """One capture."""

    wiring: Wiring
    """Which ports to open, and how."""
    recording: Path | None
    """Where to record to; None to record nothing."""
    existing: Existing = Existing.REFUSE
    """What to do when the recording's file is there already."""
    keeping: Keeping = field(default_factory=Keeping)
    """What the recording is to keep, and how much of the disk it may take."""
    trigger: str | None = None
    """A filter: the rows whose surroundings are kept; None to keep all."""
    outlives_view: bool = False
    """Whether to go on when the view is killed or its terminal gone; not when it asks to end."""
    duration_s: float | None = None
    """End after so many seconds; None, or infinity, to go on."""
    count: int | None = None
    """End after so many rows; None to go on."""
