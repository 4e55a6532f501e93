"""The layout of a log, decided by a sample: where its lines have bytes, times and labels."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final, NamedTuple

from fte_sniff.errors import InputTextError
from fte_sniff.formats.logs.chance import frames_in
from fte_sniff.formats.logs.evidence import (
    AS_GOOD,
    WHOLE,
    Cut,
    Hypothesis,
    Lane,
    folded,
    hypotheses,
)
from fte_sniff.formats.logs.forms import BY_NAME, EXTRACTORS
from fte_sniff.formats.logs.labels import label_of, without_labels
from fte_sniff.formats.logs.times import (
    Fields,
    Stamp,
    Text,
    TimeRule,
    masked,
    time_rule,
)

_CUT: Final = re.compile(rb"[\"'\]>)}]?[ ,]?(?:\.{3}(?!\.)|\xe2\x80\xa6|\+ ?\d+ more)")
_MOST_HEADINGS: Final = 8
_HEX_FORMS: Final = 13
"""Of the table's first forms, those of hex without marks."""
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
    cut: bool = False
    """Whether the log leaves out bytes after it."""


@dataclass(slots=True)
class Layout:
    """How the lines of a log are read."""

    hypothesis: Hypothesis
    times: TimeRule = field(default_factory=TimeRule)
    labels: str = "none"
    """What separates the streams: `word`, `arrow`, `port` or `both`, or `lane`."""
    labelled: str = "before"
    """Where: `before` the bytes, `above` them in a heading, or `after`."""
    streams: tuple[str, ...] = ()
    """The labels in the sample."""
    explained: list[str] = field(default_factory=list)
    """The hypotheses with the best scores."""
    notes: list[str] = field(default_factory=list)
    """What is uncertain."""
    _cuts: dict[bytes, Cut | None] = field(default_factory=dict)
    _alike: dict[str, Cut] = field(default_factory=dict)
    _lanes: dict[bytes, str] = field(default_factory=dict)
    """By lane, the label of its stream."""

    def __post_init__(self) -> None:
        self._cuts = dict(self.hypothesis.cuts)
        self._alike = {without_labels(key): cut for key, cut in self.hypothesis.cuts.items()}

    def runs(self, line: bytes) -> list[Found]:
        """The bytes of a line, by its lanes."""
        extractor = self.hypothesis.extractor
        hidden = masked(line) if extractor.masks_times else line
        found = []
        for run in extractor.runs(hidden):
            key = folded(hidden[: run.start])
            cut = self.cut_of(key)
            if cut is not None:
                more = _CUT.match(line, run.stop) is not None
                found.append(Found(cut.of(run), run.start, run.stop, key, more))
        return found

    def cut_of(self, key: bytes) -> Cut | None:
        """How the runs of a lane are read; None if it holds no bytes."""
        if key not in self._cuts:
            self._cuts[key] = self._alike.get(without_labels(key))
        return self._cuts[key]

    def stamp_of(self, line: bytes, found: Found) -> tuple[int, int, Fields, Stamp] | None:
        """Where the time of a run is in its line, and the time."""
        if self.times.where not in ("before", "after"):
            return None
        before = self.times.where == "before"
        span = (0, found.start) if before else (found.stop, len(line))
        place = self.times.find(line, *span)
        if place is None:
            return None
        begin, end, fields = place
        return begin, end, fields, self.times.stamp(line, fields, lambda a, b: int(line[a:b]))

    def heading_stamp(self, line: bytes) -> Stamp | None:
        """The time of the bytes below a heading."""
        if self.times.where != "above" or (place := self.times.find(line, 0, len(line))) is None:
            return None
        return self.times.stamp(line, place[2], lambda a, b: int(line[a:b]))

    def heading_label(self, line: bytes) -> str | None:
        """The label of the bytes below a heading."""
        return _label(self.labels, line) if self.labelled == "above" else None

    def label_of(self, line: bytes, found: Found) -> str | None:
        """The label of the stream that a run belongs to; None if only a heading has one."""
        if self.labels == "lane":
            return self._lanes.get(found.key, "")
        if self.labels == "none" or self.labelled == "above":
            return None
        before = self.labelled == "before"
        return _label(self.labels, line[: found.start] if before else line[found.stop :])

    def any_stamp(self, line: bytes) -> Stamp | None:
        """The time of a line of the sample."""
        found = self.runs(line)
        if not found:
            return self.heading_stamp(line)
        place = self.stamp_of(line, found[0])
        return None if place is None else place[3]

    def looks_like_bytes(self, line: bytes) -> bool:
        """Whether a line that is skipped has a run of several bytes in this form."""
        hidden = masked(line) if self.hypothesis.extractor.masks_times else line
        runs = self.hypothesis.extractor.runs(hidden)
        return any(len(run.data) >= _LIKE_BYTES for run in runs)

    def unread_words(self, line: bytes, found: Sequence[Found]) -> str:
        """The words of a line that are neither bytes nor a time nor a direction."""
        rest = bytearray(masked(line).replace(b"~", b" "))
        for run in found:
            rest[run.start : run.stop] = b" " * (run.stop - run.start)
        before = bytes(rest[: found[0].start])
        known = re.findall(r"\w+", without_labels(before))
        between = bytes(rest[found[0].stop : found[-1].stop]).decode("utf-8", "replace")
        return " ".join([*known, *re.findall(r"\w+", between)])

    @property
    def columnar(self) -> bool:
        """Whether many lines can be read at once."""
        return self.hypothesis.extractor.columnar

    def explain(self) -> list[str]:
        """The form, lanes, times and directions, one line each."""
        lanes = [
            f"lane {lane.key.decode('utf-8', 'replace')!r}: {len(lane.runs)} runs"
            + (f", without the first {lane.cut.first}" if lane.cut.first else "")
            + (f", without the last {lane.cut.last}" if lane.cut.last else "")
            for lane in self.hypothesis.lanes
        ]
        what = f"{self.times.kind} {self.times.where} the bytes"
        times = "none" if self.times.where == "none" else what
        streams = f"{', '.join(self.streams)}, by {self.labels} {self.labelled} the bytes"
        return [
            f'form "{self.hypothesis.extractor.name}"',
            *lanes,
            f"times: {times}",
            f"streams: {streams if self.streams else 'one'}",
            *(f"score {number}: {text}" for number, text in enumerate(self.explained, 1)),
        ]

    def separate_lanes(self, names: dict[bytes, str]) -> None:
        """Let each lane be a stream."""
        self._lanes = names


