"""Owns the checksum that guards chunks, data and summary of an MCAP: CRC-32, as in zlib.

It must not know what it is reckoned over. It is not zlib's own, because that takes six times as
long, which was a tenth of all reading.
"""

from __future__ import annotations

from zlib_ng.zlib_ng import crc32

__all__ = ["crc32"]
