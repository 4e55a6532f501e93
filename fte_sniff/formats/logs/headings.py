"""Owns lines that hold no bytes, but say of those below them when they came and which way.

It must not know what stands below.

    Incoming raw data at 2026-01-31 10:15:02                                PuTTY
    > 2024/02/08 13:45:12.000345678  length=10 from=0 to=9                  socat -x
    2024-02-08 13:45:12.345678: /dev/ttyS0                                  jpnevulator
"""

from __future__ import annotations

import re

from fte_sniff.errors import InputTextError
from fte_sniff.formats.logs.line_head import TIMES, Head, Mark

_MARKS = {"Incoming": Mark.RECEIVED, "Outgoing": Mark.SENT}
_HEADING = re.compile(
    r"\s*(?:(?P<way>Incoming|Outgoing)\ raw\ data\ at\ (?P<putty>.*)"
    r"|[<>]\ (?P<socat>\d{4}/\d\d/\d\d\ \d\d:\d\d:\d\d\S*)\s+length=\d+\ from=\d+\ to=\d+\s*"
    r"|(?P<jpnevulator>\d{4}-\d\d-\d\d\ \d\d:\d\d:\d\d\.\d+):\ /dev/\S+\s*"
    r"|=~[=~]*\s.*|Event\ Log:\ .*)",
    re.VERBOSE,
)
_BEGINS = ("Inc", "Out", "> 2", "< 2", "20", "=~", "Event")
_PACKET = re.compile(r"\d\d:\d\d:\d\d\.\d+ IP6? \S+ > \S+: ")


def heading(line: str, number: int) -> Head | None:
    """What the line says of those below it; None where it is no such line.

    Raises:
        InputTextError: those below hold more than what went over a serial line.
    """
    if " IP" in line and _PACKET.match(line):
        raise InputTextError(
            f"line {number}: packets of tcpdump hold more than their serial bytes; try: tcpdump -w"
            " x.pcap, then tshark -r x.pcap -T fields -e tcp.payload | fte-sniff hex"
        )
    if not line.lstrip().startswith(_BEGINS) or not (found := _HEADING.fullmatch(line)):
        return None
    when = found["putty"] or found["socat"] or found["jpnevulator"]
    time = TIMES.at(when) if when else None
    return Head(len(line), time and time[0], _MARKS.get(found["way"] or ""))
