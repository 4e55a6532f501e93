"""A log whose layout frames decide: from its lines to the bytes of its streams."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from datetime import UTC, datetime
from itertools import chain
from time import time_ns
from typing import TYPE_CHECKING, Any, Final

from fte_sniff.errors import InputTextError
from fte_sniff.formats.log_form import NO_TIME, LogForm, StreamBytes
from fte_sniff.formats.logs.evidence import (
    LIKE_BYTES,
    Hypothesis,
    are_known,
    hypotheses,
    without_labels,
)
from fte_sniff.formats.logs.forms import EXTRACTORS
from fte_sniff.formats.logs.layout import Found, Layout, left_out, without_bytes
from fte_sniff.formats.logs.times import LogClock, TimeRule, masked
from fte_sniff.formats.logs.weave import WIRES, Weave
from fte_sniff.formats.text_blocks import LONGEST_LINE, TextBlock
from fte_sniff.protocol import byte_time_ns

if TYPE_CHECKING:
    from fte_sniff.formats.log_form import Array, LogOptions
    from fte_sniff.formats.logs.shapes import Shapes

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
        if self._paste:  # one direction, or a second column, is no second wire
            self.single = len(self.layout.streams) < 2 or self.layout.labels == "lane"
        self._scores = [f"score {rank}: {one}" for rank, one in enumerate(found[:3], 1)]
        cuts = {left_out(cut) for cut in found[0].cuts.values()} - {""}
        self._notes = [f"lines are read{cut}, which are no data" for cut in sorted(cuts)]
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
        for alike in self._shapes.alike_lines(block.text):
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
    """The words before and between the bytes of a line that are no time.

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
