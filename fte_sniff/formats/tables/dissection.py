"""Owns the dissection of rows as text: every byte, its field, and what is wrong there.

It must not know what the bytes mean; `protocol.dissect` says that. It loads nothing heavy.

    offset 0  position  ok
       0     AA           header  control   header: control, host to controller
       1     02           cmd     2         CMD: position, turn one motor to a position
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from textwrap import TextWrapper
from typing import TextIO

import click

from fte_sniff.formats.tables.layout import STATUS_MARK, kind_text, values_text
from fte_sniff.protocol import Row, Status, faults_text, spaced_hex
from fte_sniff.protocol.dissect import Part, dissect, explain

_PLACE, _BYTES, _NAME, _VALUE = 5, 17, 9, 13
_BYTES_A_LINE = 6
_COLOR = {Status.OK: "green", Status.SUSPECT: "yellow", Status.MALFORMED: "red"}


class DissectionWriter:
    """Writes rows taken apart, an empty line between two of them."""

    def __init__(self, stream: TextIO, width: int | None, *, colored: bool) -> None:
        """Write to `stream`, in colours if asked for.

        Args:
            stream: where to.
            width: columns to wrap the explanations at; None to leave them on one line.
            colored: whether colours are wanted.
        """
        self._stream = stream
        self._wrap = _no_wrap if width is None else _wrapper(width)
        self._colored = colored
        self._begun = False

    def write(self, rows: Sequence[Row]) -> None:
        """Write the rows."""
        for row in rows:
            if self._begun:
                self._stream.write("\n")
            self._begun = True
            for line in _row_lines(row, self._wrap):
                self._stream.write((line if self._colored else click.unstyle(line)) + "\n")

    def end(self) -> None:
        """Nothing is held back."""


def _row_lines(row: Row, wrap: TextWrapper) -> Iterator[str]:
    yield _title(row)
    for sentence in explain(row):
        yield from _indented(sentence, 2, wrap, _COLOR[row.status])
    for part in dissect(row):
        yield from _part_lines(part, wrap)


def _title(row: Row) -> str:
    words = click.style(f"{row.status}", fg=_COLOR[row.status], bold=True)
    if row.faults:
        words += f" ({faults_text(row.faults)})"
    name = click.style(kind_text(row) if kind_text(row) != "-" else "damage", bold=True)
    return f"offset {row.offset}  {name}  {values_text(row)}  {words}".replace("    ", "  ")


def _part_lines(part: Part, wrap: TextWrapper) -> Iterator[str]:
    mark = STATUS_MARK[Status.MALFORMED] if part.fault else " "
    color = "red" if part.fault else None
    first, *further = _byte_groups(part.raw)
    lead = f"  {mark} {_place_text(part.places):<{_PLACE}} {first:<{_BYTES}}"
    lead += f" {part.name:<{_NAME}} {part.value:<{_VALUE}} "
    column = len(lead)
    meanings = [text for text in (part.meaning, part.note) if text] or [""]
    lines = [line for text in meanings for line in _wrapped(text, column, wrap)]
    yield click.style((lead + lines[0]).rstrip(), fg=color)
    yield from (click.style(" " * column + line, fg=color) for line in lines[1:])
    yield from (" " * 10 + group for group in further)
    for bit in part.bits:
        if bit.is_set:
            yield from _indented(f"bit {bit.number} set: {bit.meaning}", column, wrap, None)


def _place_text(places: range) -> str:
    if not places:
        return "-"
    return f"{places[0]}" if len(places) == 1 else f"{places[0]}-{places[-1]}"


def _byte_groups(raw: bytes) -> list[str]:
    return [
        spaced_hex(raw[at : at + _BYTES_A_LINE]) for at in range(0, len(raw), _BYTES_A_LINE)
    ] or ["--"]


def _indented(text: str, column: int, wrap: TextWrapper, color: str | None) -> Iterator[str]:
    for line in _wrapped(text, column, wrap):
        yield click.style(" " * column + line, fg=color)


def _wrapped(text: str, column: int, wrap: TextWrapper) -> list[str]:
    if wrap is _no_wrap:
        return [text]
    return _wrapper(max(wrap.width - column, 20)).wrap(text) or [""]


def _wrapper(width: int) -> TextWrapper:
    return TextWrapper(width=width, break_long_words=False, break_on_hyphens=False)


_no_wrap = _wrapper(1 << 16)
