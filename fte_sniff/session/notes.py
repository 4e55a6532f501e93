"""Notes on rows, in a file beside the recording, and the place at which a recording was left.

A line of the file is a note; the files of one capture share it, also after rotation:

{"time": "2026-01-31T12:00:00.033000000Z", "port": "/dev/ttyUSB0", "offset": 4890, "text": "stall",
"capture": "2026-01-31T12:00:00.000000000Z"}

`capture` is when the capture began, where the recording says it: a recording that replaces another
has rows with the same ports and offsets. Where that file cannot be written, a file in the user's
state folder takes its place. Several programs may write notes at once: each locks the folder.
"""

from __future__ import annotations

import json
import re
import stat
from bisect import bisect_right
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from datetime import UTC, datetime
from hashlib import sha256
from itertools import zip_longest
from pathlib import Path
from threading import Lock
from typing import TYPE_CHECKING, Any, Final, NamedTuple, TypeAlias

from platformdirs import user_state_path

from fte_sniff.analysis.time_text import time_ns
from fte_sniff.errors import FileError, TranslatableText, reason_of
from fte_sniff.protocol import Row, iso_time
from fte_sniff.recording.output_file import locked_folder
from fte_sniff.session.save import replace_text

if TYPE_CHECKING:
    from fte_sniff.protocol.rows import Ints, Rows

NOTES_SUFFIX: Final = ".notes.jsonl"

MOST_TEXT: Final = 500
"""Most characters of a note."""

_MOST_BYTES: Final = 10_000_000
"""Largest notes file that is read."""

_PATIENCE_S: Final = 5.0
"""How long the notes of another program are waited for."""


class RowKey(NamedTuple):
    """What identifies a row in a view."""

    port: str
    offset: int
    """Of its first byte in the port's stream."""
    capture: int = 0
    """Number of its capture among those of the view."""


@dataclass(frozen=True, slots=True)
class Note:
    """A text about a row; empty for a mark."""

    t_ns: int | None
    """Time of the row, nanoseconds since 1970 UTC."""
    port: str
    offset: int
    """Of the row's first byte in the port's stream."""
    text: str = ""
    capture: str | None = None
    """When its capture began, as the recording says it; None if that is unknown."""

    @property
    def key(self) -> RowKey:
        """What identifies its row in its capture."""
        return RowKey(self.port, self.offset)

    @classmethod
    def on(cls, row: Row, text: str = "") -> Note:
        """A note on a row."""
        return cls(row.t_ns, row.port, row.offset, text[:MOST_TEXT])

    def line(self) -> str:
        """The line of the file."""
        time = None if self.t_ns is None else iso_time(self.t_ns)
        entry = {"time": time, "port": self.port, "offset": self.offset, "text": self.text}
        if self.capture is not None:
            entry["capture"] = self.capture
        line = json.dumps(entry, ensure_ascii=False)
        # A name of a file that is not UTF-8 has half characters.
        return line if line.isascii() or _is_utf8(line) else json.dumps(entry)

    @classmethod
    def parse(cls, line: str) -> Note:
        """The note of a line; raises ValueError if it is none."""
        found = json.loads(line)
        match found:
            case {"time": str() | None as time, "port": str(port), "offset": int(offset)} if (
                isinstance(found.get("text", ""), str)
                and isinstance(found.get("capture"), str | None)
                and not isinstance(offset, bool)
            ):
                t_ns = None if time is None else time_ns(time)
                if time is None or t_ns is not None:
                    return cls(t_ns, port, offset, found.get("text", ""), found.get("capture"))
        raise ValueError("no note")


def _is_utf8(text: str) -> bool:
    try:
        text.encode()
    except UnicodeEncodeError:
        return False
    return True


def capture_path(file: Path) -> Path:
    """The name of the capture of a file: without the number of a rotated one."""
    return file.with_stem(re.sub(r"_[0-9]{5}$", "", file.stem))


def _state_folder() -> Path:
    return user_state_path("fte-sniff", appauthor=False)


def _fallback_path(capture: Path | None) -> Path:
    """The notes file in the state folder."""
    if capture is None:
        name = f"fte-sniff-{datetime.now(UTC):%Y%m%dT%H%M%SZ}"
    else:
        folder = sha256(str(capture.resolve().parent).encode()).hexdigest()[:12]
        name = f"{capture.name}.{folder}"
    return _state_folder() / "notes" / f"{name}{NOTES_SUFFIX}"


def capture_start(file: Path) -> str | None:
    """When the capture of a recording began, as it says; None if it is not a recording."""
    from fte_sniff.recording.metadata import PROGRAM, part_of
    from fte_sniff.recording.reader import RecordingReader

    with suppress(FileError):
        part = part_of(RecordingReader(file).metadata.get(PROGRAM, {}))
        return None if part is None else part.start
    return None


_Entries: TypeAlias = dict[tuple[str | None, RowKey], Note]
"""The notes of a file, by capture and row."""


