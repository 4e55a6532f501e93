"""What a recording keeps: rows around those that trigger, files within limits; their options.

name.mcap                              one file, unless it gets too long or fails
name.mcap  name_00002.mcap ...         the files after it; sorted by name is sorted by time
name_00001.mcap  name_00002.mcap ...   with --rotate or --on-full rotate-oldest
"""

from __future__ import annotations

import os
import shutil
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from enum import StrEnum
from glob import escape
from itertools import count, pairwise, takewhile
from pathlib import Path
from typing import TypeAlias

import numpy as np

from fte_sniff.errors import FileError, TranslatableText, reason_of, size_text, unwritable
from fte_sniff.protocol import Gap, GapKind, PortEvent
from fte_sniff.protocol.rows import NO_ROWS, Bools, Ints, Rows
from fte_sniff.recording.output_file import Existing, FileIdentity, file_names, is_stream

DEFAULT_FLUSH_S = 1.0
"""Seconds between two flushes: a kill or a power cut costs the rows of this time. Each flush makes
the index longer, so a shorter time also means more files."""

DEFAULT_MAX_INDEX_BYTES = 512 * 1024
"""Bytes of index at which the next file begins, after 50 to 80 minutes.

Every flush writes the index twice, as guard and as tail; at this length that takes 3 ms. The guard
protects against a power cut up to twice this length: the length is checked only once a flush.
"""

DEFAULT_MAX_BYTES = 20_000_000_000
"""Total size of a capture's files: over a week of two fully used wires."""

DEFAULT_FREE_BYTES = 1_000_000_000
"""Bytes to leave free on the disk; less on a small or nearly full one."""


class OnFull(StrEnum):
    """What to do when a limit is reached."""

    STOP = "stop"
    """Stop recording until there is space again."""
    ROTATE_OLDEST = "rotate-oldest"
    """Delete the capture's own oldest file."""


@dataclass(frozen=True, slots=True)
class TriggerWindow:
    """What to keep around each row that a trigger selects."""

    before_s: float = 10.0
    """Seconds of rows before it."""
    after_s: float = 5.0
    """Seconds of rows after it."""


@dataclass(frozen=True, slots=True)
class RecordingOptions:
    """Flush interval, rotation, limits and trigger window of a recording."""

    flush_every_s: float = DEFAULT_FLUSH_S
    rotate_bytes: int | None = None
    """Size at which the next file begins; None for no limit."""
    rotate_s: float | None = None
    """Seconds of rows after which the next file begins; None for no limit."""
    max_index_bytes: int | None = DEFAULT_MAX_INDEX_BYTES
    """Index size at which the next file begins; None for no limit: a long file is then without an
    index for some flushes at a time."""
    on_full: OnFull = OnFull.STOP
    max_bytes: int | None = DEFAULT_MAX_BYTES
    """Total size of the capture's files; None for no limit."""
    min_free_bytes: int | None = None
    """Bytes to leave free on the disk; None for the default, which fits small and full disks."""
    trigger_window: TriggerWindow | None = None
    """What to keep around the trigger's rows; None to keep all rows."""

    @property
    def rotates(self) -> bool:
        """Whether the recording is a sequence of numbered files from the beginning."""
        return (
            self.rotate_bytes is not None
            or self.rotate_s is not None
            or self.on_full is OnFull.ROTATE_OLDEST
        )


_ROTATE_BYTES = 512_000_000
_FILES = 8
_FREE_SHARE = 10
"""By default at most 1/10 of a disk is left free."""


@dataclass(frozen=True, slots=True)
class _ClosedFile:
    path: Path
    identity: FileIdentity
    rows: int


