"""A wire on which nothing comes, or nothing but what is not data.

    bytes   ####        ####
    events      .. silent   bytes again       after 2 s without a byte

Also reported, once until a frame comes: 5 s of only 00, of one other byte, or of bytes without a
frame; and then the frame.
"""

from __future__ import annotations

from math import inf
from typing import Final

from fte_sniff.errors import TranslatableText, unframed_text
from fte_sniff.protocol.items import Chunk, PortEvent, PortEventKind
from fte_sniff.protocol.spec import FEW_BYTES

DEFAULT_SILENCE_S: Final = 2.0
"""Seconds without a byte after which a wire is reported as silent."""
NO_FRAME_NS: Final = 5_000_000_000
"""How long bytes without a frame come before they are reported."""


class SilenceWatch:
    """Observes one wire; `observe` is called often, also while nothing comes."""

    def __init__(self, port: str, silence_s: float = DEFAULT_SILENCE_S) -> None:
        """Report a silence when it has lasted this long, seconds."""
        self._port, self._silence_s = port, silence_s
        self.lost()

    def lost(self) -> None:
        """Note that the port is not open: it is not silent."""
        self._last_ns = inf
        """When the last bytes came; infinity before the first."""
        self._is_silent = self._is_named = False
        self._since_ns = inf
        """Since when bytes come without a frame."""
        self._wrong_since_ns: float | None = None
        """Since when there was no frame, once that was reported and a frame came."""
        self.frame_came()

    def frame_came(self) -> None:
        """Note a readable frame: the line is right."""
        if self._is_named:
            self._wrong_since_ns = self._since_ns
        self._since_ns, self._count, self._is_named = inf, 0, False
        self._values = set[int]()

    def observe(self, chunk: Chunk) -> PortEvent | None:
        """Add a chunk; returns what it ends or shows."""
        t_ns, was_silent = chunk.t_ns or 0, self._is_silent
        silence_s = (t_ns - self._last_ns) / 1e9
        if chunk.data:
            self._is_silent, self._last_ns = False, t_ns
            self._since_ns = min(self._since_ns, t_ns)
            self._count += len(chunk.data)
            if len(self._values) < 2:
                self._values.update(chunk.data)
            if was_silent:
                detail = TranslatableText("bytes again after {seconds:.1f} s", seconds=silence_s)
                return self._event(t_ns, PortEventKind.BYTES_AGAIN, detail, silence_s)
        elif silence_s >= self._silence_s and not was_silent:
            self._is_silent = True
            detail = TranslatableText("silent for {seconds:.1f} s", seconds=self._silence_s)
            return self._event(t_ns, PortEventKind.SILENT, detail, self._silence_s)
        if self._wrong_since_ns is not None:
            wrong_s, self._wrong_since_ns = (t_ns - self._wrong_since_ns) / 1e9, None
            detail = TranslatableText("frames again after {seconds:.1f} s", seconds=wrong_s)
            return self._event(t_ns, PortEventKind.BYTES_AGAIN, detail, wrong_s)
        if t_ns - self._since_ns < NO_FRAME_NS or self._is_named or self._count < FEW_BYTES:
            return None
        self._is_named = True
        return self._event(t_ns, PortEventKind.WIRING, self._what(), 0)

    def _what(self) -> TranslatableText:
        """What bytes without a frame are, and how to find another baud."""
        lowest, highest = min(self._values), max(self._values)
        what = unframed_text(lowest, highest, self._count, NO_FRAME_NS // 1_000_000_000)
        if lowest == highest:
            return what
        return TranslatableText(
            "{what}; `fte-sniff doctor {port} --probe` tries other bauds",
            what=what,
            port=self._port,
        )

    def _event(self, t_ns: int, kind: PortEventKind, detail: str, silence_s: float) -> PortEvent:
        """An event whose count is milliseconds of silence."""
        return PortEvent(t_ns, self._port, kind, detail, round(silence_s * 1000))
