"""Owns what the capture process tells the process of the view, and the words that go back.

It must not know how messages travel. All of them can be pickled.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Final, TypeAlias

from fte_sniff.errors import FteSniffError
from fte_sniff.protocol import PortEvent, Row
from fte_sniff.recording.recorder import Change, Outcome

STOP: Final = "stop"
"""End the capture, and close its file."""

DROP: Final = "drop"
"""Behind STOP: do not write what still waits to be written, but count it."""


@dataclass(frozen=True, slots=True)
class Started:
    """The port is open, and so is the recording if there is one."""

    recording: Path | None
    """Where the recording lies, which may have become another name than the plan's."""
    device: str | None = None
    """What a host program is to open, where this is a bridge."""


@dataclass(frozen=True, slots=True)
class Batch:
    """What has come since the batch before."""

    rows: list[Row]
    events: list[PortEvent]
    total_rows: int
    """All rows captured so far."""
    not_shown: int
    """Rows captured and recorded, but dropped on the way because the view was too slow."""
    recording: tuple[Change, ...] = ()
    """What became of the recording meanwhile."""
    leftover: int = 0
    """Bytes that waited to be written when the reading ended, where these are many."""


@dataclass(frozen=True, slots=True)
class Ended:
    """The capture is over and its file is closed; nothing comes after this."""

    reason: str | None = None
    """Why, one line for people; None where it was asked to end."""
    error: FteSniffError | None = None
    """What went wrong, if something did."""
    outcome: Outcome | None = None
    """What there is of the recording, if there is one."""


Message: TypeAlias = Started | Batch | Ended