class _Sampled(NamedTuple):
    line: int
    text: Text
    found: Found


def _label(kind: str, text: bytes) -> str | None:
    label = label_of(text)
    if kind == "both":
        direction = label.word or label.arrow
        return f"{label.port}-{direction}" if label.port and direction else None
    return {"word": label.word, "arrow": label.arrow, "port": label.port}.get(kind)


def decide(lines: Sequence[bytes], form: str | None = None) -> Layout | None:
    """The layout of a log, by a sample of its lines; None if there are not enough frames.

    Args:
        lines: the sample, in the order of the log.
        form: the name of the extractor, if it is given.

    Raises:
        InputTextError: two hypotheses are as good, or there is no such form.
    """
    if form is not None and form not in BY_NAME:
        names = ", ".join(BY_NAME)
        raise InputTextError(f"--form: there is no form {form!r}; the forms are: {names}")
    ranked = hypotheses(lines, EXTRACTORS if form is None else (BY_NAME[form],))
    good = [one for one in ranked if one.accepted]
    if not good:
        return None
    best = good[0]
    for other in good[1:]:
        if other.score >= AS_GOOD * best.score and _differ(best, other):
            raise InputTextError(
                f"two readings are as good: {_named(best)} and {_named(other)};"
                f' choose one with --form "{best.extractor.name}"'
            )
    layout = Layout(best, explained=[str(one) for one in ranked[:3]])
    layout.notes = [
        f"{cut.first} numbers before and {cut.last} after the bytes of a line are no data"
        for cut in set(best.cuts.values())
        if cut != WHOLE
    ]
    _settle(layout, lines)
    return layout


