"""Owns the one line that tells how a recording that was under way came to stop.

It must not know what stands in the file.
"""

from __future__ import annotations

from fte_sniff.errors import FileError, reason_of


def stopped(path: object, error: OSError, rows: int) -> FileError:
    """What to tell the user when a recording that was under way cannot go on."""
    return FileError(
        f"recording stopped: {reason_of(error)}; {path} is complete up to there ({rows} rows); "
        "make room, or record elsewhere with -o"
    )
