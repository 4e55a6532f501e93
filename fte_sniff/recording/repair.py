"""Repair a damaged recording: read what can be read, and write it to a new file."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

from fte_sniff.errors import FileError, unreadable, unwritable
from fte_sniff.protocol import Gap, GapKind, iso_time
from fte_sniff.protocol.rows import Rows
from fte_sniff.recording.mcap.reader import MAGIC
from fte_sniff.recording.metadata import PORTS_NAME, PROGRAM, library_name
from fte_sniff.recording.output_file import Existing, OutputPath
from fte_sniff.recording.reader import MessageCounts, RecordingReader, RowRange
from fte_sniff.recording.writer import BulkWriter

REPAIR_NAME = "fte-sniff.repair"
"""The metadata record of a repaired file: what was lost."""

_MOST_LISTED = 100


@dataclass(slots=True)
class FileDamage:
    """What was found in a damaged file."""

    gaps: list[Gap] = field(default_factory=list)
    """The bytes that could not be read, in file order. A gap's reason names the bytes; its times
    are those of the last message before them and of the first one after them."""
    lost_bytes: int = 0
    kept: int = 0
    """Rows and port events that could be read."""
    messages: MessageCounts = field(default_factory=MessageCounts)


def lost_text(gap: Gap) -> str:
    """The bytes that could not be read, and the times of the messages around them."""
    if gap.start_ns is None and gap.end_ns is None:
        return gap.reason
    first = "the beginning" if gap.start_ns is None else iso_time(gap.start_ns)
    last = "the end" if gap.end_ns is None else iso_time(gap.end_ns)
    return f"{gap.reason}, between {first} and {last}"


class Repair:
    """The repair of one file, which is never changed."""

    def __init__(self, path: Path, on_read: Callable[[int], None] = lambda _bytes: None) -> None:
        """Read the file and find its damage.

        `on_read` is called with the number of bytes of each part that was read; `write` reads the
        file again. Raises FileError if the file cannot be read, or nothing in it is intact.
        """
        self._path, self._on_read = path, on_read
        try:
            self._reader = RecordingReader(path)
        except FileError as error:
            raise _nothing_left(path) or error from error
        self.damage = FileDamage()
        self._examine()

    @property
    def is_whole(self) -> bool:
        """Whether the file is intact: its records, checksums, summary and end.

        A file without summary is valid MCAP but not every tool opens it, so it is not intact.
        """
        return self._reader.is_whole

    def write(self, output: Path, existing: Existing) -> None:
        """Write what can be read to a new file; raises FileError if that fails."""
        target = OutputPath(output, existing)
        try:
            self._copy(target.descriptor)
            target.commit()
        except BaseException as error:
            target.discard()
            if isinstance(error, OSError):
                raise unwritable(output, error) from error
            raise
        target.close()

    def _examine(self) -> None:
        reader, damage = self._reader, self.damage
        starts: list[int] = []
        times: list[tuple[int, int]] = []
        for found, rows in self._ranges():
            damage.kept += len(rows) + len(rows.events)
            if (span_ns := rows.span_ns) is not None:
                starts.append(found.records[0][0])
                times.append(span_ns)
        for lost in reader.damage:
            if lost.start < lost.stop:
                after = bisect_left(starts, lost.start)
                before_ns = times[after - 1][1] if after else None
                after_ns = times[after][0] if after < len(times) else None
                where = f"bytes {lost.start} to {lost.stop} ({lost.stop - lost.start} bytes)"
                damage.gaps.append(Gap(GapKind.DAMAGE, None, before_ns, after_ns, where))
                damage.lost_bytes += lost.stop - lost.start
        if not damage.kept and not reader.metadata and not reader.ports:
            raise FileError(f"{self._path}: {_NO_CHUNK}")
        if reader.nothing_read is not None and not damage.kept:
            raise FileError(f"{reader.nothing_read}; there is nothing to repair")
        damage.messages = reader.messages

    def _ranges(self) -> Iterator[tuple[RowRange, Rows]]:
        before = 0
        try:
            for found, rows in self._reader.ranges():
                end = max(before, found.stop)
                self._on_read(end - before)
                before = end
                yield found, rows
        except FileError as error:
            raise FileError(f"{error}; there is nothing to repair") from error

    def _copy(self, descriptor: int) -> None:
        reader = self._reader
        own = reader.metadata.get(PROGRAM, {})
        facts = {name: fact for name, fact in own.items() if not name.startswith("port.")}
        writer = BulkWriter(descriptor, reader.ports, facts)
        try:
            for _, rows in self._ranges():
                writer.write(rows)
            # By content: a file may have many records, and each of them more than once.
            kept = {
                (one.name, frozenset(one.metadata.items())): (one.name, one.metadata)
                for one in reader.all_metadata
                if one.name != PORTS_NAME
            }
            kept.pop((PROGRAM, frozenset(own.items())), None)
            writer.close([(REPAIR_NAME, self._facts()), *kept.values()])
        finally:
            writer.abandon()

    def _facts(self) -> dict[str, str]:
        damage, lost = self.damage, self.damage.messages.lost
        listed = enumerate(damage.gaps[:_MOST_LISTED], 1)
        return {
            "file": self._path.name,
            "library": library_name(),
            "lost.bytes": str(damage.lost_bytes),
            "lost.messages": "" if lost is None else str(lost),
            **{f"lost.{number}": lost_text(gap) for number, gap in listed},
        }


_NO_CHUNK = "no whole chunk is left in it, so there is nothing to repair"


def _nothing_left(path: Path) -> FileError | None:
    """Why nothing can be repaired; None if the file begins as an MCAP, or cannot be read."""
    try:
        with path.open("rb") as stream:
            start = stream.read(len(MAGIC))
    except OSError as error:
        return unreadable(path, error)
    if start == MAGIC:
        return None
    why = "this is not an MCAP recording, so there is nothing to repair"
    if not start:
        why = "it is empty: nothing was recorded into it, and there is nothing to repair"
    elif MAGIC.startswith(start):
        why = _NO_CHUNK
    return FileError(f"{path}: {why}")
