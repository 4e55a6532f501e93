"""The layout of a log, decided by a sample: where its lines have bytes, times and labels."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from typing import Final, NamedTuple

from fte_sniff.errors import InputTextError
from fte_sniff.formats.logs.chance import frames_in
from fte_sniff.formats.logs.evidence import WHOLE, Hypothesis, Sample, alike, folded
from fte_sniff.formats.logs.forms import EXTRACTORS, Extractor
from fte_sniff.formats.logs.labels import label_of, without_labels
from fte_sniff.formats.logs.times import Fields, Stamp, Text, TimeRule, masked, time_rule

AS_GOOD: Final = 0.9
"""Two hypotheses whose scores differ less are ambiguous, if their frames differ."""

_CUT: Final = rb"[\"'\]>)}]?[ ,]?(?:\.{3}(?!\.)|\xe2\x80\xa6|\+ ?\d+ more)"
_GIVEN: Final = b"\x01"
"""Around the data of a line that a regular expression matches."""
_MOST_HEADINGS: Final = 8
_MOST_STREAMS: Final = 8
_COVERED: Final = 0.95
_LIKE_BYTES: Final = 4


class Found(NamedTuple):
    """A run of bytes in a line, with what the line says of it."""

    data: bytes
    start: int
    stop: int
    key: bytes
    """Of its lane."""
    cut: bool
    """Whether the log leaves out bytes after it."""


@dataclass(slots=True)
class Layout:
    """How the lines of a log are read."""

    hypothesis: Hypothesis
    times: TimeRule = field(default_factory=TimeRule)
    labels: str = "none"
    """What separates the streams: `word`, `arrow`, `port`, `both`, `lane` or `given`."""
    labelled: str = "before"
    """Where: `before` the bytes, `above` them in a heading, or `after`."""
    streams: tuple[str, ...] = ()
    """The labels in the sample."""
    explained: list[str] = field(default_factory=list)
    """The hypotheses with the best scores."""
    notes: list[str] = field(default_factory=list)
    """What is uncertain."""
    _cuts: dict[bytes, slice | None] = field(default_factory=dict)
    _alike: dict[str, slice] = field(default_factory=dict)
    _names: dict[bytes, str] = field(default_factory=dict)
    """By lane, the label of its stream."""

    def __post_init__(self) -> None:
        self._cuts = {lane.key: lane.cut for lane in self.hypothesis.lanes}
        self._alike = {without_labels(lane.key): lane.cut for lane in self.hypothesis.lanes}

    def runs(self, line: bytes) -> list[Found]:
        """The bytes of a line, by its lanes."""
        found = []
        hidden = self._hidden(line)
        for run in self.hypothesis.extractor.runs(hidden):
            key = folded(hidden[: run.start])
            cut = self.cut_of(key)
            if cut is not None:
                more = re.match(_CUT, line[run.stop : run.stop + 32]) is not None
                found.append(Found(run.data[cut], run.start, run.stop, key, more))
        return found

    def _hidden(self, line: bytes) -> bytes:
        return masked(line) if self.hypothesis.extractor.masks_times else line

    def cut_of(self, key: bytes) -> slice | None:
        """Which numbers of the runs of a lane are data; None if it holds no bytes."""
        if key not in self._cuts:
            self._cuts[key] = self._alike.get(without_labels(key))
        return self._cuts[key]

    def stamp_of(self, line: bytes, found: Found) -> tuple[int, int, Fields, Stamp] | None:
        """Where the time of a run is in its line, and the time."""
        before = self.times.where == "before"
        span = (0, found.start) if before else (found.stop, len(line))
        return self._stamp(line, *span) if self.times.where in ("before", "after") else None

    def _stamp(self, line: bytes, start: int, stop: int) -> tuple[int, int, Fields, Stamp] | None:
        place = self.times.find(line, start, stop)
        if place is None:
            return None
        return *place, self.times.stamp(line, place[2], lambda a, b: int(line[a:b]))

    def label_of(self, line: bytes, found: Found) -> str | None:
        """The label of the stream that a run belongs to; None if only a heading has one."""
        if self.labels == "lane":
            return self._names.get(found.key, "")
        around = line[: found.start] if self.labelled == "before" else line[found.stop :]
        return _label(self.labels, around) if self.labelled != "above" else None

    def heading(self, line: bytes) -> tuple[Stamp | None, str | None]:
        """The time and the label that a line without bytes gives those below it."""
        place = self._stamp(line, 0, len(line)) if self.times.where == "above" else None
        label = _label(self.labels, line) if self.labelled == "above" else None
        return (None if place is None else place[3]), label

    def any_stamp(self, line: bytes) -> Stamp | None:
        """The time of a line of the sample."""
        found = self.runs(line)
        if not found:
            return self.heading(line)[0]
        place = self.stamp_of(line, found[0])
        return None if place is None else place[3]

    def looks_like_bytes(self, line: bytes) -> bool:
        """Whether a line that is skipped has a run of several bytes in this form."""
        runs = self.hypothesis.extractor.runs(self._hidden(line))
        return any(len(run.data) >= _LIKE_BYTES for run in runs)

    def unread_words(self, line: bytes, found: Sequence[Found]) -> str:
        """The words of a line that are neither bytes nor a time nor a direction."""
        rest = bytearray(masked(line).replace(b"~", b" "))
        for run in found:
            rest[run.start : run.stop] = b" " * (run.stop - run.start)
        before, between = rest[: found[0].start], rest[found[0].stop : found[-1].stop]
        text = without_labels(bytes(before)) + " " + between.decode("utf-8", "replace")
        return " ".join(re.findall(r"\w+", text))

    @property
    def columnar(self) -> bool:
        """Whether many lines can be read at once."""
        return self.hypothesis.extractor.columnar

    def explain(self) -> list[str]:
        """The form, lanes, times and directions, one line each."""
        extractor = self.hypothesis.extractor
        times = f"{self.times.kind} {self.times.where} the bytes"
        streams = f"{', '.join(self.streams)}, by {self.labels} {self.labelled} the bytes"
        return [
            f'form "{extractor.name}", as of {extractor.tools}',
            *(
                f"lane {lane.key.decode('utf-8', 'replace')!r}: {len(lane.runs)} runs"
                + (f", without {_left_out(lane.cut)}" if lane.cut != WHOLE else "")
                for lane in self.hypothesis.lanes
            ),
            f"times: {'none' if self.times.where == 'none' else times}",
            f"streams: {streams if self.streams else 'one'}",
            *(f"score {number}: {text}" for number, text in enumerate(self.explained, 1)),
        ]

    def settle(self, lines: Sequence[bytes], *, given: bool) -> None:
        """Decide times and labels; a regular expression may have `given` the labels."""
        sampled = _sampled(self, lines)
        texts, runs = [text for text, _ in sampled], [run for _, run in sampled]
        self.times = time_rule(texts)
        bytewise = all(len(run.data) == 1 for run in runs)
        self.times.first_byte = self.times.kind == "since" and bytewise
        least = len(frames_in(b"".join(run.data for run in runs)))
        rules = product(("before", "above", "after"), ("both", "word", "arrow", "port"))
        for where, kind in [("after", "given")] if given else rules:
            labels = [_label(kind, _around(text, where)) for text in texts]
            above = {text.above for text in texts} if where == "above" else None
            if _plausible(kind, labels, above) and _frames(runs, labels).total() >= least:
                self.labels, self.labelled = kind, where
                self.streams = tuple(sorted({label for label in labels if label}))
                return
        self._separate_lanes(runs, texts[0].headings if texts else (), least)

    def _separate_lanes(self, runs: Sequence[Found], headings: Sequence[bytes], least: int) -> None:
        """Let lanes be streams if no frame is lost and each has frames of one header."""
        keys = sorted({run.key for run in runs})
        if not 2 <= len(keys) <= _MOST_STREAMS:
            return
        found = _frames(runs, [run.key for run in runs])
        pure = len(found) == len(keys) and len({header for _, header in found}) > 1
        if found.total() > least or (pure and found.total() == least):
            self.labels, self._names = "lane", _lane_names(keys, headings)
            self.streams = tuple(sorted(set(self._names.values())))


def _sampled(layout: Layout, lines: Sequence[bytes]) -> list[tuple[Text, Found]]:
    sampled, above, headings = [], b"", list[bytes]()
    for line in lines:
        found = layout.runs(line)
        if not found and line.strip():
            above = line
            headings = [*headings, line][:_MOST_HEADINGS]
        for run in found:
            sampled.append((Text(line, run.start, run.stop, above, tuple(headings)), run))
    return sampled


def _around(text: Text, where: str) -> bytes:
    if where == "above":
        return text.above
    return text.line[: text.start] if where == "before" else text.line[text.stop :]


def _label(kind: str, text: bytes) -> str | None:
    label = label_of(text)
    direction = label.word or label.arrow
    if kind == "given":
        text = text.partition(_GIVEN)[2].strip()
        return (
            label_of(text).word or label_of(text).arrow or text.decode("utf-8", "replace").lower()
        )
    if kind == "both":
        return f"{label.port}-{direction}" if label.port and direction else None
    return {"word": label.word, "arrow": label.arrow, "port": label.port}.get(kind)


def _plausible(kind: str, labels: Sequence[str | None], above: set[bytes] | None) -> bool:
    """Whether almost all runs have a label, and the labels are like those of streams."""
    known = Counter(label for label in labels if label)
    if known.total() < _COVERED * len(labels) or len(known) > _MOST_STREAMS:
        return False
    if above is not None and len(above) < 2:
        return False
    ports = {label.rpartition("-")[0] for label in known} if kind == "both" else known
    return len(ports) > 1 or kind in ("word", "given") or (kind == "arrow" and above is not None)


def _frames(runs: Sequence[Found], labels: Sequence[object]) -> Counter[tuple[object, int]]:
    """The number of frames by label and header."""
    streams: dict[object, list[bytes]] = {}
    for run, label in zip(runs, labels, strict=True):
        streams.setdefault(label, []).append(run.data)
    return Counter(
        (label, frame[0])
        for label, pieces in streams.items()
        for frame in frames_in(b"".join(pieces))
    )


def _lane_names(keys: Sequence[bytes], headings: Sequence[bytes]) -> dict[bytes, str]:
    """A name for each lane: a word that no other lane has, or the heading of its column."""
    words = [re.findall(r"[^\W\d][\w/.-]*", key.decode("utf-8", "replace")) for key in keys]
    common = set(words[0]).intersection(*words)
    columns = [key.count(b",") for key in keys]
    tables = (heading.decode("utf-8", "replace").split(",") for heading in headings)
    cells = next((cells for cells in tables if len(cells) > max(1, *columns)), None)
    names = []
    for own, column in zip(words, columns, strict=True):
        name = next((word for word in reversed(own) if word not in common), "")
        names.append((name or (cells[column].strip(' "') if cells else "")).lower())
    if len(set(filter(None, names))) < len(names):
        names = [str(number) for number in range(1, len(names) + 1)]
    return dict(zip(keys, names, strict=True))


def marked(line: bytes, pattern: re.Pattern[bytes]) -> bytes:
    """The time, data and direction that a regular expression finds in a line; else the line."""
    found = pattern.search(line)
    if found is None:
        return line
    groups = found.groupdict()
    time, way = groups.get("time") or b"", groups.get("dir") or b""
    return b" %b ".join([b"%b", b"%b", b"%b"]) % (time, _GIVEN, found["data"], _GIVEN, way)


def decide(
    lines: Sequence[bytes],
    form: str | None = None,
    pattern: re.Pattern[bytes] | None = None,
    *,
    paste: bool = False,
) -> Layout | None:
    """The layout of a log, by a sample of its lines; None if there are not enough frames.

    Args:
        lines: the sample, in the order of the log.
        form: the name of an extractor, or of a form with any separator, if it is given.
        pattern: a regular expression that gives the data of a line.
        paste: whether the text is what somebody pasted, which need not have a whole frame.

    Raises:
        InputTextError: two hypotheses are as good, or there is no such form.
    """
    extractors = [one for one in EXTRACTORS if form in (None, one.name, one.name.partition(",")[0])]
    if not extractors:
        names = ", ".join(one.name for one in EXTRACTORS)
        raise InputTextError(f"--form: there is no form {form!r}; the forms are: {names}")
    if pattern is not None:
        lines = [line for line in lines if pattern.search(line)]
    sample = Sample(lines if pattern is None else [marked(line, pattern) for line in lines])
    ranked = sample.hypotheses(extractors)
    good = [one for one in ranked if one.accepted]
    forced = paste or form is not None or pattern is not None
    notes = []
    if good:
        _refuse_ambiguous(good)
    elif forced and (good := ranked or _longest(sample, extractors, named=form is not None)):
        notes.append(
            f'no whole frame in it; what is read as "{good[0].extractor.name}" may be no bytes'
        )
    if not good:
        return None
    layout = Layout(good[0], explained=[str(one) for one in ranked[:3]], notes=notes)
    layout.notes += [
        f"{_left_out(cut)} of the bytes of a line are no data"
        for cut in {(lane.cut.start, lane.cut.stop): lane.cut for lane in good[0].lanes}.values()
        if cut != WHOLE
    ]
    layout.settle(sample.lines, given=pattern is not None and "dir" in pattern.groupindex)
    return layout


def _left_out(cut: slice) -> str:
    return f"the first {cut.start or 0} and the last {-(cut.stop or 0)}"


def _refuse_ambiguous(good: Sequence[Hypothesis]) -> None:
    best = good[0]
    for other in good[1:]:
        missing = Counter(other.frames) - Counter(best.frames)
        if other.score >= AS_GOOD * best.score and missing.total() > 0.1 * len(other.frames):
            named = (
                f'"{one.extractor.name}" (first frame {one.frames[0].hex(" ").upper()})'
                for one in (best, other)
            )
            raise InputTextError(
                f"two readings are as good: {' and '.join(named)};"
                f' choose one with --form "{best.extractor.name}"'
            )


def _longest(sample: Sample, extractors: Sequence[Extractor], *, named: bool) -> list[Hypothesis]:
    """The lane with the most bytes, in a form that is named or in hexadecimal digits."""
    found = []
    for extractor in extractors:
        if named or extractor.columnar:
            lanes = sample.lanes(replace(extractor, masks_times=True))
            found += [Hypothesis(extractor, [lane, *alike([lane], lanes)]) for lane in lanes]
    sizes = [sum(len(data) for _, data in one.lanes[0].runs) for one in found]
    return [found[sizes.index(max(sizes))]] if max(sizes, default=0) > 1 else []
