"""Owns what stands around the bytes of a ROS message over several lines: its layout.

It must not know what the bytes are, nor a message on one line (`code` does).

    layout:                     ros2 topic echo
      dim: []
      data_offset: 0
    data: [170, 1, 1, ...]      or one number a line
    ---
"""

from __future__ import annotations

import re

from fte_sniff.formats.logs.own_lines import OwnLine

_YAML = re.compile(r"\s*layout:\s*")
_JSON = re.compile(r"\s*\"layout\"\s*:\s*\{[^}]*")


class Layouts:
    """Finds the lines of layouts."""

    def __init__(self) -> None:
        """No line is read yet."""
        self._indent = -1
        """Of the word above, in YAML; -1 outside."""
        self._open = 0
        """Braces that are open, in JSON."""

    def own_line(self, text: str, _number: int) -> OwnLine | None:
        """Nothing, where a line belongs to a layout; None where it does not."""
        if self._indent < 0 and not self._open and "layout" not in text:
            return None
        if self._open:
            self._open += text.count("{") - text.count("}")
            return OwnLine("")
        indent = len(text) - len(text.lstrip())
        if self._indent >= 0 and (indent > self._indent or not text.strip()):
            return OwnLine("")
        self._indent = -1
        if _YAML.fullmatch(text):
            self._indent = indent
            return OwnLine("")
        if _JSON.fullmatch(text):
            self._open = text.count("{")
            return OwnLine("")
        return None
