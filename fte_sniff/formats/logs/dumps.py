"""Owns which lines are those of a hex dump: addresses, and text beside bytes, are no bytes.

It must not know what the bytes mean, which address follows which (`address_run` does), nor which
numbers count lines (`line_numbers`). A line is one of a dump if the text beside its bytes shows
them, or if addresses rise by as many bytes as stand on a line; so it waits for the next line where
it alone does not tell. What cannot be told even then is refused.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, replace

from fte_sniff.formats.logs.address_run import AddressRun
from fte_sniff.formats.logs.dump_line import LONGEST_LINE, DumpLine, address_of, dump_line
from fte_sniff.formats.logs.line_numbers import LineNumbers, number_before
from fte_sniff.formats.logs.pasted_line import Line

Note = Callable[[str], None]

_WIDTHS = (6, 7, 8, 16)
"""Digits of the addresses that programs write."""
_MOST_REPEATED = 1 << 20
"""Bytes that one * may stand for."""
_PER_LINE = (8, 16, 32)
"""Bytes that programs put on a line of a dump."""
_MOST_GARBLED = 2
_COMMENT = re.compile(r"\s(?:#|//|/\*)")
_PAIR = re.compile(r"[0-9A-Fa-f]{2}")
_REPEATED = re.compile(r"\s*\*\s*")


@dataclass(slots=True)
class Dumps:
    """Finds the lines of dumps among others, which may be numbered."""

    note: Note
    _dumps: list[AddressRun] = field(default_factory=list)
    _held: tuple[Line, DumpLine] | None = None
    _numbers: LineNumbers = field(init=False)
    _told: bool = False
    _latest: Line | None = None
    """The line before that is not blank."""
    _dumped_at: int = 0
    """The number of the latest line that is one of a dump."""

    def __post_init__(self) -> None:
        self._numbers = LineNumbers(self.note)

    def lines(self, lines: Iterable[Line]) -> Iterator[Line]:
        """The same lines, with blanks where addresses, numbers and text beside bytes stood.

        Raises:
            InputTextError: nothing tells whether something is an address or bytes.
        """
        for line in self._apart(lines):
            text = line.text[line.at :].strip()
            if line.piece.column or not text:
                yield line
                continue
            self._refuse_garbled_before(line)
            if line.pairs and not self._numbers.counting:
                yield from self._release()
                self._refuse_cut(line)
                # Text beside bytes may look like bytes.
                yield line.without_text_beside() if "  " in text else line
            else:
                yield from self._line(line)
            self._latest = line
        yield from self._release()

    def _apart(self, lines: Iterable[Line]) -> Iterator[Line]:
        """The lines, plain ones one by one where they may have numbers or belong to a dump."""
        for line in lines:
            if self._numbers.counting or self._behind_dump:
                yield from line.each()
            else:
                yield line

    @property
    def _behind_dump(self) -> bool:
        """Whether the latest line is one of a dump."""
        return self._latest is not None and self._dumped_at == self._latest.piece.line

    def _line(self, line: Line) -> Iterator[Line]:
        number = number_before(line)
        if number is not None:
            yield from self._numbers.unless_broken_by(number)
            if self._numbers.expects(number):
                yield from self._numbers.counted(line, number)
                return
        dumped = _dump_line(line)
        if dumped is not None:
            yield from self._numbers.release()
            yield from self._dumped(line, dumped)
        elif (self._dumps or self._held) and _REPEATED.fullmatch(line.text, line.at):
            yield from self._repeats(line)
        else:
            yield from self._release()
            self._refuse_cut(line)
            self._refuse_garbled(line)
            if number is None and self._numbers.begins_next(line):
                raise line.refused(
                    f"{line.text[line.at :].strip()} may be the next line's number cut short, or"
                    " bytes; delete it"
                )
            if number is not None and not number.like_others:
                self._numbers.hold(line, number)
            else:
                yield line.without_text_beside()

    def _dumped(self, line: Line, dumped: DumpLine) -> Iterator[Line]:
        if self._held is not None:
            held_line, held = self._held
            first = AddressRun.begun(held)
            if first.with_line(dumped) is not None:
                self._held = None
                self._dumps = [first, *self._dumps[:1]]
                yield self._accepted(held_line, held)
            else:
                yield from self._release()
        for place, dump in enumerate(self._dumps):
            if (after := dump.with_line(dumped)) is not None:
                yield from self._goes_on(place, line, after)
                return
        if not dumped.data:
            yield from self._release()
            self._refuse_cut(line)
            if any(dump.misses_lines(dumped) for dump in self._dumps):
                raise line.refused(
                    f"the dump ends at address {dumped.address}, but lines before that are missing;"
                    " paste it whole, or delete this line",
                )
            yield line.without_text_beside()
        elif dumped.shown:
            self._begin(line, dumped)
            yield self._accepted(line, dumped)
        else:
            self._held = line, dumped

    def _repeats(self, repeated: Line) -> Iterator[Line]:
        """Lines like the one before are left out; so that one is a line of a dump."""
        if self._held is not None:
            (line, dumped), self._held = self._held, None
            self._begin(line, dumped)
            yield self._accepted(line, dumped)
        self._dumps[0] = self._dumps[0].repeating()
        self._dumped_at = repeated.piece.line

    def _goes_on(self, place: int, line: Line, after: AddressRun) -> Iterator[Line]:
        before = self._dumps[place]
        left_out = before.left_out_before(after)
        if left_out is None:
            raise line.refused("nothing tells how many lines * stands for; dump again with -v")
        if left_out:
            repeated = before.last.data
            if left_out * len(repeated) > _MOST_REPEATED:
                raise line.refused("* stands for too many bytes; dump with -v")
            yield replace(line, text="", at=0, data=repeated * left_out)
        if after.last.data:
            self._dumps[place] = after
            yield self._accepted(line, after.last)
        else:
            del self._dumps[place]

    def _begin(self, line: Line, dumped: DumpLine) -> None:
        begun = AddressRun.begun(dumped)
        if self._dumps and begun.starts.get(16) and not self._told:
            self._told = True
            self.note(
                f"line {line.piece.line}: the dump goes on at address {dumped.address}, which does"
                " not follow the line before: bytes between them are missing"
            )
        self._dumps = [begun, *self._dumps[:1]]

    def _refuse_garbled(self, line: Line) -> None:
        """Refuse a line of a dump that is none."""
        found = address_of(line.text, line.at)
        if found is None:
            return
        follows = any(dump.with_line(found) for dump in self._dumps)
        if follows or any(dump.begins_again(found.address, 0) for dump in self._dumps):
            raise line.refused(
                f"behind the address {found.address}, bytes and text do not agree; paste the"
                " dump again",
            )

    def _refuse_cut(self, line: Line) -> None:
        """Refuse what may be the beginning of an address, right behind a dump."""
        if not self._behind_dump:
            return
        begins = (dump.begins_next(line.text, line.at) for dump in self._dumps)
        restarts = (dump.begins_again(line.text, line.at) for dump in self._dumps)
        if any(begins) or any(restarts):
            raise line.refused(
                f"{line.text[line.at :].strip()} may be the dump's next address cut short, or"
                " bytes; delete it",
            )

    def _refuse_garbled_before(self, line: Line) -> None:
        """Refuse the line before, taken for bytes, where this one shows that it has an address."""
        before = self._latest
        if before is None or self._held is not None or self._dumped_at == before.piece.line:
            return
        if _has_address_before(before, line):
            raise before.refused(
                "its bytes do not fit its address, which the line below goes on from; paste the"
                " dump again",
            )

    def _accepted(self, line: Line, dumped: DumpLine) -> Line:
        if dumped.unordered:
            raise line.refused(
                "the bytes of a group may stand in the machine's order, as hexdump, od -x and"
                " xxd -e show them; dump them again with hexdump -C",
            )
        self._dumped_at = line.piece.line
        return replace(line, text="", at=0, data=dumped.data)

    def _release(self) -> Iterator[Line]:
        """What was held, now that nothing more will tell of it."""
        yield from self._numbers.release()
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
            self._dumps = [AddressRun.begun(dumped)]
            yield self._accepted(line, dumped)
        else:
            raise line.refused(
                f"{dumped.address} may be an address or bytes; delete it, or write its bytes apart",
            )


def _dump_line(line: Line) -> DumpLine | None:
    """The line as one of a dump, with a comment behind it or without."""
    if (found := dump_line(line.text, line.at)) is not None:
        return found
    comment = _COMMENT.search(line.text, line.at)
    return comment and dump_line(line.text[: comment.start()], line.at)


def _has_address_before(before: Line, line: Line) -> bool:
    """Whether two lines begin with addresses between which about as many bytes stand."""
    first = address_of(before.text, before.at)
    then = first and address_of(line.text, line.at)
    if first is None or then is None or len(first.address) != len(then.address):
        return False
    rise = int(then.address, 16) - int(first.address, 16)
    if rise not in _PER_LINE:
        return False
    place = before.text.index(first.address, before.at) + len(first.address)
    pairs = len(_PAIR.findall(before.text[place : place + LONGEST_LINE]))
    return abs(pairs - rise) <= _MOST_GARBLED
