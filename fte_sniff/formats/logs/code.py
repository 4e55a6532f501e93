"""Owns what stands around bytes in source code.

It must not know what the bytes are, nor what else is on a line. Words become blanks, so that
columns stay:

    static const uint8_t f[2][10] PROGMEM = {{0xAAu, (uint8_t)0x02, ...}};       C, Arduino
    buf[0] = 0xAA; buf[1] = 0x02;         DATA[0]=0xAA, DATA[1]=0x02
    ser.write(b"\\xaa\\x02")               bytes.fromhex("AA 02")  array([170, 2], dtype=uint8)
    x := []byte{0xAA}                     let f: [u8; 2] = [0xAAu8, 0x02];       Go, Rust
    byte[] f = new byte[] {(byte) 0xAA}   0AAh, 02h                              Java, assembler
    {"layout": {"dim": [], "data_offset": 0}, "data": [170, 2]}                  ROS
"""

from __future__ import annotations

import re
from itertools import pairwise

from fte_sniff.formats.logs.hex_text import BYTES_LITERAL

ESCAPES = re.compile(r"\x1b\[[0-9;:]*[mK]")
"""What colours text on a terminal."""

_TYPE = r"(?:unsigned\s+char|u?int8_t|uint8|u8|byte|char)"
_NESTED = r"\{0}[^\{0}\{1}]*(?:\{0}[^\{0}\{1}]*\{1}[^\{0}\{1}]*)*\{1}"
_END = r"(?=\s*(?:[,;)}\]]|\Z))"
_WORDS = re.compile(
    rf"(?P<literal>{BYTES_LITERAL.pattern})"
    r"|^\s*\#\s*define\s+\w+\s*(?=\{|\(?\s*0x[0-9a-f]{2}\s*,)"
    # A count of the bytes, such as xxd -i leaves below them.
    r"|^\s*(?:(?:static|const)\s+)*(?:unsigned(?:\s+int)?|int|size_t|u?int\d+_t)\s+"
    r"\w*(?:len|size|count)\w*\s*=\s*\d+\s*;\s*$"
    rf"|\(\s*(?:const\s+)?{_TYPE}\s*\)(?=\s*[-0-9'])"
    rf"|(?<=0x[0-9a-f]{{2}})(?:u8|ul?){_END}"
    rf"|(?<![0-9a-z])0(?=[a-f][0-9a-f]h{_END})"
    r"|\b(?:bytes|bytearray)\.fromhex(?=\()"
    r"|\b(?:np\.|numpy\.)?(?:as)?array(?=\(\[)|,\s*dtype\s*=\s*[\w.'\"]+"
    r"|\barray\('B',\s*(?=\[)|\"type\"\s*:\s*\"Buffer\"\s*,"
    rf"|\"layout\"\s*:\s*{_NESTED.format('{', '}')}\s*,?|\b(?:\w+\.){{0,4}}UInt8MultiArray(?=\()"
    rf"|\blayout\s*=\s*(?:\w+\.){{0,4}}\w+{_NESTED.format(*'()')}\s*,\s*|\bdata=(?=(?:array)?[\[(])"
    r"|\b[a-z_]\w*(?:\.\w+){0,3}\.(?:write|send|sendall)(?=\()"
    rf"|\bnew\s+byte\s*\[\d*\](?=\s*\{{)|\[\d*\]{_TYPE}(?=\{{)|\bvec!(?=\[)"
    rf"|\b(?:let|var|const)\s+(?:mut\s+)?\w+\s*(?::\s*&?\[{_TYPE}(?:;\s*\d+)?\]\s*)?=(?=[^=])"
    r"|\b[a-z_]\w*\s*:=\s*(?=\[)"
    r"|\b(?:(?:public|private|protected|static|final)\s+)*+byte\s*\[\]\s*\w+\s*=(?=[^=])"
    rf"|^\s*(?:[a-z_]\w*[\s*&]+)+\w+\s*(?:\[\w*\]\s*)+(?:[a-z_]\w*\s*)?=(?=\s*(?:\{{|\Z))"
    r"|(?P<place>\b[a-z_]\w*(?:(?:\.|->)\w+){0,3}\s?\[\s?(?P<index>\d+)\s?\]\s*=\s*)(?=0x[0-9a-f])",
    re.IGNORECASE,
)
_LETTERS = "={(#!uUhH"
"""Without one of these a line has no code; most lines are told so, which is quick."""
_HINT = re.compile(
    r"[={]|#\s*define|0x[0-9a-f]{2}u|0[a-f][0-9a-f]h|!\["
    r"|\(\s*(?:const|unsigned|u?int|byte|char|u8|b['\"]|[\[\"'])",
    re.IGNORECASE,
)
"""One of these is in all of them, and in few other lines."""


def without_code(text: str) -> str:
    """The line with blanks where there are words of source code, and not bytes."""
    if not any(map(text.__contains__, _LETTERS)) or not _HINT.search(text):
        return text
    indices = [int(found["index"]) for found in _WORDS.finditer(text) if found["place"]]
    if any(later != before + 1 for before, later in pairwise(indices)):
        # In another order than they stand; so it is not read at all.
        return text
    return _WORDS.sub(lambda found: found["literal"] or " " * len(found.group()), text)
