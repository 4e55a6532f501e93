"""The frame before of the same port, motor and kind: what the filter function `previous` reads."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from fte_sniff.analysis.feed import StreamChange
from fte_sniff.analysis.model import Model
from fte_sniff.protocol import KINDS, Gap
from fte_sniff.protocol.rows import NO_FACT, NO_KIND, Ints, Rows, no_facts

_NAMES_MOTOR: Final = np.array([*(kind.names_motor for kind in KINDS), False])
"""By kind code, whether NUM is a motor."""


class PreviousFrames(Model):
    """The frame before of the same port, motor and kind, for consecutive rows."""

    def __init__(self) -> None:
        self._last: dict[tuple[str, int, int], int] = {}
        """By port, kind and NUM (0 for kinds without a motor), the payload of the last frame."""

    def add(self, rows: Rows, changes: Sequence[StreamChange] = ()) -> Rows:
        """The next rows, with `previous`; it is not known across the gaps between them."""
        found, start = [], 0
        for change in changes:
            if isinstance(change.what, Gap):
                found.append(self._added(rows[start : change.index]))
                self.interrupt()
                start = change.index
        found.append(self._added(rows[start:]))
        return rows.with_facts(no_facts(len(rows)) | {"previous": np.concatenate(found)})

    def interrupt(self) -> None:
        """Rows are missing here."""
        self._last.clear()

    def _added(self, rows: Rows) -> Ints:
        found = np.full(len(rows), NO_FACT, np.int64)
        kinds = rows.kinds
        at = np.flatnonzero(kinds != NO_KIND)
        ports, kinds = rows.port[at], kinds[at].astype(np.int64)
        nums = np.where(_NAMES_MOTOR[kinds], rows.nums[at], 0)
        keys = (ports.astype(np.int64) * len(KINDS) + kinds) * 256 + nums
        payloads = rows.payloads[at]
        for key in np.unique(keys).tolist():
            own = np.flatnonzero(keys == key)
            first = int(own[0])
            name = (rows.codebook.ports[ports[first]], int(kinds[first]), int(nums[first]))
            found[at[own[1:]]] = payloads[own[:-1]]
            found[at[first]] = self._last.get(name, NO_FACT)
            self._last[name] = int(payloads[own[-1]])
        return found
