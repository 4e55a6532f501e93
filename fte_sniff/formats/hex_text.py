r"""Owns hex as people write and paste it: from text to bytes.

It must not know what the bytes mean or where the text came from.

Accepted: digits in pairs, together or apart (`AA0202`, `AA 02 02`), a lone digit that stands by
itself (`AA 2 2`), `0x` and `\x` in front, any of `, ; : - |` and brackets and quotes between, a
Python bytes literal (`b"\xaa\x02..."`), upper or lower case, any number of lines; `#` and `//`
begin a comment. A line may start with what serial assistants put there: a time, and words or arrows
for the direction.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator

from fte_sniff.errors import InputTextError

_COMMENT = re.compile(r"#|//")
_DIRECTION = (
    r"(?:(?:RX|TX|RECV|RECEIVED?|SEND|SENT|IN|OUT)(?![A-Za-z0-9])|接收|发送|收|发"
    r"|[→←↑↓◆◇►◄▶◀>=＞＜<-]+)"
)
_CLOCK = r"\d{1,2}:\d{2}:\d{2}"
_DATE = r"\d{4}[-/]\d{1,2}[-/]\d{1,2}[T ]"
_TIME = (
    rf"(?:[\[(【]\s*(?:{_DATE})?{_CLOCK}(?:[.,:]\d+)?Z?\s*[\])】]"  # in brackets
    rf"|{_DATE}{_CLOCK}(?:[.,]\d+)?Z?(?![\w:])"  # with a date
    rf"|{_CLOCK}[.,]\d+(?![\w:])"  # with a fraction of a second
    rf"|{_CLOCK}(?=\s*{_DIRECTION})"  # before a direction
    rf"|{_CLOCK}(?=\s[^:]*$))"  # alone, where no other colon could make it bytes
)
_LINE_START = re.compile(
    rf"\s*(?:{_TIME})?\s*(?:[\[(【]?{_DIRECTION}[\])】]?\s*)*[:：]?", re.IGNORECASE
)
_BYTES_LITERAL = re.compile(r"""b(?:'(?:[^'\\]|\\.)*'|"(?:[^"\\]|\\.)*")""", re.IGNORECASE)
_WORD = re.compile(r"(?:0x|\\x)?([0-9a-f]+)", re.IGNORECASE)
_BETWEEN = re.compile(r"[\s,;:|\-\[\](){}\"'<>，；：、\u00a0\ufeff]+")


def bytes_of_text(text: str) -> bytes:
    """All the bytes that `text` writes in hex.

    Raises:
        InputTextError: something is not hex; the message names line, column and the character.
    """
    return b"".join(bytes_of_lines(text.splitlines()))


def bytes_of_lines(lines: Iterable[str]) -> Iterator[bytes]:
    """The bytes of each line, one item a line that has any.

    Raises:
        InputTextError: something is not hex; the message names line, column and the character.
    """
    for number, line in enumerate(lines, start=1):
        found = _bytes_of_line(line.rstrip("\r\n"), number)
        if found:
            yield found


def _bytes_of_line(line: str, number: int) -> bytes:
    found = bytearray()
    start = _LINE_START.match(line)
    at = start.end() if start else 0
    while at < len(line) and not _COMMENT.match(line, at):
        if between := _BETWEEN.match(line, at):
            at = between.end()
        elif literal := _BYTES_LITERAL.match(line, at):
            found += _bytes_of_literal(literal.group(), line, number, at)
            at = literal.end()
        elif word := _WORD.match(line, at):
            found += _bytes_of_word(word, line, number)
            at = word.end()
        else:
            raise _not_hex(line, number, at, "is no hex digit")
    return bytes(found)


def _bytes_of_word(word: re.Match[str], line: str, number: int) -> bytes:
    digits = word.group(1)
    if len(digits) == 1:
        after = word.string[word.end() : word.end() + 1]
        if not after or _BETWEEN.match(after):
            return bytes([int(digits, 16)])
    if len(digits) % 2:
        # An odd digit run may simply end in a character that is no digit: point at that one.
        after = word.string[word.end() : word.end() + 1]
        if after and not _BETWEEN.match(after):
            raise _not_hex(line, number, word.end(), "is no hex digit")
        raise _not_hex(line, number, word.end() - 1, "has no second digit to make a byte")
    return bytes.fromhex(digits)


def _bytes_of_literal(literal: str, line: str, number: int, at: int) -> bytes:
    from ast import literal_eval

    try:
        value = literal_eval(literal)
    except (SyntaxError, ValueError) as error:
        raise _not_hex(
            line, number, at, "starts a bytes literal that Python cannot read"
        ) from error
    return bytes(value)


def _not_hex(line: str, number: int, at: int, why: str) -> InputTextError:
    before, here, after = line[max(0, at - 12) : at], line[at], line[at + 1 : at + 12]
    return InputTextError(
        f"not hex: {here!r} {why}, line {number}, column {at + 1}: {before}>>{here}<<{after}"
        " (write bytes as hex digits, like AA 01 01 03 E8 00 00 00 00 EE; # starts a comment)"
    )
