"""Owns how the name of a file is read from the command line. It knows no command."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click


class FileName(click.Path):
    """The name of a file, there or not; an empty one is none, and would mean the folder."""

    def __init__(self) -> None:
        """As a Path."""
        super().__init__(path_type=Path)

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """The path; an empty name is refused."""
        if not str(value):
            self.fail("the name is empty.", param, ctx)
        return super().convert(value, param, ctx)
