"""Streams: the frames of one kind, to or from one motor, on one port; what changed between them."""

from __future__ import annotations

from typing import Final

import numpy as np

from fte_sniff.protocol import KINDS, MOTORS
from fte_sniff.row_batch import NO_KIND, Codes, Ints, RowBatch

_NUMS: Final = 256


def _stream_codes() -> tuple[list[tuple[int, int | None]], Ints]:
    """Kind code and motor of every stream, and the stream's number by kind code and NUM."""
    codes = np.full((NO_KIND + 1, _NUMS), -1, np.int64)
    found: list[tuple[int, int | None]] = []
    for code, kind in enumerate(KINDS):
        if kind.names_motor:
            for motor in MOTORS:
                codes[code, motor] = len(found)
                found.append((code, motor))
        else:
            codes[code, :] = len(found)
            found.append((code, None))
    codes[codes < 0] = len(found)
    return found, codes


STREAMS, _STREAM_CODES = _stream_codes()
"""Kind code and motor (None for kinds without one) of the streams of a port, by number."""

NO_STREAM: Final = len(STREAMS)
"""The number of rows that belong to no stream."""

KEYS_PER_PORT: Final = NO_STREAM + 1


def stream_keys(rows: RowBatch) -> Ints:
    """For each row: the code of its port * `KEYS_PER_PORT` + the number of its stream."""
    return rows.port.astype(np.int64) * KEYS_PER_PORT + _STREAM_CODES[rows.kinds, rows.nums]


def by_stream(keys: Ints) -> Ints:
    """The order in which the rows of each stream are adjacent, in their order."""
    # A small integer type makes numpy use a radix sort.
    return np.argsort(keys.astype(np.min_scalar_type(int(keys.max(initial=0)))), kind="stable")


def frames_before(keys: Ints) -> Ints:
    """For each row the position of the frame before of its stream in the batch, or -1."""
    order = by_stream(keys)
    ordered = keys[order]
    found = np.full(len(keys), -1, np.int64)
    follows = (ordered[1:] == ordered[:-1]) & (ordered[1:] % KEYS_PER_PORT != NO_STREAM)
    found[order[1:][follows]] = order[:-1][follows]
    return found


UNCHANGED: Final = 4
"""The age of a byte that has not changed in the latest frames, or never."""


def change_ages(raw: Codes, before: Ints) -> Codes:
    """For each byte the frames of the stream since it changed: 0 if it differs from the last one.

    `before` is that of `frames_before`; the result has the shape of `raw` and values up to
    `UNCHANGED`.
    """
    known = before >= 0
    changed = (raw != raw[before]) & known[:, None]
    ages = np.where(changed, 0, UNCHANGED).astype(np.uint8)
    earlier = before
    for age in range(1, UNCHANGED):
        ages = np.where(changed[earlier] & (earlier >= 0)[:, None], np.minimum(ages, age), ages)
        earlier = np.where(earlier >= 0, before[earlier], -1)
    return ages
