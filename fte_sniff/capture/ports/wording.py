"""Owns what an error of a port says, on one line: in pyserial's and the system's own words.

It must not know what the port was asked for. What is common is kept in its form and values, so that
the screen can say it in its language; all else stays as it is.
"""

from __future__ import annotations

import re

from fte_sniff.errors import Said, reason_of, shown

_SYSTEM = re.compile(
    r"(?:\[Errno (?P<number>\d+)\] (?P<reason>[^:]*)(?P<about>: .*)?"
    r"|\((?P<bare_number>\d+), '(?P<bare_reason>[^']*)'\))"
)
"""`[Errno 2] No such file or directory: '/dev/x'`, or as termios has it: `(5, 'Input/...')`."""

_WHOLE = {
    str(said): said
    for said in (
        Said(
            "device reports readiness to read but returned no data"
            " (device disconnected or multiple access on port?)"
        ),
        Said("device reports error (poll)"),
        Said("socket disconnected"),
        Said("Write timeout"),
        Said("Attempting to use a port that is not open"),
    )
}


def one_line(error: BaseException) -> str:
    """The error's own text on one line, with nothing that a terminal could obey."""
    if error.args and isinstance(error.args[0], Said):
        return error.args[0]
    return worded(shown(" ".join(str(error).split())))


def worded(text: str) -> str:
    """The same text, as a `Said` where its words are known."""
    if text in _WHOLE:
        return _WHOLE[text]
    if system := _SYSTEM.fullmatch(text):
        return _of_system(system) or text
    lead, colon, rest = text.partition(": ")
    why = worded(rest) if colon else rest
    if not isinstance(why, Said):
        return text
    if lead == "read failed":
        return Said("read failed: {why}", why=why)
    if lead == "write failed":
        return Said("write failed: {why}", why=why)
    if lead == "Could not configure port":
        return Said("Could not configure port: {why}", why=why)
    return text


def _of_system(found: re.Match[str]) -> Said | None:
    number = int(found["number"] or found["bare_number"])
    words = found["reason"] or found["bare_reason"] or ""
    reason = reason_of(OSError(number, words))
    if not isinstance(reason, Said) or reason != words:
        return None
    if found["about"]:
        about = found["about"].removeprefix(": ")
        return Said("[Errno {number}] {reason}: {about}", number=number, reason=reason, about=about)
    return Said("[Errno {number}] {reason}", number=number, reason=reason)
