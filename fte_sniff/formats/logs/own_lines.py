"""Owns what a line of another program's own form comes to: its bytes, with blanks around them.

It must not know any such form.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from fte_sniff.formats.logs.line_head import Mark
from fte_sniff.formats.logs.line_time import Stamp


@dataclass(frozen=True, slots=True)
class OwnLine:
    """What such a line holds."""

    text: str
    """The line, with blanks where no bytes stand; empty where it has none."""
    stamp: Stamp | None = None
    mark: Mark | None = None
    data: bytes | None = None
    """The bytes, where the form leaves no doubt of them; there is no text then."""


class OwnLines(Protocol):
    """Reads the lines of one program, in their order."""

    def own_line(self, text: str, number: int) -> OwnLine | None:
        """What a line holds; None where it is none of the program's."""
        ...
