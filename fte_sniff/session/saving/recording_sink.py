"""Owns rows on their way to a recording, where they are not captured but saved.

It must not know how the file came to be or what it will be called.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from fte_sniff.errors import FileError
from fte_sniff.protocol import Row
from fte_sniff.recording.encoding.facts import PortFacts
from fte_sniff.recording.writing.place import Existing
from fte_sniff.recording.writing.writer import RecordingWriter


class RecordingSink:
    """Rows as a recording; each must have a time."""

    def __init__(self, path: Path, ports: Sequence[str]) -> None:
        facts = [PortFacts(port) for port in ports]
        self._writer = RecordingWriter(path, facts, existing=Existing.REPLACE)

    def write(self, rows: Sequence[Row]) -> None:
        """Record the rows."""
        with _plainly():
            self._writer.write(rows)

    def end(self) -> None:
        """Write the index, and close."""
        with _plainly():
            self._writer.close()

    abandon = end


@contextmanager
def _plainly() -> Iterator[None]:
    """Give the system's own word: what a recording says of it speaks of a capture."""
    try:
        yield
    except FileError as error:
        if isinstance(error.__cause__, OSError):
            raise error.__cause__ from None
        raise
