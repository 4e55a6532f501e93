"""Owns counting rows that lie side by side into a tally.

It must not know where the rows come from. What it counts, and when, the tally says.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fte_sniff.analysis.accumulators.tally import Tally
from fte_sniff.analysis.columns.fields import kind_codes
from fte_sniff.analysis.columns.packing import PackedRows
from fte_sniff.analysis.columns.side_by_side import SideBySide
from fte_sniff.protocol import KINDS, Row, status_of


def count_rows(tally: Tally, rows: Sequence[Row]) -> None:
    """Count rows, one by one or many at once, whichever they allow."""
    if isinstance(rows, PackedRows):
        count_columns(tally, rows)
    else:
        tally.add(rows)


def count_columns(tally: Tally, rows: SideBySide) -> None:
    """Count these rows too, as `tally.add` counts rows."""
    words = rows.words
    tally.rows += len(rows.t_ns)
    tally.bytes += int(rows.length.sum(dtype=np.int64))
    tally.frames += int(np.count_nonzero(rows.framed))
    for port, count in enumerate(np.bincount(rows.port).tolist()):
        if count:
            tally.by_port[words.ports[port]] += count
    for number, count in enumerate(np.bincount(rows.faults).tolist()):
        if count:
            faults = words.faults[number]
            tally.by_status[status_of(faults)] += count
            for fault in dict.fromkeys(faults):
                tally.by_fault[fault] += count
    for kind, count in zip(
        KINDS, np.bincount(kind_codes(rows.raw, rows.framed), minlength=len(KINDS)), strict=False
    ):
        if count:
            tally.by_kind[kind.name] += int(count)
    timed = rows.timed
    times = rows.t_ns if timed.all() else rows.t_ns[timed]
    if len(times):
        first, last = int(times.min()), int(times.max())
        tally.first_ns = first if tally.first_ns is None else min(first, tally.first_ns)
        tally.last_ns = last if tally.last_ns is None else max(last, tally.last_ns)
