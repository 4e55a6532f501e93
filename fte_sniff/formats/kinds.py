"""Owns which kind of input a file is: a recording, raw bytes, or hex text.

It must not read a file beyond its first bytes.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum
from pathlib import Path
from types import MappingProxyType

from fte_sniff.errors import UsageError, unreadable
from fte_sniff.formats.logs.text_lines import looks_like_text

MCAP_MAGIC = b"\x89MCAP0\r\n"
"""The first bytes of every MCAP file."""


class InputKind(StrEnum):
    """What a file holds."""

    MCAP = "mcap"
    RAW = "raw"
    HEX = "hex"


KIND_OF_SUFFIX: Mapping[str, InputKind] = MappingProxyType(
    {
        ".mcap": InputKind.MCAP,
        ".bin": InputKind.RAW,
        ".raw": InputKind.RAW,
        ".hex": InputKind.HEX,
        ".txt": InputKind.HEX,
        ".log": InputKind.HEX,
        ".csv": InputKind.HEX,
        ".jsonl": InputKind.HEX,
    }
)
"""The kind that a file's name promises."""


def kind_of_file(path: Path) -> InputKind:
    """What the file holds, by the end of its name, or else by the magic of an MCAP.

    Raises:
        FileError: the file cannot be read.
        UsageError: neither name nor content tells.
    """
    named = KIND_OF_SUFFIX.get(path.suffix.lower())
    if named is not None:
        return named
    try:
        with path.open("rb") as file:
            first = file.read(len(MCAP_MAGIC))
    except OSError as error:
        raise unreadable(path, error) from error
    if first == MCAP_MAGIC:
        return InputKind.MCAP
    names = ", ".join(KIND_OF_SUFFIX)
    raise UsageError(
        f"{path}: the name does not tell what is in it ({names}); say --input {'|'.join(InputKind)}"
    )


def kind_of_content(first: bytes) -> InputKind:
    """What a stream most likely holds, by its first bytes: text is hex, all else is raw bytes."""
    if first.startswith(MCAP_MAGIC):
        return InputKind.MCAP
    return InputKind.HEX if looks_like_text(first) else InputKind.RAW
