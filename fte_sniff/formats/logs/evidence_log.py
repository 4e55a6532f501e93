"""A log whose layout frames decide: groups of lines, each of which is read at once.

Lines of a group have the same length and differ only in digits: of the bytes, of the time, and of
numbers before the bytes. One of them is parsed; numpy reads the others at the same positions. Where
lines are few or irregular, each is a group of its own.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from datetime import UTC, datetime
from functools import cache, partial
from time import time_ns
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from fte_sniff.errors import InputTextError
from fte_sniff.formats.logs.evidence import NUMBER_TOKEN, Hypothesis, Sample
from fte_sniff.formats.logs.forms import EXTRACTORS
from fte_sniff.formats.logs.layout import Layout, left_out, unread_words
from fte_sniff.formats.logs.streams import NO_TIME, LogForm, LogStreams
from fte_sniff.formats.logs.text import TextBlock
from fte_sniff.formats.logs.times import Fields, LogClock, Stamp, TimeRule
from fte_sniff.protocol import FRAME_LENGTH

if TYPE_CHECKING:
    from fte_sniff.formats.logs.reader import LogOptions
    from fte_sniff.formats.logs.streams import Array

_AS_GOOD: Final = 0.9
"""Two hypotheses whose scores differ less are ambiguous, if their frames differ."""
_CERTAIN: Final = 0.95
"""Share of the bytes in frames from which on nothing else is plausible."""
_COLUMNAR: Final = 256
"""Lines of a block from which on numpy reads them."""
_MOST_SHAPES: Final = 24
_LONGEST_SHAPE: Final = 4096
_MARK: Final = b"\x01"
"""Around the data of a line that a regular expression matches."""
_LIKE: Final = "hold what looks like bytes but is not read"


class _Group(NamedTuple):
    """Lines that are read at once."""

    lines: Sequence[int] | Array
    """Their numbers, rising."""
    data: bytes
    """Of each line, the same number of bytes."""
    label: str | None
    stamp: Stamp = Stamp(NO_TIME)
    """Of each line, or of all."""
    gap: bool = False
    """Whether the log leaves out bytes after it."""


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
        self.single = self._paste or not self.layout.streams
        self._scores = [f"score {rank}: {one}" for rank, one in enumerate(found[:3], 1)]
        cuts = {left_out(cut) for cut in found[0].cuts.values()} - {""}
        self._notes = [f"lines are read{cut}, which are no data" for cut in sorted(cuts)]
        if not self.frames:
            form = found[0].extractor.name
            self._notes = [f'no whole frame in it; what is read as "{form}" may be no bytes']
        self._stamp: Stamp | None = None
        self._label: str | None = None
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
        times = log.layout.times
        for block in blocks() if times.is_open else ():
            times.learn(block.text)
            if not times.is_open:
                break
        near = options.day or datetime.fromtimestamp((written_ns or time_ns()) / 1e9, UTC).date()
        note = times.settle_order(near, given=options.day is not None)
        if times.kind == "unread":
            note = "numbers in the lines above the bytes may be times; they are not read"
        log._notes += [note] if note else []
        places = (
            log.layout.stamp_of(line, next(iter(log.layout.runs(line)[0]), None)) for line in lines
        )
        stamps = [stamp for _, stamp in filter(None, places)]
        if stamps and log._paste and times.kind not in ("date", "epoch"):
            log.layout.times = TimeRule()  # nobody asks when a pasted line was
        elif stamps:
            log.clock.settle(stamps, name, written_ns)
        timed = log.layout.times.where != "none"
        log.resolution_ns = times.resolution_ns if timed else None
        return log

    def better_than(self, frames: int, size: int) -> bool:
        """Whether it explains more than plain hex with these frames and bytes."""
        share = self.layout.hypothesis.share
        more_certain = share > _CERTAIN > FRAME_LENGTH * frames / max(size, 1)
        return self.frames > frames or (self.frames == frames > 0 and more_certain)

    def ports(self, name: str) -> list[str]:
        """One for each label."""
        labels = self.layout.streams
        return [f"{name}:{label}" for label in labels] if len(labels) > 1 else [name]

    def read(self, block: TextBlock, streams: LogStreams) -> None:
        """See `LogForm`."""
        if block.column or block.unfinished:
            self._skip(block.first, block.text[:80], like=False)
            return
        layout, rest, groups = self.layout, [*range(len(block.lines))], list[_Group]()
        before = {layout.times.where, layout.labelled} <= {"before", "none"}
        many = len(rest) >= _COLUMNAR and self._pattern is None
        if many and before and layout.hypothesis.extractor.columnar:
            groups, rest = self._shapes(block)
        for at in rest:
            below = block.lines[at + 1 : at + 2] if layout.hypothesis.extractor.size > 1 else ()
            groups += self._groups(block.lines[at], block.first + at, *below)
        single = streams.direct and len(rest) == len(block.lines)
        for one in groups if single else ():
            stream = streams.stream(streams.name, one.label)
            stream.append(one.data, (), (), gaps=(len(one.data),) * one.gap)
        if groups and not single:
            self._append(groups, streams)

    def _append(self, groups: list[_Group], streams: LogStreams) -> None:
        """Append the bytes of groups in the order of lines, each to the stream of its label."""
        import numpy as np

        counts = [len(one.lines) for one in groups]
        lines: Any = np.concatenate([one.lines for one in groups])
        order: Any = slice(None) if (lines[1:] > lines[:-1]).all() else lines.argsort(kind="stable")

        def column(values: Iterable[Any]) -> Any:
            parts = zip(values, counts, strict=True)
            full = [np.broadcast_to(np.int64(own), count) for own, count in parts]
            return np.concatenate(full)[order]

        widths, lines = [len(one.data) // len(one.lines) for one in groups], lines[order]
        sizes, ends = column(widths), np.cumsum(np.repeat(widths, counts))[order]
        text = np.frombuffer(b"".join(one.data for one in groups), np.uint8)
        times = None
        if self.resolution_ns is not None:
            ns, zones = (column(one.stamp[at] for one in groups) for at in (0, 1))
            times = self.clock.times(ns, zones, lines)
        elif streams.start_ns is not None:
            times = streams.start_ns + (streams.size + np.cumsum(sizes)) * streams.byte_ns
        labels = [self._label, *dict.fromkeys(one.label for one in groups)]
        last = column(labels.index(one.label, 1) * (one.label is not None) for one in groups)
        last = last[np.maximum.accumulate(np.arange(len(last)) * (last > 0))]
        self._label, gaps = labels[last[-1]], column(one.gap for one in groups)
        for number in np.flatnonzero(np.bincount(last)).tolist():
            mine = np.flatnonzero(last == number)
            own, stops = sizes[mine], np.cumsum(sizes[mine])
            if len(set(widths)) == 1 and widths[0]:
                data = text.reshape(-1, widths[0])[order][mine]
            else:
                data = text[np.repeat(ends[mine] - stops, own) + np.arange(stops[-1])]
            stream = streams.stream(self._port(streams.name, labels[number]), labels[number])
            stream.append(
                data.tobytes(), own, lines[mine], None if times is None else times[mine],
                gaps=stops[gaps[mine] > 0].tolist(), first=self.layout.times.first_byte,
            )  # fmt: skip

    def _port(self, name: str, label: str | None) -> str:
        known = self.layout.streams
        several = len(known) > 1 or (known and label not in known)
        return f"{name}:{label}" if several and label and not self._paste else name

    def _groups(self, line: bytes, number: int, below: bytes = b"") -> Iterator[_Group]:
        """The bytes of a line; the offset `below` it may show padding."""
        line = line if self._pattern is None else _rearranged(line, self._pattern)
        found, others = self.layout.runs(line)
        if self._paste and found and (words := unread_words(line, found)):
            self._count("hold words that are not read as bytes", number, words)
        if found and others:
            self._count(_LIKE, number, line)
        for run in (*found,) or (None,):
            place, label = self.layout.stamp_of(line, run), self.layout.label_of(line, run)
            above = self.layout.labelled == "above"
            if run is None or self.layout.times.where == "above":
                self._stamp = place[1] if place else self._stamp
            stamp = self._stamp if self.layout.times.where == "above" else place and place[1]
            if run is None or above:
                self._label = label or self._label
            if run is not None:
                data = run.data[:-1] if _is_padded(run.data, line, below) else run.data
                own = self._label if above else label
                yield _Group([number], data, own, stamp or Stamp(NO_TIME), run.gap)
                if run.gap:
                    self._count("leave out bytes", number, line[run.stop :])
            elif line.strip() == b"*" and self.layout.times.where == "none":
                yield _Group(
                    [number], b"", None, gap=True
                )  # a dump leaves out lines like that before
                self._count("leave out bytes", number, line)
            elif place is None and label is None and line.strip():
                self._skip(number, line, like=others)

    def _skip(self, number: int, line: bytes, *, like: bool) -> None:
        self._count("hold no bytes", number, line[:120])
        if like:
            self._count(_LIKE, number, line[:120])

    def _count(self, what: str, number: int, text: bytes | str, lines: int = 1) -> None:
        text = text if isinstance(text, str) else text.decode("utf-8", "replace")
        count, first, example = self._seen.get(what, (0, number, text))
        self._seen[what] = count + lines, first, example

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

    def _shapes(self, block: TextBlock) -> tuple[list[_Group], list[int]]:
        """Groups of lines of the same shape, and the indices of the other lines."""
        import numpy as np

        text = np.frombuffer(block.text, np.uint8)
        ends = np.flatnonzero(text == ord("\n"))
        starts = np.append(0, ends[:-1] + 1)
        lengths, left = ends - starts, np.ones(len(ends), np.bool_)
        groups = list[_Group]()
        for length in np.flatnonzero(np.bincount(lengths))[:_LONGEST_SHAPE].tolist():
            rows = np.flatnonzero(lengths == length)
            items = np.ndarray((max(len(text) - length + 1, 0),), f"V{length}", text, 0, (1,))
            for _ in range(_MOST_SHAPES if 0 < length <= _LONGEST_SHAPE else 0):
                if len(rows) < 2:
                    break
                table = np.ascontiguousarray(
                    items[starts[rows]].view(np.uint8).reshape(len(rows), -1).T
                )
                line = table[:, 0].tobytes()
                same = np.arange(len(rows)) == 0
                if shape := self._shape(line):
                    fixed, digits, pairs, fields = shape
                    same = (table[fixed] == table[fixed, :1]).all(0)
                    same &= (table[digits] - np.uint8(ord("0")) < 10).all(0)
                    nibbles = _values().take(table[pairs])
                    same &= (nibbles < 16).all(0)
                    if not same.all():
                        table, nibbles = table[:, same], nibbles[:, same]
                    stamp: Stamp | None = Stamp(NO_TIME)
                    if fields:
                        stamp = self.layout.times.stamp(line, fields, partial(_number, table))
                    if stamp is not None:
                        data = (nibbles[::2] << np.uint8(4) | nibbles[1::2]).T.tobytes()
                        run = self.layout.runs(line)[0][0]
                        label = self.layout.label_of(line, run)
                        groups.append(_Group(rows[same] + block.first, data, label, stamp))
                        left[rows[same]] = False
                rows = rows[~same]
        return groups, np.flatnonzero(left).tolist()

    def _shape(self, line: bytes) -> tuple[list[int], list[int], list[int], Fields] | None:
        """Where a line has fixed text, digits of numbers and of bytes, and the fields of a time."""
        found, others = self.layout.runs(line)
        labels = {self.layout.label_of(line, one) for one in found}
        if len(labels) != 1 or others or any(run.gap for run in found):
            return None
        pairs = list[int]()
        for one in found:
            text = line[one.start : one.stop]
            of_run = [one.start + pair.start() for pair in re.finditer(b"[0-9A-Fa-f]{2}", text)]
            pairs += [at + digit for at in of_run[one.cut] for digit in (0, 1)]
        place = self.layout.stamp_of(line, found[0])
        if len(pairs) != 2 * sum(len(one.data) for one in found) or (place is None) != (
            self.layout.times.where != "before"
        ):
            return None
        fields = {} if place is None else place[0]
        free, digits = set(pairs), set[int]()
        for number in re.finditer(NUMBER_TOKEN, line[: found[0].start]):
            digits |= {at for at in range(*number.span()) if line[at] in b"0123456789"}
        digits -= {*range(*fields.get("zone", (0, 0))), *free}
        fixed = [at for at in range(len(line)) if at not in free | digits]
        return fixed, sorted(digits), pairs, fields


@cache
def _values() -> Any:
    """By character, the value of a hexadecimal digit; 255 of others."""
    import numpy as np

    values = np.full(256, 0xFF, np.uint8)
    for digit in "0123456789ABCDEFabcdef":
        values[ord(digit)] = int(digit, 16)
    return values


def _number(table: Any, start: int, stop: int) -> Any:
    """The number in some columns of a table of lines; one for all while their digits are equal."""
    number: Any = 0
    for digits in table[start:stop]:
        equal = (digits == digits[0]).all()
        number = number * 10 + (int(digits[0]) if equal else digits.astype("int64")) - ord("0")
    return number


def _is_padded(data: bytes, line: bytes, below: bytes) -> bool:
    """Whether the offsets of two lines of a dump show that the last word is half empty."""
    for base in (8, 16) if below else ():
        with suppress(ValueError, IndexError):
            if int(below.split()[0], base) - int(line.split()[0], base) == len(data) - 1:
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
