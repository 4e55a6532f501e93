"""Owns the standard streams: closed from the start, full, narrow, or left by their reader.

It knows no command. Whatever is wrong with a stream shows when something is written to it, and
ends in one line or in silence, never in a traceback.
"""

from __future__ import annotations

import io
import os
import sys

from fte_sniff.errors import FileError, reason_of


class ClosedOutput(io.TextIOBase):
    """Stands for a standard output that was closed before the program began."""

    def write(self, text: str, /) -> int:
        """Refuse, in one line."""
        raise FileError("standard output is closed; let it go somewhere, for example > rows.txt")


def settle_streams() -> None:
    """Make the standard streams usable, whatever the program was started with."""
    for descriptor in range(3):
        try:
            os.fstat(descriptor)
        except OSError:
            # Taken by nothing, it would be given to the next file that is opened.
            os.open(os.devnull, os.O_RDWR)
    if sys.stdin is None:
        sys.stdin = open(0, encoding="utf-8", closefd=False)  # noqa: SIM115
    if sys.stdout is None:
        sys.stdout = ClosedOutput()
    if sys.stderr is None:
        sys.stderr = open(2, "w", encoding="utf-8", closefd=False)  # noqa: SIM115
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


def unwritable_stdout(error: OSError) -> FileError:
    """What to tell the user when standard output takes nothing; not every command has a `-o`."""
    return FileError(
        f"standard output cannot be written: {reason_of(error)}; let it go somewhere else"
    )


def abandon_stdout() -> None:
    """Let what is still buffered for standard output go nowhere, so that the end stays quiet."""
    if not isinstance(sys.stdout, ClosedOutput):
        abandon(sys.stdout.fileno())


def abandon(descriptor: int) -> None:
    """Let all that is and will be written there go nowhere; writes that wait do not wait on."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, descriptor)
    os.close(nowhere)
