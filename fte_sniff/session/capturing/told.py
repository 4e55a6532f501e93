"""Owns what a view knows of a capture by now: the messages so far, as one value.

It must not know how messages travel, nor how a capture process is started or ended.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import reduce
from pathlib import Path

from fte_sniff.analysis.feed import FeedState
from fte_sniff.errors import FteSniffError, Said
from fte_sniff.protocol import PortEvent, PortEventKind
from fte_sniff.recording.recorder import Change, Outcome
from fte_sniff.session.capturing.messages import Batch, Ended, Message, Started


@dataclass(frozen=True, slots=True)
class Told:
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

    def after(self, message: Message) -> Told:
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
        return reduce(Told._after_change, message.recording, self._after_batch(message))

    def _after_batch(self, batch: Batch) -> Told:
        return replace(
            self,
            total_rows=batch.total_rows,
            not_shown=batch.not_shown,
            leftover=batch.leftover,
            away=reduce(_away_after, batch.events, self.away),
        )

    def _after_change(self, change: Change) -> Told:
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
            ended=(ended.reason or Said("stopped")) if ended else None,
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
            return Said("writing what has arrived: {bytes:,} bytes wait", bytes=self.leftover)
        trouble = self.error.said
        if not self.recording:
            return trouble
        return Said("{trouble}; recording goes on in {path}", trouble=trouble, path=self.recording)


def _away_after(away: frozenset[str], event: PortEvent) -> frozenset[str]:
    if event.kind is PortEventKind.LOST:
        return away | {event.port}
    if event.kind is PortEventKind.FOUND_AGAIN:
        return away - {event.port}
    return away
