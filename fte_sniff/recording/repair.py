"""Repair a damaged recording: read what can be read, and write it to a new file."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from mcap.records import Metadata

from fte_sniff.errors import FileError
from fte_sniff.protocol.columns import iso_time
from fte_sniff.protocol.items import PortEvent
from fte_sniff.protocol.rows import Rows
from fte_sniff.recording.chunks import LostBytes, walk
from fte_sniff.recording.metadata import PROGRAM, library_name
from fte_sniff.recording.output_file import Existing, created
from fte_sniff.recording.reader import Recording
from fte_sniff.recording.writer import BulkWriter

REPAIR_NAME: Final = "fte-sniff.repair"
"""The metadata record of a repaired file: what was lost."""

_MOST_LISTED: Final = 100


class Repair:
    """The repair of one file, which is never changed."""

    def __init__(self, path: Path) -> None:
        """Read the file and find its damage.

        Raises FileError if the file cannot be read, or nothing in it is intact.
        """
        self._path, self._recording = path, Recording(path)
        recording = self._recording
        kept = (one for one in recording.items() if isinstance(one, Rows | PortEvent))
        self.kept = sum(len(one) if isinstance(one, Rows) else 1 for one in kept)
        """Rows and port events that could be read."""
        with path.open("rb") as file:
            self.lost = sorted({*recording.contents.lost, *walk(file).lost})
            """The bytes that could not be read."""
        self.unreadable = recording.unreadable
        """Messages of intact chunks that could not be read."""
        self.lost_messages: int | None = None
        """Messages that are missing; None without a summary that counts them."""
        if recording.count is not None:
            self.lost_messages = max(0, recording.count - recording.messages)
        if not self.kept and self.lost:
            raise FileError(
                "{path}: no whole chunk is left in it, so there is nothing to repair", path=path
            )

    @property
    def is_whole(self) -> bool:
        """Whether the file is intact: its records, checksums, summary and end."""
        return self._recording.is_whole and not self.lost

    def where(self, lost: LostBytes) -> str:
        """The lost bytes, and the times of the chunks around them."""
        chunks = self._recording.contents.chunks
        before = [iso_time(one.last_ns) for one in chunks if one.stop <= lost.start]
        after = [iso_time(one.first_ns) for one in chunks if one.start >= lost.stop]
        times = f"{['the beginning', *before][-1]} and {[*after, 'the end'][0]}"
        return f"{lost.where} ({lost.stop - lost.start} bytes), between {times}"

    def write(self, output: Path, existing: Existing) -> None:
        """Write what can be read to a new file; raises FileError if that fails."""
        with created(output, existing) as target:
            self._copy(target.descriptor)
        target.close()

    def _copy(self, descriptor: int) -> None:
        recording = self._recording
        own = {name: one for name, one in recording.facts.items() if not name.startswith("port.")}
        writer = BulkWriter(descriptor, recording.ports, own)
        for item in recording.items():
            if isinstance(item, Rows | PortEvent):
                writer.write(item)
        kept = {
            (one.name, frozenset(one.metadata.items())): one
            for one in recording.contents.metadata
            if one.name != PROGRAM
        }
        writer.close([Metadata(REPAIR_NAME, self._facts()), *kept.values()])

    def _facts(self) -> dict[str, str]:
        lost = "" if self.lost_messages is None else str(self.lost_messages)
        listed = enumerate(self.lost[:_MOST_LISTED], 1)
        return {
            "file": self._path.name,
            "library": library_name(),
            "lost.bytes": str(sum(one.stop - one.start for one in self.lost)),
            "lost.messages": lost,
            **{f"lost.{number}": self.where(one) for number, one in listed},
        }
