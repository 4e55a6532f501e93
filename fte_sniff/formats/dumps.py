"""Owns which lines are those of a hex dump, or numbered: addresses and numbers are no bytes.

It must not know what the bytes mean. A line is one of a dump if the text beside its bytes shows
them, or if addresses rise by as many bytes as stand on a line; so it waits for the next line where
it alone does not tell. What cannot be told even then is refused.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, replace

from fte_sniff.errors import InputTextError
from fte_sniff.formats.dump_line import DumpLine, address_of, dump_line, text_beside
from fte_sniff.formats.line_head import Mark, Stamp
from fte_sniff.formats.text_lines import Piece

Note = Callable[[str], None]

_BASES = (16, 8, 10)
_WIDTHS = (6, 7, 8, 16)
"""Digits of the addresses that programs write."""
_DIGITS_OF_OD = 7
"""Its addresses are octal, or decimal with -A d."""
_MOST_REPEATED = 1 << 20
_NUMBER = re.compile(
    r"\s*(?:\[(?P<boxed>\d{1,7})\]|(?P<marked>\d{1,7})\s?[.:)](?=\s)|(?P<grep>\d{1,7}):|"
    r"(?P<bare>\d{1,7})(?=\s))\s*(?=(?:0x)?[0-9A-Fa-f]{2}(?:[\s,]|\Z))[^:\[\]]*\Z"
)
_COMMENT = re.compile(r"\s(?:#|//|/\*)")
_REPEATED = re.compile(r"\s*\*\s*")


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


@dataclass(slots=True)
class _Dump:
    """A dump under way."""

    last: DumpLine
    start: dict[int, int]
    """The address of the last line, by each base that it can be written in."""
    repeats: bool = False

    def follows(self, line: DumpLine) -> dict[int, int]:
        """The address of a line that follows, by base; empty where it does not follow."""
        size = len(self.last.data)
        found = {}
        for base, start in self.start.items():
            address = _value(line.address, base)
            rise = -1 if address is None else address - start
            repeated = self.repeats and rise > size and rise % size == 0
            if address is not None and (rise == size or repeated):
                found[base] = address
        return found


@dataclass(slots=True)
class Dumps:
    """Finds the lines of dumps, and numbers of lines."""

    note: Note
    _dumps: list[_Dump] = field(default_factory=list)
    _held: tuple[Line, DumpLine] | None = None
    _number: int | None = None
    _numbered: tuple[Line, re.Match[str]] | None = None
    _told: bool = False

    def lines(self, lines: Iterable[Line]) -> Iterator[Line]:
        """The same lines, with blanks where addresses, numbers and text beside bytes stood.

        Raises:
            InputTextError: nothing tells whether something is an address or bytes.
        """
        for line in lines:
            if line.piece.column or not line.text[line.at :].strip():
                yield line
            elif line.pairs and self._number is None:
                yield from self._release()
                yield line
            else:
                yield from self._line(line)
        yield from self._release()

    def _line(self, line: Line) -> Iterator[Line]:
        number = _NUMBER.match(line.text, line.at)
        if number is not None and (self._is_next(number) or self._numbered is not None):
            yield from self._counted(line, number)
            return
        dumped = _dump_line(line)
        if dumped is not None:
            yield from self._release_number()
            yield from self._dumped(line, dumped)
        elif (self._dumps or self._held) and _REPEATED.fullmatch(line.text, line.at):
            yield from self._repeats()
        else:
            yield from self._release()
            self._refuse_garbled(line)
            if number is not None and not _like_others(number):
                self._numbered = line, number
            else:
                yield _without_text_beside(line)

    # Dumps.

    def _dumped(self, line: Line, dumped: DumpLine) -> Iterator[Line]:
        if self._held is not None:
            held_line, held = self._held
            first = _Dump(held, _starts(held))
            if first.follows(dumped):
                self._held = None
                self._dumps = [first, *self._dumps[:1]]
                yield self._accepted(held_line, held)
            else:
                yield from self._release()
        for dump in self._dumps:
            if follows := dump.follows(dumped):
                yield from self._goes_on(dump, line, dumped, follows)
                return
        if not dumped.data:
            yield from self._release()
            yield _without_text_beside(line)
        elif dumped.shown:
            self._begin(line, dumped)
            yield self._accepted(line, dumped)
        else:
            self._held = line, dumped

    def _repeats(self) -> Iterator[Line]:
        """Lines like the one before are left out; so that one is a line of a dump."""
        if self._held is not None:
            (line, dumped), self._held = self._held, None
            self._begin(line, dumped)
            yield self._accepted(line, dumped)
        self._dumps[0].repeats = True

    def _goes_on(
        self, dump: _Dump, line: Line, dumped: DumpLine, follows: dict[int, int]
    ) -> Iterator[Line]:
        base = _base(line, dump, follows)
        repeated = (follows[base] - dump.start[base]) // len(dump.last.data) - 1
        if repeated:
            data = dump.last.data * repeated
            if len(data) > _MOST_REPEATED:
                raise _refused(line, "* stands for too many bytes; dump with -v")
            yield replace(line, text="", at=0, data=data)
        if dumped.data:
            dump.last, dump.start, dump.repeats = dumped, follows, False
            yield self._accepted(line, dumped)
        else:
            self._dumps.remove(dump)

    def _begin(self, line: Line, dumped: DumpLine) -> None:
        starts = _starts(dumped)
        if self._dumps and starts.get(16) and not self._told:
            self._told = True
            self.note(
                f"line {line.piece.line}: the dump goes on at address {dumped.address}, which does"
                " not follow the line before: bytes between them are missing"
            )
        self._dumps = [_Dump(dumped, starts), *self._dumps[:1]]

    def _refuse_garbled(self, line: Line) -> None:
        """Refuse a line of a dump that is none."""
        found = address_of(line.text, line.at)
        if found is not None and any(dump.follows(found) for dump in self._dumps):
            raise _refused(
                line,
                f"behind the address {found.address}, bytes and text do not agree; paste the"
                " dump again",
            )

    def _accepted(self, line: Line, dumped: DumpLine) -> Line:
        if dumped.unordered:
            raise _refused(
                line,
                "the bytes of a group may stand in the machine's order, as hexdump, od -x and"
                " xxd -e show them; dump them again with hexdump -C",
            )
        return replace(line, text="", at=0, data=dumped.data)

    def _release(self) -> Iterator[Line]:
        """What was held, now that nothing more will tell of it."""
        yield from self._release_number()
        if self._held is None:
            return
        (line, dumped), self._held = self._held, None
        zero = not dumped.address.strip("0")
        padded = dumped.address.startswith("0") and len(dumped.address) in _WIDTHS
        if not (dumped.colon or (dumped.pairs and (zero or padded))):
            yield line
        elif zero and (dumped.colon or dumped.gap > 1):
            if not self._told:
                self._told = True
                self.note(f"line {line.piece.line}: {dumped.address} is taken for an address")
            self._dumps = [_Dump(dumped, _starts(dumped))]
            yield self._accepted(line, dumped)
        else:
            raise _refused(
                line,
                f"{dumped.address} may be an address or bytes; delete it, or write its bytes apart",
            )

    # Numbered lines.

    def _is_next(self, number: re.Match[str]) -> bool:
        return self._number is not None and _number_of(number) == self._number + 1

    def _counted(self, line: Line, number: re.Match[str]) -> Iterator[Line]:
        if self._numbered is not None:
            before, first = self._numbered
            if _number_of(number) != _number_of(first) + 1:
                yield from self._release_number()
                yield from self._line(line)
                return
            self._numbered = None
            yield _blank(before, _number_end(first))
            if first["bare"] is not None:
                self.note(
                    f"line {before.piece.line}: {first['bare']} and the numbers below it count"
                    " lines, and are not read as bytes"
                )
        self._number = _number_of(number)
        yield _blank(line, _number_end(number))

    def _release_number(self) -> Iterator[Line]:
        if self._numbered is None:
            return
        (line, number), self._numbered = self._numbered, None
        if number["bare"] is None and number["grep"] is None:
            raise _refused(
                line,
                f"{number[0][: _number_end(number) - number.start()].strip()} may be a line's"
                " number or a byte; delete it, or what makes it look like a number",
            )
        yield _without_text_beside(line)


def _number_of(number: re.Match[str]) -> int:
    return int(next(digits for digits in number.groups() if digits is not None))


def _number_end(number: re.Match[str]) -> int:
    """Behind the number and what marks it."""
    end = max(number.end(name) for name in ("boxed", "marked", "grep", "bare"))
    while end < len(number.string) and number.string[end] in " ].:)":
        end += 1
    return end


def _like_others(number: re.Match[str]) -> bool:
    """Whether the number looks like the others on the line, so that it is one of them."""
    return number["bare"] is not None and len(number["bare"]) > 1


def _dump_line(line: Line) -> DumpLine | None:
    """The line as one of a dump, with a comment behind it or without."""
    if (found := dump_line(line.text, line.at)) is not None:
        return found
    comment = _COMMENT.search(line.text, line.at)
    return comment and dump_line(line.text[: comment.start()], line.at)


def _blank(line: Line, until: int) -> Line:
    return _without_text_beside(replace(line, at=until))


def _without_text_beside(line: Line) -> Line:
    try:
        end = text_beside(line.text, line.at)
    except ValueError as error:
        (place,) = error.args
        beside = line.text[place:].strip()
        raise _refused(
            line, f"{beside} may be bytes, or the text of those before it; delete it"
        ) from None
    return line if end is None else replace(line, text=line.text[:end])


def _base(line: Line, dump: _Dump, follows: dict[int, int]) -> int:
    """The base of an address; where it says how many lines were left out, it must be certain."""
    usual = (8, 10) if len(dump.last.address) == _DIGITS_OF_OD else (16,)
    likely = [base for base in follows if base in usual] or list(follows)
    if dump.repeats and len({follows[base] for base in likely}) > 1:
        raise _refused(line, "nothing tells how many lines * stands for; dump again with -v")
    return likely[0]


def _starts(line: DumpLine) -> dict[int, int]:
    values = {base: _value(line.address, base) for base in _BASES}
    return {base: value for base, value in values.items() if value is not None}


def _value(digits: str, base: int) -> int | None:
    try:
        return int(digits, base)
    except ValueError:
        return None


def _refused(line: Line, why: str) -> InputTextError:
    return InputTextError(f"line {line.piece.line}: {why}")
