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
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Final, NamedTuple

from fte_sniff.analysis.time_text import time_ns
from fte_sniff.errors import FileError, TranslatableText, reason_of
from fte_sniff.platform import open_flags
from fte_sniff.protocol.columns import iso_time

if TYPE_CHECKING:
    from fte_sniff.protocol.rows import Rows

NOTES_SUFFIX: Final = ".notes.jsonl"

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


def line_of(key: RowKey, text: str | None) -> bytes:
    """The line of a notes file that sets the note on a row, or removes it (None)."""
    time = None if key.t_ns is None else iso_time(key.t_ns)
    entry = {"time": time, "port": key.port, "offset": key.offset, "text": text}
    # A file name that is not UTF-8 has half characters; JSON has the same escapes for them.
    return json.dumps(entry, ensure_ascii=False).encode(errors="backslashreplace") + b"\n"


def parse_line(line: str) -> tuple[RowKey, str | None]:
    """What a line of a notes file sets; raises ValueError if it is not a note."""
    match found := json.loads(line):
        case {"time": str() | None as time, "port": str(port), "offset": int(offset)}:
            text, t_ns = found.get("text", ""), None if time is None else time_ns(time)
            if isinstance(text, str | None) and (time is None or t_ns is not None):
                return RowKey(port, offset, t_ns), text
    raise ValueError("not a note")


def notes_path(recording: Path) -> Path:
    """The notes file of a recording: that of its capture, without the number of a rotated file."""
    capture = re.sub(r"_[0-9]{5}$", "", recording.stem)
    return recording.with_name(f"{capture}{recording.suffix}{NOTES_SUFFIX}")


class Notes:
    """The notes on the rows of a view."""

    def __init__(self, recordings: Mapping[Path, int | None] | None = None) -> None:
        """Read the notes of recordings, each with the time of its first row, if it is known."""
        starts: dict[Path, int] = {}
        for recording, first_ns in (recordings or {}).items():
            path, start = notes_path(recording), first_ns or 0
            starts[path] = min(starts.get(path, start), start)
        self._starts = sorted((start, path) for path, start in starts.items())
        self.damage: list[str] = []
        """Files that could not be read, one line each."""
        self.written: list[Path] = []
        """Files that were written."""
        self.notes: dict[RowKey, str] = {}
        """The texts by row; empty for a mark."""
        for _, path in self._starts:
            self._read(path)

    def _read(self, path: Path) -> None:
        try:
            content = b""
            if path.is_file():
                with path.open("rb") as file:
                    content = file.read(_MOST_BYTES)
        except OSError as error:
            text = "the notes in {path} are not read: {why}"
            self.damage.append(TranslatableText(text, path=path, why=reason_of(error)))
            return
        for line in content.decode("utf-8", "replace").split("\n"):
            with suppress(ValueError, RecursionError):  # of another version, or damaged
                self._apply(*parse_line(line))

    def _apply(self, key: RowKey, text: str | None) -> None:
        if text is None:
            self.notes.pop(key, None)
        else:
            self.notes[key] = text

    def _path_of(self, key: RowKey) -> Path | None:
        """The file for a note on a row: that of the capture that began last before it."""
        before = [path for start, path in self._starts if start <= (key.t_ns or 0)]
        return next(reversed(before or [path for _, path in self._starts[:1]]), None)

    def set(self, key: RowKey, text: str | None) -> Path | None:
        """Set the note on a row, or remove it (None), and append that to the file.

        Returns the file if it was not written before. Raises FileError if it cannot be written:
        then only this view has the note.
        """
        self._apply(key, text)
        path = self._path_of(key)
        if path is None:
            return None
        try:
            _append(path, line_of(key, text))
        except OSError as error:
            raise FileError(
                "the note is not saved: {path}: {why}", path=path, why=reason_of(error)
            ) from error
        if path in self.written:
            return None
        self.written.append(path)
        return path


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
