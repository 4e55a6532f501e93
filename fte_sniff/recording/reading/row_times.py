"""Owns when the first and the last row of a recording were, as far as little reading tells it.

It must not know why that is asked. What a summary tells are times of messages, and port events are
messages too: a port is opened before its first row comes, and closed after its last.
"""

from __future__ import annotations

from fte_sniff.recording.reading.reader import RecordingReader
from fte_sniff.recording.reading.span import EVERYTHING, Span
from fte_sniff.row_batch import Words

_LENGTH_NS = 10**9
_LONGER = 60
"""How many times as far back the last row is looked for where there was none."""


def row_times(reader: RecordingReader) -> tuple[int, int] | None:
    """Time of the first row in the file, and the latest of all; None where there is no row.

    Raises:
        FileError: the file cannot be read.
    """
    first_ns = _first_ns(reader)
    return None if first_ns is None else (first_ns, _last_ns(reader, first_ns))


def _first_ns(reader: RecordingReader) -> int | None:
    batches = reader.batches(Words(), EVERYTHING)
    return next((int(columns.t_ns[0]) for columns in batches if len(columns)), None)


def _last_ns(reader: RecordingReader, first_ns: int) -> int:
    """The latest time; chunks at the end of the file are looked through first."""
    end_ns = reader.times[1] if reader.times else first_ns
    back_ns = _LENGTH_NS
    while end_ns - back_ns > first_ns:
        found = _latest_ns(reader, Span(end_ns - back_ns))
        if found is not None:
            return found
        back_ns *= _LONGER
    return max(first_ns, _latest_ns(reader, Span(first_ns)) or first_ns)


def _latest_ns(reader: RecordingReader, span: Span) -> int | None:
    latest = [int(columns.t_ns.max()) for columns in reader.batches(Words(), span) if len(columns)]
    return max(latest, default=None)
