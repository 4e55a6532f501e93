"""A log with a layout: a sample decides it, and lines are read by it into the bytes of streams.

The layout is the form of the bytes, the lanes that hold them, and where times and labels are.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from datetime import UTC, datetime
from itertools import accumulate, chain, product
from time import time_ns
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from fte_sniff.errors import InputTextError
from fte_sniff.formats.logs.evidence import (
    EXTRACTORS,
    LIKE_BYTES,
    RECORD_BORDER,
    WIRES,
    Hypothesis,
    Weave,
    are_known,
    frames_in,
    hypotheses,
    label_of,
    runs_in_lanes,
    without_labels,
)
from fte_sniff.formats.logs.text import (
    LONGEST_LINE,
    NO_TIME,
    LogForm,
    LogOptions,
    StreamBytes,
    TextBlock,
)
from fte_sniff.formats.logs.times import Fields, LogClock, StepUnit, TimeRule, masked, time_rule
from fte_sniff.protocol import byte_time_ns
from fte_sniff.protocol.spec import HEADERS, Direction

if TYPE_CHECKING:
    from fte_sniff.formats.logs.shapes import Shapes
    from fte_sniff.formats.logs.text import Array, LogOptions


GAP: Final = re.compile(
    rb"[\"'\]>)}]?[ ,]?(?:\.{3}(?!\.)|\xe2\x80\xa6|\+ ?\d+ more)"
    rb"|(?i:([ ,:-])(?:[\da-f][g-z]|[g-z][\da-f]|[\da-f](?=\1[\da-f]{2}\1))(?=\1[\da-f]{2}\b))"
)
"""After bytes, where others are left out, or one of them has a mistake."""
_MOST_STREAMS: Final = 8
_LONGEST_ABOVE: Final = 1000
_HEADER_OF: Final = {
    "tx": {HEADERS[Direction.CONTROL]},
    "rx": {HEADERS[Direction.FEEDBACK]},
}
"""Of a direction, the headers of its frames."""
_ONE_WORD: Final = rb"\W*(?:\d{1,16}|(?:0[xX])?\w{1,8})\W*"
"""An address, a counter or a name."""
_BORDER: Final = re.compile(RECORD_BORDER)
_FAR: Final = 1024
"""Bytes of a line that are searched for what is not near its bytes."""
_MOST_TIMED: Final = 300
_MOST_SEARCHED: Final = 200_000
"""Runs of a sample that show where the times are, and the bytes of their lines."""
_COVERED: Final = 0.95
_LABELS: Final = ("both", "word", "first word", "arrow", "port")
_SEVERAL: Final = (*product(("before", "above", "after"), _LABELS), ("before", "lane"))
"""Where the labels that separate streams may be, and their kind."""
_LONE: Final = (*product(("before", "above", "after"), ("word",)), ("above", "arrow"))
"""Where a label may be that is the only one, and its kind; other lone labels are an accident."""


class Found(NamedTuple):
    """Bytes in a line, with what the line says of them; a heading has no bytes."""

    data: bytes = b""
    start: int = 0
    stop: int = 0
    key: bytes = b""
    """Of its lane."""
    cut: slice = slice(None)
    """Which of its numbers are data."""
    gap: bool = False
    """Whether the log leaves out bytes after it."""
    parts: Mapping[str, Sequence[tuple[int, int]]] = MappingProxyType({})
    """Of the line, `before` and `after` it, what may be about it: near it, its record, the line."""
    label: str | None = None
    """Of its stream."""
    fields: Fields | None = None
    """Of its time."""
    stamp: int = NO_TIME
    """Its time, as `TimeRule.stamp` reads it."""
    line: bytes = b""
    """In a sample, the line."""
    above: bytes = b""
    """In a sample, the lines without bytes above it."""
    below: bytes = b""
    """In a sample, the lines without bytes below it."""

    def texts(self, part: int) -> tuple[bytes, bytes, bytes, bytes]:
        """What is before and after it in a part of its line, above it, and below it."""
        before, after = (self.line[slice(*self.parts[at][part])] for at in ("before", "after"))
        return before, after, self.above, self.below


class Layout:
    """How the lines of a log are read."""

    def __init__(
        self,
        hypothesis: Hypothesis,
        lines: Sequence[bytes],
        options: LogOptions,
        *,
        given: bool,
        is_cut: bool,
    ) -> None:
        """Decide times and labels by a sample; a regular expression may have `given` the labels.

        The last lines are not in a sample that `is_cut`.
        """
        self.hypothesis = hypothesis
        self.labels, self.labelled = "none", "none"
        """What separates the streams: a kind of label, or `lane`; `above`, `before` or `after`."""
        self.streams: tuple[str, ...] = ()
        """The labels in the sample."""
        self._names: dict[bytes, str] = {}
        """By lane, the label of its stream."""
        self.times = TimeRule()
        self._reach = 0
        """How many of the parts of a line may have the time of its bytes."""
        self.coarse: TimeRule | None = None
        """A time beside the times that is not as fine, and shows what they count from."""
        sampled = self._sampled(lines)
        some = sampled[:: len(sampled) // _MOST_TIMED + 1]
        bytewise = all(len(one.data) == 1 for one in sampled)
        steps = StepUnit(bytewise, options.baud, options.samplerate)
        is_below = self._ends_with_time(sampled, is_cut=is_cut)
        while self.times.where == "none" and self._reach < 3:
            texts = [one.texts(self._reach) for one in some]
            size = sum(len(before) + len(after) for before, after, *_ in texts)
            texts = texts[:: size // _MOST_SEARCHED + 1]
            self.times, self.coarse = time_rule(texts, steps, is_below=is_below)
            self._reach += 1
        hidden = {text: masked(text) for one in sampled for text in (one.line, one.above)}
        sampled = [one._replace(line=hidden[one.line], above=hidden[one.above]) for one in sampled]
        self.times.first_byte = self.times.kind == "since" and bytewise
        rules = [(2, *rule) for rule in _SEVERAL] + [(1, *rule) for rule in _LONE]
        for least, where, kind in [(1, "after", "given")] if given else rules:
            if self._separates(kind, where, sampled, least):
                break
        self.is_woven = hypothesis.is_woven and not self.streams
        """Whether only frames show the wire of each byte."""
        if self.is_woven:
            self.streams = tuple(sorted(WIRES))

    def read(self, line: bytes) -> tuple[list[Found], bytes]:
        """The bytes of a line, or what a heading says; another run that looks like bytes."""
        hidden = masked(line) if self.hypothesis.extractor.masks_times else line
        runs = self.hypothesis.extractor.runs(hidden)
        found, others = list[Found](), dict[int, bytes]()
        for run, key in runs_in_lanes(hidden, runs, self.hypothesis.common):
            cut = self.hypothesis.cut_of(key, len(run.data))
            if cut is None:
                text = line[run.start : run.stop]
                is_time = hidden[run.start : run.stop] != text
                if (
                    len(run.data) >= LIKE_BYTES
                    and not is_time
                    and not re.fullmatch(_ONE_WORD, text)
                ):
                    others[run.start] = text
                continue
            gap = GAP.match(line, run.stop, run.stop + 32) is not None
            found.append(Found(run.data[cut], run.start, run.stop, key, cut, gap))
        found = [self._described(one, line) for one in _with_parts(found, line)]
        if not found and {"above", "below"} & {self.labelled, self.times.where}:
            all_of_it = ((0, len(line)),)
            heading = self._described(Found(parts={"above": all_of_it, "below": all_of_it}), line)
            found = [heading] * bool(heading.fields or heading.label)
        times = {at for one in found for at, _ in (one.fields or {}).values()}
        return found, next((text for at, text in others.items() if at not in times), b"")

    def _described(self, found: Found, line: bytes) -> Found:
        """The bytes with their label and time."""
        label = self._names.get(found.key)
        if not self._names:
            label = _label(self.labels, line, found.parts.get(self.labelled, ())[:2])
        found = found._replace(label=label)
        for part in found.parts.get(self.times.where, ())[: max(2, self._reach)]:
            fields = self.times.find(line, *part)
            stamp = self.times.stamp(line, fields) if fields else None
            if stamp is not None:
                return found._replace(fields=fields, stamp=stamp)
        return found

    def coarse_steps(self, read: Sequence[tuple[bytes, Sequence[Found]]]) -> list[int]:
        """By how much coarse times beside the times of a sample are later, nanoseconds."""
        steps, coarse = list[int](), self.coarse
        if coarse is None:
            return steps
        for line, one in ((line, one) for line, found in read for one in found if one.fields):
            parts = one.parts.get(coarse.where, ())[: max(2, self._reach)]
            fields = next(filter(None, (coarse.find(line, *part) for part in parts)), None)
            stamp = coarse.stamp(line, fields) if fields else None
            if stamp is not None:
                steps.append(stamp - one.stamp)
        return steps

    def explain(self) -> list[str]:
        """The form, lanes, times and directions, one line each."""
        extractor, where = self.hypothesis.extractor, self.times.where
        by = f"{self.labels} {self.labelled} the bytes"
        by = "the frames that their bytes make" if self.is_woven else by
        streams = f"{', '.join(self.streams)}, by {by}"
        return [
            f'form "{extractor.name}", written by {extractor.tools}',
            *(f"lane {key!r}{left_out(cut)}" for key, cut in self.hypothesis.cuts.items()),
            f"times: {'none' if where == 'none' else f'{self.times.kind} {where} the bytes'}",
            f"streams: {streams if self.streams else 'one'}",
        ]

    def _sampled(self, lines: Sequence[bytes]) -> list[Found]:
        sampled, above, below = list[Found](), b"", True
        for line in lines:
            found, _ = self.read(line)
            if not found and line.strip():
                above = line if below else above[-_LONGEST_ABOVE:] + b"\n" + line
            if not found and sampled and line.strip():
                last = sampled[-1]
                last = last._replace(below=(last.below + b"\n" + line)[:_LONGEST_ABOVE])
                sampled[-1] = last
            below = bool(found) or (below and not line.strip())
            sampled += [one._replace(line=line, above=above) for one in found]
        return sampled

    @staticmethod
    def _ends_with_time(sampled: Sequence[Found], *, is_cut: bool) -> bool:
        """Whether the log begins with bytes and ends with a time, so that times are below bytes."""
        first, last = sampled[0], sampled[-1]
        above, below = (masked(text) != text for text in (first.above, last.below))
        return not above and masked(first.below) != first.below and (below or is_cut)

    def _separates(self, kind: str, where: str, runs: Sequence[Found], least: int) -> bool:
        """Separate streams by labels, if almost all runs have one and no frame is lost."""
        if where == "above":
            labels = [label_of(kind, one.above) for one in runs]
            for at in range(1, len(labels)):  # of the last heading that has one
                labels[at] = labels[at] or labels[at - 1]
        elif kind == "lane":
            labels = [str(one.key) for one in runs]
        else:
            labels = [_label(kind, one.line, one.parts[where][:2]) for one in runs]
        known = sorted({label for label in labels if label is not None})
        named = {label.rpartition("-")[0] for label in known} if kind == "both" else known
        if (
            not 0 < len(known) <= _MOST_STREAMS
            or labels.count(None) > (1 - _COVERED) * len(labels)
            or (where == "above" and len({one.above for one in runs}) < 2)
            or len(named) < least
        ):
            return False
        pieces = [
            b"".join(run.data for own, run in zip(labels, runs, strict=True) if own == label)
            for label in {None, *known}
        ]
        frames = [frames_in(data) for data in pieces if data]
        gain = sum(map(len, frames)) - len(frames_in(b"".join(run.data for run in runs)))
        headers = [{frame[0] for frame in own} for own in frames]
        if (
            len(named) == 1
            and known[0] in _HEADER_OF
            and set().union(*headers) != _HEADER_OF[known[0]]
        ):
            return False  # it is a word of the program, such as the name of its host
        pure = all(len(own) == 1 for own in headers) and len(set().union(*headers)) > 1
        if gain < 0 or (kind == "lane" and not (gain or pure)):
            return False
        if kind == "lane":
            self._names = _lane_names({run.key for run in runs}, runs[0].above.split(b"\n"))
            known = sorted(self._names.values())
        self.labels, self.labelled, self.streams = kind, where, tuple(known)
        return True


def _with_parts(found: Sequence[Found], line: bytes) -> Iterator[Found]:
    """Bytes of a line with the parts of the line that are about them."""
    stops = [0, *(one.stop for one in found)]
    starts = [*(one.start for one in found[1:]), len(line)]
    borders = [[*_BORDER.finditer(line, *gap)] for gap in zip(stops[1:], starts[:-1], strict=False)]
    begins = accumulate((own[-1].end() if own else 0 for own in borders), max, initial=0)
    ends = (own[0].start() if own else len(line) for own in reversed(borders))
    records = zip(begins, [*accumulate(ends, min, initial=len(line))][::-1], strict=True)
    for one, last, following, (begin, end) in zip(found, stops, starts, records, strict=False):
        before = (max(begin, last), one.start), (begin, min(one.start, begin + _FAR))
        after = (one.stop, min(end, following)), (one.stop, min(end, one.stop + _FAR))
        all_before, all_after = (0, min(one.start, _FAR)), (one.stop, one.stop + _FAR)
        yield one._replace(parts={"before": (*before, all_before), "after": (*after, all_after)})


def _label(kind: str, line: bytes, parts: Iterable[tuple[int, int]]) -> str | None:
    """The label in the first part of a line that has one."""
    return next(filter(None, (label_of(kind, line[slice(*part)]) for part in parts)), None)


def without_bytes(line: bytes, found: Sequence[Found]) -> bytes:
    """The line with spaces for its bytes."""
    around = bytearray(line)
    for one in found:
        around[one.start : one.stop] = b" " * (one.stop - one.start)
    return bytes(around)


def left_out(cut: slice) -> str:
    """Which numbers of a run are not data."""
    first, last = cut.start or 0, -(cut.stop or 0)
    return f" without the first {first} and the last {last} numbers" if first or last else ""


def _lane_names(keys: set[bytes], headings: Sequence[bytes]) -> dict[bytes, str]:
    """A name for each lane: a word that no other lane has, or the heading of its column."""
    words = {key: re.findall(r"[^\W\d][\w/.-]*", key.decode("utf-8", "replace")) for key in keys}
    common = set.intersection(*map(set, words.values()))
    columns = max(key.count(b",") for key in keys) + 1
    tables = (heading.decode("utf-8", "replace").lower().split(",") for heading in headings)
    cells = next((cells for cells in tables if len(cells) >= max(2, columns)), [""] * columns)
    names = {}
    for key, own in words.items():
        different = [word.lower() for word in own if word not in common]
        names[key] = different[-1] if different else cells[key.count(b",")].strip(' "')
    if len(set(names.values()) - {""}) < len(keys):
        return {key: str(number) for number, key in enumerate(sorted(keys), 1)}
    return names


_AS_GOOD: Final = 0.9
"""Two hypotheses whose scores differ less are ambiguous, if their frames differ."""
_CERTAIN: Final = 20
"""Frames from which on a sample is large enough."""
_COLUMNAR: Final = 256
"""Lines of a block from which on numpy reads them."""
_MARK: Final = "\x01"
"""Around the data of a line that a regular expression matches."""
_LIKE_TIME: Final = rb"(?:[-/\d]+ +\d?\d|\d\d:[0-5]\d):[0-5]\d[\d.:,]*|\b\d{8}T\d{6}[\d.,]*"
_MOST_SHOWN: Final = 20
"""Bytes of a line in an explanation."""
_MOST_MARKED: Final = 4
_LONGEST_SHOWN: Final = 100
"""Runs that are marked in that line, and characters of a part of it."""
_OF_NUMBERS: Final = ("hex", "0x", "decimal,", "h after", "octal", "binary")
"""How the names of forms begin that prose does not look like."""
_REGEX: Final = "--input-regex can say where"
_LIKE: Final = "hold what looks like bytes but is not read"


class EvidenceLog(LogForm):
    """A log with a layout."""

    def __init__(
        self,
        lines: Sequence[bytes],
        found: Sequence[Hypothesis],
        options: LogOptions,
        *,
        is_cut: bool,
    ) -> None:
        """The log of a sample of lines, by what is found in it, the best hypothesis first.

        The last lines are not in a sample that `is_cut`.
        """
        self._pattern, self._paste = options.pattern, not options.whole
        given = options.pattern is not None and "dir" in options.pattern.groupindex
        self.layout = Layout(found[0], lines, options, given=given, is_cut=is_cut)
        self.clock = LogClock(self.layout.times, options, self._count)
        self.rank, self.is_certain = found[0].rank, len(found[0].frames) >= _CERTAIN
        self.single, self.share = not self.layout.streams, found[0].share
        if self._paste:  # a direction, or a second column, is not a second wire
            self.single = len(self.layout.streams) < 2 or self.layout.labels == "lane"
        self._scores = [f"score {rank}: {one}" for rank, one in enumerate(found[:3], 1)]
        cuts = {left_out(cut) for cut in found[0].cuts.values()} - {""}
        self._notes = [f"lines are read{cut}, which are not data" for cut in sorted(cuts)]
        if self.layout.is_woven:
            self._notes.append(
                "its bytes are of two wires without a label; their frames show which"
            )
        if not found[0].frames:
            form = found[0].extractor.name
            self._notes = [f'no whole frame in it; what is read as "{form}" may be no bytes']
        self._examples: list[tuple[bytes, list[Found]]] = []
        """Lines with bytes, and what is read of them."""
        self._start_ns, self._byte_ns = options.start_ns, byte_time_ns(options.baud)
        """When the next bytes of a log without times begin, by `--start`."""
        self._labels: dict[str | None, int] = {None: 0}
        """Their numbers, 0 for none."""
        self._label = 0
        """The number of that of the last line."""
        self._shapes: Shapes | None = None
        """Of its lines, once there are many."""
        self._waiting: tuple[Any, Any] | None = None
        """Lines that wait for a time below them, or until their wires are decided."""
        self._weave, self._wires = Weave(), b""
        """Decides the wires of bytes, if only frames show them; those of bytes that wait."""
        self._read = 0
        """Runs so far."""
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
            InputTextError: two hypotheses are as good, or the form is unknown.
        """
        if options.pattern is not None:
            matching = [one for line in lines if (one := _rearranged(line, options.pattern))]
            if not matching:
                raise InputTextError(f"--input-regex matches none of {len(lines):,} lines")
            lines = matching
        found = _hypotheses(lines, options)
        if not found:
            return None
        log = cls(lines, found, options, is_cut=written_ns is None)
        times = log.layout.times
        texts = chain([b"\n".join(lines)], (block.text for block in blocks()))
        near = options.day or datetime.fromtimestamp((written_ns or time_ns()) / 1e9, UTC).date()
        log._notes += times.decide(texts, near, given=options.day is not None)
        coarse = log.layout.coarse
        if coarse is not None:
            log._notes += coarse.decide([b"\n".join(lines)], near, given=options.day is not None)
        read = [(line, log.layout.read(line)[0]) for line in lines]
        stamps = [found[0].stamp for _, found in read if found and found[0].fields]
        if not stamps or (log._paste and times.kind not in ("date", "epoch")):
            times = log.layout.times = TimeRule()  # nobody asks when a pasted line was
        else:
            log.clock.settle(stamps, name, written_ns, coarse, log.layout.coarse_steps(read))
        if times.where == "none" and not log._paste:
            around = [without_bytes(*one) for one in read if one[1]]
            like = [time[0].decode() for text in around if (time := re.search(_LIKE_TIME, text))]
            if 2 * len(like) > len(around):
                example = f"for example {like[0]!r}; {_REGEX} they are"
                log._notes.append(f"what may be times is not read, {example}")
        log.resolution_ns = None if times.where == "none" else times.resolution_ns
        log._examples = _two_of([one for one in read if one[1] and one[1][0].data])
        return log

    def ports(self, name: str) -> list[str]:
        """One for each label."""
        labels = self.layout.streams
        return [f"{name}:{label}" for label in labels] if len(labels) > 1 else [name]

    def read(self, block: TextBlock, name: str) -> Iterator[StreamBytes]:
        """See `LogForm`."""
        if block.column is not None:
            if not block.column:
                most = f"{LONGEST_LINE >> 20} MB, the most that is read of a line"
                self._count(f"exceed {most}", block.first, block.text[:80])
            return
        tables, data = list[Any](), list[bytes]()
        many = block.count >= _COLUMNAR and self._pattern is None
        rest = self._read_shapes(block, tables, data) if many else range(block.count)
        found = [(block.first + at, one) for at in rest for one in self._found(block, at)]
        if self.is_one_stream and not tables:
            for _, one in found:
                gaps = (len(one.data),) * one.gap
                yield StreamBytes(name, one.data, gaps=gaps, label=one.label)
        elif found or tables:
            import numpy as np

            numbers = self._labels
            rows = [
                (at, len(own.data), numbers.setdefault(own.label, len(numbers)), own.stamp, own.gap)
                for at, own in found
            ]
            tables.append(np.array(rows, np.int64).reshape(-1, 5).T)
            data += [one.data for _, one in found]
            text = np.frombuffer(b"".join(data), np.uint8)
            yield from self._streams(np.hstack(tables), text, name)

    def _read_shapes(self, block: TextBlock, tables: list[Any], data: list[bytes]) -> Sequence[int]:
        """Read the lines that have the shape of others; the indices of the other lines."""
        import numpy as np

        from fte_sniff.formats.logs.shapes import Shapes

        self._shapes = self._shapes or Shapes(self.layout)
        left = np.ones(block.count, np.bool_)
        for alike in self._shapes.alike_lines(block.lines):
            left[alike.rows] = False
            numbers = block.first + alike.rows
            if alike.label is None and not alike.data and isinstance(alike.stamps, int):
                self._count_foreign(block, alike.rows)
                continue
            label = self._labels.setdefault(alike.label, len(self._labels))
            columns = numbers, alike.sizes, label, alike.stamps, 0
            tables.append(np.stack(np.broadcast_arrays(*columns)))
            data.append(alike.data)
        return np.flatnonzero(left).tolist()

    def rest(self, name: str) -> Iterator[StreamBytes]:
        """See `LogForm`."""
        if self._waiting is not None or self.layout.is_woven:
            import numpy as np

            empty = np.zeros((5, 0), np.int64), np.zeros(0, np.uint8)
            yield from self._streams(*empty, name, final=True)

    def _with_waiting(self, table: Array, text: Any) -> tuple[Array, Any]:
        """The lines that waited, and these."""
        import numpy as np

        if self._waiting is not None:
            before, its = self._waiting
            table[5] += its.size
            table, text = np.hstack([before, table]), np.append(its, text)
            self._waiting = None
        return table, text

    def _wait(self, table: Array, text: Any) -> None:
        """Let lines wait for the next ones."""
        import numpy as np

        if table.size:
            rest = [text[at : at + size] for size, at in zip(table[1], table[5], strict=True)]
            table = table.copy()
            table[5] = np.cumsum(table[1]) - table[1]
            self._waiting = table, np.concatenate(rest)

    def _until_time(self, table: Array, text: Any, *, final: bool) -> tuple[Array, Any]:
        """The lines up to the last time, with those that waited; the others wait for the next."""
        import numpy as np

        table, text = self._with_waiting(table, text)
        timed = np.flatnonzero(table[3] != NO_TIME)
        end = table.shape[1] if final else int(timed[-1]) + 1 if timed.size else 0
        self._wait(table[:, end:], text)
        return table[:, :end], text

    def _unwoven(self, table: Array, text: Any, *, final: bool) -> tuple[Array, Any]:
        """The lines whose wires are decided, with their labels; the others wait."""
        import numpy as np

        data = b"".join(
            text[at : at + size].tobytes() for size, at in zip(table[1], table[5], strict=True)
        )
        self._wires += self._weave.push(data, final=final)
        table, text = self._with_waiting(table, text)
        ends = np.cumsum(table[1])
        end = int(np.searchsorted(ends, len(self._wires), "right"))
        self._wait(table[:, end:], text)
        table = table[:, :end]
        if end:
            names = np.array([self._labels.setdefault(one, len(self._labels)) for one in WIRES])
            wires = np.frombuffer(self._wires[: int(ends[end - 1])], np.uint8)
            table[2] = names[wires[np.minimum(ends[:end] - table[1], wires.size - 1)]]
            self._wires = self._wires[int(ends[end - 1]) :]
        return table, text

    def _count_foreign(self, block: TextBlock, rows: Any) -> None:
        """Count lines of a block that hold no bytes."""
        lines = block.lines
        rows = [at for at in rows.tolist() if not lines[at].isspace()]
        if rows:
            self._count("hold no bytes", block.first + rows[0], lines[rows[0]], len(rows))

    def _streams(
        self, table: Array, text: Any, name: str, *, final: bool = False
    ) -> Iterator[StreamBytes]:
        """The bytes of lines in their order, by the labels of their streams.

        Args:
            table: for each line its number, size, label, time, and whether a gap follows.
            text: the bytes of all lines.
        """
        import numpy as np

        table = np.vstack([table, np.cumsum(table[1]) - table[1]])
        if (table[0, 1:] < table[0, :-1]).any():
            table = table[:, table[0].argsort(kind="stable")]
        if self.layout.times.where == "below":
            table, text = self._until_time(table, text, final=final)
        elif self.layout.is_woven:
            table, text = self._unwoven(table, text, final=final)
        if not table.size:
            return
        if not table[2].all():  # a line without a label has that of the line before
            known = np.maximum.accumulate(np.arange(1, table.shape[1] + 1) * (table[2] > 0))
            table[2] = np.append(self._label, table[2])[known]
        self._label, times = int(table[2, -1]), None
        read = (table[1] > 0) | (table[4] > 0) | (self.layout.times.where in ("above", "below"))
        table = table if read.all() else table[:, read]
        lines, sizes, labels, ns, gaps, begins = table
        order = self._read + np.arange(lines.size)
        self._read += lines.size
        if self.resolution_ns is not None and lines.size:
            times = self.clock.times(ns, lines)
        elif self._start_ns is not None:
            times = self._start_ns + np.cumsum(sizes) * self._byte_ns
            self._start_ns += int(sizes.sum()) * self._byte_ns
        for label in np.flatnonzero(np.bincount(labels)).tolist():
            mine = np.flatnonzero((labels == label) & ((sizes > 0) | (gaps > 0)))
            own, stops = sizes[mine], np.cumsum(sizes[mine])
            if own.size and (sizes == own[0]).all():
                data = text.reshape(-1, own[0])[begins[mine] // own[0]]
            else:
                data = text[np.repeat(begins[mine] - stops + own, own) + np.arange(own.sum())]
            at = None if times is None else times[mine]
            left_out, first = stops[gaps[mine] > 0].tolist(), self.layout.times.first_byte
            word, streams = [*self._labels][label], self.layout.streams
            several = len(streams) > 1 or (streams and word not in streams)
            port = f"{name}:{word}" if several and word else name
            yield StreamBytes(port, data.tobytes(), own, order[mine], at, left_out, first, word)

    def _found(self, block: TextBlock, at: int) -> list[Found]:
        """The bytes of a line, or what a heading says; what is not read is counted."""
        line, number = block.lines[at], block.first + at
        line = line if self._pattern is None else _rearranged(line, self._pattern) or line
        found, other = self.layout.read(line)
        if found and self._paste and (words := _unread_words(line, found, single=self.single)):
            self._count("hold words that are not read as bytes", number, words)
        if other:
            self._count(_LIKE, number, other)
        if not found and line.strip() == b"*" and self.layout.times.where == "none":
            found = [Found(gap=True)]  # a dump leaves out lines like that before
        elif not found and not other and line.strip():
            self._count("hold no bytes", number, line)
        for one in found:
            if one.gap:
                self._count("leave out bytes", number, line[one.stop :])
        has_words = self.layout.hypothesis.extractor.swaps
        if has_words and found and _is_padded(found[-1].data, line, *block.lines[at + 1 : at + 2]):
            found[-1] = found[-1]._replace(data=found[-1].data[:-1])
        return found

    def _count(self, what: str, number: int, text: bytes | str, lines: int = 1) -> None:
        text = text if isinstance(text, str) else text[:120].decode("utf-8", "replace")
        count, first, example = self._seen.get(what, (0, number, text))
        self._seen[what] = (count + lines, *min((number, text), (first, example)))

    def notes(self) -> list[str]:
        """How the log was read, one line each."""
        notes = list(self._notes)
        for what, (count, number, text) in sorted(self._seen.items(), key=lambda one: one[1][1]):
            shown = " ".join(text.replace(_MARK, " ").split())
            shown = shown and f": {shown if len(shown) <= 60 else shown[:59] + '…'!r}"
            one = f"line {number} {what.replace(' ', 's ', 1)}{shown}"
            many = f"{count:,} lines {what}, for example line {number}{shown}"
            notes.append(one if count == 1 else many)
        if _LIKE in self._seen and not self._paste:
            notes.append(f"{_REGEX} the bytes are")
        return notes if self._paste else [*notes, *self.clock.notes]

    def explain(self) -> list[str]:
        """The form, lanes, times and directions; two lines with what is read; the best scores."""
        examples = [text for one in self._examples for text in self._example(*one)]
        return [*self.layout.explain(), *examples, *self._scores]

    def _example(self, line: bytes, found: Sequence[Found]) -> list[str]:
        """A line in which bytes and time are marked, and their values."""
        fields = found[0].fields or {}
        spans = {(one.start, one.stop) for one in found[:_MOST_MARKED]}
        if fields:
            spans.add((min(at for at, _ in fields.values()), max(at for _, at in fields.values())))
        marked, at = "", 0
        for start, stop in [*sorted(spans), (len(line), len(line))]:
            around, inside = (_shortened(line[slice(*own)]) for own in ((at, start), (start, stop)))
            marked += around + (f">>{inside}<<" if inside else "")
            at = stop
        data = b"".join(one.data for one in found)
        more = f" and {len(data) - _MOST_SHOWN} more" if len(data) > _MOST_SHOWN else ""
        values = [f"bytes {data[:_MOST_SHOWN].hex(' ').upper()}{more}"]
        if fields and self.resolution_ns is not None:
            values.append(f"time {self.clock.shown(found[0].stamp)}")
        if found[0].label is not None:
            values.append(f"stream {found[0].label}")
        return [f"for example {marked.replace(_MARK, '').strip()}", f"    {', '.join(values)}"]


def _two_of(lines: Sequence[tuple[bytes, list[Found]]]) -> list[tuple[bytes, list[Found]]]:
    """The first line and one of another stream, or the last."""
    if len(lines) < 2:
        return [*lines]
    others = (one for one in lines if one[1][0].label != lines[0][1][0].label)
    return [lines[0], next(others, lines[-1])]


def _shortened(text: bytes) -> str:
    shown = text.decode("utf-8", "replace")
    return shown if len(shown) <= _LONGEST_SHOWN else f"{shown[:30]}…{shown[-30:]}"


def candidates(lines: Sequence[bytes]) -> list[str]:
    """What comes near to bytes in the lines of a log that is refused, and why it is not read."""
    ranked = [one for one in hypotheses(lines, EXTRACTORS, needed=b"") if one.size >= LIKE_BYTES]
    like = likely_form(lines, ranked)
    ranked.sort(key=lambda one: (-len(one.frames), one is not like, -one.size))
    return [
        f'candidate {number}: "{one.extractor.name}", {one.size:,} bytes in {len(one.cuts)}'
        f" lane{'' if len(one.cuts) == 1 else 's'}, {len(one.frames)} frames:"
        f" {one.fault or 'it is as good as another'}"
        for number, one in enumerate(ranked[:3], 1)
    ]


def likely_form(
    lines: Sequence[bytes], found: Sequence[Hypothesis] | None = None
) -> Hypothesis | None:
    """The form whose numbers are in most lines of a log without frames, if there is one."""
    forms = [one for one in EXTRACTORS if one.name.startswith(_OF_NUMBERS)]
    if found is None:
        found = hypotheses(lines, forms, needed=b"")
    names = {one.name for one in forms}
    runs = {id(one): sum(len(lane.runs) for lane in one.lanes) for one in found}
    enough = (
        one
        for one in found
        if one.extractor.name in names and 2 * runs[id(one)] >= len(lines) and one.size > 1
    )
    return max(enough, key=lambda one: one.size, default=None)


def _unread_words(line: bytes, found: Sequence[Found], *, single: bool) -> str:
    """The words before and between the bytes of a line that are not a time.

    Directions before the first bytes are left out; those between, if the log is not `single`.
    """
    text = without_bytes(masked(line).replace(b"~", b" "), found)
    start, last = found[0 if single else -1].start, found[-1].start
    words = f"{without_labels(text[:start])} {text[start:last].decode('utf-8', 'replace')}"
    return " ".join(re.findall(r"\w+", words))


def _is_padded(data: bytes, line: bytes, below: bytes = b"") -> bool:
    """Whether the offsets of two lines of a dump show that the last word is half empty."""
    for base in (8, 16) if below else ():
        with suppress(ValueError, IndexError):
            if int(below.split()[0], base) - int(line.split()[0], base) == len(data) - 1:
                return True
    return False


def _rearranged(line: bytes, pattern: re.Pattern[str]) -> bytes:
    """The time, data and direction that a regular expression finds in a line; else nothing."""
    found = pattern.search(line.decode("utf-8", "replace"))
    if found is None:
        return b""
    time, way = (found.groupdict().get(name) or "" for name in ("time", "dir"))
    return f"{time} {_MARK} {found['data']} {_MARK} {way}".encode()


def _hypotheses(lines: Sequence[bytes], options: LogOptions) -> list[Hypothesis]:
    """Where the bytes may be, the best first; none if there are not enough frames."""
    forms = [one for one in EXTRACTORS if options.form in (None, one.name, one.name.split(",")[0])]
    if not forms:
        names = "; ".join(one.name for one in EXTRACTORS)
        raise InputTextError(f"--form: unknown form {options.form!r}; the forms are: {names}")
    ranked = [one for one in hypotheses(lines, forms) if one.frames]
    good = [one for one in ranked if one.accepted]
    for other in good[1:]:
        is_as_good = other.score >= _AS_GOOD * good[0].score
        if is_as_good and not are_known(other.frames, good[0].frames):
            raise InputTextError(
                f"two readings are as good: {_shown(good[0], other)} and {_shown(other, good[0])};"
                f' choose one with --form "{good[0].extractor.name}"'
            )
    if good or not (options.form or options.pattern or not options.whole):
        return good and [good[0], *(one for one in ranked if one is not good[0])]
    digits = [one for one in forms if options.form or one.name.startswith("hex")]
    like = hypotheses(lines, (one._replace(masks_times=True) for one in digits), needed=b"")
    return ranked or [one for one in sorted(like, key=lambda one: -one.size) if one.size > 1][:1]


def _shown(one: Hypothesis, other: Hypothesis) -> str:
    first = next((frame for frame in one.frames if frame not in other.frames), one.frames[0])
    return f'"{one.extractor.name}" (for example {first.hex(" ").upper()})'
