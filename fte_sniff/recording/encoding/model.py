"""Owns where the values of a message stand in its bytes, so that many are written at once.

It must not know how single messages are encoded: it takes one that is, laid out as `wire` says.

Sound frames of one kind make messages that differ in few places only (see `schema`). A model of
such a message, with its record's head before it, is copied for each row, and columns written over:

    05 length channel sequence time time | 09 offset 11 delay 1A 0A raw 20 status ... 75 value ...
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Any

import numpy as np
from mcap.opcode import Opcode
from numpy.typing import NDArray

from fte_sniff.protocol import Field
from fte_sniff.recording.encoding.wire import WireField, laid

MESSAGE = struct.Struct("<BQHIQQ")
"""What stands before the data of a message: opcode, length, channel, sequence, log and publish
time."""

MESSAGE_HEAD = MESSAGE.size - 9
"""Bytes of a message record's body before its data."""

_HEAD_PLACES = {"channel": ("<u2", 9), "sequence": ("<u4", 11), "log": ("<u8", 15)}
_HEAD_PLACES["publish"] = ("<u8", 23)


@dataclass(frozen=True, slots=True)
class Columns:
    """What differs between the messages of one form, a value for each row."""

    channel: int | NDArray[np.int64]
    sequences: NDArray[np.uint32]
    times: NDArray[np.int64]
    offsets: NDArray[np.int64]
    delays: NDArray[np.int64]
    raws: NDArray[np.uint8]
    """The rows' ten bytes, one row a line."""


class Model:
    """Writes messages of one form: sound frames of one kind on one topic."""

    def __init__(
        self, model: bytes, message: Any, fields: tuple[Field, ...], lacking: frozenset[str]
    ) -> None:
        """Find the places.

        Args:
            model: one message of the form, with a read delay, without faults and own time.
            message: its protobuf class.
            fields: the frame's fields that differ from row to row.
            lacking: the names of the fields that are not in it.
        """
        head = MESSAGE.pack(Opcode.MESSAGE, MESSAGE_HEAD + len(model), 0, 0, 0, 0)
        self._bytes = np.frombuffer(head + model, np.uint8)
        self._fields = fields
        places = _HEAD_PLACES | {
            field.name: (_numpy_type(field), MESSAGE.size + field.place)
            for field in laid(message.DESCRIPTOR.fields, lacking)
        }
        self._type = np.dtype(
            {
                "names": list(places),
                "formats": [kind for kind, _ in places.values()],
                "offsets": [offset for _, offset in places.values()],
                "itemsize": len(self._bytes),
            }
        )

    @property
    def length(self) -> int:
        """Bytes of each message record."""
        return len(self._bytes)

    def records(self, columns: Columns) -> list[bytes]:
        """The message records of these rows."""
        found: list[bytes] = self.lines(columns).tolist()
        return found

    def lines(self, columns: Columns) -> NDArray[np.void]:
        """The same as an array, whose items are the records."""
        found: NDArray[np.void] = np.empty(len(columns.times), f"V{self.length}")
        found[:] = np.void(self._bytes.tobytes())
        table = found.view(self._type)
        table["channel"] = columns.channel
        table["sequence"] = columns.sequences
        table["log"] = table["publish"] = columns.times
        table["offset"] = columns.offsets
        table["read_delay_ns"] = columns.delays
        raws = np.ascontiguousarray(columns.raws)
        table["raw"] = raws.view(f"V{raws.shape[1]}")[:, 0]
        for field in self._fields:
            kind = f">{'i' if field.signed else 'u'}{field.size}"
            # Read where they stand: to cut them out first takes as long as all else.
            table[field.name] = np.ndarray(len(raws), kind, raws, field.start, raws.strides[:1])
        return found


def _numpy_type(field: WireField) -> str:
    return f"V{field.size}" if field.code == "s" else f"<{field.code}"
