"""Owns `--keep-rows`: how many rows can be looked at on the screen. It knows no screen."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import click


def keep_rows_option(default: int) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """The `--keep-rows` option; a row takes some 60 bytes of memory."""
    return click.option(
        "--keep-rows",
        type=click.IntRange(min=1),
        default=default,
        show_default=True,
        metavar="N",
        help="Rows that the screen keeps; the oldest leave it first, never the file.",
    )