class _NotesFile:
    """The notes of one capture, in the file beside it and that in the state folder."""

    def __init__(self, capture: Path | None, start: str | None) -> None:
        self._start = start
        self.paths = [_fallback_path(capture)]
        if capture is not None:
            self.paths.insert(0, capture.with_name(capture.name + NOTES_SUFFIX))
        self.damaged: dict[Path, str] = {}
        """Files that are never written, each with what is wrong."""
        self.written: Path | None = None
        self.said: Path | None = None
        """The file that the user knows."""

    def read(self) -> dict[RowKey, Note]:
        """The notes of both files on this capture, and those that name no capture."""
        found: dict[RowKey, Note] = {}
        for path in reversed(self.paths):
            entries = self._read(path)
            for start in (None, self._start):
                found |= {key: note for (own, key), note in entries.items() if own == start}
        return found

    def _read(self, path: Path) -> _Entries:
        found: _Entries = {}
        number = 0
        try:
            if not stat.S_ISREG(path.stat().st_mode):
                raise ValueError("no regular file")
            with path.open("rb") as file:
                content = file.read(_MOST_BYTES + 1)
            if len(content) > _MOST_BYTES:
                raise ValueError("too large")
            for line in content.decode("utf-8").split("\n"):
                number += 1
                if line.strip():
                    note = Note.parse(line)
                    found[note.capture, note.key] = note
        except (FileNotFoundError, NotADirectoryError):
            pass
        except OSError as error:
            self._refuse(path, reason_of(error))
        except (ValueError, RecursionError):
            self._refuse(path, TranslatableText("line {number:,} is not a note", number=number))
        return found

    def _refuse(self, path: Path, why: str) -> None:
        self.damaged[path] = TranslatableText(
            "the notes in {path} are not read further, and not changed: {why}", path=path, why=why
        )

    def write(self, changes: Mapping[RowKey, Note | None]) -> str | None:
        """Apply changes to the file that can be written; returns what went wrong, if anything."""
        why: str | None = None
        for path in self.paths:
            try:
                self._change(path, changes)
            except OSError as error:
                why = TranslatableText(
                    "the notes are not saved: {path}: {why}", path=path, why=reason_of(error)
                )
                continue
            if path in self.damaged:
                continue
            self.written = path
            for other in self.paths:  # it was written when this one could not be
                if other != path and other.exists():
                    with suppress(OSError):
                        self._change(other, dict.fromkeys(changes))
            return None
        return why or TranslatableText("the notes are not saved")

    def _change(self, path: Path, changes: Mapping[RowKey, Note | None]) -> None:
        """Apply changes to a file that is not damaged; raises OSError."""
        folder = path.resolve().parent
        folder.mkdir(parents=True, exist_ok=True)
        with locked_folder(folder, _PATIENCE_S):
            before = self._read(path)
            if path in self.damaged:
                return
            notes = before.copy()
            for key, note in changes.items():
                notes.pop((None, key), None)
                notes.pop((self._start, key), None)
                if note is not None:
                    notes[self._start, key] = replace(note, capture=self._start)
            if notes != before:
                replace_text(path, "".join(f"{note.line()}\n" for note in notes.values()), 0o666)


class RowOrigins:
    """For each row of a view, the number of its capture."""

    def __init__(self, captures: Sequence[int]) -> None:
        """Know no rows yet; `captures` are the numbers of the captures of the inputs."""
        self._captures = captures
        self.captures = max(1, len(set(captures)))
        self._several = self.captures > 1
        self._starts: list[int] = []
        self._found: list[int | Ints] = []
        """For each start, the capture of the rows from there on, or of each of them."""
        self._rows = 0

    def append(self, rows: int, origin: int | Ints) -> None:
        """Append rows; `origin` is the number of their input, or of that of each row."""
        if not self._several or not rows:
            return
        if isinstance(origin, int):
            captures: int | Ints = self._captures[origin]
        else:
            import numpy as np

            # A byte for each row where captures overlap, which can be hundreds of millions.
            kind = np.min_scalar_type(max(self._captures))
            captures = np.array(self._captures, kind)[origin]
        self._starts.append(self._rows)
        self._found.append(captures)
        self._rows += rows

    def at(self, index: int) -> int:
        """The capture of a row; `index` counts all rows from 0."""
        if not self._several:
            return 0
        number = bisect_right(self._starts, index) - 1
        found = self._found[number]
        return found if isinstance(found, int) else int(found[index - self._starts[number]])


