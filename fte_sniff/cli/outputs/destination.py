"""Owns where a command's rows go: standard output, or a file that must not be there yet.

It must not know the formats; `formats.writers` does.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TextIO

import click

from fte_sniff.cli.streams.telling import tell
from fte_sniff.errors import FileError, UsageError, unwritable
from fte_sniff.formats.writers import FORM_BY_END, TEXT_FORMS, OutputFormat

_IN_SEQUENCE = (OutputFormat.RAW, OutputFormat.MCAP)
"""Forms that are no text and need no seeking."""

Decorator = Callable[[Callable[..., Any]], Callable[..., Any]]


def format_option(
    default: OutputFormat | None, forms: Sequence[OutputFormat] = TEXT_FORMS
) -> Decorator:
    """The `--format` option; without a default the command chooses its own form."""
    return click.option(
        "--format",
        "form",
        type=click.Choice([form.value for form in forms]),
        callback=lambda _context, _option, word: OutputFormat(word) if word else None,
        default=default and default.value,
        show_default=default is not None,
        help="How rows are written; a table is plain where the output is no terminal.",
    )


def form_of(output: Path | None) -> OutputFormat:
    """The form that the end of the output's name asks for; a table where it has no end.

    Raises:
        UsageError: the end is none that is known.
    """
    end = "" if output is None else output.suffix.lower()
    if not end:
        return OutputFormat.TABLE
    if end not in FORM_BY_END:
        raise UsageError(
            f"{output}: the name's end says what is written, and {end} is none of"
            f" {' '.join(FORM_BY_END)}; take one of them, or say --format"
        )
    return FORM_BY_END[end]


@contextmanager
def text_output(path: Path | None, *, force: bool) -> Iterator[TextIO]:
    """Standard output, or a file that stands at `path` once it is whole.

    What is written goes to a file beside it first, so that a command that fails leaves nothing
    behind, and an old file is replaced only by a new one. What was written when Ctrl-C came is
    kept, and that it is not all is told.

    Raises:
        FileError: the file is there already (and `force` is not set), or cannot be written.
    """
    if path is None or str(path) == "-":
        yield sys.stdout
        return
    try:
        if path.exists() and not path.is_file() and not path.is_dir():
            with path.open("w", encoding="utf-8", newline="") as device:
                yield device
            return
        check_output(path, force=force)
        with _beside(path) as file:
            yield file
    except OSError as error:
        raise unwritable(path, error) from error


@contextmanager
def file_output(path: Path | None, form: OutputFormat, *, force: bool) -> Iterator[Path]:
    """Where to write a file that is not text; it stands at `path` once it is whole.

    `-` stands for standard output, for the forms that are written in sequence.

    Raises:
        UsageError: no file was named, or it cannot go to standard output.
        FileError: the file is there already (and `force` is not set), or cannot be written.
        BrokenPipeError: who read standard output is gone.
    """
    if path is None:
        raise UsageError(f"{form} is no text: name a file to write it to with -o{_or_pipe(form)}")
    if str(path) == "-":
        with _stdout_as_file(form) as stdout:
            yield stdout
        return
    part = path.with_name(f"{path.name}.part")
    try:
        check_output(path, force=force)
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
        raise UsageError(f"{form} is no text for a terminal: send it to a pipe, or name a file")
    try:
        yield Path(f"/dev/fd/{sys.stdout.fileno()}")
    except FileError as error:
        if isinstance(error.__cause__, BrokenPipeError):
            raise error.__cause__ from error
        raise


def check_output(path: Path, *, force: bool) -> None:
    """Refuse what cannot be an output.

    Raises:
        OSError: it is a directory, or it exists already and `force` is not set.
    """
    if path.is_dir():
        raise IsADirectoryError
    if path.exists() and not force:
        raise FileExistsError


@contextmanager
def _beside(path: Path) -> Iterator[TextIO]:
    """A new file next to `path`, which takes its place in the end if anything was written."""
    part = path.with_name(f"{path.name}.part")
    with part.open("w", encoding="utf-8", newline="") as file:
        try:
            try:
                yield file
            except KeyboardInterrupt:
                if _settled(file, part, path):
                    tell(f"fte-sniff: interrupted; {path} holds the rows up to there")
                raise
            _settled(file, part, path)
        finally:
            part.unlink(missing_ok=True)


def _settled(file: TextIO, part: Path, path: Path) -> bool:
    """Let the file take its place, if there is anything in it."""
    file.flush()
    some = file.tell() > 0
    if some:
        part.replace(path)
    return some
