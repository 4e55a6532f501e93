"""Owns what serial assistants and logs put in front of the bytes of a line: a time, a direction.

It must not know what the bytes are, nor how a time is written (`line_time` does).

    [14:03:22.123]收←◆55 01 ...                     SSCOM
    [2026-01-31 10:15:02.123]# RECV HEX>            the bytes on the lines below
    1769860802.123 AA 01 ...                        seconds since 1970
    2026-01-31 10:15:02,123 - INFO - TX: AA 01 ...
    [INFO] [1769860800.123456789] [base]: AA 01 ... ROS
    2/8/2024 13:45:12.345 [TX] - AA 01 ...          Docklight
    [08/02/2024 13:45:12] Written data (COM3)       Eltima, the bytes below
    (13:45:12.345) (COM3) (>>) AAh 01h ... (10)     YAT, which counts the bytes behind them
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from enum import StrEnum

from fte_sniff.formats.logs.line_time import Stamp, Times
from fte_sniff.protocol import HEADERS


class Mark(StrEnum):
    """Which way bytes went, as the log says, seen from the machine that wrote it."""

    RECEIVED = "received"
    SENT = "sent"


@dataclass(frozen=True, slots=True)
class Head:
    """The front of a line."""

    end: int
    """Where the bytes begin."""
    stamp: Stamp | None = None
    mark: Mark | None = None
    wrong_count: str = ""
    """A count of bytes beside them, which they are not as many as; empty where there is none."""
    stop: int | None = None
    """Where the bytes end, with their count behind them; None for the end of the line."""


_RECEIVED = r"RX[0-9]?|RXD|RECV|RECEIVED?|READ|IN|Incoming"
_SENT = r"TX[0-9]?|TXD|SEND|SENT|WRITE|WROTE|WRITTEN|OUT|Outgoing"
_COUNT = (
    r"(?:\s*+[\[(]\s*+(?:len\s*+[=:]?\s*+)?\d{1,5}\s*+(?:bytes?|字节)?\s*+[\])](?=\s*+[:>=-])"
    r"|\s*+\d{1,5}\s*+(?:bytes?|字节)(?![A-Za-z]))?"
)
_WORD_END = r"(?![A-Za-z0-9])"
_RECEIVED_WORD = rf"(?:(?:{_RECEIVED}){_WORD_END}|R(?=\s?:)|接收到?|收到?|读取?)"
_SENT_WORD = rf"(?:(?:{_SENT}){_WORD_END}|T(?=\s?:)|已?发送|发|写入?)"
_ARROW = r"(?:[→←↑↓◆◇►◄▶◀>=<]|-(?![0-9]))+"
_DIRECTION = rf"(?:{_RECEIVED_WORD}|{_SENT_WORD}|{_ARROW})"
_ABOUT = (
    r"(?:HEX(?:/\d{1,5})?|DATA|RAW|FRAME|PACKET|PAYLOAD|BUFFER|BYTES(?=\s*[:=>]))(?![A-Za-z0-9])"
    r"|数据|十六进制|(?:(?<=READ )|(?<=WRITTEN ))DA(?=\s*\Z)"
)

_FRAME = rf"(?:0x)?(?:{'|'.join(f'{header:02X}' for header in HEADERS.values())})"
_BYTE = "(?:0x)?[0-9A-F][0-9A-F]"
_WORD = f"{_RECEIVED_WORD}|{_SENT_WORD}"
TIMES = Times(_FRAME, _WORD, _DIRECTION)
_TIMES_AS_BEFORE = Times(_BYTE, _WORD, _DIRECTION)
"""In a log that has had times, lines may begin within a frame."""

_ITEM = re.compile(
    r"\s*+(?:"
    rf"[\[(]?(?P<received>{_RECEIVED_WORD})[\])]?{_COUNT}"
    rf"|[\[(]?(?P<sent>{_SENT_WORD})[\])]?{_COUNT}"
    rf"|(?:{_ABOUT}){_COUNT}|{_ARROW}|\((?:<<|>>)\)|[:：](?=\s|\Z|[^0-9A-Fa-f])|:"
    r"|\((?:COM\d{1,3}|/dev/tty\w+|\+\d+\.\d+)\)|(?:FROM|TO)\s+\d+(?:\.\d+){3}\s?:\d+"
    r"|\[?\s*+(?:TRACE|DEBUG|INFO|NOTICE|WARN|WARNING|ERROR)\s*\]?(?![A-Za-z0-9])(?::[\w.]+(?=:))?"
    r")",
    re.IGNORECASE,
)
_LENGTH = re.compile(
    r"\s*:\s?(?P<count>\d{1,4})(?:\s{2,}|\t)(?P<bytes>(?:[0-9A-F]{2}\s)*[0-9A-F]{2})\s*\Z",
    re.IGNORECASE,
)
"""How many bytes there are, apart from them as they are not from each other."""
_SOURCE = re.compile(r"\s*\[[A-Za-z_/][\w./ -]*\]\s*(?=:)")
_PROGRAM = re.compile(
    r"\s*\[[A-Za-z_/][\w./-]*-\d+\]\s*(?=\[(?:TRACE|DEBUG|INFO|WARN|ERROR)\])"
    r"|[EWIDV] \(\d+\) [A-Za-z_][\w.-]*:(?=\s)"
    rf"|\s*(?:COM\d{{1,3}}|/dev/tty\w+)\s*:?\s+(?={_DIRECTION})"
)
"""What wrote the line, or where: ros2 launch, ESP-IDF, a port."""
_HASH = re.compile(rf"\s*#\s*(?={_DIRECTION})", re.IGNORECASE)
_COUNTED = re.compile(
    r"(?P<bytes>[^()\[\]]*[^()\[\]\s])\s*[\[(]\s*(?:len\s*[=:]?\s*)?"
    r"(?P<count>\d{1,5})\s*(?:bytes?|字节)?\s*[\])]?\s*\Z",
    re.IGNORECASE,
)
_PAIR = re.compile(r"[0-9A-Fa-f]{2}")
_NAME = r"(?!(?:[0-9a-f]{2})+(?!\w))[a-z_]\w*+"
"""A word of a declaration; what could be bytes is none."""
_DECLARATION = re.compile(
    rf"\s*+(?:(?:{_NAME}[\s:<>*&]*+(?:\[\d*\]\s*+)?)++=\s*+"
    rf"(?:new\s+{_NAME}\s*+\[\d*\]\s*+)?(?=[\[{{(b\"'])"
    r"|[{\s]*[\"']?[a-z_]\w*[\"']?\s*+:\s*+(?=\[)"
    r"|<Buffer\s+|Uint8Array\(\d+\)\s*+(?=\[))",
    re.IGNORECASE,
)


def head_of(line: str, *, timed: bool = False) -> Head:
    """What stands in front of the bytes of a line.

    Args:
        line: the line.
        timed: whether a line before it had a time.
    """
    program = _PROGRAM.match(line)
    stamp, mark, at = None, None, program.end() if program else 0
    times = _TIMES_AS_BEFORE if timed else TIMES
    while True:
        if stamp is None and (time := times.at(line, at)):
            stamp, at = time
            # Elsewhere it begins a comment.
            at = hashed.end() if (hashed := _HASH.match(line, at)) else at
        elif (source := _SOURCE.match(line, at)) and (stamp is not None or at):
            at = source.end()
        elif (item := _ITEM.match(line, at)) and item.end() > at:
            said = Mark.RECEIVED if item["received"] else Mark.SENT if item["sent"] else None
            mark, at = mark or said, item.end()
            if said and (length := _LENGTH.match(line, at)):
                if int(length["count"]) != len(length["bytes"].split()):
                    return Head(at, stamp, mark, length["count"])
                at = length.start("bytes")
        else:
            break
    bracketed = at and (line.find("(", at) >= 0 or line.find("[", at) >= 0)
    if bracketed and (counted := _COUNTED.fullmatch(line, at)):
        if int(counted["count"]) != len(_PAIR.findall(counted["bytes"])):
            return Head(at, stamp, mark, counted["count"])
        return Head(at, stamp, mark, stop=counted.end("bytes"))
    if declared := _DECLARATION.match(line, at):
        at = declared.end()
    return Head(at, stamp, mark)


def lone_stamp(text: str) -> Stamp | None:
    """The time that the text is and nothing else; None where it is none."""
    boxed = f"[{text.strip()}]"
    time = TIMES.at(boxed)
    return time[0] if time and time[1] == len(boxed) else None
