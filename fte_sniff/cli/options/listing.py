"""Owns the `--format` option of commands that list something else than rows.

It must not know what they list.
"""

from __future__ import annotations

import click

list_format_option = click.option(
    "--format",
    "form",
    type=click.Choice(["table", "jsonl"]),
    default="table",
    show_default=True,
    help="A table for people, or a JSON object a line.",
)
"""The `--format` option of commands that list something else than rows."""
