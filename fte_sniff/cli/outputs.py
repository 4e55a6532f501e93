"""Owns where a command's rows go: standard output, or a file that must not be there yet.

It must not know the formats; `formats.writers` does.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TextIO

import click

from fte_sniff.errors import unwritable
from fte_sniff.formats.writers import OutputFormat

Decorator = Callable[[Callable[..., Any]], Callable[..., Any]]


def format_option(default: OutputFormat | None) -> Decorator:
    """The `--format` option; without a default the command chooses its own form."""
    return click.option(
        "--format",
        "form",
        type=click.Choice([form.value for form in OutputFormat]),
        callback=lambda _context, _option, word: OutputFormat(word) if word else None,
        default=default and default.value,
        show_default=default is not None,
        help="How rows are written; a table is plain where the output is no terminal.",
    )


@contextmanager
def text_output(path: Path | None, *, force: bool) -> Iterator[TextIO]:
    """Standard output, or the file at `path`, made now.

    Raises:
        FileError: the file is there already (and `force` is not set), or cannot be written.
    """
    if path is None:
        yield sys.stdout
        return
    try:
        with path.open("w" if force else "x", encoding="utf-8", newline="") as file:
            yield file
    except OSError as error:
        raise unwritable(path, error) from error
