"""Owns the lines of a log behind what stands in front of their bytes or above them.

It must not know how bytes are written. A time holds up to the next one; a direction only where it
stands on a line of its own.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace

from fte_sniff.errors import InputTextError, quoted
from fte_sniff.formats.logs.analyzers import Annotations
from fte_sniff.formats.logs.code import ESCAPES, without_code
from fte_sniff.formats.logs.comma_rows import CommaRows
from fte_sniff.formats.logs.headings import heading
from fte_sniff.formats.logs.line_head import Head, Mark, head_of, lone_stamp
from fte_sniff.formats.logs.line_time import Stamp
from fte_sniff.formats.logs.lone_times import Kind, LoneTimes, like
from fte_sniff.formats.logs.own_lines import OwnLine, OwnLines
from fte_sniff.formats.logs.pasted_line import Line
from fte_sniff.formats.logs.ros import Layouts
from fte_sniff.formats.logs.strace import Strace
from fte_sniff.formats.logs.text_lines import Piece
from fte_sniff.formats.logs.written_rows import WrittenRows

_FENCE = re.compile(r"\s*(?:(?:```|~~~)[\w-]*|[\u2500-\u257f]{3,})\s*")
_PAIRS = re.compile(r"[ \t]*(?:[0-9A-Fa-f]{2}[ \t]+)*[0-9A-Fa-f]{2}[ \t]*")
_MOST_HELD = 1000
_WIDE: dict[int, int] = {
    **{wide: wide - 0xFEE0 for wide in range(0xFF01, 0xFF5F)},
    **dict(zip(map(ord, "【】「」『』、。"), map(ord, "[][][],."), strict=True)),
    **dict.fromkeys((0x201C, 0x201D, 0x2018, 0x2019), ord('"')),
    **dict.fromkeys((0x3000, 0xFEFF, 0x200B), ord(" ")),
}
"""What Chinese keyboards write, one for one, so that columns stay."""


class HeadedLines:
    """The lines behind their heads, with what these say."""

    def __init__(self, note: Callable[[str], None]) -> None:
        """No line is read yet; `note` is told what was doubtful."""
        self._note = note
        self._stamp: Stamp | None = None
        self._mark: Mark | None = None
        self._programs: tuple[OwnLines, ...] = (
            *(WrittenRows(), Strace(), Annotations(note), CommaRows(note), Layouts()),
        )
        self._alone = LoneTimes()
        self._held: list[tuple[Line, Kind]] = []
        """Lines that are bytes, or nothing but times."""
        self._told_cut = False

    def of(self, pieces: Iterable[Piece]) -> Iterator[Line]:
        """The lines that may hold bytes.

        Raises:
            InputTextError: nothing tells whether a number counts bytes or is one.
        """
        for piece in self._apart(pieces):
            text = piece.text if piece.text.isascii() else piece.text.translate(_WIDE)
            pairs = piece.lines > 1 or _PAIRS.fullmatch(text) is not None
            if piece.column or pairs:
                line = Line(piece, text, 0, self._stamp, self._mark, pairs)
                if self._held or self._alone.each_timed:
                    yield from self._untimed(line, Kind.BYTES if piece.column else None)
                else:
                    self._alone.see_bytes(_last_line(text), timed=False)
                    yield line
            elif text and not text.isspace() and not _FENCE.fullmatch(text):
                yield from self._line(piece, text)
        yield from self._ended()

    def _apart(self, pieces: Iterable[Piece]) -> Iterator[Piece]:
        """The pieces, plain lines one by one where what stands above holds for some of them."""
        for piece in pieces:
            if piece.lines > 1 and (
                self._held or self._alone.each_timed or self._stamp or self._mark
            ):
                yield from piece.each()
            else:
                yield piece

    def _line(self, piece: Piece, text: str) -> Iterator[Line]:
        if "\x1b" in text:
            text = ESCAPES.sub("", text)
            piece = replace(piece, text=text)
        for program in self._programs:
            if (own := program.own_line(text, piece.line)) is not None:
                yield from self._own(piece, own)
                return
        text = without_code(text)
        head = heading(text, piece.line) or head_of(text, timed=self._stamp is not None)
        if head.wrong_count:
            raise InputTextError(
                f"line {piece.line}: {head.wrong_count} may be a byte, or a count that the bytes"
                " beside it do not come to; delete it, or set it as far apart as they are"
            )
        text = text[: head.stop]
        if not text[head.end :].strip():
            yield from self._heading(text, head)
            return
        pairs = _PAIRS.fullmatch(text, head.end) is not None
        stamp, mark = head.stamp or self._stamp, head.mark or self._mark
        line = Line(piece, text, head.end, stamp, mark, pairs)
        self._mark = None if head.mark or head.stamp else self._mark
        if head.stamp is None:
            yield from self._untimed(line)
            if head.mark is not None:
                self._alone.see_head(text[: head.end])
        elif self._alone.begins_head(text):
            self._tell_cut(line)
        else:
            if self._held:
                yield from self._released()
            self._stamp = head.stamp
            self._alone.see_head(text[: head.end])
            self._alone.see_bytes(text, head.end, timed=True)
            yield line

    def _own(self, piece: Piece, own: OwnLine) -> Iterator[Line]:
        """A line of a program that has a form of its own."""
        yield from self._released()
        self._stamp = own.stamp or self._stamp
        if own.text or own.data:
            yield Line(piece, own.text, 0, self._stamp, own.mark, data=own.data)

    def _heading(self, text: str, head: Head) -> Iterator[Line]:
        """What holds for the lines below."""
        if head.stamp is not None:
            yield from self._released()
            self._stamp = head.stamp
            self._alone.see_head(text)
        if head.mark or head.stamp:
            self._mark = head.mark

    def _untimed(self, line: Line, known: Kind | None = None) -> Iterator[Line]:
        """A line that has no time, or is nothing but one."""
        if self._held and self._held[0][1] is Kind.CUT_IF_LAST:
            yield from self._released()
        kind = known or self._kind_of(line)
        if kind is Kind.CUT:
            self._tell_cut(line)
        elif kind is Kind.TIME:
            self._stamp = lone_stamp(line.text) or self._stamp
        elif kind is not Kind.BYTES:
            self._held.append((line, kind))
            if len(self._held) > _MOST_HELD:
                yield from self._ended()
        else:
            if self._held:
                yield from self._released(line.text)
                line = replace(line, stamp=self._stamp)
            self._alone.see_bytes(line.text, timed=False)
            yield line

    def _kind_of(self, line: Line) -> Kind:
        if line.pairs and not line.at and not self._alone.each_timed:
            return Kind.BYTES
        return self._alone.kind_of(line.text)

    def _released(self, below: str = "") -> Iterator[Line]:
        """What waits, now that something comes below: bytes without a time, or with one."""
        held, self._held = self._held, []
        for line, kind in held:
            if kind is Kind.UNTOLD and not like(line.text.strip(), below):
                self._stamp = lone_stamp(line.text) or self._stamp
            else:
                self._alone.see_bytes(line.text, timed=False)
                yield line

    def _ended(self) -> Iterator[Line]:
        """What waits, now that nothing comes below."""
        held, self._held = self._held, []
        if held and held[0][1] is Kind.CUT_IF_LAST:
            self._tell_cut(held[0][0])
            return
        if held:
            first = held[0][0]
            told = f"{first.text.strip()} is read as bytes, not as a time or day"
            self._note(f"line {first.piece.line}: {told}")
        for line, _ in held:
            self._alone.see_bytes(line.text, timed=False)
            yield line

    def _tell_cut(self, line: Line) -> None:
        if self._told_cut:
            return
        self._told_cut = True
        self._note(
            f"line {line.piece.line}: {quoted(line.text.strip())} is taken for the beginning of a"
            " time, and is not read as bytes"
        )


def _last_line(text: str) -> str:
    return text[text.rstrip("\r\n").rfind("\n") + 1 :]
