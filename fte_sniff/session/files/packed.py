"""Owns the way from a recording's columns to the packed rows that a view keeps.

It must not know files, nor what shows the rows.
"""

from __future__ import annotations

import numpy as np

from fte_sniff.analysis.columns.packing import (
    DELAYED,
    FRAMED,
    ROW_TYPE,
    TIMED,
    UNORDERED,
    Codebook,
    PackedRows,
)
from fte_sniff.recording.encoding.columns import RowColumns


def packed_rows(columns: RowColumns) -> PackedRows:
    """The same rows, packed."""
    codebook = Codebook()
    for port in tuple(columns.words.ports):
        codebook.port_code(port)
    for faults in tuple(columns.words.faults):
        codebook.fault_code(faults)
    packed = np.empty(len(columns), ROW_TYPE)
    for name in ("t_ns", "offset", "delay_ns", "length", "port", "faults", "raw"):
        packed[name] = getattr(columns, name)
    packed["form"] = columns.framed * np.uint8(FRAMED) | np.uint8(TIMED)
    packed["form"] |= columns.delayed * np.uint8(DELAYED)
    packed["form"] |= columns.unordered * np.uint8(UNORDERED)
    return PackedRows(packed, columns.long, codebook)
