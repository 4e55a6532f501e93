"""Outputs of a command: format, path, overwriting, and the summary at the end."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, TextIO

import click

from fte_sniff.cli.streams import print_err
from fte_sniff.errors import FileError, UsageError, printable, unwritable
from fte_sniff.formats.writers import FORMAT_BY_SUFFIX, TEXT_FORMATS, OutputFormat
from fte_sniff.protocol import Gap, Status, iso_time, status_of

if TYPE_CHECKING:
    from fte_sniff.analysis.counters import Tally


_IN_SEQUENCE = (OutputFormat.RAW, OutputFormat.MCAP)
"""Binary formats that are written in sequence, so that a pipe can take them."""

Decorator = Callable[[Callable[..., Any]], Callable[..., Any]]


def format_option(
    default: OutputFormat | None, forms: Sequence[OutputFormat] = TEXT_FORMATS
) -> Decorator:
    """The `--format` option; without a default the command chooses the format."""
    return click.option(
        "--format",
        "form",
        type=click.Choice([form.value for form in forms]),
        callback=lambda _context, _option, word: OutputFormat(word) if word else None,
        default=default and default.value,
        show_default=default is not None,
        help="Format of the rows; a table has no colours if the output is not a terminal.",
    )


def format_for(output: Path | None) -> OutputFormat:
    """The format for the extension of the output; a table without an extension.

    Raises:
        UsageError: the extension is unknown.
    """
    end = "" if output is None else output.suffix.lower()
    if not end:
        return OutputFormat.TABLE
    if end not in FORMAT_BY_SUFFIX:
        raise UsageError(
            f"{output}: the extension selects the format, and {end} is not one of"
            f" {' '.join(FORMAT_BY_SUFFIX)}; use one of them, or --format"
        )
    return FORMAT_BY_SUFFIX[end]


@contextmanager
def text_output(path: Path | None, *, force: bool) -> Iterator[TextIO]:
    """Open standard output, or a file that replaces `path` when it is complete.

    Rows go to a temporary file in the same folder first, so that a command that fails leaves no
    file, and an old file stays until the new one is complete. After Ctrl-C the rows so far are
    kept, and this is reported.

    Raises:
        FileError: the file exists (and `force` is not set), or cannot be written.
    """
    if path is None or str(path) == "-":
        yield sys.stdout
        return
    try:
        if path.exists() and not path.is_file() and not path.is_dir():
            with path.open("w", encoding="utf-8", newline="") as device:
                yield device
            return
        check_output_path(path, force=force)
        with _beside(path) as file:
            yield file
    except OSError as error:
        raise unwritable(path, error) from error


@contextmanager
def file_output(path: Path | None, form: OutputFormat, *, force: bool) -> Iterator[Path]:
    """The path to write a binary file to; it replaces `path` when it is complete.

    `-` is standard output, for formats that are written in sequence.

    Raises:
        UsageError: no file was named, or the format cannot go to standard output.
        FileError: the file exists (and `force` is not set), or cannot be written.
        BrokenPipeError: standard output lost its reader.
    """
    if path is None:
        raise UsageError(f"{form} is not text: name a file to write it to with -o{_or_pipe(form)}")
    if str(path) == "-":
        with _stdout_as_file(form) as stdout:
            yield stdout
        return
    part = path.with_name(f"{path.name}.part")
    try:
        check_output_path(path, force=force)
        try:
            yield part
            part.replace(path)
        finally:
            part.unlink(missing_ok=True)
    except OSError as error:
        raise unwritable(path, error) from error


def _or_pipe(form: OutputFormat) -> str:
    return ", or - for a pipe" if form in _IN_SEQUENCE else ""


@contextmanager
def _stdout_as_file(form: OutputFormat) -> Iterator[Path]:
    if form not in _IN_SEQUENCE:
        raise UsageError(f"{form} is not written in sequence: name a file to write it to with -o")
    if sys.stdout.isatty():
        raise UsageError(f"{form} is not text for a terminal: send it to a pipe, or name a file")
    try:
        yield Path(f"/dev/fd/{sys.stdout.fileno()}")
    except FileError as error:
        if isinstance(error.__cause__, BrokenPipeError):
            raise error.__cause__ from error
        raise


def check_output_path(path: Path, *, force: bool) -> None:
    """Refuse a path that cannot be an output.

    Raises:
        OSError: it is a directory, or it exists and `force` is not set.
    """
    if path.is_dir():
        raise IsADirectoryError
    if path.exists() and not force:
        raise FileExistsError


@contextmanager
def _beside(path: Path) -> Iterator[TextIO]:
    """A temporary file next to `path`; replaces it at the end if anything was written."""
    part = path.with_name(f"{path.name}.part")
    with part.open("w", encoding="utf-8", newline="") as file:
        try:
            try:
                yield file
            except KeyboardInterrupt:
                if _settled(file, part, path):
                    print_err(f"fte-sniff: interrupted; {path} holds the rows up to there")
                raise
            _settled(file, part, path)
        finally:
            part.unlink(missing_ok=True)


def _settled(file: TextIO, part: Path, path: Path) -> bool:
    """Move the file to its path if it is not empty."""
    file.flush()
    some = file.tell() > 0
    if some:
        part.replace(path)
    return some


ENOUGH_ROWS = 5
"""This many damaged rows without a frame point to a wrong setup."""


def summary(
    tally: Tally,
    written: int | None = None,
    *,
    partly: bool = False,
    filter_text: str | None = None,
    spanned: bool = False,
    gaps: Sequence[Gap] = (),
) -> str:
    """Summary of an input: `512 rows, 3 malformed (0.6 %: truncated 2, noise 1), 10.2 s from ...`.

    Args:
        tally: counts of all rows that were read.
        written: how many of them were written; None for all.
        partly: reading stopped at a limit, so that the counts do not cover the whole input.
        filter_text: the filter of the rows that were written; None without a filter.
        spanned: only rows of a time range were read.
        gaps: gaps that the input reports.
    """
    if partly:
        return f"stopped at the limit: {tally.rows:,} rows read so far, {written or 0:,} written"
    parts = [f"{tally.rows:,} row{'s' if tally.rows != 1 else ''}"]
    if written is not None and written != tally.rows:
        parts[0] += f" read, {written:,} written"
    parts += [
        text for status in (Status.SUSPECT, Status.MALFORMED) if (text := _share(tally, status))
    ]
    if len(parts) == 1 and tally.rows:
        parts.append("nothing malformed")
    advice = _missed(tally, written, filter_text, spanned=spanned) or explain_no_frames(tally)
    lacking = f"; {gap_text(gaps)} left out when recorded" if gaps else ""
    return ", ".join(parts) + _span(tally) + lacking + (advice and f"; {advice}")


def gap_text(gaps: Sequence[Gap]) -> str:
    """`893 rows in 2 places`; `893 rows and more` if the size of a gap is unknown."""
    rows, places = sum(gap.rows or 0 for gap in gaps), len(gaps)
    told = f"{rows:,} row{'s' * (rows != 1)}"
    if any(gap.rows is None for gap in gaps):
        told = f"{told} and more" if rows else "nobody knows how many rows"
    return f"{told} in {places:,} place{'s' * (places != 1)}"


def _missed(tally: Tally, written: int | None, filter_text: str | None, *, spanned: bool) -> str:
    """Why no row was written although rows may have been read; empty otherwise."""
    if not tally.rows and spanned:
        return "none is between --from and --to"
    if tally.rows and written == 0 and filter_text is not None:
        return f"none of them matches the filter: {printable(filter_text)}"
    return ""


def explain_no_frames(tally: Tally) -> str:
    """What to check if there are no rows or no frames; empty otherwise."""
    if not tally.rows:
        return "nothing came: check the wire, the ground and the baud rate"
    if tally.rows >= ENOUGH_ROWS and not tally.frames:
        return "no frame in it: is it this controller, this baud rate, this polarity?"
    return ""


def _share(tally: Tally, status: Status) -> str:
    count = tally.by_status[status]
    if not count:
        return ""
    faults = ", ".join(
        f"{fault} {found:,}"
        for fault, found in tally.by_fault.items()
        if found and status_of((fault,)) is status
    )
    return f"{count:,} {status} ({count / tally.rows:.2%}: {faults})"


def _span(tally: Tally) -> str:
    if tally.first_ns is None or tally.duration_ns is None:
        return ""
    return f", {tally.duration_ns / 1e9:,.3f} s from {iso_time(tally.first_ns)}"