class Notes:
    """The notes on the rows of a view."""

    def __init__(self, inputs: Sequence[Path] = (), starts: Sequence[str | None] = ()) -> None:
        """Read the notes of the captures to which the inputs belong; none for unrecorded rows.

        `starts` says of each input when its capture began, see `capture_start`.
        """
        named = [*zip_longest(map(capture_path, inputs), starts)]
        captures = [*dict.fromkeys(named)] or [(None, None)]
        self.origins = RowOrigins([captures.index(one) for one in named])
        self._files = [_NotesFile(capture, start) for capture, start in captures]
        self.notes: dict[RowKey, Note] = {
            key._replace(capture=number): note
            for number, one in enumerate(self._files)
            for key, note in one.read().items()
        }
        self._changes: dict[RowKey, Note | None] = {}
        """What is not saved."""
        self._lock, self._saving = Lock(), Lock()

    @property
    def damage(self) -> list[str]:
        """What could not be read, one line each."""
        return [line for one in self._files for line in one.damaged.values()]

    @property
    def written(self) -> list[Path]:
        """Files that were written."""
        return [one.written for one in self._files if one.written is not None]

    def news(self, capture: int = 0) -> Path | None:
        """The file in which the notes on a capture are or will be; None if that was said before."""
        own = self._files[capture]
        path = own.written or next((path for path in own.paths if path not in own.damaged), None)
        if path == own.said:
            return None
        own.said = path
        return path

    def set(self, note: Note, capture: int = 0) -> None:
        """Add or replace a note on a row of a capture; `save` writes it."""
        key = note.key._replace(capture=capture)
        self.notes[key] = note
        self._change(key, note)

    def remove(self, note: Note, capture: int = 0) -> None:
        """Remove the note on a row of a capture; `save` writes it."""
        key = note.key._replace(capture=capture)
        self.notes.pop(key, None)
        self._change(key, None)

    def _change(self, key: RowKey, changed: Note | None) -> None:
        with self._lock:
            self._changes[key] = changed

    def save(self) -> str | None:
        """Write the changes; returns what went wrong, if anything. Any thread may call it.

        Changes that cannot be written are kept, and tried again by the next call.
        """
        trouble: str | None = None
        with self._saving:
            with self._lock:
                taken, self._changes = self._changes, {}
            by_file: dict[int, dict[RowKey, Note | None]] = {}
            for key, note in taken.items():
                by_file.setdefault(key.capture, {})[key] = note
            for capture, changes in by_file.items():
                own = {key._replace(capture=0): note for key, note in changes.items()}
                why = self._files[capture].write(own)
                if why is not None:
                    trouble = why
                    with self._lock:
                        self._changes = {**changes, **self._changes}
        return trouble


def located(rows: Rows, keys: Iterable[RowKey]) -> Iterator[tuple[int, RowKey]]:
    """The rows that contain the byte of a key, of any capture: number in the batch, and key."""
    import numpy as np

    by_port: dict[str, dict[int, list[RowKey]]] = {}
    for key in keys:
        by_port.setdefault(key.port, {}).setdefault(key.offset, []).append(key)
    for code, port in enumerate(rows.codebook.ports):
        if port not in by_port:
            continue
        wanted = np.sort(np.array(list(by_port[port]), np.int64))
        numbers = np.flatnonzero(rows.port == code)
        starts = rows.offset[numbers]
        first = wanted.searchsorted(starts)
        last = wanted.searchsorted(starts + rows.length[numbers])
        for at in np.flatnonzero(last > first).tolist():
            for offset in wanted[first[at] : last[at]].tolist():
                yield from ((int(numbers[at]), key) for key in by_port[port][offset])


@dataclass(frozen=True, slots=True)
class Place:
    """Where a view was left."""

    filter: str = ""
    columns: tuple[str, ...] | None = None
    cursor: RowKey | None = None


START: Final = Place()
"""The place of a view that is opened for the first time."""

MOST_PLACES: Final = 200
"""Views whose place is kept."""


def _places_path() -> Path:
    return _state_folder() / "views.json"


def _view_key(files: Iterable[Path]) -> str:
    return "\n".join(str(file.resolve()) for file in files)


def _read_places() -> dict[str, Any]:
    with suppress(OSError, ValueError, RecursionError):
        path = _places_path()
        if path.stat().st_size <= _MOST_BYTES:
            found = json.loads(path.read_text("utf-8"))
            return found if isinstance(found, dict) else {}
    return {}


def read_place(files: Iterable[Path]) -> Place:
    """Where the view of these files was left; the start if that is unknown."""
    match _read_places().get(_view_key(files)):
        case {"filter": str(text), "columns": columns, "cursor": cursor}:
            with suppress(TypeError, ValueError):
                return Place(
                    text,
                    None if columns is None else tuple(map(str, columns)),
                    None if cursor is None else RowKey(str(cursor[0]), *map(int, cursor[1:3])),
                )
    return START


def save_place(files: Iterable[Path], place: Place) -> None:
    """Keep where the view of these files was left.

    Raises FileError if that cannot be written.
    """
    path, places, key = _places_path(), _read_places(), _view_key(files)
    places.pop(key, None)
    places[key] = asdict(place)
    latest = dict(list(places.items())[-MOST_PLACES:])
    try:
        replace_text(path, json.dumps(latest, ensure_ascii=False, indent=1))
    except OSError as error:
        raise FileError(f"{path} cannot be written: {reason_of(error)}") from error
