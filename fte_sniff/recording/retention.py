"""Rotation and size limits; which old files are deleted.

name.mcap                              alone, as long as it is short and nothing goes wrong
name.mcap  name_00002.mcap ...         then; sorting by name is sorting by time
name_00001.mcap  name_00002.mcap ...   in sequence; sorting by name is sorting by time
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from enum import StrEnum
from itertools import count
from pathlib import Path

from fte_sniff.errors import FileError, TranslatableText, unwritable
from fte_sniff.recording.output_file import Existing, is_outlet

DEFAULT_FLUSH_S = 1.0
"""Seconds that rows wait for the disk at most, which are what a kill or a power cut can cost.

A shorter time would cost more than it saves: a flush takes two waits for the disk and a new index,
whatever is in it, and each chunk makes the index longer, so that twice as many flushes a second
mean twice as many files in a long capture. One second is also what people expect to lose.
"""

DEFAULT_MOST_INDEX = 512 * 1024
"""Bytes of index at which the next file begins if nobody says else.

Every flush writes the index twice, as guard and as tail. At this length that takes a flush of two
full wires some 3 ms of processor time in addition to 4; a file spans 50 to 80 minutes then, at a
flush a second and ten to four channels. Up to twice this length the guard holds against a power cut
too, which leaves room for whatever comes between two looks at the length.
"""

DEFAULT_MOST_BYTES = 20_000_000_000
"""What a capture's files may take together if nobody says else: over a week of two full wires."""

DEFAULT_FREE_BYTES = 1_000_000_000
"""What is left free on the disk if nobody says else; less where it is small or nearly full."""


class OnFull(StrEnum):
    """What to do when there is no room for more."""

    STOP = "stop"
    """Stop recording, and go on once there is room again."""
    ROTATE_OLDEST = "rotate-oldest"
    """Delete the capture's own oldest file."""


@dataclass(frozen=True, slots=True)
class TriggerWindow:
    """What to keep around each row that a trigger picks."""

    before_s: float = 10.0
    """Seconds of rows before it."""
    after_s: float = 5.0
    """Seconds of rows after it."""


@dataclass(frozen=True, slots=True)
class RecordingOptions:
    """What a recording is to keep."""

    flush_every_s: float = DEFAULT_FLUSH_S
    """Seconds that rows wait for the disk at most."""
    rotate_bytes: int | None = None
    """Begin the next file when one has so many bytes; None for any number."""
    most_index: int | None = DEFAULT_MOST_INDEX
    """Begin the next file when one's index has so many bytes, so that each has it at every moment.
    None for any number: then a long file is without its index for some flushes at a time."""
    rotate_s: float | None = None
    """Begin the next file when one spans so many seconds of rows; None for any number."""
    on_full: OnFull = OnFull.STOP
    most_bytes: int | None = DEFAULT_MOST_BYTES
    """Bytes that the capture's files may take together; None for any number."""
    free_bytes: int | None = None
    """Bytes to leave free on the disk; None for the default, which spares small and full disks."""
    around: TriggerWindow | None = None
    """What to keep around the rows of the trigger; None to keep all rows."""

    @property
    def rotates(self) -> bool:
        """Whether the recording is a sequence of files from the beginning, by their names too."""
        return (
            self.rotate_bytes is not None
            or self.rotate_s is not None
            or self.on_full is OnFull.ROTATE_OLDEST
        )


_ROTATE_BYTES = 512_000_000
_FILES = 8
_DISK_SHARE = 10
"""One part in so many of a disk is left free at most, where nobody says how much."""


@dataclass(frozen=True, slots=True)
class _Finished:
    """A file that this capture has closed, and how to know it again."""

    path: Path
    size: int
    identity: tuple[int, ...]
    """Device, inode, size and time of the last change; an inode alone may be another's by now."""
    rows: int


