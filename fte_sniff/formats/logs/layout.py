"""The layout of a log, decided by a sample: where its lines have bytes, times and labels."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import replace
from itertools import pairwise, product
from typing import Final, NamedTuple

from fte_sniff.errors import InputTextError
from fte_sniff.formats.logs.chance import frames_in
from fte_sniff.formats.logs.evidence import Hypothesis, Sample, folded
from fte_sniff.formats.logs.forms import EXTRACTORS
from fte_sniff.formats.logs.labels import label_of, without_labels
from fte_sniff.formats.logs.times import Fields, Stamp, Text, masked, time_rule

_AS_GOOD: Final = 0.9
"""Two hypotheses whose scores differ less are ambiguous, if their frames differ."""
_GAP: Final = rb"[\"'\]>)}]?[ ,]?(?:\.{3}(?!\.)|\xe2\x80\xa6|\+ ?\d+ more)"
_MARK: Final = b"\x01"
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


class Layout:
    """How the lines of a log are read."""

    def __init__(
        self, hypothesis: Hypothesis, lines: Sequence[bytes], notes: list[str], *, given: bool
    ) -> None:
        """Decide times and labels.

        Args:
            hypothesis: where the bytes are.
            lines: the sample.
            notes: what is uncertain.
            given: whether a regular expression gives the labels.
        """
        self.hypothesis, self.notes = hypothesis, notes
        self.scores: list[str] = []
        """The hypotheses with the best scores."""
        self.labels, self.labelled = "none", "before"
        """What separates the streams: a kind of label, or `lane`; `above`, `before` or `after`."""
        self.streams: tuple[str, ...] = ()
        """The labels in the sample."""
        self._names: dict[bytes, str] = {}
        """By lane, the label of its stream."""
        texts, runs = self._sampled(lines)
        self.times = time_rule(texts)
        bytewise = all(len(run.data) == 1 for run in runs)
        self.times.first_byte = self.times.kind == "since" and bytewise
        kinds = product(("before", "above", "after"), ("both", "word", "arrow", "port"))
        for where, kind in [("after", "given")] if given else [*kinds, ("before", "lane")]:
            if self._separates(kind, where, texts, runs):
                break

    def runs(self, line: bytes) -> list[Found]:
        """The bytes of a line, by its lanes."""
        found = []
        hidden = self._hidden(line)
        for run in self.hypothesis.extractor.runs(hidden):
            key = folded(hidden[: run.start])
            cut = self.cut_of(key)
            if cut is not None:
                gap = re.match(_GAP, line[run.stop : run.stop + 32]) is not None
                found.append(Found(run.data[cut], run.start, run.stop, key, gap))
        return found

    def _hidden(self, line: bytes) -> bytes:
        return masked(line) if self.hypothesis.extractor.masks_times else line

    def cut_of(self, key: bytes) -> slice | None:
        """Which numbers of the runs of a lane are data; None if it holds no bytes."""
        return self.hypothesis.cuts.get(without_labels(key))

    def stamp_of(self, line: bytes, found: Found) -> tuple[int, int, Fields, Stamp] | None:
        """Where the time of a run is in its line, and the time."""
        spans = {"before": (0, found.start), "after": (found.stop, len(line))}
        span = spans.get(self.times.where)
        return self._stamp(line, *span) if span else None

    def _stamp(self, line: bytes, start: int, stop: int) -> tuple[int, int, Fields, Stamp] | None:
        place = self.times.find(line, start, stop)
        if place is None:
            return None
        return *place, self.times.stamp(line, place[2], lambda a, b: int(line[a:b]))

    def label_of(self, line: bytes, found: Found) -> str | None:
        """The label of the stream that a run belongs to; None if only a heading has one."""
        if self.labels == "lane":
            return self._names.get(found.key, "")
        if self.labels == "none" or self.labelled == "above":
            return None
        before = self.labelled == "before"
        return label_of(self.labels, line[: found.start] if before else line[found.stop :])

    def heading(self, line: bytes) -> tuple[Stamp | None, str | None]:
        """The time and the label that a line without bytes gives those below it."""
        stamp = self._stamp(line, 0, len(line)) if self.times.where == "above" else None
        label = label_of(self.labels, line) if self.labelled == "above" else None
        return stamp and stamp[3], label

    def any_stamp(self, line: bytes) -> Stamp | None:
        """The time of a line of the sample."""
        found = self.runs(line)
        stamp = self.stamp_of(line, found[0]) if found else None
        return stamp[3] if stamp else None if found else self.heading(line)[0]

    def looks_like_bytes(self, line: bytes) -> bool:
        """Whether a line that is skipped has a run of several bytes in this form."""
        runs = self.hypothesis.extractor.runs(self._hidden(line))
        return any(len(run.data) >= _LIKE_BYTES for run in runs)

    def unread_words(self, line: bytes, found: Sequence[Found]) -> str:
        """The words of a line that are neither bytes nor a time nor a direction."""
        hidden = masked(line).replace(b"~", b" ")
        gaps = b" ".join(hidden[one.stop : two.start] for one, two in pairwise(found))
        text = without_labels(hidden[: found[0].start]) + " " + gaps.decode("utf-8", "replace")
        return " ".join(re.findall(r"\w+", text))

    @property
    def columnar(self) -> bool:
        """Whether many lines can be read at once."""
        return self.hypothesis.extractor.columnar

    def explain(self) -> list[str]:
        """The form, lanes, times and directions, one line each."""
        extractor, where = self.hypothesis.extractor, self.times.where
        return [
            f'form "{extractor.name}", as of {extractor.tools}',
            *(
                f"lane {key.decode('utf-8', 'replace')!r}{_left_out(cut)}"
                for lane in self.hypothesis.lanes
                for key, cut in lane.cuts.items()
            ),
            f"times: {'none' if where == 'none' else f'{self.times.kind} {where} the bytes'}",
            f"streams: {', '.join(self.streams)}, by {self.labels} {self.labelled} the bytes"
            if self.streams
            else "streams: one",
            *self.scores,
        ]

    def _sampled(self, lines: Sequence[bytes]) -> tuple[list[Text], list[Found]]:
        texts, runs, above, headings = list[Text](), list[Found](), b"", list[bytes]()
        for line in lines:
            found = self.runs(line)
            if not found and line.strip():
                above = line
                headings = [*headings, line][:_MOST_HEADINGS]
            runs += found
            texts += [Text(line, run.start, run.stop, above, tuple(headings)) for run in found]
        return texts, runs

    def _separates(
        self, kind: str, where: str, texts: Sequence[Text], runs: Sequence[Found]
    ) -> bool:
        """Separate streams by labels, if almost all runs have one and no frame is lost."""
        labels = [
            str(run.key) if kind == "lane" else label_of(kind, _around(text, where))
            for text, run in zip(texts, runs, strict=True)
        ]
        known = sorted({label for label in labels if label is not None})
        named = {label.rpartition("-")[0] for label in known} if kind == "both" else known
        if (
            not 0 < len(known) <= _MOST_STREAMS
            or labels.count(None) > (1 - _COVERED) * len(labels)
            or (where == "above" and len({text.above for text in texts}) < 2)
            or (len(named) < 2 and where != "above" and kind not in ("word", "given"))
        ):
            return False
        frames = [frames_in(b"".join(of_label)) for of_label in _separated(labels, runs)]
        gain = sum(map(len, frames)) - len(frames_in(b"".join(run.data for run in runs)))
        headers = [{frame[0] for frame in own} for own in frames]
        pure = all(len(own) == 1 for own in headers) and len(set().union(*headers)) > 1
        if gain < 0 or (kind == "lane" and not (gain or pure)):
            return False
        if kind == "lane":
            self._names = _lane_names({run.key for run in runs}, texts[0].headings)
            known = sorted(self._names.values())
        self.labels, self.labelled, self.streams = kind, where, tuple(known)
        return True


def _separated(labels: Sequence[str | None], runs: Sequence[Found]) -> Iterable[list[bytes]]:
    """The data of each label."""
    found: dict[str | None, list[bytes]] = {}
    for label, run in zip(labels, runs, strict=True):
        found.setdefault(label, []).append(run.data)
    return found.values()


def _around(text: Text, where: str) -> bytes:
    if where == "above":
        return text.above
    return text.line[: text.start] if where == "before" else text.line[text.stop :]


def _lane_names(keys: set[bytes], headings: Sequence[bytes]) -> dict[bytes, str]:
    """A name for each lane: a word that no other lane has, or the heading of its column."""
    words = {key: re.findall(r"[^\W\d][\w/.-]*", key.decode("utf-8", "replace")) for key in keys}
    tables = (heading.decode("utf-8", "replace").split(",") for heading in headings)
    most = max(key.count(b",") for key in keys)
    cells = next((cells for cells in tables if len(cells) > max(1, most)), [""] * (most + 1))
    common = set.intersection(*map(set, words.values()))
    names = {
        key: next(
            (word for word in reversed(own) if word not in common),
            cells[key.count(b",")].strip(' "'),
        ).lower()
        for key, own in words.items()
    }
    if len(set(names.values()) - {""}) < len(keys):
        return {key: str(number) for number, key in enumerate(sorted(keys), 1)}
    return names


def marked(line: bytes, pattern: re.Pattern[bytes]) -> bytes:
    """The time, data and direction that a regular expression finds in a line; else the line."""
    found = pattern.search(line)
    if found is None:
        return line
    groups = found.groupdict()
    time, way = groups.get("time") or b"", groups.get("dir") or b""
    return b" ".join([time, _MARK, found["data"], _MARK, way])


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
        paste: whether the text is pasted, and need not have a whole frame.

    Raises:
        InputTextError: two hypotheses are as good, or there is no such form.
    """
    extractors = [one for one in EXTRACTORS if form in (None, one.name, one.name.partition(",")[0])]
    if not extractors:
        names = ", ".join(one.name for one in EXTRACTORS)
        raise InputTextError(f"--form: there is no form {form!r}; the forms are: {names}")
    if pattern is not None:
        lines = [marked(line, pattern) for line in lines if pattern.search(line)]
    sample, notes = Sample(lines), list[str]()
    ranked = sample.hypotheses(extractors)
    good = [one for one in ranked if one.accepted]
    _refuse_ambiguous(good)
    if not good and (paste or form or pattern):
        digits = [replace(one, masks_times=True) for one in extractors if form or one.columnar]
        good = ranked or sample.longest(digits)
        notes = [
            f'no whole frame in it; what is read as "{one.extractor.name}" may be no bytes'
            for one in good[:1]
        ]
    if not good:
        return None
    cuts = {_left_out(cut) for cut in good[0].cuts.values()} - {""}
    notes += [f"the bytes of a line are read{cut}, which are no data" for cut in sorted(cuts)]
    layout = Layout(good[0], lines, notes, given=bool(pattern and "dir" in pattern.groupindex))
    layout.scores = [f"score {number}: {one}" for number, one in enumerate(ranked[:3], 1)]
    return layout


def _left_out(cut: slice) -> str:
    if cut == slice(None):
        return ""
    return f" without the first {cut.start or 0} and the last {-(cut.stop or 0)}"


def _refuse_ambiguous(good: Sequence[Hypothesis]) -> None:
    for other in good[1:]:
        best = good[0]
        missing = Counter(other.frames) - Counter(best.frames)
        if other.score >= _AS_GOOD * best.score and missing.total() > 0.1 * len(other.frames):
            first = (
                f'"{one.extractor.name}" ({one.frames[0].hex(" ").upper()})'
                for one in (best, other)
            )
            raise InputTextError(
                f"two readings are as good, by their first frame: {' and '.join(first)};"
                f' choose one with --form "{best.extractor.name}"'
            )
