"""Notes on rows, in a file beside the recording: JSON lines to which lines are only appended.

    capture.mcap  capture_00002.mcap  capture.mcap.notes.jsonl

    {"time": "2026-01-31T12:00:00.033000000Z", "port": "ttyUSB0", "offset": 4890, "text": "stall"}
    {"time": "2026-01-31T12:00:00.033000000Z", "port": "ttyUSB0", "offset": 4890, "text": null}

A line replaces earlier ones about the same row: an empty text is a mark, null removes the note. The
files of one capture share their notes. Several programs may write at once.
"""

from __future__ import annotations

import json
import os
import re
import stat
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final, NamedTuple

from fte_sniff.analysis.time_text import time_ns
from fte_sniff.errors import FileError, TranslatableText, reason_of
from fte_sniff.platform import open_flags
from fte_sniff.protocol.columns import iso_time
from fte_sniff.protocol.rows import Row

if TYPE_CHECKING:
    from fte_sniff.protocol.rows import Rows

NOTES_SUFFIX: Final = ".notes.jsonl"

MOST_TEXT: Final = 500
"""Most characters of a note."""

_MOST_BYTES: Final = 10_000_000
"""Largest notes file that is read."""

_NEAR_NS: Final = 1_000_000_000
"""A row whose time differs less may be that of a note: a later decoder may divide bytes anew."""


class RowKey(NamedTuple):
    """What identifies a row: captures that repeat ports and offsets differ in their times."""

    port: str
    offset: int
    """Of its first byte in the port's stream."""
    t_ns: int | None = None
    """Its time, nanoseconds since 1970 UTC; None if it has none."""


@dataclass(frozen=True, slots=True)
class Note:
    """A text about a row; empty for a mark, None where the note was removed."""

    key: RowKey
    text: str | None = ""

    @classmethod
    def on(cls, row: Row, text: str | None = "") -> Note:
        """A note on a row."""
        key = RowKey(row.port, row.offset, row.t_ns)
        return cls(key, None if text is None else text[:MOST_TEXT])

    def line(self) -> bytes:
        """The line of the file, with its end."""
        port, offset, t_ns = self.key
        time = None if t_ns is None else iso_time(t_ns)
        entry = {"time": time, "port": port, "offset": offset, "text": self.text}
        # A file name that is not UTF-8 has half characters; JSON has the same escapes for them.
        return json.dumps(entry, ensure_ascii=False).encode(errors="backslashreplace") + b"\n"

    @classmethod
    def parse(cls, line: str) -> Note:
        """The note of a line; raises ValueError if it is not a note."""
        found = json.loads(line)
        match found:
            case {"time": str() | None as time, "port": str(port), "offset": int(offset)}:
                text, t_ns = found.get("text", ""), None if time is None else time_ns(time)
                if isinstance(text, str | None) and (time is None or t_ns is not None):
                    return cls(RowKey(port, offset, t_ns), text)
        raise ValueError("not a note")


def notes_path(recording: Path) -> Path:
    """The notes file of a recording: that of its capture, without the number of a rotated file."""
    capture = re.sub(r"_[0-9]{5}$", "", recording.stem)
    return recording.with_name(f"{capture}{recording.suffix}{NOTES_SUFFIX}")


class Notes:
    """The notes on the rows of a view; `save` appends the changes."""

    def __init__(self, recordings: Mapping[Path, int | None] | None = None) -> None:
        """Read the notes of recordings, each with the time of its first row, if it is known."""
        starts: dict[Path, int] = {}
        for recording, first_ns in (recordings or {}).items():
            path, start = notes_path(recording), first_ns or 0
            starts[path] = min(starts.get(path, start), start)
        self._starts = sorted((start, path) for path, start in starts.items())
        self.damage: list[str] = []
        """What could not be read, one line each."""
        self.written: list[Path] = []
        """Files that were written."""
        self._pending: list[Note] = []
        self.notes: dict[RowKey, Note] = {}
        for _, path in self._starts:
            for note in self._read(path):
                self._apply(note)

    def _read(self, path: Path) -> Iterator[Note]:
        unread = 0
        try:
            if not stat.S_ISREG(path.stat().st_mode):
                raise FileError("{path} is not a regular file", path=path)
            with path.open("rb") as file:
                content = file.read(_MOST_BYTES)
        except (FileNotFoundError, NotADirectoryError):
            return
        except (OSError, FileError) as error:
            why = reason_of(error) if isinstance(error, OSError) else error.message
            self.damage.append(
                TranslatableText("the notes in {path} are not read: {why}", path=path, why=why)
            )
            return
        for line in content.decode("utf-8", "replace").split("\n"):
            try:
                yield Note.parse(line)
            except (ValueError, RecursionError):
                unread += bool(line.strip())
        if unread:
            text = "{path}: {count:,} lines are not notes, and are ignored"
            self.damage.append(TranslatableText(text, path=path, count=unread))

    def _apply(self, note: Note) -> None:
        if note.text is None:
            self.notes.pop(note.key, None)
        else:
            self.notes[note.key] = note

    def path_of(self, key: RowKey) -> Path | None:
        """The file for a note on a row: that of the capture that began last before it.

        None for rows that no file has.
        """
        if not self._starts:
            return None
        before = [path for start, path in self._starts if start <= (key.t_ns or 0)]
        return before[-1] if before else self._starts[0][1]

    def news(self, key: RowKey) -> Path | None:
        """The file in which a note on a row is stored; None if it was written before."""
        path = self.path_of(key)
        return None if path in self.written else path

    def set(self, note: Note) -> None:
        """Add, replace or remove a note; `save` writes it."""
        self._apply(note)
        self._pending.append(note)

    def save(self) -> str | None:
        """Append the changes; returns what went wrong, if anything.

        Changes that cannot be written are kept, and tried again by the next call.
        """
        while self._pending:
            note = self._pending[0]
            path = self.path_of(note.key)
            if path is not None:
                try:
                    _append(path, note.line())
                except OSError as error:
                    text = "the notes are not saved: {path}: {why}"
                    return TranslatableText(text, path=path, why=reason_of(error))
                if path not in self.written:
                    self.written.append(path)
            del self._pending[0]
        return None


def _append(path: Path, data: bytes) -> None:
    """Append to a file, which is made, and never through a link; raises OSError."""
    flags = open_flags("O_WRONLY", "O_CREAT", "O_APPEND", "O_NOFOLLOW", "O_NONBLOCK")
    descriptor = os.open(path, flags, 0o666)
    try:
        if not stat.S_ISREG(os.fstat(descriptor).st_mode):
            raise OSError("it is not a regular file")
        os.write(descriptor, data)
    finally:
        os.close(descriptor)


def located(rows: Rows, keys: Iterable[RowKey]) -> Iterator[tuple[int, RowKey]]:
    """The rows that contain the byte of a key, at about its time: number in the batch, and key."""
    import numpy as np

    for key in keys:
        if key.port not in rows.ports:
            continue
        own = rows.port == rows.ports.index(key.port)
        own &= (rows.offset <= key.offset) & (key.offset < rows.offset + rows.length)
        if key.t_ns is not None:
            own &= ~rows.timed | (np.abs(rows.t_ns - key.t_ns) < _NEAR_NS)
        yield from ((at, key) for at in np.flatnonzero(own).tolist())
