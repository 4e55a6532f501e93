"""Files that hold no bytes of a wire, by how they begin: programs, archives, captures, results."""

from __future__ import annotations

import re
from typing import Final

from fte_sniff.errors import FileError


def _result(what: str, reader: str) -> str:
    """The refusal of rows that this program wrote, with the function of polars that reads them."""
    polars = f", or read it with polars.{reader}" if reader else ""
    return (
        f"holds rows that fte-sniff wrote as {what}, a result, which is not decoded again;"
        f" name the recording (.mcap) or the log that they come from{polars}"
    )


_NO_LOG: Final = "which holds no log;"
_KNOWN: Final = {
    rb"\x7fELF": f"is a program, {_NO_LOG} name a log or a recording",
    rb"\x89PNG\r\n\x1a\n": f"is a PNG picture, {_NO_LOG} save the log as text",
    rb"\x1f\x8b\x08": f"is a gzip archive, {_NO_LOG} unpack it with gunzip first",
    rb"PK\x03\x04": (
        f"is a zip archive or an office document, {_NO_LOG} unpack it, or save it as text or CSV"
    ),
    rb"%PDF": f"is a PDF, {_NO_LOG} save the log as text",
    rb"SQLite format 3\0": (
        f"is a ROS 2 bag or another SQLite database, {_NO_LOG} convert a ROS 2 bag with"
        " `ros2 bag convert` to MCAP, then name its topic with --topic"
    ),
    rb"\xd4\xc3\xb2\xa1|\xa1\xb2\xc3\xd4|\x4d\x3c\xb2\xa1|\xa1\xb2\x3c\x4d|\x0a\x0d\x0d\x0a": (
        f"is a capture of packets, {_NO_LOG} export the payload as text with tshark -T fields, and"
        " read that"
    ),
    rb"PAR1": _result("Parquet", "read_parquet"),
    rb"\s*time,port,offset": _result("CSV", "read_csv"),
    rb"\s*\{\"time\": *[^,]*, *\"port\":": _result("JSON lines", "read_ndjson"),
    rb"\s*(?:time\s+)?(?:port\s+)?offset\s+kind\s+values\s+raw\b": _result("a table", ""),
}
"""By what a file begins with: why it is refused, and what to do."""


def refuse_known(name: str, first: bytes) -> None:
    """Raise FileError if a file begins as one that holds no bytes of a wire."""
    for start, reason in _KNOWN.items():
        if re.match(start, first):
            raise FileError(f"{name}: {reason}")
