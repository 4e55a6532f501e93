"""Owns which numbers in front of lines count the lines, and so are no bytes.

It must not know what else stands on the lines. A number that alone does not tell waits for the next
line: where that has the next number, both count lines.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

from fte_sniff.formats.logs.pasted_line import Line

_NUMBER = re.compile(
    r"\s*(?:\[(?P<boxed>\d{1,7})\]|(?P<marked>\d{1,7})\s?[.:)](?=\s)|(?P<grep>\d{1,7}):|"
    r"(?P<bare>\d{1,7})(?=\s))\s*(?=(?:0x)?[0-9A-Fa-f]{2}(?:[\s,]|\Z))[^:\[\]]*\Z"
)


@dataclass(frozen=True, slots=True)
class Number:
    """A number in front of a line that may count it."""

    digits: str
    form: str
    """How it is marked as one: `boxed`, `marked`, as `grep` does, or not at all (`bare`)."""
    start: int
    end: int
    """Behind it and what marks it."""

    @property
    def value(self) -> int:
        """What it counts."""
        return int(self.digits)

    @property
    def like_others(self) -> bool:
        """Whether it looks like the others on the line, so that it is one of them."""
        return self.form == "bare" and len(self.digits) > 1


def number_before(line: Line) -> Number | None:
    """The number in front of a line, where it may count it."""
    found = _NUMBER.match(line.text, line.at)
    if found is None:
        return None
    form = str(found.lastgroup)
    end = found.end(form)
    while end < len(line.text) and line.text[end] in " ].:)":
        end += 1
    return Number(found[form], form, found.start(), end)


class LineNumbers:
    """The count of lines under way."""

    def __init__(self, note: Callable[[str], None]) -> None:
        """Nothing is counted yet; `note` is told where that is not certain."""
        self._note = note
        self._last: int | None = None
        self._held: tuple[Line, Number] | None = None

    @property
    def counting(self) -> bool:
        """Whether lines are numbered."""
        return self._last is not None

    def expects(self, number: Number) -> bool:
        """Whether the number goes on from the last, or from the one that waits."""
        if self._held is not None:
            return number.value == self._held[1].value + 1
        return self._last is not None and number.value == self._last + 1

    def begins_next(self, line: Line) -> bool:
        """Whether the line is like the next number, or the first digits of it, and nothing else."""
        digits = line.text[line.at :].strip().lstrip("[").rstrip("].:)")
        return self._last is not None and digits != "" and str(self._last + 1).startswith(digits)

    def unless_broken_by(self, number: Number) -> Iterator[Line]:
        """The line that waits, where this number does not go on from its own."""
        if self._held is not None and not self.expects(number):
            yield from self.release()

    def counted(self, line: Line, number: Number) -> Iterator[Line]:
        """The line that waits and this one, with blanks where the numbers stood."""
        if self._held is not None:
            (before, first), self._held = self._held, None
            yield _behind(before, first)
            if first.form == "bare":
                self._note(
                    f"line {before.piece.line}: {first.digits} and the numbers below it count"
                    " lines, and are not read as bytes"
                )
        self._last = number.value
        yield _behind(line, number)

    def hold(self, line: Line, number: Number) -> None:
        """Let a line wait for the next one."""
        self._held = line, number

    def release(self) -> Iterator[Line]:
        """The line that waits, now that nothing more will tell of its number."""
        if self._held is None:
            return
        (line, number), self._held = self._held, None
        if number.form not in ("bare", "grep"):
            raise line.refused(
                f"{line.text[number.start : number.end].strip()} may be a line's number or a byte;"
                " delete it, or what makes it look like a number"
            )
        yield line.without_text_beside()


def _behind(line: Line, number: Number) -> Line:
    return replace(line, at=number.end).without_text_beside()