def decide_paste(lines: Sequence[bytes]) -> Layout | None:
    """The layout of a paste without whole frames: the longest run of hex is taken for bytes."""
    found = [
        (len(run.data), -number, extractor, folded(masked(line)[: run.start]))
        for number, extractor in enumerate(EXTRACTORS[:_HEX_FORMS])
        for line in lines
        for run in extractor.runs(masked(line))
        if len(run.data) > 1
    ]
    if not found:
        return None
    _, _, extractor, key = max(found, key=lambda one: one[:2])
    layout = Layout(Hypothesis(extractor, [Lane(key)]))
    layout.notes = [f'no whole frame in it; what is read as "{extractor.name}" may be no bytes']
    _settle(layout, lines)
    return layout


def _settle(layout: Layout, lines: Sequence[bytes]) -> None:
    """Decide times and labels."""
    sampled = _sampled(layout, lines)
    layout.times = time_rule([one.text for one in sampled])
    layout.times.first_byte = layout.times.kind == "since" and all(
        len(one.found.data) == 1 for one in sampled
    )
    _decide_labels(layout, sampled)


def _differ(best: Hypothesis, other: Hypothesis) -> bool:
    """Whether frames of one are in no way those of the other."""
    missing = Counter(other.frames) - Counter(best.frames)
    return missing.total() > 0.1 * len(other.frames)


def _named(one: Hypothesis) -> str:
    return f'"{one.extractor.name}" (first frame {one.frames[0].hex(" ").upper()})'


def _sampled(layout: Layout, lines: Sequence[bytes]) -> list[_Sampled]:
    sampled, above, headings = [], b"", list[bytes]()
    for number, line in enumerate(lines):
        found = layout.runs(line)
        if not found and line.strip():
            above = line
            if len(headings) < _MOST_HEADINGS:
                headings.append(line)
        for run in found:
            text = Text(line, run.start, run.stop, above, tuple(headings))
            sampled.append(_Sampled(number, text, run))
    return sampled


def _decide_labels(layout: Layout, sampled: Sequence[_Sampled]) -> None:
    """Choose what separates streams: most frames, then a direction, a port, or lanes."""
    best = len(frames_in(b"".join(one.found.data for one in sampled)))
    for where in ("before", "above", "after"):
        for kind in ("both", "word", "arrow", "port"):
            labels = [_label(kind, _around(one.text, where)) for one in sampled]
            known = [label for label in labels if label is not None]
            if len(known) < _COVERED * len(labels) or len(set(known)) > _MOST_STREAMS:
                continue
            if kind == "both" and len({label.partition("-")[0] for label in known}) < 2:
                continue
            if kind == "port" and len(set(known)) < 2:
                continue
            if where == "above" and len({one.text.above for one in sampled}) < 2:
                continue
            if kind == "arrow" and where != "above" and len(set(known)) < 2:
                continue
            frames = _frames(sampled, labels)
            if frames >= best:
                layout.labels, layout.labelled = kind, where
                layout.streams = tuple(sorted(set(known)))
                return
    _try_lanes(layout, sampled, best)


def _around(text: Text, where: str) -> bytes:
    if where == "above":
        return text.above
    return text.line[: text.start] if where == "before" else text.line[text.stop :]


def _frames(sampled: Sequence[_Sampled], labels: Sequence[str | None]) -> int:
    streams: dict[str | None, list[bytes]] = {}
    for one, label in zip(sampled, labels, strict=True):
        streams.setdefault(label, []).append(one.found.data)
    return sum(len(frames_in(b"".join(pieces))) for pieces in streams.values())


