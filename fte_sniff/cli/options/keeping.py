"""Owns `--keep-rows`: how many rows a screen has in memory. It knows no screen."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import click

LEAVE = "Rows that the screen keeps; the oldest leave it first, never the file."
REREAD = (
    "Rows that the screen keeps in memory; others of recordings are read again when they "
    "are looked at, others of raw bytes and hex text leave the screen, the oldest first."
)


def keep_rows_option(
    default: int, meaning: str = LEAVE
) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """The `--keep-rows` option; a row takes some 60 bytes of memory."""
    return click.option(
        "--keep-rows",
        type=click.IntRange(min=1),
        default=default,
        show_default=True,
        metavar="N",
        help=meaning,
    )
