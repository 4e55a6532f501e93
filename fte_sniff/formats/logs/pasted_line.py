"""Owns a line of pasted text on its way to its bytes: what is known of it by now.

It must not know the lines around it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

from fte_sniff.errors import InputTextError
from fte_sniff.formats.logs.dump_line import text_beside
from fte_sniff.formats.logs.line_head import Mark
from fte_sniff.formats.logs.line_time import Stamp
from fte_sniff.formats.logs.text_lines import Piece


@dataclass(frozen=True, slots=True)
class Line:
    """A line, or a piece of a very long one, on the way to its bytes."""

    piece: Piece
    text: str
    """As the piece has it, but for what is known to be no bytes: that is blank."""
    at: int
    """Where in the text the bytes begin."""
    stamp: Stamp | None
    mark: Mark | None
    pairs: bool = False
    """Whether there is nothing but pairs of digits, white space between them."""
    data: bytes | None = None
    """The bytes, where they are known by now."""

    def each(self) -> Iterator[Line]:
        """The lines one by one, where these are several plain ones."""
        if self.piece.lines == 1:
            yield self
            return
        # Plain lines hold no mark of a comment: they lie in one as a whole, or not at all.
        blank = self.text != self.piece.text
        for piece in self.piece.each():
            yield replace(self, piece=piece, text=" " * len(piece.text) if blank else piece.text)

    def without_text_beside(self) -> Line:
        """The same without the text behind its bytes that shows them.

        Raises:
            InputTextError: what stands there may be bytes as well.
        """
        try:
            end = text_beside(self.text, self.at)
        except ValueError as error:
            (place,) = error.args
            beside = self.text[place:].strip()
            raise self.refused(
                f"{beside} may be bytes, or the text of those before it; delete it"
            ) from None
        return self if end is None else replace(self, text=self.text[:end])

    def refused(self, why: str) -> InputTextError:
        """The error that says why the line cannot be read."""
        return InputTextError(f"line {self.piece.line}: {why}")
