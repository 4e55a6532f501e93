"""The plan of a capture, the messages of its process, and the state they add up to."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import reduce
from pathlib import Path
from typing import Final, TypeAlias

from fte_sniff.analysis.feed import FeedState
from fte_sniff.capture.source import Wiring
from fte_sniff.errors import FteSniffError, TranslatableText
from fte_sniff.protocol import PortEvent, PortEventKind, Rows
from fte_sniff.recording.output_file import Existing
from fte_sniff.recording.recorder import Change, Outcome
from fte_sniff.recording.retention import RecordingOptions

STOP: Final = "stop"
"""Request: end the capture and close its file."""

DROP: Final = "drop"
"""Request after STOP: do not write what still waits, only count it."""


ROTATE: Final = "rotate"
"""Request: begin the next file of the recording."""


@dataclass(frozen=True, slots=True)
class Started:
    """The port and the recording, if any, are open."""

    recording: Path | None
    """Path of the recording; may differ from the plan's if that name was taken."""
    device: str | None = None
    """The device that host programs open, for a bridge."""
    waits_for_reader: bool = False
    """Whether the recording is a named pipe without a reader."""


@dataclass(frozen=True, slots=True)
class WriteProgress:
    """How far the recording is on the disk."""

    unrecorded: int = 0
    """Rows that are not in the file yet."""
    waiting: int = 0
    """Bytes that were read and are in no row yet."""
    is_slow: bool = False
    """Whether a write takes long."""
    is_end: bool = False
    bytes: int = 0
    """Size of all files."""
    fired: int | None = None
    """How often the trigger fired; None without one."""
    turns: int = 0
    """How often the capture has looked for bytes; it grows on a silent line too."""

    @property
    def remaining(self) -> TranslatableText:
        """What is not in the file yet: `512 rows and 1,024 bytes not yet in rows`."""
        rows = TranslatableText("{rows:,} rows", rows=self.unrecorded)
        if not self.waiting:
            return rows
        return TranslatableText(
            "{rows} and {bytes:,} bytes not yet in rows", rows=rows, bytes=self.waiting
        )


@dataclass(frozen=True, slots=True)
class RowsMessage:
    """Rows and events since the previous batch."""

    rows: Rows
    total_rows: int
    """All rows captured so far."""
    not_shown: int
    """Rows captured and recorded, but dropped because the view was too slow."""
    recording: tuple[Change, ...] = ()
    """Changes of the recording since the previous batch."""
    leftover: int = 0
    """Bytes still to be written when reading ended, if many; else 0."""
    progress: WriteProgress = WriteProgress()


@dataclass(frozen=True, slots=True)
class Ended:
    """The last message: the capture is over and its file is closed."""

    reason: str | None = None
    """Why it ended, in one line; None if it was requested."""
    error: FteSniffError | None = None
    outcome: Outcome | None = None
    progress: WriteProgress = WriteProgress()
    """How far the recording is; the last known if the capture was killed."""


Message: TypeAlias = Started | RowsMessage | Ended


@dataclass(frozen=True, slots=True)
class CaptureState:
    """State of a capture, folded from its messages."""

    names: tuple[str, ...]
    started: bool = False
    """True once the port and the recording, if any, are open."""
    ended: Ended | None = None
    error: FteSniffError | None = None
    """The latest error of the port, the recording or the capture process."""
    recording: Path | None = None
    """Path of the current file; None without a recording or after it stopped."""
    recordings: tuple[Path, ...] = ()
    """All files of the recording, in order; several after rotation or a failed write."""
    stopped_recording: FteSniffError | None = None
    """Why the recording last stopped; at the end `error` says what was lost."""
    device: str | None = None
    waits_for_reader: bool = False
    """Whether the recording began as a named pipe without a reader."""
    total_rows: int = 0
    not_shown: int = 0
    """Rows recorded but not sent, because the view was too slow."""
    leftover: int = 0
    progress: WriteProgress = WriteProgress()
    lost: frozenset[str] = frozenset()
    """Ports that are currently lost and waited for."""

    @property
    def outcome(self) -> Outcome | None:
        """What was recorded, once the capture process has ended by itself."""
        return self.ended.outcome if self.ended is not None else None

    def after(self, message: Message) -> CaptureState:
        """The state after one more message."""
        if isinstance(message, Ended):
            return replace(self, ended=message, error=message.error, progress=message.progress)
        if isinstance(message, Started):
            return replace(
                self,
                started=True,
                recording=message.recording,
                recordings=() if message.recording is None else (message.recording,),
                device=message.device,
                waits_for_reader=message.waits_for_reader,
            )
        return reduce(CaptureState._after_change, message.recording, self._after_batch(message))

    def _after_batch(self, batch: RowsMessage) -> CaptureState:
        return replace(
            self,
            total_rows=batch.total_rows,
            not_shown=batch.not_shown,
            leftover=batch.leftover,
            progress=batch.progress,
            lost=reduce(_lost_ports, batch.rows.events, self.lost),
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
    def feed_state(self) -> FeedState:
        """The state as a feed shows it."""
        ended = self.ended
        return FeedState(
            title=self._title(),
            recording=str(self.recording) if self.recording else None,
            running=ended is None,
            waiting=ended is None and bool(self.lost),
            ended=(ended.reason or TranslatableText("stopped")) if ended else None,
            trouble=self._trouble() if ended is None else None,
            rows=self.total_rows,
            not_shown=self.not_shown,
            files=tuple(map(str, self.recordings)),
            recorded_bytes=self.progress.bytes,
            fired=self.progress.fired,
        )

    def _title(self) -> str:
        if self.device is not None:
            # A bridge shows the device that the host program opens.
            return f"{self.names[0]} + {self.device}"
        return " + ".join(self.names)

    @property
    def is_write_slow(self) -> bool:
        """Whether the end waits for a write."""
        return self.progress.is_slow and self.progress.is_end

    @property
    def backlog(self) -> str | None:
        """What the end waits for; None if nothing."""
        if self.is_write_slow:
            return TranslatableText(
                "writing is slow, as the disk or the processor is busy: {what} are not written yet",
                what=self.progress.remaining,
            )
        if self.leftover:
            return TranslatableText(
                "writing received data: {bytes:,} bytes left", bytes=self.leftover
            )
        return None

    def _trouble(self) -> str | None:
        if self.error is None:
            return self.backlog
        trouble = self.error.message
        if not self.recording:
            return trouble
        return TranslatableText(
            "{trouble}; recording goes on in {path}", trouble=trouble, path=self.recording
        )


def _lost_ports(lost: frozenset[str], event: PortEvent) -> frozenset[str]:
    if event.kind is PortEventKind.LOST:
        return lost | {event.port}
    if event.kind is PortEventKind.FOUND_AGAIN:
        return lost - {event.port}
    return lost


@dataclass(frozen=True, slots=True)
class CapturePlan:
    """What to capture and how to record it."""

    wiring: Wiring
    recording: Path | None
    """Path of the recording; None to record nothing."""
    existing: Existing = Existing.REFUSE
    recording_options: RecordingOptions = field(default_factory=RecordingOptions)
    trigger: str | None = None
    """A filter: only rows around matching rows are recorded; None to record all."""
    outlives_view: bool = False
    """Continue if the view is killed or its terminal is closed; a STOP still ends it."""
    duration_s: float | None = None
    """End after this many seconds; None or infinity for no limit."""
    count: int | None = None
    """End after this many rows; None for no limit."""
