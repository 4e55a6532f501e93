r"""Owns lines of strace: what a program wrote to its port, and what it read from there.

It must not know what the bytes are. A line's string becomes a bytes literal at its place:

    write(3, "\xaa\x02\x02\x03\xe8\x00\x00\x27\x10\xee", 10) = 10
    13:45:12.345678 read(3</dev/ttyUSB0>, "U\2\1\0\0'\20\0\17\356", 4096) = 10 <0.000012>
"""

from __future__ import annotations

import re

from fte_sniff.errors import InputTextError
from fte_sniff.formats.logs.line_head import Mark, lone_stamp
from fte_sniff.formats.logs.own_lines import OwnLine

_LINE = re.compile(
    r"\s*(?:\[pid\s+\d+\]\s*|\d+\s+(?=\S+\s|\w+\())?"
    r"(?:(?P<time>\d\d:\d\d:\d\d(?:\.\d+)?|\d{10}\.\d{6,9})\s+|(?:\d+\.\d{6,9})\s+)?"
    r"(?:(?P<call>write|read|pwrite64|pread64|send|recv|sendto|recvfrom)"
    r"\((?P<file>\d+)(?:<[^\"]*>)?,\s(?P<rest>.*)|(?P<other>[a-z_]\w*\(.*|<\.\.\. .*|[-+]{3}\s.*))",
    re.DOTALL,
)
_SENDS = ("write", "pwrite", "send")
_STRING = re.compile(
    r"\"(?P<bytes>(?:[^\"\\]|\\.)*+)\"(?P<left_out>\.\.\.)?(?:,[^)]*)?\)\s+=\s+(?P<count>-?\d+)(?!\w)"
)
_ENDS = re.compile(r"(?:\)\s+=\s+(?:-?\d+|\?|0x)|\s<unfinished \.\.\.>$)|^[-+<]")
_UNIT = re.compile(r"\\x[0-9a-fA-F]{2}|\\[0-7]{1,3}|\\.|[^\\]", re.DOTALL)


class Strace:
    """Reads them; the files of all are to be one, so that they are of one port."""

    def __init__(self) -> None:
        """No line is read yet."""
        self._file: str | None = None

    def own_line(self, text: str, number: int) -> OwnLine | None:
        """What a line holds; None where it is none of strace's.

        Raises:
            InputTextError: bytes are left out, or are those of another file.
        """
        if "(" not in text and "+++" not in text and "---" not in text:
            return None
        line = _LINE.fullmatch(text)
        if line is None or not _ENDS.search(line["other"] or line["rest"]):
            return None
        stamp = lone_stamp(line["time"]) if line["time"] else None
        if line["call"] is None:
            return OwnLine("") if self._file or line["other"][:3] in ("+++", "---") else None
        if not line["rest"].startswith('"'):
            # Nothing came, or it is told on a line of its own.
            if "unfinished" in line["rest"]:
                raise _refused(number, "the call is not finished on its line; trace without -f")
            return OwnLine("")
        string = _STRING.match(line["rest"])
        if string is None:
            raise _refused(number, "the call is cut short; delete the line")
        self._check_file(line["file"], number)
        count = int(string["count"])
        units = list(_UNIT.finditer(string["bytes"]))
        if count > len(units) or (string["left_out"] and count > 0):
            raise _refused(number, "bytes are left out; trace with -s 65536")
        if count <= 0:
            return OwnLine("")
        start = line.start("rest")
        end = units[count - 1].end()
        return OwnLine(
            f'{" " * (start - 1)}b"{string["bytes"][:end]}"',
            stamp,
            Mark.SENT if line["call"].startswith(_SENDS) else Mark.RECEIVED,
        )

    def _check_file(self, file: str, number: int) -> None:
        if self._file not in (None, file):
            raise _refused(
                number,
                f"file {file} is another than {self._file} above; keep the lines of the port alone",
            )
        self._file = file


def _refused(number: int, why: str) -> InputTextError:
    return InputTextError(f"line {number}: {why}")
