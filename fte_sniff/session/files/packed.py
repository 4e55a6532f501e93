"""Owns the way from a recording's columns to the packed rows that a view keeps, and back.

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
from fte_sniff.recording.encoding.columns import RowColumns, Words


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


def row_columns(words: Words, rows: PackedRows) -> RowColumns:
    """Packed rows as the columns of a recording, with these words.

    Raises:
        FileError: a row has no time that a recording can hold.
    """
    if not rows.timed.all() or (rows.t_ns < 0).any():
        return RowColumns.of_rows(words, rows)
    ports = np.array([words.port_code(port) for port in rows.words.ports], np.uint16)
    faults = np.array([words.fault_code(found) for found in rows.words.faults], np.uint16)
    return RowColumns(
        words,
        t_ns=rows.t_ns,
        offset=rows.offset,
        delay_ns=rows.delay_ns,
        length=rows.length,
        port=ports[rows.port],
        faults=faults[rows.faults],
        framed=rows.framed,
        delayed=rows.delayed,
        unordered=rows.unordered,
        raw=rows.raw,
        long=dict(rows.long),
    )
