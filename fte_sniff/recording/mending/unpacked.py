"""Owns the messages of an unpacked chunk, whatever channels they are of, and packing some anew.

It must not know what a message says, nor in which file the chunk stands.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from mcap.opcode import Opcode
from numpy.typing import NDArray

from fte_sniff.recording.container.records import HEAD, records_in
from fte_sniff.recording.encoding.batch import Batch
from fte_sniff.recording.encoding.model import MESSAGE, MESSAGE_HEAD


@dataclass(frozen=True, slots=True)
class UnpackedMessages:
    """The messages of an unpacked chunk."""

    batch: Batch
    """Its data is the whole chunk."""
    sequences: NDArray[np.int64]
    stops: NDArray[np.int64]
    """Where each message record ends."""

    @property
    def span(self) -> tuple[int, int]:
        """First and last time, nanoseconds since 1970 UTC; there is a message at least."""
        return int(self.batch.times.min()), int(self.batch.times.max())

    def only(self, kept: NDArray[np.bool_]) -> Batch:
        """The messages that are kept, packed anew."""
        starts, stops = self.batch.places[kept], self.stops[kept]
        data = [self.batch.data[a:b] for a, b in zip(starts, stops, strict=True)]
        places = np.cumsum(stops - starts) - (stops - starts)
        return Batch(b"".join(data), self.batch.channels[kept], self.batch.times[kept], places)


def messages_of(records: bytes) -> UnpackedMessages:
    """The messages of an unpacked chunk; what is too short to be one is left out."""
    found = []
    place = 0
    for opcode, body in records_in(records):
        stop = place + HEAD.size + len(body)
        if opcode == Opcode.MESSAGE and len(body) >= MESSAGE_HEAD:
            _, _, channel, sequence, time, _ = MESSAGE.unpack_from(records, place)
            found.append((channel, time, place, sequence, stop))
        place = stop
    columns = np.array(found, np.uint64).reshape(-1, 5).astype(np.int64).T
    channels, times, places, sequences, stops = columns
    return UnpackedMessages(Batch(records, channels, times, places), sequences, stops)