class FileRetention:
    """Names, total size and deletion of the files of one capture."""

    def __init__(self, path: Path, options: RecordingOptions, existing: Existing) -> None:
        """Choose the name of the first file.

        Raises:
            FileError: files of an earlier sequence have this name, or a limit is reached already.
        """
        self._options = options
        self._existing = existing
        self._number = 0
        self._closed: list[_ClosedFile] = []
        self.undeleted: TranslatableText | None = None
        """The oldest file that could not be deleted at the last attempt, and why."""
        self.deleted_files = self.deleted_rows = 0
        """The files that were deleted for space, and the rows in them."""
        self.are_regular = not is_stream(path)
        """Whether the recording goes to regular files, which others can follow."""
        self._rotates = options.rotates and self.are_regular
        is_sequence = self._rotates or (self.are_regular and options.max_index_bytes is not None)
        self._path = path
        if is_sequence and existing is Existing.NUMBER:
            self._path = next(name for name in file_names(path) if not _numbered(name))
        self.first = self._name(1) if self._rotates else self._path
        if is_sequence and existing is Existing.REFUSE:
            self._refuse_existing(path)
        self._min_free = self._free_limit()
        if self.are_regular and (limit := self.limit_reached(0)):
            raise FileError(
                "{path} cannot be recorded: {limit}; free space, or change the limit",
                path=self.first,
                limit=limit,
            )

    def _refuse_existing(self, path: Path) -> None:
        if not self._rotates and os.path.lexists(path) and not path.is_dir():
            raise unwritable(path, FileExistsError())
        if earlier := _numbered(path):
            raise FileError(
                "{path}: {earlier} exists already, from an earlier capture; name another file, or "
                "use --force",
                path=path,
                earlier=earlier.name,
            )

    @property
    def existing(self) -> Existing:
        """What to do if the first file exists."""
        is_numbered = self._existing is Existing.NUMBER and self._options.rotates
        return Existing.REFUSE if is_numbered else self._existing

    @property
    def rotate_bytes(self) -> int | None:
        """Size at which the next file begins; None for no limit."""
        options = self._options
        if options.rotate_bytes is not None or options.rotate_s is not None:
            return options.rotate_bytes
        if options.on_full is not OnFull.ROTATE_OLDEST:
            return None
        return min(_ROTATE_BYTES, (options.max_bytes or _ROTATE_BYTES) // _FILES)

    def opened(self, path: Path) -> None:
        """Note that `first`, or the file of `next_path`, was made under this name."""
        if self._number:
            self._number = int(path.stem.rpartition("_")[2])
            return
        self._number = 1
        if not self._rotates:
            self._path = path

    def next_path(self) -> tuple[Path, Existing]:
        """The next file, and what to do if it exists."""
        replaces = self._existing is Existing.REPLACE
        names = (self._name(number) for number in count(self._number + 1))
        path = next(name for name in names if replaces or not os.path.lexists(name))
        return path, Existing.REPLACE if replaces else Existing.REFUSE

    def closed(self, path: Path, identity: FileIdentity | None, rows: int) -> None:
        """Register a closed file; ignored if the path does not lead to it any more."""
        try:
            is_there = identity is not None and identity.is_at(path)
        except OSError:
            is_there = True  # it takes space, and `delete_oldest` says why it cannot be deleted
        if is_there and identity is not None:
            self._closed.append(_ClosedFile(path, identity, rows))

    @property
    def closed_bytes(self) -> int:
        """Size of the closed files that were not deleted."""
        return sum(file.identity.size for file in tuple(self._closed))

    @property
    def oldest(self) -> Path | None:
        """The oldest closed file that was not deleted."""
        return self._closed[0].path if self._closed else None

    def limit_reached(self, size: int) -> str:
        """The limit that is reached, in words, if the current file has `size` bytes; else empty."""
        limit = self._options.max_bytes
        if limit is not None and size + self.closed_bytes >= limit:
            return TranslatableText(
                "its files have reached {size} (--max-size)", size=size_text(limit)
            )
        free = self._disk()[1]
        if free is not None and free < self._min_free:
            return TranslatableText(
                "the disk has only {left} free (--min-free {free})",
                left=size_text(free),
                free=size_text(self._min_free),
            )
        return ""

    def delete_oldest(self, keep: int = 0) -> bool:
        """Delete the capture's oldest closed file; False if at most `keep` can be deleted.

        A file that another program replaced or moved is left alone, and counts no more. One that
        cannot be deleted still counts, and `undeleted` says why.
        """
        self.undeleted = None
        for oldest in self._closed[: len(self._closed) - keep]:
            try:
                is_deleted = oldest.identity.delete(oldest.path)
            except OSError as error:
                self.undeleted = self.undeleted or TranslatableText(
                    "{path} cannot be deleted: {reason}",
                    path=oldest.path,
                    reason=reason_of(error),
                )
                continue
            self._closed.remove(oldest)
            if is_deleted:
                self.deleted_files += 1
                self.deleted_rows += oldest.rows
                return True
        return False

    def _name(self, number: int) -> Path:
        return self._path.with_stem(f"{self._path.stem}_{number:05}")

    def _free_limit(self) -> int:
        if self._options.min_free_bytes is not None:
            return self._options.min_free_bytes
        total, free = self._disk()
        if total is None or free is None:
            return 0
        return min(DEFAULT_FREE_BYTES, total // _FREE_SHARE, free // 2)

    def _disk(self) -> tuple[int, int] | tuple[None, None]:
        """Total and free bytes; None if unknown."""
        try:
            found = shutil.disk_usage(self._path.parent)
        except OSError:
            return None, None
        return found.total, found.free


def _numbered(path: Path) -> Path | None:
    """The first existing file of a sequence of this name."""
    pattern = f"{escape(path.stem)}_[0-9][0-9][0-9][0-9][0-9]{path.suffix}"
    return min(path.parent.glob(pattern), default=None)


MAX_WAITING_ROWS = 500_000
"""Rows that may wait for a trigger, about 25 MB; of more, the oldest are dropped."""

Select: TypeAlias = Callable[[Rows], Bools]
"""Selects rows: whether each of them matches."""

_EMPTY = Gap(GapKind.LEFT_OUT, 0, reason=TranslatableText("they are outside the trigger window"))
_NEVER, _EVER = -1, 2**63 - 1


class Trigger:
    """Selects the rows around those that match; `gaps` reports the others."""

    def __init__(self, matches: Select, window: TriggerWindow) -> None:
        self._matches = matches
        self._before_ns = round(window.before_s * 1e9)
        self._after_ns = round(window.after_s * 1e9)
        self._until_ns = _NEVER
        self._waiting: deque[Rows] = deque()
        self._waiting_rows = 0
        self._events: deque[PortEvent] = deque()
        self._gap = _EMPTY
        self._gaps: list[Gap] = []
        self.seen = self.dropped = 0
        """All rows, and those of them that were not kept."""
        self.events = 0
        """How often it fired while it kept nothing."""

    def select(self, rows: Rows) -> Rows:
        """The rows to keep after these; they may include earlier ones. Port events are all kept."""
        kept: list[Rows] = []
        self._events.extend(rows.events)
        if len(rows):
            self.seen += len(rows)
            t_ns = np.maximum.accumulate(rows.t_ns)
            matches = self._matches(rows)
            nexts = np.minimum.accumulate(np.where(matches, t_ns, _EVER)[::-1])[::-1]
            if matches.any():
                self._expire(int(nexts[0]) - self._before_ns)
                kept += self._waiting
                self._waiting.clear()
                self._waiting_rows = 0
            kept += self._kept(rows, self._until(matches, t_ns) | (t_ns >= nexts - self._before_ns))
            self._expire(int(t_ns[-1]) - self._before_ns)
        next_ns = int(self._waiting[0].t_ns[0]) if self._waiting else _EVER
        events = list(takewhile(lambda event: event.t_ns < next_ns, self._events))
        for _ in events:
            self._events.popleft()
        return Rows.concat(kept).with_columns(events=events)

    def _until(self, matches: Bools, t_ns: Ints) -> Bools:
        """Which rows match, or are in the window after one that does."""
        ends = np.maximum.accumulate(np.where(matches, t_ns + self._after_ns, self._until_ns))
        self.events += int((matches & (t_ns > np.append(self._until_ns, ends[:-1]))).sum())
        self._until_ns = int(ends[-1])
        found: Bools = t_ns <= ends
        return found

    def _kept(self, rows: Rows, keeps: Bools) -> Iterator[Rows]:
        """The rows to keep; those after the last of them wait."""
        edges = [0, *(np.flatnonzero(np.diff(keeps)) + 1).tolist(), len(rows)]
        for start, stop in pairwise(edges):
            run = rows[start:stop]
            if keeps[start]:
                self._close_gap()
                yield run
            elif stop < len(rows):
                self._drop(run)
            else:
                self._waiting.append(run)
                self._waiting_rows += len(run)

    def flush(self) -> Rows:
        """The events that still wait; the rows that wait are dropped."""
        self._expire(_EVER)
        self._close_gap()
        events = list(self._events)
        self._events.clear()
        return NO_ROWS.with_columns(events=events)

    def gaps(self) -> list[Gap]:
        """The gaps that ended since the previous call."""
        gaps, self._gaps = self._gaps, []
        return gaps

    def _expire(self, oldest_ns: int) -> None:
        """Drop the rows that wait and are earlier, or too many."""
        while self._waiting:
            run = self._waiting.popleft()
            old = int(np.maximum.accumulate(run.t_ns).searchsorted(oldest_ns))
            count = min(len(run), max(old, self._waiting_rows - MAX_WAITING_ROWS))
            self._waiting_rows -= count
            self._drop(run[:count])
            if count < len(run):
                self._waiting.appendleft(run[count:])
                return

    def _drop(self, rows: Rows) -> None:
        if (extent := rows.extent) is not None:
            first_ns, last_ns, count = extent
            self.dropped += count
            self._gap = self._gap.including(first_ns, count).including(last_ns, 0)

    def _close_gap(self) -> None:
        if self._gap.rows:
            self._gaps.append(self._gap)
            self._gap = _EMPTY
