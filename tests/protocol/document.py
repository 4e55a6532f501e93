"""The examples of the vendor's document (docs/reference/protocol.md, "Examples")."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from fte_sniff.protocol.spec import KIND_BY_NAME, FrameKind


class Example(NamedTuple):
    """One example; NUM and reserve are 00 where the document leaves them out."""

    text: str
    """The bytes in hex."""
    kind: str
    values: Mapping[str, int]
    """By row name."""
    shown: str
    """The values as they are printed."""

    @property
    def raw(self) -> bytes:
        """The bytes."""
        return bytes.fromhex(self.text)

    @property
    def frame_kind(self) -> FrameKind:
        """The kind in the frame table."""
        return KIND_BY_NAME[self.kind]


EXAMPLES = [
    Example("AA 00 00 00 00 00 00 00 00 EE", "reset", {}, ""),
    Example(
        "AA 01 01 03 E8 00 00 00 00 EE",
        "speed",
        {"motor": 1, "rpm": 1000},
        "motor=1 rpm=1000",
    ),
    Example(
        "AA 02 02 03 E8 00 00 27 10 EE",
        "position",
        {"motor": 2, "rpm": 1000, "pulses": 10000},
        "motor=2 rpm=1000 pulses=10000",
    ),
    Example(
        "AA 03 00 00 0A 00 00 00 00 EE",
        "mecanum",
        {"vx_cm_s": 10, "vy_cm_s": 0, "wz_mrad_s": 0},
        "vx_cm_s=10 vy_cm_s=0 wz_mrad_s=0",
    ),
    Example(
        "AA 03 00 00 14 00 0A 00 00 EE",
        "mecanum",
        {"vx_cm_s": 20, "vy_cm_s": 10, "wz_mrad_s": 0},
        "vx_cm_s=20 vy_cm_s=10 wz_mrad_s=0",
    ),
    Example(
        "55 01 01 03 E8 00 00 00 0F EE",
        "speed_feedback",
        {"motor": 1, "rpm": 1000, "error": 0, "online": 15},
        "motor=1 rpm=1000 error=0x00 online=0x0F",
    ),
    Example(
        "55 02 01 00 00 27 10 00 0F EE",
        "position_feedback",
        {"motor": 1, "pulses": 10000, "error": 0, "online": 15},
        "motor=1 pulses=10000 error=0x00 online=0x0F",
    ),
]
"""In the order of the document."""
