"""Owns whether numbers on lines are hex or decimal, and decimal ones as bytes.

It must not know what else stands on a line. Hex is what serial assistants write, so numbers are
decimal only where they cannot be hex: three digits up to 255, or a sign before them. Lines that
could be either wait for one that decides; where none does, they are hex, and that is told.

    [170, 1, 1, 3, 232, 0, 0, 0, 0, 238]     JSON, Python
    [-86, 1, 1, 3, -24, 0, 0, 0, 0, -18]     Java, where bytes have signs
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from enum import Enum

from fte_sniff.errors import InputTextError
from fte_sniff.formats.logs.hex_text import bytes_of_line, first_wrong, not_hex, without_literals
from fte_sniff.formats.logs.pasted_line import Line
from fte_sniff.formats.logs.words import WordsBeside

_MOST_HELD = 1000
_FEWEST_HALVES = 4
_TOKEN = re.compile(
    r"(?:0[xX]|\\x|\\u00|\$|&[hH]|%|(?<![0-9A-Za-z]))[0-9A-Fa-f]++[hH]?(?![0-9A-Za-z])"
)
_NUMBER = re.compile(r"(?:(?<![0-9A-Za-z])-)?[0-9]{1,3}(?![0-9A-Za-z])")
_SIGNED = re.compile(r"(?:^|[\s\[({,])-[0-9]{1,3}(?=[\s,\])}]|$)")
_PREFIXED = re.compile(r"0x[0-9a-f]+", re.IGNORECASE)
_PADDED = re.compile(r"(?<![0-9A-Za-z])0[0-9A-Fa-f](?![0-9A-Za-z])")
_PADDED_WORD = re.compile(r"(?:0[xX]|\\x)0[0-9A-Fa-f](?![0-9A-Za-z])|\b0[0-9A-Fa-f][hH]\b")
_ENDING_LONE = re.compile(r"(?:.*[^0-9A-Za-z]|0[xX]|\\x)?[0-9A-Fa-f]")
"""Of the last three characters of a line."""
_HIGHEST = 255
_LOWEST = -128


class _Reading(Enum):
    HEX = "hex"
    DECIMAL = "decimal"


@dataclass(slots=True)
class Numbers:
    """Reads lines as hex or as decimal numbers, all of them in one way."""

    note: Callable[[str], None]
    _reading: _Reading | None = None
    _held: list[Line] = field(default_factory=list)
    _held_lines: int = 0
    _count: int = 0
    """Numbers on the lines that are held."""
    _padded: bool = False
    """Whether a byte below 10 was written with two hex digits."""
    _padded_words: bool = False
    """Whether one with 0x or the like was."""
    _three_digits: bool = False
    """Whether one of them is decimal, if it is a number among others."""
    _words: WordsBeside = field(init=False)

    def __post_init__(self) -> None:
        self._words = WordsBeside(self.note)

    def bytes_of(self, lines: Iterable[Line]) -> Iterator[tuple[Line, bytes]]:
        """The lines, each with its bytes.

        Raises:
            InputTextError: something is neither, or both.
        """
        for line in self._apart(lines):
            if line.data is None and self._reading is None:
                self._weigh(line)
            if self._reading is None and line.data is None:
                self._held.append(line)
                self._held_lines += line.piece.lines
                if self._held_lines > _MOST_HELD:
                    self._reading = _Reading.HEX
                    yield from self._release()
                continue
            yield from self._release()
            yield line, self._read(line)
        if self._reading is None and self._count and not self._three_digits:
            self.note("nothing tells whether the numbers are hex or decimal; they are read as hex")
        yield from self._release()
        self._words.tell()

    def _apart(self, lines: Iterable[Line]) -> Iterator[Line]:
        """The lines, plain ones one by one where one of them may decide, or be wrong."""
        for line in lines:
            if self._reading is _Reading.DECIMAL or (self._reading is None and self._three_digits):
                yield from line.each()
            else:
                yield line

    def _release(self) -> Iterator[tuple[Line, bytes]]:
        held, self._held = self._held, []
        for line in held:
            yield line, self._read(line)

    def _weigh(self, line: Line) -> None:
        """What this line says of how to read it and those that are held."""
        text = without_literals(line.text[line.at :])
        tokens = _TOKEN.findall(text)
        if not tokens:
            # What is no number at all need not wait; brackets alone tell nothing.
            if text != line.text[line.at :] or first_wrong(text, _TOKEN) is not None:
                self._reading = _Reading.HEX
            return
        if _SIGNED.search(text) and all(_is_decimal(token) for token in tokens):
            self._decide_decimal(line)
            return
        if any(map(_is_hex, tokens)) or first_wrong(text, _TOKEN) is not None:
            self._reading = _Reading.HEX
            return
        self._count += len(tokens)
        self._three_digits = self._three_digits or any(len(token) == 3 for token in tokens)
        if self._three_digits and self._count > 1:
            self._decide_decimal(line)

    def _decide_decimal(self, line: Line) -> None:
        self._reading = _Reading.DECIMAL
        self.note(f"line {line.piece.line}: the numbers are read as decimal")

    def _read(self, line: Line) -> bytes:
        if line.data is not None:
            return line.data
        if self._reading is _Reading.DECIMAL:
            return _bytes_of_decimals(line)
        if line.pairs:
            self._padded = self._padded or _PADDED.search(line.text, line.at) is not None
            return bytes.fromhex(line.text[line.at :])
        _refuse_mixture(line)
        try:
            found = bytes_of_line(line.text, line.at, line.piece)
        except InputTextError:
            bare = self._words.without_words(line)
            if bare is None:
                raise
            return self._read(bare)
        self._refuse_lone_digits(line)
        return found

    def _refuse_lone_digits(self, line: Line) -> None:
        """Digits that stand alone where others are padded, or on a line where each stands alone."""
        text = line.text[: line.at] + without_literals(line.text[line.at :])
        digits = list(_TOKEN.finditer(text, line.at))
        self._padded = self._padded or _PADDED.search(text, line.at) is not None
        self._padded_words = self._padded_words or _PADDED_WORD.search(text, line.at) is not None
        bare = text.rstrip()
        if (self._padded or self._padded_words) and _ENDING_LONE.fullmatch(bare[line.at :][-3:]):
            raise not_hex(line.piece, len(bare) - 1, "has no second digit, as others have")
        lone = [found for found in digits if len(found.group()) == 1]
        if not lone:
            return
        if self._padded:
            raise not_hex(line.piece, lone[0].start(), "has no second digit, as others have")
        each = len(lone) == len(digits) >= _FEWEST_HALVES
        if each and any(not found.group().isdecimal() for found in lone):
            raise not_hex(line.piece, lone[0].start(), "may be a byte or half of one")


def _is_decimal(token: str) -> bool:
    return token.isdecimal() and len(token) <= 3 and int(token) <= _HIGHEST


def _is_hex(token: str) -> bool:
    """Whether it can be no decimal number as people write bytes."""
    return not _is_decimal(token) or (len(token) == 2 and token[0] == "0")


def _bytes_of_decimals(line: Line) -> bytes:
    text = " " * line.at + line.text[line.at :]
    wrong = first_wrong(text, _NUMBER)
    if wrong is not None:
        why = "is in no decimal number, as those before it are"
        if text.startswith("..", wrong):
            why = "stands where bytes seem to have been left out (ros2 topic echo --full-length)"
        raise not_hex(line.piece, wrong, why)
    found = bytearray()
    for number in _NUMBER.finditer(text):
        value = int(number.group())
        if not _LOWEST <= value <= _HIGHEST:
            raise InputTextError(
                f"line {line.piece.line}, column {line.piece.column + number.start() + 1}:"
                f" {value} is no byte; bytes are from {_LOWEST} or 0 up to {_HIGHEST}"
            )
        found.append(value & 0xFF)
    return bytes(found)


def _refuse_mixture(line: Line) -> None:
    """Numbers with 0x and two digits without it, as in code, where the latter are decimal."""
    if "," not in line.text or not _PREFIXED.search(line.text):
        return
    text = without_literals(line.text)
    bare = [token for token in _TOKEN.findall(_PREFIXED.sub(" ", text)) if token]
    doubtful = [token for token in bare if len(token) == 2 and not _is_hex(token)]
    if doubtful and not any(_is_hex(token) for token in bare):
        raise line.refused(
            f"{doubtful[0]} may be hex or decimal among numbers with 0x;"
            f" write 0x{doubtful[0]} or 0x{int(doubtful[0]):02X}"
        )
