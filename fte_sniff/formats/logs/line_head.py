"""Owns what serial assistants and logs put in front of the bytes of a line: a time, a direction.

It must not know what the bytes are, nor which day or zone a time belongs to.

    [14:03:22.123]收←◆55 01 ...                     SSCOM
    [2026-01-31 10:15:02.123]# RECV HEX>            the bytes on the lines below
    1769860802.123 AA 01 ...                        seconds since 1970
    2026-01-31 10:15:02,123 - INFO - TX: AA 01 ...
    [INFO] [1769860800.123456789] [base]: AA 01 ... ROS
    Incoming raw data at 2026-01-31 10:15:02        PuTTY, a dump below
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from enum import StrEnum

from fte_sniff.protocol import HEADERS


class Mark(StrEnum):
    """Which way bytes went, as the log says, seen from the machine that wrote it."""

    RECEIVED = "received"
    SENT = "sent"


@dataclass(frozen=True, slots=True)
class Stamp:
    """A time as it is written."""

    date: tuple[int, int, int] | None = None
    """Year, month, day."""
    clock_ns: int | None = None
    """Nanoseconds since midnight; None where the time is `epoch_ns` or counts from no known one."""
    zone_s: int | None = None
    """Seconds east of UTC, where the text says so."""
    epoch_ns: int | None = None
    """Nanoseconds since 1970 UTC, where the time is written so."""


@dataclass(frozen=True, slots=True)
class Head:
    """The front of a line."""

    end: int
    """Where the bytes begin."""
    stamp: Stamp | None = None
    mark: Mark | None = None
    wrong_count: str = ""
    """A count of bytes before them, which they are not as many as; empty where there is none."""


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
    r"(?:HEX|DATA|RAW|FRAME|PACKET|PAYLOAD|BUFFER|BYTES(?=\s*[:=>]))(?![A-Za-z0-9])"
    r"|数据|十六进制"
)

_CLOCK = r"(?P<h{0}>\d{{1,2}}):(?P<m{0}>\d{{2}}):(?P<s{0}>\d{{2}})"
_DATE = r"(?P<y{0}>\d{{4}})[-/.年](?P<o{0}>\d{{1,2}})[-/.月](?P<d{0}>\d{{1,2}})日?[T ]\s*"
_DAY = r"(?P<y{0}>\d{{4}})[-/.](?P<o{0}>\d{{1,2}})[-/.](?P<d{0}>\d{{1,2}})"
_MINUTES = r"(?P<h{0}>[01]?\d|2[0-3]):(?P<m{0}>[0-5]\d)"
_ZONE = r"(?:\s*(?P<z{0}>Z|UTC|[+-]\d{{2}}:?\d{{2}}))?"
_HALF = r"(?:\s*(?P<a{0}>[AP]M))?"
_FRAME = rf"(?:0x)?(?:{'|'.join(f'{header:02X}' for header in HEADERS.values())})"
_BYTE = "(?:0x)?[0-9A-F][0-9A-F]"


def _form(number: int, pattern: str) -> str:
    parts = {
        "MINUTES": _MINUTES,
        "DAY": _DAY,
        "CLOCK": _CLOCK,
        "DATE": _DATE,
        "ZONE": _ZONE,
        "HALF": _HALF,
    }
    for name, part in parts.items():
        pattern = pattern.replace(name, part.format(number))
    return pattern.replace("FRACTION", f"(?P<f{number}>[0-9]{{1,9}})")


_FORMS = (
    r"[\[(<{]\s*(?:DATE)?CLOCK(?:[.,:]FRACTION)?HALFZONE\s*[\])>}]",
    r"DATECLOCK(?:[.,:]FRACTION)?HALFZONE(?![\w:])",
    r"CLOCK[.,]FRACTION(?![\w:])",
    rf"CLOCK(?::(?P<t>\d{{3}})(?![\w:]))?HALF(?=\s*{_DIRECTION})",
)


def _plain_forms(begin: str) -> tuple[str, ...]:
    # Colons are between bytes too.
    behind = rf"(?=\s+{begin}(?:[\s,](?!.*:)|\Z))"
    forms = ("CLOCK", r"CLOCK:(?P<t2>\d{3})", "(?:DATE)?MINUTES", "DAY")
    return tuple(form + behind for form in forms)


def _time(begin: str) -> re.Pattern[str]:
    """What is a time; without a mark, only where `begin` and no colon is behind it."""
    return re.compile(
        r"\s*(?:"
        + "|".join(
            _form(number, form) for number, form in enumerate((*_FORMS, *_plain_forms(begin)))
        )
        + r"|[\[(]\s*(?P<count>\d{1,10}\.\d{3,9})\s*[\])]"
        rf"|(?P<plain>\d{{1,10}}\.\d{{3,9}})(?=\s+(?:{_RECEIVED_WORD}|{_SENT_WORD}))"
        rf"|(?P<epoch>1\d{{9}}(?:\.\d{{1,9}})?)(?=\s+{begin}(?:[\s,](?!.*:)|\Z))"
        r")",
        re.IGNORECASE,
    )


_TIME = _time(_FRAME)
_TIME_AS_BEFORE = _time(_BYTE)
"""In a log that has had times, lines may begin within a frame."""

_ITEM = re.compile(
    r"\s*+(?:"
    rf"[\[(]?(?P<received>{_RECEIVED_WORD})[\])]?{_COUNT}"
    rf"|[\[(]?(?P<sent>{_SENT_WORD})[\])]?{_COUNT}"
    rf"|(?:{_ABOUT}){_COUNT}|{_ARROW}|[:：](?=\s|\Z|[^0-9A-Fa-f])|:"
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
_PUTTY = re.compile(
    r"\s*(?:(?P<way>Incoming|Outgoing) raw data at (?P<when>.*)|=~[=~]*\s.*|Event Log: .*)"
)
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
    if putty := _PUTTY.match(line):
        return _of_putty(line, putty)
    program = _PROGRAM.match(line)
    stamp, mark, at = None, None, program.end() if program else 0
    time_of = _TIME_AS_BEFORE if timed else _TIME
    while True:
        if stamp is None and (time := time_of.match(line, at)):
            stamp, at = _stamp(time), time.end()
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
    if declared := _DECLARATION.match(line, at):
        at = declared.end()
    return Head(at, stamp, mark)


def _of_putty(line: str, heading: re.Match[str]) -> Head:
    if heading["way"] is None:
        return Head(len(line))
    time = _TIME.match(heading["when"])
    mark = Mark.RECEIVED if heading["way"] == "Incoming" else Mark.SENT
    return Head(len(line), time and _stamp(time), mark)


def _stamp(time: re.Match[str]) -> Stamp:
    found = {name[0]: text for name, text in time.groupdict().items() if text is not None}
    counted = time["count"] or time["plain"] or time["epoch"]
    if counted is not None:
        whole, _, fraction = counted.partition(".")
        # What has fewer digits counts from when something was switched on.
        since_1970 = int(whole) * 10**9 + int(fraction.ljust(9, "0"))
        return Stamp(epoch_ns=since_1970 if len(whole) >= 9 else None)
    if "h" not in found:
        return Stamp()
    hours = int(found["h"])
    if "a" in found:
        hours = hours % 12 + (12 if found["a"].upper() == "PM" else 0)
    seconds = (hours * 60 + int(found["m"])) * 60 + int(found.get("s", 0))
    fraction = found.get("f") or found.get("t") or ""
    clock_ns = seconds * 10**9 + int(fraction.ljust(9, "0"))
    date = (int(found["y"]), int(found["o"]), int(found["d"])) if "y" in found else None
    return Stamp(date, clock_ns, _zone(found.get("z")))


def _zone(text: str | None) -> int | None:
    if text is None:
        return None
    if text.upper() in ("Z", "UTC"):
        return 0
    digits = text[1:].replace(":", "")
    east = int(digits[:2]) * 3600 + int(digits[2:]) * 60
    return -east if text[0] == "-" else east
