"""A log whose layout frames decide: its lines read one by one, or many at once with numpy."""

from __future__ import annotations

import re
from collections.abc import Sequence
from datetime import UTC, datetime
from time import time_ns
from typing import TYPE_CHECKING, Final

from fte_sniff.formats.logs.clock import LogClock
from fte_sniff.formats.logs.layout import Layout, PatternLayout, decide, decide_paste
from fte_sniff.formats.logs.streams import BYTE_NS, LogStream, LogStreams
from fte_sniff.formats.logs.text import TextBlock
from fte_sniff.formats.logs.times import Stamp, TimeRule
from fte_sniff.protocol import FRAME_LENGTH

if TYPE_CHECKING:
    from fte_sniff.formats.logs.columns import Array
    from fte_sniff.formats.logs.reader import LogOptions

_CERTAIN: Final = 0.95
"""Share of the bytes in frames from which on nothing else is plausible."""
_COLUMNAR: Final = 256
"""Lines of a block from which on numpy reads them."""
_DIRECTIONS: Final = ("rx", "tx")


class EvidenceLog:
    """A log with a layout."""

    def __init__(self, layout: Layout, clock: LogClock) -> None:
        self.layout, self.clock = layout, clock
        self.resolution_ns = layout.times.resolution_ns
        self.frames = len(layout.hypothesis.frames)
        self._stamp: Stamp | None = None
        self._t_ns: int | None = None
        self._label: str | None = None
        self._size = 0
        self._paste = False
        self._unread: list[tuple[int, str]] = []
        self._skipped: list[tuple[int, bytes]] = []
        self._skips = self._like = self._cuts = self._untimed = 0
        self._first_like = self._first_cut = (0, b"")

    @classmethod
    def by_sample(
        cls, lines: Sequence[bytes], options: LogOptions, name: str, written_ns: int | None
    ) -> EvidenceLog | None:
        """The log, if a sample has frames.

        Raises:
            InputTextError: two layouts are as good, or an option is wrong.
        """
        layout: Layout | None
        if options.pattern is not None:
            layout = PatternLayout.by_sample(lines, options.pattern, options.form)
        else:
            layout = decide(lines, options.form)
            if layout is None and not options.whole:
                layout = decide_paste(lines)
        if layout is None:
            return None
        near = options.day or datetime.fromtimestamp((written_ns or time_ns()) / 1e9, UTC).date()
        note = layout.times.settle_order(near, given=options.day is not None)
        if note is not None:
            layout.notes.append(note)
        clock = LogClock(options.day, options.zone, options.start_ns)
        stamps = [stamp for line in lines if (stamp := layout.any_stamp(line)) is not None]
        if stamps and not options.whole and stamps[0].kind not in ("date", "epoch"):
            layout.times = TimeRule()  # nobody asks when a pasted line was
        elif stamps:
            clock.settle(stamps, name, written_ns)
        log = cls(layout, clock)
        log._paste = not options.whole
        return log

    def better_than(self, frames: int, size: int) -> bool:
        """Whether it explains more than plain hex with these frames and bytes."""
        own = self.layout.hypothesis
        share = FRAME_LENGTH * len(own.frames) / max(own.size, 1)
        return len(own.frames) > frames or (
            len(own.frames) == frames > 0 and share > _CERTAIN > FRAME_LENGTH * frames / size
        )

    def ports(self, name: str) -> list[str]:
        """One for each label."""
        labels = self.layout.streams
        return [f"{name}:{label}" for label in labels] if len(labels) > 1 else [name]

    def _port(self, name: str, label: str | None) -> str:
        labels = self.layout.streams
        if self._paste or not label or (len(labels) < 2 and (not labels or label == labels[0])):
            return name
        return f"{name}:{label}"

    def read(self, block: TextBlock, streams: LogStreams, name: str) -> None:
        """See `LogForm`."""
        if block.column or block.unfinished:
            self._skip(block.first, block.text[:80])
            return
        lines = block.lines
        timed = self.layout.times.where == "before" or self.clock.start_ns is None
        if len(lines) >= _COLUMNAR and self.layout.columnar and timed:
            from fte_sniff.formats.logs.columns import read_columns

            if read_columns(self, lines, block.first, streams, name):
                return
        for number, line in enumerate(lines, block.first):
            self.read_line(line, number, streams, name)

    def read_line(self, line: bytes, number: int, streams: LogStreams, name: str) -> None:
        """Append the bytes of a line to the streams."""
        layout = self.layout
        found = layout.runs(line)
        if not found:
            self._read_heading(line, number)
            return
        if self._paste and (unread := layout.unread_words(line, found)):
            self._unread.append((number, unread))
        for run in found:
            place = layout.stamp_of(line, run)
            if place is not None:
                self._t_ns = self.clock.t_ns(place[3], number)
            elif layout.times.where in ("before", "after"):
                self._untimed += 1
            stream = self.stream_of(streams, name, layout.label_of(line, run))
            t_ns = self._t_ns
            self._size += len(run.data)
            if layout.times.where == "none" and self.clock.start_ns is not None:
                t_ns = self.clock.start_ns + self._size * BYTE_NS
            stream.append(run.data, number, t_ns, first=layout.times.first_byte)
            if run.cut:
                stream.cut()
                self._cuts += 1
                self._first_cut = self._first_cut if self._cuts > 1 else (number, line[run.stop :])

    def stream_of(self, streams: LogStreams, name: str, label: str | None) -> LogStream:
        """The stream of a label; without one, that of the lines before."""
        self._label = label or self._label
        return streams.labelled(self._port(name, self._label), self._label)

    def column_of(self, stamp: Stamp | None, lines: Array) -> Array | None:
        """The times of many lines."""
        if stamp is None:
            return None
        t_ns = self.clock.column(stamp, lines)
        self._t_ns = int(t_ns[-1])
        return t_ns

    def _read_heading(self, line: bytes, number: int) -> None:
        if not line.strip():
            return
        stamp = self.layout.heading_stamp(line)
        if stamp is not None:
            self._t_ns = self.clock.t_ns(stamp, number)
        label = self.layout.heading_label(line)
        if label is not None:
            self._label = label
        if stamp is None and label is None:
            self._skip(number, line)

    def _skip(self, number: int, line: bytes) -> None:
        if line.strip() == b"*":  # a dump leaves out lines like the one before
            self._cuts += 1
            self._first_cut = self._first_cut if self._cuts > 1 else (number, line)
            return
        if not self._skips:
            self._skipped.append((number, line))
        self._skips += 1
        if self.layout.looks_like_bytes(line):
            self._like += 1
            self._first_like = self._first_like if self._like > 1 else (number, line)

    def notes(self) -> list[str]:
        """How the log was read, one line each."""
        notes = list(self.layout.notes)
        if self._unread:
            number, words = self._unread[0]
            more = (
                f", nor words on {len(self._unread) - 1:,} more lines" if self._unread[1:] else ""
            )
            notes.append(f"line {number}: {words!r} is not read as bytes{more}")
        if self._skips:
            number, line = self._skipped[0]
            lines = "1 line holds" if self._skips == 1 else f"{self._skips:,} lines hold"
            notes.append(f"{lines} no bytes, for example line {number}: {_shown(line)}")
        if self._like:
            number, line = self._first_like
            lines = "1 of them looks" if self._like == 1 else f"{self._like:,} of them look"
            notes.append(
                f"{lines} like bytes, for example line {number}: {_shown(line)};"
                " --input-regex can say where the bytes are"
            )
        if self._cuts:
            number, text = self._first_cut
            more = f", and on {self._cuts - 1:,} more lines" if self._cuts > 1 else ""
            notes.append(f"line {number}: the log leaves out bytes here: {_shown(text)}{more}")
        return notes if self._paste else [*notes, *self.clock.notes]

    def explain(self) -> list[str]:
        """The form, lanes, times and directions, one line each."""
        return self.layout.explain()


def _shown(line: bytes) -> str:
    text = re.sub(r"\s+", " ", line[:120].decode("utf-8", "replace")).strip()
    return repr(text if len(text) <= 60 else text[:59] + "…")
