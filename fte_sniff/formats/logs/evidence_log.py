"""A log whose layout frames decide: its lines read one by one, or many at once with numpy."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime
from time import time_ns
from typing import TYPE_CHECKING, Final

from fte_sniff.formats.logs.clock import LogClock
from fte_sniff.formats.logs.layout import Layout, decide, marked
from fte_sniff.formats.logs.streams import BYTE_NS, LogStream, LogStreams
from fte_sniff.formats.logs.text import TextBlock
from fte_sniff.formats.logs.times import Stamp, TimeRule
from fte_sniff.protocol import FRAME_LENGTH

if TYPE_CHECKING:
    from fte_sniff.formats.logs.columns import Array
    from fte_sniff.formats.logs.reader import LogOptions

_CERTAIN: Final = 0.95
"""Share of the bytes in frames from which on nothing else is plausible."""
_LIKE: Final = "look like bytes but are not read"
_COLUMNAR: Final = 256
"""Lines of a block from which on numpy reads them."""


class EvidenceLog:
    """A log with a layout."""

    def __init__(self, layout: Layout, clock: LogClock, options: LogOptions) -> None:
        self.layout, self.clock = layout, clock
        self.resolution_ns = layout.times.resolution_ns
        self.frames = len(layout.hypothesis.frames)
        self._pattern, self._paste = options.pattern, not options.whole
        self._t_ns: int | None = None
        self._label: str | None = None
        self._size = 0
        self._stream: LogStream | None = None
        self._seen: dict[str, tuple[int, int, str]] = {}
        """By what they do, how many lines, and number and text of the first."""

    @classmethod
    def by_sample(
        cls, lines: Sequence[bytes], options: LogOptions, name: str, written_ns: int | None
    ) -> EvidenceLog | None:
        """The log, if a sample has frames.

        Raises:
            InputTextError: two layouts are as good, or an option is wrong.
        """
        layout = decide(lines, options.form, options.pattern, paste=not options.whole)
        if layout is None:
            return None
        near = options.day or datetime.fromtimestamp((written_ns or time_ns()) / 1e9, UTC).date()
        note = layout.times.settle_order(near, given=options.day is not None)
        layout.notes += [note] if note else []
        clock = LogClock(options.day, options.zone, options.start_ns)
        log = cls(layout, clock, options)
        stamps = [stamp for line in lines if (stamp := layout.any_stamp(log.marked(line)))]
        if stamps and not options.whole and stamps[0].kind not in ("date", "epoch"):
            layout.times = TimeRule()  # nobody asks when a pasted line was
        elif stamps:
            clock.settle(stamps, name, written_ns)
        return log

    def better_than(self, frames: int, size: int) -> bool:
        """Whether it explains more than plain hex with these frames and bytes."""
        share = self.layout.hypothesis.share
        more_certain = share > _CERTAIN > FRAME_LENGTH * frames / max(size, 1)
        return self.frames > frames or (self.frames == frames > 0 and more_certain)

    def marked(self, line: bytes) -> bytes:
        """The line, as a regular expression rearranges it."""
        return line if self._pattern is None else marked(line, self._pattern)

    def ports(self, name: str) -> list[str]:
        """One for each label."""
        labels = self.layout.streams
        return [f"{name}:{label}" for label in labels] if len(labels) > 1 else [name]

    def read(self, block: TextBlock, streams: LogStreams, name: str) -> None:
        """See `LogForm`."""
        if block.column or block.unfinished:
            self._skip(block.first, block.text[:80])
            return
        lines = block.lines if self._pattern is None else list(map(self.marked, block.lines))
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
        if self._paste and found and (words := layout.unread_words(line, found)):
            self._count("hold words that are not read as bytes", number, words)
        if not found and line.strip():
            self._read_heading(line, number)
        for run in found:
            stamp = layout.stamp_of(line, run)
            if stamp is not None:
                self._t_ns = self.clock.t_ns(stamp[3], number)
            stream = self.stream_of(streams, name, layout.label_of(line, run))
            self._size += len(run.data)
            t_ns = self._t_ns
            if layout.times.where == "none" and self.clock.start_ns is not None:
                t_ns = self.clock.start_ns + self._size * BYTE_NS
            stream.append(run.data, number, t_ns, first=layout.times.first_byte)
            if run.cut:
                self._leave_gap(number, line[run.stop :])

    def stream_of(self, streams: LogStreams, name: str, label: str | None) -> LogStream:
        """The stream of a label; without one, that of the lines before."""
        self._label = label or self._label
        labels = self.layout.streams
        one = not self._label or (len(labels) < 2 and self._label in (*labels, None)) or not labels
        port = name if self._paste or one else f"{name}:{self._label}"
        self._stream = streams.labelled(port, self._label)
        return self._stream

    def column_of(self, stamp: Stamp | None, lines: Array) -> Array | None:
        """The times of many lines."""
        if stamp is None:
            return None
        t_ns = self.clock.column(stamp, lines)
        self._t_ns = int(t_ns[-1])
        return t_ns

    def _read_heading(self, line: bytes, number: int) -> None:
        stamp, label = self.layout.heading(line)
        if stamp is not None:
            self._t_ns = self.clock.t_ns(stamp, number)
        self._label = label or self._label
        if line.strip() == b"*":  # a dump leaves out lines like the one before
            self._leave_gap(number, line)
        elif stamp is None and label is None:
            self._skip(number, line)

    def _leave_gap(self, number: int, line: bytes) -> None:
        if self._stream is not None:
            self._stream.cut()
        self._count("leave out bytes", number, line.decode("utf-8", "replace"))

    def _skip(self, number: int, line: bytes) -> None:
        text = line[:120].decode("utf-8", "replace")
        self._count("hold no bytes", number, text)
        if self.layout.looks_like_bytes(line):
            self._count(_LIKE, number, text)

    def _count(self, what: str, number: int, text: str) -> None:
        count, first, example = self._seen.get(what, (0, number, text))
        self._seen[what] = count + 1, first, example

    def notes(self) -> list[str]:
        """How the log was read, one line each."""
        notes = list(self.layout.notes)
        for what, (count, number, text) in self._seen.items():
            shown = " ".join(text.replace("\x01", " ").split())
            shown = repr(shown if len(shown) <= 60 else shown[:59] + "…")
            one = f"line {number} {what.replace(' ', 's ', 1)}: {shown}"
            many = f"{count:,} lines {what}, for example line {number}: {shown}"
            notes.append(one if count == 1 else many)
        if _LIKE in self._seen:
            notes.append("--input-regex can say where the bytes are")
        return notes if self._paste else [*notes, *self.clock.notes]

    def explain(self) -> list[str]:
        """The form, lanes, times and directions, one line each."""
        return self.layout.explain()
