r"""Owns hex as people write it on one line: from text to bytes.

It must not know what else stands on the line or around it; `pastes` does.

Accepted: digits in pairs, together or apart (`AA0202`, `AA 02 02`), a lone digit that stands by
itself (`AA 2 2`), `0x`, `\x`, `$` and the like in front or `h` behind, any of `, ; : - |` and
brackets and quotes between, a Python bytes literal (`b"\xaa\x02..."`), upper or lower case, and
bits on a line with nothing else (`0b10101010 0b00000001`).
"""

from __future__ import annotations

import re

from fte_sniff.errors import InputTextError
from fte_sniff.formats.logs.text_lines import Piece

BYTES_LITERAL = re.compile(
    r"""(?<![0-9a-z'"])b(?:'(?:[^'\\]|\\.)*+'|"(?:[^"\\]|\\.)*+")""", re.IGNORECASE | re.DOTALL
)
_OPENED_LITERAL = re.compile(r"""(?<![0-9a-z'"])b(?P<quote>['"])""", re.IGNORECASE)
_COMMENT = re.compile(
    rf"{BYTES_LITERAL.pattern}|{_OPENED_LITERAL.pattern}.*|(?P<comment>#.*|//.*|/\*(?:.*?\*/|(?P<open>.*)))",
    re.IGNORECASE | re.DOTALL,
)
_CLOSED = "*/"
_WORD = re.compile(
    r"(?:0x|(?P<escape>\\x|\\u00)|\$|&h|%)?(?P<digits>[0-9a-f]+)(?:h(?![0-9a-z]))?", re.IGNORECASE
)
_BETWEEN = re.compile(
    r"(?:[\s,;:|\-\[\](){}\"'`<>□\u00a0\ufeff]"
    r"|\.(?=\s|\Z|[\])}\"'])|(?<=[0-9a-fA-F]{2})\.(?=[0-9a-fA-F]{2}))+"
    r"|bytearray(?=\()|bytes(?=\()"
    r"|\\(?=\s*\Z)"
)
_BITS = re.compile(r"(?<![0-9A-Za-z])0b(?P<bits>[01]{8})(?![0-9A-Za-z])")
_LINE_OF_BITS = re.compile(r"[\s\[({]*(?:0b[01]{8}[\s,;]+)+0b[01]{8}[\s\])},;]*")
"""Two at least, and nothing else: five bytes that look like bits are not often side by side."""
_BASE64 = re.compile(r"\s*(?:[A-Za-z0-9+/]{4}){2,}(?:[A-Za-z0-9+/]{2}==|[A-Za-z0-9+/]{3}=)?\s*")
_WAY_OUT = "write bytes as hex digits, like AA 01 01 03 E8 00 00 00 00 EE; # starts a comment"


def bytes_of_line(text: str, at: int, piece: Piece) -> bytes:
    """The bytes that a line writes in hex.

    Args:
        text: the line, with blanks where something stood that is no bytes.
        at: where to begin.
        piece: the line as it is, to be shown where something is wrong.

    Raises:
        InputTextError: something is not hex; the message names line, column and the character.
    """
    found = bytearray()
    has_bits = "0b" in text and _BITS.search(text, at) is not None
    only_bits = has_bits and _LINE_OF_BITS.fullmatch(text, at)
    while at < len(text):
        if between := _BETWEEN.match(text, at):
            at = between.end()
        elif literal := BYTES_LITERAL.match(text, at):
            found += _bytes_of_literal(literal.group(), piece, at)
            at = literal.end()
        elif _OPENED_LITERAL.match(text, at):
            raise not_hex(piece, at, "starts a bytes literal that does not end on its line")
        elif has_bits and (one := _BITS.match(text, at)):
            if not only_bits:
                raise not_hex(piece, at, "begins eight bits or five bytes")
            found.append(int(one["bits"], 2))
            at = one.end()
        elif word := _WORD.match(text, at):
            found += _bytes_of_word(word, piece)
            at = word.end()
        else:
            raise not_hex(piece, at, _why(text, at))
    return bytes(found)


def without_literals(text: str) -> str:
    """The text with blanks where Python's bytes literals stand."""
    return BYTES_LITERAL.sub(lambda literal: " " * len(literal.group()), text)


def opened_literal(text: str) -> str | None:
    """The quotation mark of Python's bytes literal that goes on behind the text."""
    if not _OPENED_LITERAL.search(text):
        return None
    return next((found["quote"] for found in _COMMENT.finditer(text) if found["quote"]), None)


def without_comments(text: str, at: int, *, inside: bool) -> tuple[str, bool, bool]:
    """The text with blanks where comments stand, or up to one that goes on to the line's end.

    Returns:
        The text; whether a comment goes on behind it, up to the one that closes it, wherever that
        is; whether one goes on to the line's end.
    """
    parts = [text[:at]]
    if inside:
        closed = text.find(_CLOSED, at)
        if closed < 0:
            return text[:at] + " " * (len(text) - at), True, False
        parts.append(" " * (closed + len(_CLOSED) - at))
        at = closed + len(_CLOSED)
    for comment in _COMMENT.finditer(text, at):
        if comment["comment"] is None:
            continue
        parts.append(text[at : comment.start()])
        if not comment["comment"].startswith("/*"):
            return "".join(parts), False, True
        parts.append(" " * len(comment["comment"]))
        at = comment.end()
        if comment["open"] is not None:
            return "".join(parts), True, False
    return "".join((*parts, text[at:])), False, False


def first_wrong(text: str, number: re.Pattern[str]) -> int | None:
    """Where something stands that is neither a number nor between two; None where nothing does."""
    at = 0
    while at < len(text):
        found = number.match(text, at) or _BETWEEN.match(text, at)
        if found is None:
            return at
        at = found.end()
    return None


def _why(text: str, at: int) -> str:
    if _BASE64.fullmatch(text):
        return "is no hex digit, but base64 has it (base64 -d | fte-sniff decode - --input raw)"
    if text.startswith(("..", "…"), at):
        return "stands where bytes seem to have been left out, or beside them"
    return "is no hex digit"


def _bytes_of_word(word: re.Match[str], piece: Piece) -> bytes:
    digits = word["digits"]
    after = word.string[word.end() : word.end() + 1]
    apart = not after or _BETWEEN.match(word.string, word.end()) is not None
    if word["escape"] and len(digits) > 2:
        raise not_hex(piece, word.start("digits") + 2, "stands behind a whole escape")
    if len(digits) == 1 and apart:
        return bytes([int(digits, 16)])
    if len(digits) % 2:
        # An odd digit run may simply end in a character that is no digit: point at that one.
        if not apart:
            raise not_hex(piece, word.end(), _why(word.string, word.end()))
        raise not_hex(piece, word.end() - 1, "has no second digit to make a byte")
    return bytes.fromhex(digits)


def _bytes_of_literal(literal: str, piece: Piece, at: int) -> bytes:
    from ast import literal_eval

    try:
        value = literal_eval(literal)
    except (SyntaxError, ValueError) as error:
        raise not_hex(piece, at, "starts a bytes literal that Python cannot read") from error
    return bytes(value)


def not_hex(piece: Piece, at: int, why: str) -> InputTextError:
    """What to tell of the character at that place of a line."""
    line = piece.text
    before, here, after = line[max(0, at - 12) : at], line[at], line[at + 1 : at + 12]
    return InputTextError(
        f"not hex: {here!r} {why}, line {piece.line}, column {piece.column + at + 1}:"
        f" {before}>>{here}<<{after} ({_WAY_OUT})"
    )
