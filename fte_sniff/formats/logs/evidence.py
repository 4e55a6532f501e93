"""Evidence for where the bytes are in a text: frames of the protocol tell them from chance.

The lines of a sample are read with every extractor. Its runs whose lines look the same before the
run form a lane. Whole frames in the bytes of lanes give the score of an extractor.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Final, NamedTuple

from fte_sniff.formats.logs.chance import chance_level, frames_in
from fte_sniff.formats.logs.forms import Extractor, Run
from fte_sniff.formats.logs.labels import without_labels
from fte_sniff.formats.logs.times import masked
from fte_sniff.protocol.spec import FRAME_LENGTH

FRAME_SCORE: Final = 10.0
OUTSIDE_SCORE: Final = -0.05
LANE_SCORE: Final = -2.0
LEAST_SHARE: Final = 0.05
"""Of the bytes of the chosen lanes, how many are in frames."""
LEAST_SHARE_CUT: Final = 0.8
"""The same for a lane of whose runs numbers are left out."""
AS_GOOD: Final = 0.9
"""Two hypotheses whose scores differ less are ambiguous, if their frames differ."""

_MOST_LANES: Final = 48
_MOST_CUT: Final = 3


NUMBER_TOKEN: Final = re.compile(
    rb"(?<![A-Za-z])(?:0[xX])?[0-9A-Fa-f]*\d[0-9A-Fa-f]*(?:[.:\-][0-9A-Fa-f]*\d[0-9A-Fa-f]*)*"
    rb"|\b[0-9A-F]{2}\b|\b[0-9a-f]{2}\b"
)
_SPACES: Final = re.compile(rb"\s+")


@lru_cache(maxsize=8192)
def folded(text: bytes) -> bytes:
    """The text with each number as 0, and white space as one space."""
    return _SPACES.sub(b" ", NUMBER_TOKEN.sub(b"0", text)) if text.strip(b" ") else b""


class Cut(NamedTuple):
    """How many numbers of each run are no data: an offset before them, a count after them."""

    first: int = 0
    last: int = 0

    def of(self, run: Run) -> bytes:
        """The data of a run."""
        return run.data[self.first : len(run.data) - self.last]


WHOLE: Final = Cut()


@dataclass(slots=True)
class Lane:
    """Runs whose lines look the same before the run."""

    key: bytes
    runs: list[tuple[int, Run]] = field(default_factory=list)
    """Each with the index of its line."""
    cut: Cut = WHOLE

    def pieces(self) -> list[tuple[int, int, bytes]]:
        """Index of the line, offset in it, and bytes of each run."""
        return [(line, run.start, self.cut.of(run)) for line, run in self.runs]

    def data(self) -> bytes:
        """All bytes."""
        return b"".join(data for _, _, data in self.pieces())


@dataclass(slots=True)
class Hypothesis:
    """An extractor with the lanes that hold bytes."""

    extractor: Extractor
    lanes: list[Lane] = field(default_factory=list)
    frames: list[bytes] = field(default_factory=list)
    score: float = 0.0
    level: float = 0.0
    """Frames to be expected by chance."""
    size: int = 0

    @property
    def cuts(self) -> dict[bytes, Cut]:
        """By lane, the numbers that are no data."""
        return {lane.key: lane.cut for lane in self.lanes}

    @property
    def accepted(self) -> bool:
        """Whether there are more frames than by chance."""
        share = FRAME_LENGTH * len(self.frames) / max(self.size, 1)
        return bool(self.frames) and len(self.frames) >= 2 * self.level and share >= LEAST_SHARE

    def __str__(self) -> str:
        frames = "frame" if len(self.frames) == 1 else "frames"
        return (
            f'"{self.extractor.name}": {len(self.frames)} {frames} in {self.size:,} bytes of'
            f" {len(self.lanes)} lanes, score {self.score:.1f}"
        )


def hypotheses(lines: Sequence[bytes], extractors: Iterable[Extractor]) -> list[Hypothesis]:
    """What the extractors find in the lines, the best score first; only those with frames."""
    text = b"\n".join(lines)
    hidden = [masked(line) for line in lines]
    found = []
    for extractor in extractors:
        if re.search(extractor.needs, text) is None:
            continue
        hypothesis = _hypothesis(extractor, hidden if extractor.masks_times else lines)
        if hypothesis.frames:
            found.append(hypothesis)
    return sorted(found, key=lambda one: -one.score)


def _hypothesis(extractor: Extractor, lines: Sequence[bytes]) -> Hypothesis:
    lanes: dict[bytes, Lane] = {}
    for number, line in enumerate(lines):
        for run in extractor.runs(line):
            key = folded(line[: run.start])
            lanes.setdefault(key, Lane(key)).runs.append((number, run))
    for lane in lanes.values():
        if extractor.unit:
            lane.cut = _cut_of(lane)
    return _chosen(extractor, list(lanes.values()))


def _cut_of(lane: Lane) -> Cut:
    """The numbers of each run that are no data; none unless 80 % of the others are in frames."""
    least = min(len(run.data) for _, run in lane.runs)
    if least < 2 or len(lane.runs) < 2:
        return WHOLE
    whole = frames_in(lane.data())
    best, most = WHOLE, len(whole)
    size = sum(len(run.data) for _, run in lane.runs)
    outside = size - FRAME_LENGTH * most
    if outside < len(lane.runs) * 0.8:
        return WHOLE
    for first in range(_MOST_CUT + 1):
        for last in range(_MOST_CUT):
            if not 0 < first + last < least:
                continue
            cut = Cut(first, last)
            data = b"".join(cut.of(run) for _, run in lane.runs)
            frames = len(frames_in(data))
            if frames >= most + (
                best is not WHOLE
            ) and FRAME_LENGTH * frames >= LEAST_SHARE_CUT * len(data):
                best, most = cut, frames
    return best


def _score(data: bytes, lanes: int) -> float:
    inside = FRAME_LENGTH * len(frames_in(data))
    return (
        FRAME_SCORE * inside / FRAME_LENGTH
        + OUTSIDE_SCORE * (len(data) - inside)
        + LANE_SCORE * lanes
    )


def _chosen(extractor: Extractor, lanes: list[Lane]) -> Hypothesis:
    """Choose lanes greedily; a lane joins a stream if that makes frames whole."""
    ranked = sorted(lanes, key=lambda lane: -_score(lane.data(), 1))
    best = Hypothesis(extractor)
    streams: list[list[Lane]] = []
    for lane in ranked[:_MOST_LANES]:
        alone = _score(lane.data(), 1)
        gains = []
        for stream in streams:
            joined = _score(_joined([*stream, lane]), len(stream) + 1)
            gains.append(joined - _score(_joined(stream), len(stream)))
        gain = max(gains, default=0.0)
        if gain > max(alone, 0.0):
            streams[gains.index(gain)].append(lane)
        elif alone > 0:
            streams.append([lane])
    best.lanes = [lane for stream in streams for lane in stream]
    if not best.lanes:
        return best
    best.lanes += _like(best.lanes, lanes)
    contents = [_joined(stream) for stream in streams]
    best.frames = [frame for data in contents for frame in frames_in(data)]
    best.level = sum(map(chance_level, contents))
    best.size = sum(map(len, contents))
    best.score = (
        FRAME_SCORE * len(best.frames)
        + OUTSIDE_SCORE * (best.size - FRAME_LENGTH * len(best.frames))
        + LANE_SCORE * sum(map(len, streams))
    )
    return best


def _joined(lanes: Sequence[Lane]) -> bytes:
    pieces = sorted(piece for lane in lanes for piece in lane.pieces())
    return b"".join(data for _, _, data in pieces)


def _like(chosen: Sequence[Lane], lanes: Iterable[Lane]) -> list[Lane]:
    """The lanes that differ from a chosen one only by their label."""
    keys = {without_labels(lane.key): lane.cut for lane in chosen}
    found = []
    for lane in lanes:
        if lane not in chosen and without_labels(lane.key) in keys:
            lane.cut = keys[without_labels(lane.key)]
            found.append(lane)
    return found