def _try_lanes(layout: Layout, sampled: Sequence[_Sampled], best: int) -> None:
    """Let lanes be streams if no frame is lost and each has frames of one header."""
    keys = sorted({one.found.key for one in sampled})
    if not 2 <= len(keys) <= _MOST_STREAMS:
        return
    headers = []
    total = 0
    for key in keys:
        frames = frames_in(b"".join(one.found.data for one in sampled if one.found.key == key))
        total += len(frames)
        headers.append({frame[0] for frame in frames})
    pure = all(len(own) == 1 for own in headers) and len(set().union(*headers)) > 1
    if total < best or not (pure or total > best):
        return
    names = _names_of(keys, sampled[0].text.headings)
    layout.labels = "lane"
    layout.separate_lanes(names)
    layout.streams = tuple(sorted(set(names.values())))


def _names_of(keys: Sequence[bytes], headings: Sequence[bytes]) -> dict[bytes, str]:
    """A name for each lane: the heading of its column, or the words that no other lane has."""
    words = [re.findall(r"[^\W\d][\w/.-]*", key.decode("utf-8", "replace")) for key in keys]
    common = set(words[0]).intersection(*map(set, words[1:]))
    names = {}
    for number, (key, own) in enumerate(zip(keys, words, strict=True)):
        cells = next(
            (
                cells
                for cells in (heading.decode("utf-8", "replace").split(",") for heading in headings)
                if len(cells) > 1 and len(cells) > key.count(b",")
            ),
            [],
        )
        different = [word for word in own if word not in common]
        name = different[-1] if different else ""
        if not name and cells:
            name = cells[key.count(b",")].strip().strip('"')
        names[key] = name.lower() or str(number + 1)
    if len(set(names.values())) < len(names):
        names = {key: str(number + 1) for number, key in enumerate(keys)}
    return names


class PatternLayout(Layout):
    """A layout that a regular expression gives, with the groups `data`, `time` and `dir`."""

    pattern: re.Pattern[bytes]

    @classmethod
    def by_sample(
        cls, lines: Sequence[bytes], pattern: re.Pattern[bytes], form: str | None
    ) -> PatternLayout | None:
        """The layout, if a line of the sample matches."""
        contents = [found["data"] for line in lines if (found := pattern.search(line))]
        if not contents:
            return None
        ranked = hypotheses(contents, EXTRACTORS if form is None else (BY_NAME[form],))
        layout = cls(ranked[0] if ranked else Hypothesis(EXTRACTORS[0]))
        layout.pattern = pattern
        layout.labels = "word" if "dir" in pattern.groupindex else "none"
        if "time" in pattern.groupindex:
            layout.times = time_rule(
                [
                    Text(found["time"] + b" ", len(found["time"]), len(found["time"]), b"")
                    for line in lines
                    if (found := pattern.search(line))
                ]
            )
        directions = {layout.label_of(line, run) for line in lines for run in layout.runs(line)}
        layout.streams = tuple(sorted(label for label in directions if label))
        return layout

    def runs(self, line: bytes) -> list[Found]:
        """The bytes of the group `data`."""
        found = self.pattern.search(line)
        if found is None:
            return []
        data = b"".join(run.data for run in self.hypothesis.extractor.runs(found["data"]))
        return [Found(data, *found.span("data"), b"")] if data else []

    def stamp_of(self, line: bytes, found: Found) -> tuple[int, int, Fields, Stamp] | None:
        """The time in the group `time`."""
        match = self.pattern.search(line)
        if match is None or "time" not in match.groupdict() or match["time"] is None:
            return None
        place = self.times.find(line, *match.span("time"))
        if place is None:
            return None
        return *place, self.times.stamp(line, place[2], lambda a, b: int(line[a:b]))

    def label_of(self, line: bytes, found: Found) -> str | None:
        """The direction in the group `dir`, or its text."""
        match = self.pattern.search(line)
        if match is None or "dir" not in match.groupdict() or match["dir"] is None:
            return None
        label = label_of(match["dir"])
        return label.word or label.arrow or match["dir"].decode("utf-8", "replace").lower()

    @property
    def columnar(self) -> bool:
        """False: lines are matched one by one."""
        return False
