"""What a capture process and its view share: the plan, the state, and the pipes between them.

    view ──standard input: the plan as JSON, then `stop`──► capture process
         ◄──standard output: a state, one JSON line──

The capture sends its state, never rows; the view shows the last one. The end of standard input
means that the view is gone.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any, Final

from fte_sniff.capture.serial_port import PortSettings
from fte_sniff.capture.silence import DEFAULT_SILENCE_S
from fte_sniff.capture.wiring import Wiring
from fte_sniff.errors import FileError, FteSniffError, PortError, TranslatableText, UsageError
from fte_sniff.recording.output_file import Existing
from fte_sniff.recording.recorder import RecordingOptions


@dataclass(frozen=True, slots=True)
class CapturePlan:
    """What to capture and how to record it."""

    wiring: Wiring
    recording: Path
    """Path of the recording."""
    existing: Existing = Existing.REFUSE
    options: RecordingOptions = field(default_factory=RecordingOptions)
    is_temporary: bool = False
    """Whether the recording, and its folder, go with the program."""
    outlives_view: bool = False
    """Continue if the view is killed or its terminal is closed; a stop still ends it."""
    shows_rows: bool = True
    """Whether a view shows the rows as they come, so that they are written at once."""
    duration_s: float | None = None
    """End after this many seconds; None or infinity for no limit."""
    count: int | None = None
    """End after this many rows; None for no limit."""
    silence_s: float = DEFAULT_SILENCE_S
    """Report a wire that was alive and is silent for this time, seconds."""

    def line(self) -> bytes:
        """One line of JSON, for `parse`."""
        return json.dumps(asdict(self), default=str).encode() + b"\n"

    @classmethod
    def parse(cls, line: bytes) -> CapturePlan:
        """The plan of a line."""
        values = json.loads(line)
        wiring, options = values.pop("wiring"), RecordingOptions(**values.pop("options"))
        settings = PortSettings(**wiring.pop("settings"))
        existing, path = Existing(values.pop("existing")), Path(values.pop("recording"))
        return cls(Wiring(settings=settings, **wiring), path, existing, options, **values)


REPORTED_LEFTOVER: Final = 2**20
"""This many waiting bytes take over a second to write, and are reported."""


@dataclass(frozen=True, slots=True)
class CaptureState:
    """State of a capture."""

    recordings: Sequence[str] = ()
    """All files of the recording, in order; several after rotation or a failed write. They go with
    the program where the user wants none. Empty until the ports and the first one are open."""
    recording: str | None = None
    """The current file; None while no file can be made."""
    device: str | None = None
    """The device that host programs open, for a bridge."""
    error: FteSniffError | None = None
    """The latest error of the recording; at the end, what failed in all."""
    is_ended: bool = False
    """Whether the capture is over and its file is closed."""
    reason: str | None = None
    """Why it ended, in one line; None if it was requested."""
    unrecorded: int = 0
    """Rows that the recorder has, and the file not yet."""
    waiting: int = 0
    """Bytes that were read, and are in none of the recorder's rows."""
    is_slow: bool = False
    """Whether a write takes long."""
    is_ending: bool = False
    """Whether no more bytes are read."""
    size: int = 0
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
        form = "{rows:,} rows and {bytes:,} bytes not yet in rows"
        return TranslatableText(form, rows=self.unrecorded, bytes=self.waiting)

    @property
    def backlog(self) -> TranslatableText | None:
        """What is not written for a while, and what the end waits for; None if nothing."""
        if self.is_slow:
            slow = "the disk is slow: {what} are not written yet"
            return TranslatableText(slow, what=self.remaining)
        if not self.is_ending or self.waiting < REPORTED_LEFTOVER:
            return None
        return TranslatableText("still writing: {what} are not written yet", what=self.remaining)

    def line(self) -> bytes:
        """One line of JSON, for `parse`."""
        values = {one.name: _plain(getattr(self, one.name)) for one in fields(self)}
        return json.dumps(values, default=str).encode() + b"\n"

    @classmethod
    def parse(cls, line: bytes) -> CaptureState:
        """The state of a line."""
        return cls(**json.loads(line, object_hook=_restored))


_ERRORS: Final = {kind.exit_code: kind for kind in (UsageError, PortError, FileError)}


def _plain(value: object) -> object:
    """A value for JSON, which has errors and translatable texts as objects."""
    if isinstance(value, FteSniffError):
        return {"exit_code": value.exit_code, "message": _plain(value.message)}
    if isinstance(value, TranslatableText):
        values = {name: _plain(one) for name, one in value.values.items()}
        return {"form": value.form, "values": values}
    return value


def _restored(found: dict[str, Any]) -> Any:
    if "exit_code" in found:
        return _ERRORS[found["exit_code"]](found["message"])
    return TranslatableText(found["form"], **found["values"]) if "form" in found else found


# The folder of this package is first only for the package: it may have other modules.
_START: Final = """
import sys
sys.path.insert(0, sys.argv[1])
from fte_sniff.__main__ import worker
del sys.path[0]
worker()
"""


def start(plan: CapturePlan) -> subprocess.Popen[bytes]:
    """Start the capture process of a plan.

    Its import path is that of this process without the working folder. It has standard error of
    this process; its session is a new one, so that Ctrl-C, Ctrl-Z and a closed terminal do not
    reach it. Raises OSError if it cannot be started.
    """
    # The folder may have been removed, and has no name then; of one that is closed, os.path.exists
    # is False, and raises no error.
    found = filter(os.path.exists, sys.path)
    path = [one for one in found if not os.path.samefile(one, os.curdir)]  # noqa: PTH121
    process = subprocess.Popen(
        [sys.executable, "-P", "-c", _START, str(Path(__file__).parents[2])],
        bufsize=0,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(path)},
        start_new_session=True,
        creationflags=getattr(subprocess, "CREATE_NEW_PROCESS_GROUP", 0),  # on Windows
    )
    send(process, plan.line())
    return process


def send(process: subprocess.Popen[bytes], line: bytes) -> None:
    """Send a line to a process; one that has ended shows that on its standard output."""
    assert process.stdin is not None
    with suppress(OSError):
        process.stdin.write(line.rstrip() + b"\n")
