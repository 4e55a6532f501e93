"""The layout of a log, decided by a sample: where its lines have bytes, times and labels."""

from __future__ import annotations

import re
from collections.abc import Sequence
from itertools import product
from typing import Final, NamedTuple

from fte_sniff.formats.log_form import NO_TIME
from fte_sniff.formats.logs.evidence import (
    LIKE_BYTES,
    Hypothesis,
    frames_in,
    label_of,
    runs_in_lanes,
    without_labels,
)
from fte_sniff.formats.logs.times import Fields, Stamp, Text, masked, time_rule

_GAP: Final = rb"[\"'\]>)}]?[ ,]?(?:\.{3}(?!\.)|\xe2\x80\xa6|\+ ?\d+ more)"
_MOST_HEADINGS: Final = 8
_MOST_STREAMS: Final = 8
_LONGEST_ABOVE: Final = 1000
_COVERED: Final = 0.95
_LABELS: Final = ("both", "word", "first word", "arrow", "port")
_SEVERAL: Final = (*product(("before", "above", "after"), _LABELS), ("before", "lane"))
"""Where the labels that separate streams may be, and their kind."""
_LONE: Final = (*product(("before", "above", "after"), ("word",)), ("above", "arrow"))
"""The same of a label that is the only one; other lone labels are an accident."""


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
    label: str | None = None
    """Of its stream."""
    fields: Fields | None = None
    """Of its time."""
    stamp: Stamp = Stamp(NO_TIME)


class Layout:
    """How the lines of a log are read."""

    def __init__(self, hypothesis: Hypothesis, lines: Sequence[bytes], *, given: bool) -> None:
        """Decide times and labels by a sample; a regular expression may have `given` the labels."""
        self.hypothesis = hypothesis
        self.labels, self.labelled = "none", "none"
        """What separates the streams: a kind of label, or `lane`; `above`, `before` or `after`."""
        self.streams: tuple[str, ...] = ()
        """The labels in the sample."""
        self._names: dict[bytes, str] = {}
        """By lane, the label of its stream."""
        self.times = time_rule([])
        texts, runs = self._sampled(lines)
        self.times = time_rule(texts)
        bytewise = all(len(run.data) == 1 for run in runs)
        texts = [one._replace(line=masked(one.line), above=masked(one.above)) for one in texts]
        self.times.first_byte = self.times.kind == "since" and bytewise
        rules = [(2, *rule) for rule in _SEVERAL] + [(1, *rule) for rule in _LONE]
        for least, where, kind in [(1, "after", "given")] if given else rules:
            if self._separates(kind, where, texts, runs, least):
                break

    def read(self, line: bytes) -> tuple[list[Found], bool]:
        """The bytes of a line, or what a heading says; whether other runs look like bytes too."""
        hidden = masked(line) if self.hypothesis.extractor.masks_times else line
        found, others = list[Found](), False
        for run, key in runs_in_lanes(hidden, self.hypothesis.extractor.runs(hidden)):
            cut = self.hypothesis.cuts.get(without_labels(key))
            if cut is None:
                others |= len(run.data) >= LIKE_BYTES
                continue
            gap = re.match(_GAP, line[run.stop : run.stop + 32]) is not None
            one = Found(run.data[cut], run.start, run.stop, key, cut, gap)
            found.append(
                self._described(one, line, before=(0, run.start), after=(run.stop, len(line)))
            )
        if not found and "above" in (self.labelled, self.times.where):
            heading = self._described(Found(), line, above=(0, len(line)))
            found = [heading] * bool(heading.fields or heading.label)
        return found, others

    def _described(self, found: Found, line: bytes, **parts: tuple[int, int]) -> Found:
        """The bytes with the label and the time that are in these parts of the line."""
        label = self._names.get(found.key)
        if self.labelled in parts and not self._names:
            label = label_of(self.labels, line[slice(*parts[self.labelled])])
        found = found._replace(label=label)
        fields = None
        if self.times.where in parts:
            fields = self.times.find(line, *parts[self.times.where])
        stamp = self.times.stamp(line, fields) if fields else None
        return found._replace(fields=fields, stamp=stamp) if stamp else found

    def explain(self) -> list[str]:
        """The form, lanes, times and directions, one line each."""
        extractor, where = self.hypothesis.extractor, self.times.where
        streams = f"{', '.join(self.streams)}, by {self.labels} {self.labelled} the bytes"
        return [
            f'form "{extractor.name}", written by {extractor.tools}',
            *(f"lane {key!r}{left_out(cut)}" for key, cut in self.hypothesis.cuts.items()),
            f"times: {'none' if where == 'none' else f'{self.times.kind} {where} the bytes'}",
            f"streams: {streams if self.streams else 'one'}",
        ]

    def _sampled(self, lines: Sequence[bytes]) -> tuple[list[Text], list[Found]]:
        texts, runs, above, headings, below = list[Text](), list[Found](), b"", list[bytes](), True
        for line in lines:
            found, _ = self.read(line)
            if not found and line.strip():
                above = line if below else above[-_LONGEST_ABOVE:] + b"\n" + line
                headings = [*headings, line][:_MOST_HEADINGS]
            below = bool(found) or (below and not line.strip())
            runs += found
            texts += [Text(line, run.start, run.stop, above, tuple(headings)) for run in found]
        return texts, runs

    def _separates(
        self, kind: str, where: str, texts: Sequence[Text], runs: Sequence[Found], least: int
    ) -> bool:
        """Separate streams by labels, if almost all runs have one and no frame is lost."""
        labels: list[str | None] = [
            str(run.key) if kind == "lane" else label_of(kind, text.part(where))
            for text, run in zip(texts, runs, strict=True)
        ]
        if where == "above":  # of the last heading that has one
            for at in range(1, len(labels)):
                labels[at] = labels[at] or labels[at - 1]
        known = sorted({label for label in labels if label is not None})
        named = {label.rpartition("-")[0] for label in known} if kind == "both" else known
        if (
            not 0 < len(known) <= _MOST_STREAMS
            or labels.count(None) > (1 - _COVERED) * len(labels)
            or (where == "above" and len({text.above for text in texts}) < 2)
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
        pure = all(len(own) == 1 for own in headers) and len(set().union(*headers)) > 1
        if gain < 0 or (kind == "lane" and not (gain or pure)):
            return False
        if kind == "lane":
            self._names = _lane_names({run.key for run in runs}, texts[0].headings)
            known = sorted(self._names.values())
        self.labels, self.labelled, self.streams = kind, where, tuple(known)
        return True


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
