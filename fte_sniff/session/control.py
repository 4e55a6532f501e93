"""What a capture and its view tell each other, as lines of JSON: control only, never rows.

    capture  {"Started": {"recording": {"path": "x.mcap"}, "device": null}}     ──►  view
             {"CaptureStatus": {"rows": 512, "bytes": 20480, ...}}              ──►
             {"Ended": {"reason": null, "error": null, "outcome": {...}, ...}}  ──►
                                                                       ◄──  {"Stop": {}}

Texts that the screen translates keep their form and values.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path
from typing import Any, Final, TypeAlias

from fte_sniff.errors import FileError, FteSniffError, PortError, TranslatableText, UsageError
from fte_sniff.recording.recorder import FileChange, Outcome


@dataclass(frozen=True, slots=True)
class Stop:
    """Request: end the capture and close its file."""


@dataclass(frozen=True, slots=True)
class Started:
    """The port and the recording are open."""

    recording: Path
    """The file, also where the user wants none: it goes with the program then."""
    device: str | None = None
    """The device that host programs open, for a bridge."""


@dataclass(frozen=True, slots=True)
class CaptureStatus:
    """How far the recording is."""

    rows: int = 0
    """All rows so far."""
    unrecorded: int = 0
    """Rows of them that are not in the file yet."""
    waiting: int = 0
    """Bytes that were read and are in no row yet."""
    is_slow: bool = False
    """Whether a write takes long."""
    is_end: bool = False
    bytes: int = 0
    """Size of all files."""
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
class Ended:
    """The last message: the capture is over and its file is closed."""

    reason: str | None = None
    """Why it ended, in one line; None if it was requested."""
    error: FteSniffError | None = None
    outcome: Outcome | None = None
    progress: CaptureStatus = CaptureStatus()
    """How far the recording is; the last known if the capture was killed."""


Message: TypeAlias = Stop | Started | CaptureStatus | FileChange | Ended

_TYPES: Final = {
    one.__name__: one for one in (Stop, Started, CaptureStatus, FileChange, Ended, Outcome)
}
_ERRORS: Final = {one.__name__: one for one in (FteSniffError, FileError, PortError, UsageError)}


def line_of(message: Message) -> bytes:
    """A message as a line of JSON."""
    return json.dumps(_packed(message)).encode() + b"\n"


def message_in(line: bytes) -> Any:
    """The message of a line."""
    return _unpacked(json.loads(line))


def _packed(value: Any) -> Any:
    match value:
        case TranslatableText():
            values = {name: _packed(one) for name, one in value.values.items()}
            return {"form": value.form, "values": values}
        case Path():
            return {"path": str(value)}
        case FteSniffError():
            kind = next(one.__name__ for one in type(value).__mro__ if one.__name__ in _ERRORS)
            return {"error": kind, "text": _packed(value.message)}
        case _ if is_dataclass(value):
            own = {one.name: _packed(getattr(value, one.name)) for one in fields(value)}
            return {type(value).__name__: own}
    return value


def _unpacked(value: Any) -> Any:
    match value:
        case {"form": str(form), "values": dict(values)}:
            return TranslatableText(form, **{name: _unpacked(one) for name, one in values.items()})
        case {"path": str(path)}:
            return Path(path)
        case {"error": str(kind), "text": text}:
            return _ERRORS[kind](_unpacked(text))
        case dict():
            ((kind, own),) = value.items()
            return _TYPES[kind](**{name: _unpacked(one) for name, one in own.items()})
    return value
