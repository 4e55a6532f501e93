"""Owns rows on their way to a recording, where they are not captured but saved.

It must not know how the file came to be or what it will be called.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from mcap.records import Metadata

from fte_sniff.errors import FileError
from fte_sniff.protocol import Row
from fte_sniff.recording.metadata import LEFT_OUT_NAME, SELECTION_NAME, PortFacts
from fte_sniff.recording.output_file import Existing
from fte_sniff.recording.writer import RecordingWriter
from fte_sniff.session.saving.origin import Origin


class RecordingSink:
    """Rows as a recording; each must have a time."""

    def __init__(self, path: Path, origin: Origin) -> None:
        facts = [PortFacts(port, origin.bauds.get(port)) for port in origin.ports]
        self._writer = RecordingWriter(path, facts, existing=Existing.REPLACE)
        for stretch in origin.left_out:
            self._writer.note(Metadata(LEFT_OUT_NAME, stretch.told()))
        for selection in origin.selections:
            self._writer.note(Metadata(SELECTION_NAME, selection.told()))

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
