"""Messages of the capture process and the state folded from them."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import reduce
from pathlib import Path
from typing import Final, TypeAlias

from fte_sniff.analysis.feed import FeedState
from fte_sniff.capture.source import Wiring
from fte_sniff.errors import FteSniffError, TranslatableText
from fte_sniff.protocol import PortEvent, PortEventKind, Row
from fte_sniff.recording.output_file import Existing
from fte_sniff.recording.recorder import Change, Outcome
from fte_sniff.recording.retention import RecordingOptions

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
class RowsMessage:
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


Message: TypeAlias = Started | RowsMessage | Ended


@dataclass(frozen=True, slots=True)
class CaptureState:
    """What a capture has told."""

    names: tuple[str, ...]
    """The ports, as they were asked for."""
    begun: bool = False
    """Whether the port is open, and the recording if there is to be one."""
    ended: Ended | None = None
    """How it ended, once it has."""
    error: FteSniffError | None = None
    """What went wrong, once it has: with the port, the recording, or the capture process."""
    recording: Path | None = None
    """Where the recording lies; None where there is none, or it has stopped."""
    recordings: tuple[Path, ...] = ()
    """All files that it was written to, in order; more than one where it was rotated or went on
    elsewhere."""
    stopped_recording: FteSniffError | None = None
    """Why the recording stopped last, once it has; `error` tells at the end what that cost."""
    device: str | None = None
    """What a host program is to open, where this is a bridge."""
    total_rows: int = 0
    """All rows captured so far."""
    not_shown: int = 0
    """Rows recorded but not handed over, because the view was too slow for them."""
    leftover: int = 0
    """Bytes that waited to be written when the reading ended, where these are many."""
    away: frozenset[str] = frozenset()
    """The ports that are lost at present, and waited for."""

    @property
    def outcome(self) -> Outcome | None:
        """What there is of the recording, once the capture has ended of itself."""
        return self.ended.outcome if self.ended is not None else None

    def after(self, message: Message) -> CaptureState:
        """What is known after one more message."""
        if isinstance(message, Ended):
            return replace(self, ended=message, error=message.error)
        if isinstance(message, Started):
            return replace(
                self,
                begun=True,
                recording=message.recording,
                recordings=() if message.recording is None else (message.recording,),
                device=message.device,
            )
        return reduce(CaptureState._after_change, message.recording, self._after_batch(message))

    def _after_batch(self, batch: RowsMessage) -> CaptureState:
        return replace(
            self,
            total_rows=batch.total_rows,
            not_shown=batch.not_shown,
            leftover=batch.leftover,
            away=reduce(_away_after, batch.events, self.away),
        )

    def _after_change(self, change: Change) -> CaptureState:
        return replace(
            self,
            recording=change.path,
            recordings=self.recordings + (() if change.path is None else (change.path,)),
            stopped_recording=change.failure or self.stopped_recording,
            error=change.failure or self.error,
        )

    @property
    def state(self) -> FeedState:
        """The same for a view."""
        ended = self.ended
        return FeedState(
            title=self._title(),
            recording=str(self.recording) if self.recording else None,
            running=ended is None,
            waiting=ended is None and bool(self.away),
            ended=(ended.reason or TranslatableText("stopped")) if ended else None,
            trouble=self._trouble() if ended is None else None,
            rows=self.total_rows,
            not_shown=self.not_shown,
            files=tuple(map(str, self.recordings)),
            leftover=self.leftover,
        )

    def _title(self) -> str:
        if self.device is not None:
            # Whoever looks wants to know what the host program is to open.
            return f"{self.names[0]} + {self.device}"
        return " + ".join(self.names)

    def _trouble(self) -> str | None:
        if self.error is None:
            if not self.leftover:
                return None
            return TranslatableText(
                "writing what has arrived: {bytes:,} bytes wait", bytes=self.leftover
            )
        trouble = self.error.message
        if not self.recording:
            return trouble
        return TranslatableText(
            "{trouble}; recording goes on in {path}", trouble=trouble, path=self.recording
        )


def _away_after(away: frozenset[str], event: PortEvent) -> frozenset[str]:
    if event.kind is PortEventKind.LOST:
        return away | {event.port}
    if event.kind is PortEventKind.FOUND_AGAIN:
        return away - {event.port}
    return away


@dataclass(frozen=True, slots=True)
class CapturePlan:
    """One capture."""

    wiring: Wiring
    """Which ports to open, and how."""
    recording: Path | None
    """Where to record to; None to record nothing."""
    existing: Existing = Existing.REFUSE
    """What to do when the recording's file is there already."""
    keeping: RecordingOptions = field(default_factory=RecordingOptions)
    """What the recording is to keep, and how much of the disk it may take."""
    trigger: str | None = None
    """A filter: the rows whose surroundings are kept; None to keep all."""
    outlives_view: bool = False
    """Whether to go on when the view is killed or its terminal gone; not when it asks to end."""
    duration_s: float | None = None
    """End after so many seconds; None, or infinity, to go on."""
    count: int | None = None
    """End after so many rows; None to go on."""
