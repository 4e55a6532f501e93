"""Repair a damaged recording: read what can be read, and write it to a new file."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from mcap.records import Metadata

from fte_sniff.errors import FileError, unreadable, unwritable
from fte_sniff.protocol.columns import iso_time
from fte_sniff.protocol.items import Gap, GapKind, PortEvent
from fte_sniff.protocol.rows import Rows
from fte_sniff.recording.chunks import MAGIC, LostBytes, walk
from fte_sniff.recording.metadata import PROGRAM, library_name
from fte_sniff.recording.output_file import Existing, OutputFile
from fte_sniff.recording.reader import Batch, Recording
from fte_sniff.recording.writer import BulkWriter

REPAIR_NAME: Final = "fte-sniff.repair"
"""The metadata record of a repaired file: what was lost."""

_MOST_LISTED: Final = 100


@dataclass(slots=True)
class FileDamage:
    """What was found in a damaged file."""

    gaps: list[Gap] = field(default_factory=list)
    """The bytes that could not be read, in file order. A gap's reason names the bytes; its times
    are those of the chunks around them."""
    lost_bytes: int = 0
    kept: int = 0
    """Rows and port events that could be read."""
    chunks: int = 0
    """Chunks that could be read."""
    unreadable: int = 0
    """Messages of these chunks that could not be read."""
    lost_messages: int | None = None
    """Messages that are missing; None without a summary that counts them."""


def lost_text(gap: Gap) -> str:
    """The bytes that could not be read, and the times of the chunks around them."""
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
            self._recording = Recording(path)
        except FileError as error:
            raise _nothing_left(path) or error from error
        self.damage = FileDamage()
        self._examine()

    @property
    def is_whole(self) -> bool:
        """Whether the file is intact: its records, checksums, summary and end."""
        recording = self._recording
        return recording.has_summary and not (self.damage.gaps or recording.losses)

    def write(self, output: Path, existing: Existing) -> None:
        """Write what can be read to a new file; raises FileError if that fails."""
        target = OutputFile(output, existing)
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
        recording, damage = self._recording, self.damage
        for batch in self._batches():
            damage.kept += len(batch.rows)
            damage.kept += sum(isinstance(item, PortEvent) for _, item in batch.between)
            if len(batch.rows) or not any(isinstance(item, Gap) for _, item in batch.between):
                damage.chunks += len(batch.chunks)
        with self._path.open("rb") as file:
            walked = walk(file)
        lost = {*recording.contents.lost, *walked.lost}
        damage.gaps = [self._gap(one) for one in sorted(lost)]
        damage.lost_bytes = sum(one.stop - one.start for one in lost)
        damage.unreadable = recording.unreadable
        if recording.count is not None:
            damage.lost_messages = max(0, recording.count - recording.messages)
        if not damage.kept and damage.gaps:
            raise FileError("{path}: {why}", path=self._path, why=_NO_CHUNK)

    def _gap(self, lost: LostBytes) -> Gap:
        chunks = self._recording.contents.chunks
        before = [one.last_ns for one in chunks if one.stop <= lost.start]
        after = [one.first_ns for one in chunks if one.start >= lost.stop]
        times = before[-1] if before else None, after[0] if after else None
        where = f"{lost.where} ({lost.stop - lost.start} bytes)"
        return Gap(GapKind.DAMAGE, None, *times, where)

    def _batches(self) -> Iterator[Batch]:
        before = 0
        for batch in self._recording.batches():
            end = batch.chunks[-1].end
            self._on_read(end - before)
            before = end
            yield batch

    def _copy(self, descriptor: int) -> None:
        recording = self._recording
        own = {name: one for name, one in recording.facts.items() if not name.startswith("port.")}
        writer = BulkWriter(descriptor, recording.ports, own)
        for batch in self._batches():
            writer.write(*(item for item in batch.items if isinstance(item, Rows | PortEvent)))
        kept = {
            (one.name, frozenset(one.metadata.items())): one
            for one in recording.contents.metadata
            if one.name != PROGRAM
        }
        writer.close([Metadata(REPAIR_NAME, self._facts()), *kept.values()])

    def _facts(self) -> dict[str, str]:
        lost = self.damage.lost_messages
        listed = enumerate(self.damage.gaps[:_MOST_LISTED], 1)
        return {
            "file": self._path.name,
            "library": library_name(),
            "lost.bytes": str(self.damage.lost_bytes),
            "lost.messages": "" if lost is None else str(lost),
            **{f"lost.{number}": lost_text(gap) for number, gap in listed},
        }


_NO_CHUNK: Final = "no whole chunk is left in it, so there is nothing to repair"


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
    return FileError("{path}: {why}", path=path, why=why)