class FileRetention:
    """Where the files of one capture go."""

    def __init__(self, path: Path, keeping: RecordingOptions, existing: Existing) -> None:
        """Take the name that the user gave, and find the first file's.

        Raises:
            FileError: a sequence of that name is there already.
        """
        self._keeping = keeping
        self._existing = existing
        self._number = 1
        self._begun = False
        self._finished: list[_Finished] = []
        self.deleted_files = self.deleted_rows = 0
        """What made room for later files, and the rows in it."""
        self.seeks = not is_outlet(path)
        """Whether the recording lies in files that can be followed by others."""
        self._path = self._free_stem(path) if existing is Existing.NUMBER else path
        self.first = self._name(1) if keeping.rotates and self.seeks else self._path
        """The first file."""
        if existing is Existing.REFUSE and self._follows and (there := self._there()):
            raise unwritable(there, FileExistsError())
        self._free_bytes = self._to_leave_free()

    @property
    def existing(self) -> Existing:
        """What to do with a file that is in the way of the first one."""
        numbered = self._existing is Existing.NUMBER and self._keeping.rotates
        return Existing.REFUSE if numbered else self._existing

    @property
    def _follows(self) -> bool:
        """Whether files follow the first one though nothing goes wrong."""
        return self.seeks and (self._keeping.rotates or self._keeping.most_index is not None)

    @property
    def rotate_bytes(self) -> int | None:
        """Bytes at which the next file begins; None for any number."""
        if self._keeping.rotate_bytes is not None or self._keeping.rotate_s is not None:
            return self._keeping.rotate_bytes
        if self._keeping.on_full is not OnFull.ROTATE_OLDEST:
            return None
        return min(_ROTATE_BYTES, (self._keeping.most_bytes or _ROTATE_BYTES) // _FILES)

    def began(self, path: Path) -> None:
        """Note that the file that `first` or `next` named was made, under this name."""
        if self._begun:
            self._number = int(path.stem.rpartition("_")[2])
        elif path != self.first:
            self._path = path
        self._begun = True

    def next(self) -> tuple[Path, Existing]:
        """The next file's name, and what to do if it is there."""
        _, path = self._next_number()
        replaced = self._existing is Existing.REPLACE
        return path, Existing.REPLACE if replaced else Existing.REFUSE

    def _next_number(self) -> tuple[int, Path]:
        for number in count(self._number + 1):
            path = self._name(number)
            if self._existing is Existing.REPLACE or not os.path.lexists(path):
                return number, path
        raise AssertionError

    @property
    def oldest(self) -> Path | None:
        """The first of the closed files that were not deleted."""
        return self._finished[0].path if self._finished else None

    def finished(self, path: Path, rows: int) -> None:
        """Note a closed file of so many rows; one that is gone is none of ours any more."""
        try:
            found = path.stat()
        except OSError:
            return
        self._finished.append(_Finished(path, found.st_size, _identity(found), rows))

    def over(self, size: int) -> str:
        """Which bound does not hold, in words, while the file under way has `size` bytes."""
        most, free = self._keeping.most_bytes, self._free_bytes
        total = size + sum(file.size for file in self._finished)
        if most is not None and total >= most:
            return TranslatableText(
                "its files have reached {size} (--max-size)", size=size_text(most)
            )
        left = self._left()
        if left is not None and left < free:
            return TranslatableText(
                "the disk is full but for {left} (--min-free {free})",
                left=size_text(left),
                free=size_text(free),
            )
        return ""

    def remove_oldest(self, keep: int = 0) -> bool:
        """Delete the capture's oldest file; False where no more than `keep` are finished."""
        while len(self._finished) > keep:
            oldest = self._finished.pop(0)
            try:
                found = oldest.path.lstat()
                if _identity(found) == oldest.identity:
                    oldest.path.unlink()
                    self.deleted_files += 1
                    self.deleted_rows += oldest.rows
                    return True
            except OSError:
                continue
        return False

    def _name(self, number: int) -> Path:
        return self._path.with_stem(f"{self._path.stem}_{number:05}")

    def _there(self) -> Path | None:
        """A file of an earlier sequence of this name."""
        pattern = f"{_literal(self._path.stem)}_[0-9][0-9][0-9][0-9][0-9]{self._path.suffix}"
        return next(iter(sorted(self._path.parent.glob(pattern))), None)

    def _free_stem(self, path: Path) -> Path:
        """A name that begins no sequence yet."""
        self._path = path
        for number in count(2):
            if not (self._follows and self._there()):
                return self._path
            self._path = path.with_stem(f"{path.stem}-{number}")
        raise AssertionError

    def _to_leave_free(self) -> int:
        if self._keeping.free_bytes is not None:
            return self._keeping.free_bytes
        try:
            found = os.statvfs(self._path.parent)
        except OSError:
            return 0
        whole, left = found.f_blocks * found.f_frsize, found.f_bavail * found.f_frsize
        return min(DEFAULT_FREE_BYTES, whole // _DISK_SHARE, left // 2)

    def _left(self) -> int | None:
        """Bytes that are free to us; None where that cannot be told."""
        try:
            found = os.statvfs(self._path.parent)
        except OSError:
            return None
        return found.f_bavail * found.f_frsize


def _identity(found: os.stat_result) -> tuple[int, ...]:
    return found.st_dev, found.st_ino, found.st_size, found.st_mtime_ns


def _literal(text: str) -> str:
    """The text as a pattern that matches only itself."""
    return "".join(f"[{letter}]" if letter in "*?[" else letter for letter in text)


def size_text(size: int) -> str:
    """A size for people."""
    for unit, name in ((10**9, "GB"), (10**6, "MB"), (10**3, "kB")):
        if size >= unit:
            return f"{size / unit:.3g} {name}"
    return f"{size} bytes"


def check_room(shelf: FileRetention) -> None:
    """Raise FileError if a bound does not hold before anything is recorded."""
    if shelf.seeks and (bound := shelf.over(0)):
        raise FileError(
            "{path} cannot be recorded: {bound}; make room, or lower the bound",
            path=shelf.first,
            bound=bound,
        )
