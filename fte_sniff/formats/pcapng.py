"""pcapng files of rows, for Wireshark and tshark with the dissector of `decoders`.

A file is a sequence of blocks (draft-ietf-opsawg-pcapng): a section header, a description of each
port when its first row comes, and a packet per row. A packet begins with the tags of an exported
PDU (link type 252, `epan/exported_pdu.h`), which name the dissector, and then has the row's bytes:

    +----------------------+------+------------+--------------+-------------+
    | type, block length   | port | time, ns   | tags + bytes | options     | block length
    +----------------------+------+------------+--------------+-------------+
                                                   comment: the faults; flags: the direction
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from functools import cache
from struct import pack
from typing import BinaryIO, Final

from fte_sniff.errors import FileError
from fte_sniff.protocol.rows import Row
from fte_sniff.protocol.spec import Direction

LINK_TYPE: Final = 252
"""LINKTYPE_WIRESHARK_UPPER_PDU: exported PDUs, which name their dissector."""

FRAME_DISSECTOR: Final = "fte"
DAMAGE_DISSECTOR: Final = "fte_damage"

COMMENT: Final = "faults: "
"""Begins the comment of a row with faults; they follow as in CSV."""

_SECTION, _INTERFACE, _PACKET = 0x0A0D0D0A, 1, 6
_BYTE_ORDER: Final = 0x1A2B3C4D
_NAME_TAG: Final = 12
_FLAGS: Final = {None: 0, Direction.FEEDBACK: 1, Direction.CONTROL: 2}
"""Inbound or outbound, as the host sees it."""
_LONGEST_OPTION: Final = 2**16 - 1
"""Bytes of a text, such as the name of a port; a longer one is cut."""


class PcapngWriter:
    """Writes rows to a binary stream, which stays open."""

    def __init__(self, stream: BinaryIO, bauds: Mapping[str, int]) -> None:
        """Write the section header; `bauds` are by port."""
        self._stream = stream
        self._bauds = bauds
        self._interfaces: dict[str, int] = {}
        application = _option(4, b"fte-sniff")
        head = pack("<IHHq", _BYTE_ORDER, 1, 0, -1)
        stream.write(_block(_SECTION, head + application + _option(0, b"")))

    def write(self, rows: Iterable[Row]) -> None:
        """Write the rows.

        Raises FileError if a row has no time.
        """
        self._stream.write(b"".join(map(self._blocks, rows)))

    def _blocks(self, row: Row) -> bytes:
        """The block of a row, behind the description of its port if it is the first."""
        if row.t_ns is None or row.t_ns < 0:
            raise FileError(
                f"{row.port!r}, offset {row.offset}, has no time since 1970, and pcapng needs one;"
                " write another format"
            )
        interface, described = self._interfaces.get(row.port), b""
        if interface is None:
            interface = self._interfaces[row.port] = len(self._interfaces)
            described = self._description(row.port)
        is_frame = row.framed
        data = _tags(FRAME_DISSECTOR if is_frame else DAMAGE_DISSECTOR) + row.raw
        options = _option(2, pack("<I", _FLAGS[row.direction]))
        if row.faults:
            options = _option(1, f"{COMMENT}{','.join(row.faults)}".encode()) + options
        high, low = divmod(row.t_ns, 1 << 32)
        head = pack("<IIIII", interface, high, low, len(data), len(data))
        return described + _block(_PACKET, head + _padded(data) + options + _option(0, b""))

    def _description(self, port: str) -> bytes:
        options = _option(2, port.encode("utf-8", "backslashreplace")) + _option(9, bytes([9]))
        if port in self._bauds:
            options += _option(8, pack("<Q", self._bauds[port]))
        return _block(_INTERFACE, pack("<HHI", LINK_TYPE, 0, 0) + options + _option(0, b""))


@cache
def _tags(dissector: str) -> bytes:
    name = _padded(dissector.encode() + b"\0")
    return pack(">HH", _NAME_TAG, len(name)) + name + pack(">HH", 0, 0)


def _block(kind: int, body: bytes) -> bytes:
    length = pack("<I", len(body) + 12)
    return pack("<I", kind) + length + body + length


@cache
def _option(code: int, value: bytes) -> bytes:
    value = value[:_LONGEST_OPTION]
    return pack("<HH", code, len(value)) + _padded(value)


def _padded(data: bytes) -> bytes:
    return data + bytes(-len(data) % 4)
