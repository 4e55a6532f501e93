"""Owns the lines that tell why a recording cannot begin, or how one under way came to stop.

It must not know what stands in the file.
"""

from __future__ import annotations

from fte_sniff.errors import FileError, Said, reason_of


def no_regular_file(path: object) -> FileError:
    """What to tell the user when something that is no file stands where a recording should."""
    return FileError(
        Said("{path} is not a regular file, which a recording must be; name another", path=path)
    )


def recorded_to(path: object) -> FileError:
    """What to tell the user when two programs would record to one file."""
    return FileError(
        Said("{path} is being recorded to by another program; name another file", path=path)
    )


def stopped(path: object, error: OSError, rows: int) -> FileError:
    """What to tell the user when a recording that was under way cannot go on."""
    if isinstance(error, BrokenPipeError):
        where = Said("standard output") if str(path) == "-" else path
        return FileError(
            Said(
                "{where}: its reader is gone; the recording ended after {rows:,} rows",
                where=where,
                rows=rows,
            )
        )
    return FileError(
        Said(
            "recording stopped: {reason}; {path} is complete up to there "
            "({rows} rows); make room, or record elsewhere with -o",
            reason=reason_of(error),
            path=path,
            rows=rows,
        )
    )


def taken_away(path: object, rows: int, *, deleted: bool) -> FileError:
    """What to tell the user when the file of a recording under way is not where it was."""
    if deleted:
        return FileError(
            Said(
                "recording stopped: {path} was deleted while it was being written; the {rows} rows "
                "in it are lost; start again, and leave the file in its place",
                path=path,
                rows=rows,
            )
        )
    return FileError(
        Said(
            "recording stopped: {path} was moved or replaced while it was being written; "
            "the {rows} rows in it went with it; start again, and leave the file in its place",
            path=path,
            rows=rows,
        )
    )


def bound_reached(path: object, bound: str, rows: int) -> FileError:
    """What to tell the user when a recording would take more of the disk than it may."""
    return FileError(
        Said(
            "recording stopped: {bound}; {path} is complete up to there "
            "({rows} rows); make room, raise the bound, or let the oldest go "
            "with --on-full rotate-oldest",
            bound=bound,
            path=path,
            rows=rows,
        )
    )


def not_recorded(what: str, reason: str) -> FileError:
    """What to tell the user at the end of a capture whose recording had gaps."""
    return FileError(Said("{what} were not recorded: {reason}", what=what, reason=reason))
