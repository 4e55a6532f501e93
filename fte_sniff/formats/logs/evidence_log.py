"""A log whose layout frames decide: its lines read one by one, or many at once with numpy."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from datetime import UTC, datetime
from time import time_ns
from typing import TYPE_CHECKING, Final

from fte_sniff.errors import InputTextError
from fte_sniff.formats.logs.evidence import Hypothesis, Sample
from fte_sniff.formats.logs.forms import EXTRACTORS
from fte_sniff.formats.logs.layout import Layout, left_out
from fte_sniff.formats.logs.streams import LogForm, LogStream, LogStreams
from fte_sniff.formats.logs.text import TextBlock
from fte_sniff.formats.logs.times import LogClock, TimeRule
from fte_sniff.protocol import FRAME_LENGTH

if TYPE_CHECKING:
    from fte_sniff.formats.logs.reader import LogOptions

_AS_GOOD: Final = 0.9
"""Two hypotheses whose scores differ less are ambiguous, if their frames differ."""
_CERTAIN: Final = 0.95
"""Share of the bytes in frames from which on nothing else is plausible."""
_COLUMNAR: Final = 256
"""Lines of a block from which on numpy reads them."""
_MARK: Final = b"\x01"
"""Around the data of a line that a regular expression matches."""
_LIKE: Final = "look like bytes but are not read"


class EvidenceLog(LogForm):
    """A log with a layout."""

    def __init__(
        self, lines: Sequence[bytes], found: Sequence[Hypothesis], options: LogOptions
    ) -> None:
        """The log of a sample of lines, by what is found in it, the best hypothesis first."""
        self._pattern, self._paste = options.pattern, not options.whole
        given = options.pattern is not None and "dir" in options.pattern.groupindex
        self.layout = Layout(found[0], lines, given=given)
        self.clock = LogClock(self.layout.times, options)
        self.frames = len(found[0].frames)
        self._scores = [f"score {rank}: {one}" for rank, one in enumerate(found[:3], 1)]
        cuts = {left_out(cut) for cut in found[0].cuts.values()} - {""}
        self._notes = [f"lines are read{cut}, which are no data" for cut in sorted(cuts)]
        if not self.frames:
            form = found[0].extractor.name
            self._notes = [f'no whole frame in it; what is read as "{form}" may be no bytes']
        self._t_ns: int | None = None
        self._label: str | None = None
        self._stream: LogStream | None = None
        self._seen: dict[str, tuple[int, int, str]] = {}
        """By what they do, how many lines, and number and text of the first."""

    @classmethod
    def by_sample(
        cls,
        lines: Sequence[bytes],
        options: LogOptions,
        name: str,
        written_ns: int | None,
        blocks: Callable[[], Iterable[TextBlock]],
    ) -> EvidenceLog | None:
        """The log, if a sample has frames; `blocks` are all of a file, none of a pipe.

        Raises:
            InputTextError: two hypotheses are as good, or there is no such form.
        """
        if options.pattern is not None:
            matching = filter(options.pattern.search, lines)
            lines = [_rearranged(line, options.pattern) for line in matching]
        found = _hypotheses(lines, options)
        if not found:
            return None
        log = cls(lines, found, options)
        log.settle_times(lines, options, name, written_ns, blocks)
        return log

    def settle_times(
        self,
        lines: Sequence[bytes],
        options: LogOptions,
        name: str,
        written_ns: int | None,
        blocks: Callable[[], Iterable[TextBlock]],
    ) -> None:
        """Decide what the times of a log count from."""
        times = self.layout.times
        for block in blocks() if times.is_open else ():
            times.learn(block.text)
            if not times.is_open:
                break
        near = options.day or datetime.fromtimestamp((written_ns or time_ns()) / 1e9, UTC).date()
        note = times.settle_order(near, given=options.day is not None)
        self._notes += [note] if note else []
        found = (
            self.layout.stamp_of(line, next(iter(self.layout.runs(line)), None)) for line in lines
        )
        stamps = [stamp for _, stamp in filter(None, found)]
        if stamps and self._paste and times.kind not in ("date", "epoch"):
            self.layout.times = TimeRule()  # nobody asks when a pasted line was
        elif stamps:
            self.clock.settle(stamps, name, written_ns)
        timed = self.layout.times.where != "none"
        self.resolution_ns = times.resolution_ns if timed else None

    def better_than(self, frames: int, size: int) -> bool:
        """Whether it explains more than plain hex with these frames and bytes."""
        share = self.layout.hypothesis.share
        more_certain = share > _CERTAIN > FRAME_LENGTH * frames / max(size, 1)
        return self.frames > frames or (self.frames == frames > 0 and more_certain)

    def ports(self, name: str) -> list[str]:
        """One for each label."""
        labels = self.layout.streams
        return [f"{name}:{label}" for label in labels] if len(labels) > 1 else [name]

    def read(self, block: TextBlock, streams: LogStreams, name: str) -> None:
        """See `LogForm`."""
        if block.column or block.unfinished:
            self._skip(block.first, block.text[:80])
            return
        many = block.text.count(b"\n") >= _COLUMNAR and self._pattern is None
        timed = self.layout.times.where in ("before", "none")
        if many and timed and self.layout.hypothesis.extractor.columnar:
            from fte_sniff.formats.logs.columns import read_columns

            if read_columns(self, block, streams, name):
                return
        words = self.layout.hypothesis.extractor.size > 1
        for at, line in enumerate(block.lines):
            below = block.lines[at + 1 : at + 2] if words else ()
            self.read_line(line, block.first + at, streams, name, *below)

    def read_line(
        self, line: bytes, number: int, streams: LogStreams, name: str, below: bytes = b""
    ) -> None:
        """Append the bytes of a line to the streams; the offset `below` it may show padding."""
        line = line if self._pattern is None else _rearranged(line, self._pattern)
        found = self.layout.runs(line)
        if self._paste and found and (words := self.layout.unread_words(line, found)):
            self._count("hold words that are not read as bytes", number, words)
        where = self.layout.times.where
        for run in (*found,) or (None,):
            place, label = self.layout.stamp_of(line, run), self.layout.label_of(line, run)
            if place is not None or (run is not None and where in ("before", "after")):
                self._t_ns = self.clock.t_ns(place and place[1], number)
            if run is None:
                self._label = label or self._label
                if place is None and label is None and line.strip():
                    self._skip(number, line)
                continue
            data = run.data[:-1] if below and _is_padded(run.data, line, below) else run.data
            stream = self.stream_of(streams, name, label)
            stream.append(data, number, self._t_ns, first=self.layout.times.first_byte)
            if run.gap:
                self._leave_gap(number, line[run.stop :])

    def stream_of(self, streams: LogStreams, name: str, label: str | None) -> LogStream:
        """The stream of a label; without one, that of the lines before."""
        self._label = label or self._label
        labels = self.layout.streams
        several = len(labels) > 1 or (labels and self._label not in labels)
        port = f"{name}:{self._label}" if several and self._label and not self._paste else name
        self._stream = streams.labelled(port, self._label)
        return self._stream

    def _leave_gap(self, number: int, text: bytes) -> None:
        if self._stream is not None:
            self._stream.cut()
        self._count("leave out bytes", number, text.decode("utf-8", "replace"))

    def _skip(self, number: int, line: bytes) -> None:
        if line.strip() == b"*":  # a dump leaves out lines like the one before
            self._leave_gap(number, line)
            return
        text = line[:120].decode("utf-8", "replace")
        self._count("hold no bytes", number, text)
        if self.layout.looks_like_bytes(line):
            self._count(_LIKE, number, text)

    def _count(self, what: str, number: int, text: str) -> None:
        count, first, example = self._seen.get(what, (0, number, text))
        self._seen[what] = count + 1, first, example

    def notes(self) -> list[str]:
        """How the log was read, one line each."""
        notes = list(self._notes)
        for what, (count, number, text) in self._seen.items():
            shown = " ".join(text.replace(_MARK.decode(), " ").split())
            shown = repr(shown if len(shown) <= 60 else shown[:59] + "…")
            one = f"line {number} {what.replace(' ', 's ', 1)}: {shown}"
            many = f"{count:,} lines {what}, for example line {number}: {shown}"
            notes.append(one if count == 1 else many)
        if _LIKE in self._seen:
            notes.append("--input-regex can say where the bytes are")
        return notes if self._paste else [*notes, *self.clock.notes]

    def explain(self) -> list[str]:
        """The form, lanes, times and directions, one line each; the best three scores."""
        return [*self.layout.explain(), *self._scores]


def _is_padded(data: bytes, line: bytes, below: bytes) -> bool:
    """Whether the offsets of two lines of a dump show that the last word is half empty."""
    for base in (8, 16):
        with suppress(ValueError, IndexError):
            length = int(below.split()[0], base) - int(line.split()[0], base)
            if length == len(data) - 1:
                return True
    return False


def _rearranged(line: bytes, pattern: re.Pattern[bytes]) -> bytes:
    """The time, data and direction that a regular expression finds in a line; else the line."""
    found = pattern.search(line)
    if found is None:
        return line
    groups = found.groupdict()
    time, way = groups.get("time") or b"", groups.get("dir") or b""
    return b" ".join([time, _MARK, found["data"], _MARK, way])


def _hypotheses(lines: Sequence[bytes], options: LogOptions) -> list[Hypothesis]:
    """Where the bytes may be, the best first; none if there are not enough frames."""
    forms = [
        one for one in EXTRACTORS if options.form in (None, one.name, one.name.partition(",")[0])
    ]
    if not forms:
        names = ", ".join(one.name for one in EXTRACTORS)
        raise InputTextError(f"--form: there is no form {options.form!r}; the forms are: {names}")
    sample = Sample(lines)
    ranked = sample.hypotheses(forms)
    good = [one for one in ranked if one.accepted]
    for other in good[1:]:
        missing = Counter(other.frames) - Counter(good[0].frames)
        if other.score >= _AS_GOOD * good[0].score and missing.total() > 0.1 * len(other.frames):
            raise InputTextError(
                f"two readings are as good: {_first(good[0])} and {_first(other)};"
                f' choose one with --form "{good[0].extractor.name}"'
            )
    if good or not (options.form or options.pattern or not options.whole):
        return good and [good[0], *(one for one in ranked if one is not good[0])]
    digits = [one._replace(masks_times=True) for one in forms if options.form or one.columnar]
    return ranked or sample.longest(digits)


def _first(one: Hypothesis) -> str:
    return f'"{one.extractor.name}" (first frame {one.frames[0].hex(" ").upper()})'
