"""Directions and ports that the text around bytes names."""

from __future__ import annotations

import re
from functools import lru_cache
from typing import Final, NamedTuple

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


class Label(NamedTuple):
    """What the text around the bytes of a line says of their wire."""

    word: str | None = None
    """`SENT` or `RECEIVED`, by a word."""
    arrow: str | None = None
    """The same, by an arrow."""
    port: str | None = None
    """The name of a port or channel."""


@lru_cache(maxsize=4096)
def label_of(text: bytes) -> Label:
    """The label in the text before the bytes; the one next to them counts."""
    readable = text.decode("utf-8", "replace")
    words = [found.lastgroup for found in re.finditer(_WORD, readable)]
    arrows = [found.lastgroup for found in re.finditer(_ARROW, readable)]
    ports = [name.lower() for name in re.findall(_PORT, readable)]
    return Label(*(found[-1] if found else None for found in (words, arrows, ports)))


@lru_cache(maxsize=4096)
def without_labels(text: bytes) -> str:
    """The text without directions and ports."""
    return re.sub(f"{_PORT}|{_SENT}|{_RECEIVED}|{_ARROW}", "", text.decode("utf-8", "replace"))
