"""Owns the way from one port's bytes to its rows: where frames begin and end, and what is damaged.

It must not do I/O or read a clock; the times come with the chunks.
"""

from __future__ import annotations

import re

from fte_sniff.protocol.codec import frame_faults
from fte_sniff.protocol.rows import Chunk, Damage, Fault, Frame, Row
from fte_sniff.protocol.table import DEFAULT_BAUD, FRAME_LENGTH, KINDS, MOTORS, TAIL, byte_time_ns


def _legal_pattern() -> re.Pattern[bytes]:
    kinds = (
        b"%b[%b]%b.{6}%b"
        % (
            re.escape(bytes([kind.header])),
            re.escape(bytes(kind.cmds)),
            b"[%b]" % re.escape(bytes(MOTORS)) if kind.names_motor else b".",
            re.escape(bytes([TAIL])),
        )
        for kind in KINDS
    )
    return re.compile(b"|".join(kinds), re.DOTALL)


LEGAL_FRAME = _legal_pattern()
"""Ten bytes whose header, CMD, NUM and tail are legal."""


class Framer:
    """Turns the chunks of one port into rows that tile its stream exactly."""

    def __init__(self, port: str, baud: int = DEFAULT_BAUD) -> None:
        self._port = port
        self._byte_ns = byte_time_ns(baud)
        self._held = bytearray()
        self._offset = 0
        self._t_ns: int | None = None

    def feed(self, chunk: Chunk) -> list[Row]:
        """The rows that these bytes complete; never raises on wire data."""
        self._held += chunk.data
        self._t_ns = chunk.t_ns
        return self._take(len(self._held) - FRAME_LENGTH + 1)

    def flush(self) -> list[Row]:
        """The rows of whatever is still held; the stream ends here."""
        return self._take(len(self._held))

    def _take(self, limit: int) -> list[Row]:
        rows: list[Row] = []
        data, at = bytes(self._held), 0
        while at < limit:
            match = LEGAL_FRAME.search(data, at)
            end = match.start() if match else limit
            if end > at:
                rows.append(self._row(Damage, data[at:end], at, (Fault.NOISE,)))
            if match:
                raw = match.group()
                rows.append(self._row(Frame, raw, end, frame_faults(raw)))
                end += len(raw)
            at = end
        del self._held[:at]
        self._offset += at
        return rows

    def _row(self, row: type[Row], raw: bytes, at: int, faults: tuple[Fault, ...]) -> Row:
        behind = len(self._held) - at
        t_ns = None if self._t_ns is None else self._t_ns - behind * self._byte_ns
        delay = None if t_ns is None or self._t_ns is None else self._t_ns - t_ns
        return row(self._port, self._offset + at, raw, t_ns, faults, delay)
