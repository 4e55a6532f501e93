"""The layout of a log, decided by a sample: where its lines have bytes, times and labels."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import accumulate, product
from types import MappingProxyType
from typing import Final, NamedTuple

from fte_sniff.formats.log_form import NO_TIME, LogOptions
from fte_sniff.formats.logs.evidence import (
    LIKE_BYTES,
    RECORD_BORDER,
    Hypothesis,
    frames_in,
    label_of,
    runs_in_lanes,
)
from fte_sniff.formats.logs.times import Fields, StepUnit, TimeRule, masked, time_rule
from fte_sniff.formats.logs.weave import WIRES
from fte_sniff.protocol.spec import HEADERS, Direction

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
    """Which numbers of a run are no data."""
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
