"""Files that hold no bytes of a wire, by how they begin: programs, archives, captures, results."""

from __future__ import annotations

import re
from typing import Final

from fte_sniff.errors import FileError
from fte_sniff.protocol.columns import COLUMNS

_BINARY: Final = {
    b"\x7fELF": ("a program", "name a log or a recording"),
    b"\x89PNG\r\n\x1a\n": ("a PNG picture", "save the log as text"),
    b"\x1f\x8b\x08": ("a gzip archive", "unpack it with gunzip first"),
    b"PK\x03\x04": ("a zip archive or an office document", "unpack it, or save it as text or CSV"),
    b"%PDF": ("a PDF", "save the log as text"),
    b"SQLite format 3\0": (
        "a ROS 2 bag or another SQLite database",
        "convert a ROS 2 bag with `ros2 bag convert` to MCAP, then name its topic with --topic",
    ),
    **dict.fromkeys(
        (b"\xd4\xc3\xb2\xa1", b"\xa1\xb2\xc3\xd4", b"\x4d\x3c\xb2\xa1", b"\xa1\xb2\x3c\x4d",
         b"\x0a\x0d\x0d\x0a"),
        ("a capture of packets", "export the payload as text with tshark -T fields, and read that"),
    ),
}  # fmt: skip
"""By first bytes: what it is, and what to do."""
_NAMES: Final = [column.name for column in COLUMNS]
_RESULTS: Final = {
    "CSV": (re.compile(",".join(_NAMES[:3])), "read_csv"),
    "JSON lines": (re.compile(r'\{"time": *[^,]*, *"port":'), "read_ndjson"),
    "a table": (re.compile(r"\s*(?:time\s+)?(?:port\s+)?offset\s+kind\s+values\s+raw\b"), ""),
}
"""What this program writes, how it begins, and the function of polars that reads it."""
PARQUET_MAGIC: Final = b"PAR1"


def refuse_binary(name: str, first: bytes) -> None:
    """Raise FileError if a file begins as a known kind of binary files, or as Parquet."""
    if first.startswith(PARQUET_MAGIC):
        raise _result(name, "Parquet", "read_parquet")
    for magic, (what, fix) in _BINARY.items():
        if first.startswith(magic):
            raise FileError(f"{name}: is {what}, which holds no log; {fix}")


def refuse_results(name: str, first: str) -> None:
    """Raise FileError if a text begins as the results of this program."""
    for what, (start, reader) in _RESULTS.items():
        if start.match(first.lstrip()):
            raise _result(name, what, reader)


def _result(name: str, what: str, reader: str) -> FileError:
    polars = f", or read it with polars.{reader}" if reader else ""
    return FileError(
        f"{name}: holds rows that fte-sniff wrote as {what}, a result, which is not decoded again;"
        f" name the recording (.mcap) or the log that they come from{polars}"
    )
