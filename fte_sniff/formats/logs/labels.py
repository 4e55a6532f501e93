"""Directions and ports that the text around bytes names."""

from __future__ import annotations

import re
from functools import lru_cache
from typing import Final

SENT: Final = "tx"
RECEIVED: Final = "rx"

_SENT: Final = (
    r"(?i:(?<![a-z])(?:tx\d?|txd|out(?:going|put)?|transmit(?:ted)?|wrote|request|host|master|pc"
    r"|t(?=\s?:))(?![a-z])|(?<![a-z])(?:on|serial)?_?(?:send|sent|writ(?:e|es|ten|ing))(?![a-z]))"
    r"|[a-z](?:Send|Sent|Write)|发[送出]?|写入?"
)
_RECEIVED: Final = (
    r"(?i:(?<![a-z])(?:rx\d?|rxd|in(?:coming|put)?|reply|response|device|slave|mcu|r(?=\s?:))(?![a-z])"
    r"|(?<![a-z])(?:on|serial)?_?(?:recv|receiv(?:e|es|ed|ing)|reads?|reading)(?![a-z]))"
    r"|on(?:New)?Data|[a-z](?:Recv|Receiv|Read)|接?收到?|读取?"
)
_WORD: Final = rf"(?P<tx>{_SENT})|(?P<rx>{_RECEIVED})"
_ARROW: Final = r"(?P<tx>[→⇒►▶]|[=-]>|>+)|(?P<rx>[←⇐◄◀]|<[=-]|<+(?!\w))"
_PORT: Final = (
    r"(?<![A-Za-z])(?:/dev/)?((?i:com\d+|tty[a-z]*\d+|cu\.[\w-]+|us?art[-_ ]?\d+|serial\d+"
    r"|ch(?:annel)?[-_ ]?\d+|port[-_ ]?\d+|peer\d+))(?![A-Za-z0-9])"
)


_PATTERNS: Final = {"word": _WORD, "arrow": _ARROW, "port": _PORT}


@lru_cache(maxsize=4096)
def label_of(kind: str, text: bytes) -> str | None:
    """The last label of a kind in a text: `word`, `arrow`, `port`, `both`, or all the text."""
    readable = text.decode("utf-8", "replace").strip(" \x01").lower()
    if kind == "given":
        return direction_of(text) or readable
    if kind == "both":
        port, direction = label_of("port", text), direction_of(text)
        return f"{port}-{direction}" if port and direction else None
    found = list(re.finditer(_PATTERNS[kind], text.decode("utf-8", "replace")))
    return (found[-1].lastgroup or found[-1][1].lower()) if found else None


def direction_of(text: bytes) -> str | None:
    """`SENT` or `RECEIVED`, by a word or an arrow."""
    return label_of("word", text) or label_of("arrow", text)


@lru_cache(maxsize=4096)
def without_labels(text: bytes) -> str:
    """The text without directions and ports."""
    return re.sub(f"{_PORT}|{_SENT}|{_RECEIVED}|{_ARROW}", "", text.decode("utf-8", "replace"))
