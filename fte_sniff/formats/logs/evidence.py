"""Evidence for where the bytes are in a text: frames of the protocol distinguish them from chance.

The lines of a sample are read with every extractor. Its runs whose lines look the same before the
run form a lane. Whole frames in the bytes of lanes give the score of an extractor.
"""

from __future__ import annotations

import re
from bisect import bisect_right
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from itertools import accumulate, product
from typing import Final

from fte_sniff.formats.logs.chance import chance_level, frames_in
from fte_sniff.formats.logs.forms import Extractor
from fte_sniff.formats.logs.labels import without_labels
from fte_sniff.formats.logs.times import masked
from fte_sniff.protocol.spec import FRAME_LENGTH, TAIL

LEAST_SHARE: Final = 0.05
"""Of the bytes of the chosen lanes, how many are in frames."""
LEAST_SHARE_CUT: Final = 0.8
"""The same for a lane of whose runs numbers are left out."""
NUMBER_TOKEN: Final = (
    rb"(?<![A-Za-z])(?:0[xX])?[0-9A-Fa-f]*\d[0-9A-Fa-f]*(?:[.:\-][0-9A-Fa-f]*\d[0-9A-Fa-f]*)*"
    rb"|\b[0-9A-F]{2}\b|\b[0-9a-f]{2}\b"
)
WHOLE: Final = slice(None)

_FRAME_SCORE: Final = 10.0
_OUTSIDE_SCORE: Final = -0.05
_LANE_SCORE: Final = -2.0
_MOST_LANES: Final = 48
_CUTS: Final = [
    slice(first, -last or None) for first, last in product(range(4), range(3)) if first + last
]
"""Numbers of each run that are no data: an offset before the others, a count after them."""


@lru_cache(maxsize=8192)
def folded(text: bytes) -> bytes:
    """The text with each number as 0, and white space as one space."""
    if not text.strip(b" "):
        return b""
    return re.sub(rb"\s+", b" ", re.sub(NUMBER_TOKEN, b"0", text))


@dataclass(slots=True, eq=False)
class Lane:
    """Runs whose lines look the same before the run."""

    key: bytes
    runs: list[tuple[int, bytes]] = field(default_factory=list)
    """The offset in the sample and the bytes of each."""
    cut: slice = field(default_factory=lambda: WHOLE)
    """Which numbers of each run are data."""

    def pieces(self) -> list[tuple[int, bytes]]:
        """The runs, with their data only."""
        return [(start, data[self.cut]) for start, data in self.runs]


def _joined(lanes: Iterable[Lane]) -> bytes:
    return b"".join(data for _, data in sorted(piece for lane in lanes for piece in lane.pieces()))


def _score(data: bytes, frames: int, lanes: int) -> float:
    outside = len(data) - FRAME_LENGTH * frames
    return _FRAME_SCORE * frames + _OUTSIDE_SCORE * outside + _LANE_SCORE * lanes


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
    def share(self) -> float:
        """Of the bytes, how many are in frames."""
        return FRAME_LENGTH * len(self.frames) / max(self.size, 1)

    @property
    def accepted(self) -> bool:
        """Whether there are more frames than by chance."""
        enough = len(self.frames) >= max(2 * self.level, 1)
        return enough and self.share >= LEAST_SHARE

    def __str__(self) -> str:
        frames = "frame" if len(self.frames) == 1 else "frames"
        return (
            f'"{self.extractor.name}": {len(self.frames)} {frames} in {self.size:,} bytes of'
            f" {len(self.lanes)} lanes, score {self.score:.1f}"
        )


class Sample:
    """Lines of a text, in which extractors find lanes."""

    def __init__(self, lines: Sequence[bytes]) -> None:
        self.lines = lines
        self._lines = b"\n".join(lines)
        self._masked = b"\n".join(map(masked, lines))
        self._starts = list(accumulate((len(line) + 1 for line in lines), initial=0))

    def hypotheses(self, extractors: Iterable[Extractor]) -> list[Hypothesis]:
        """What the extractors find, the best score first; only those with frames."""
        tail = bytes([TAIL])
        found = [_chosen(extractor, self.lanes(extractor, tail)) for extractor in extractors]
        return sorted((one for one in found if one.frames), key=lambda one: -one.score)

    def lanes(self, extractor: Extractor, needed: bytes = b"") -> list[Lane]:
        """The runs of an extractor by what is before them in their lines; none without a byte."""
        text = self._masked if extractor.masks_times else self._lines
        lanes: dict[bytes, Lane] = {}
        runs = list(extractor.runs(text)) if re.search(extractor.needs, text) else []
        if needed not in b"".join(run.data for run in runs):
            return []
        for run in runs:
            start = self._starts[bisect_right(self._starts, run.start) - 1]
            key = folded(text[start : run.start])
            lanes.setdefault(key, Lane(key)).runs.append((run.start, run.data))
        return list(lanes.values())


def _cut_of(lane: Lane) -> slice:
    """The numbers of each run that are data; all unless 80 % of the others are in frames."""
    data = _joined([lane])
    best, most = WHOLE, len(frames_in(data))
    least = min(len(data) for _, data in lane.runs)
    if len(lane.runs) < 2 or len(data) - FRAME_LENGTH * most < 0.8 * len(lane.runs):
        return best
    for cut in _CUTS:
        if len(bytes(least)[cut]) == 0:
            continue
        data = b"".join(data[cut] for _, data in lane.runs)
        frames = len(frames_in(data))
        more = frames > most or (frames == most and best is WHOLE)
        if more and FRAME_LENGTH * frames >= LEAST_SHARE_CUT * len(data):
            best, most = cut, frames
    return best


@dataclass(slots=True)
class _Stream:
    """Lanes whose bytes, in their order, make frames."""

    lanes: list[Lane]
    data: bytes = b""
    frames: int = 0
    score: float = 0.0

    def __post_init__(self) -> None:
        self.data = _joined(self.lanes)
        self.frames = len(frames_in(self.data))
        self.score = _score(self.data, self.frames, len(self.lanes))


def _chosen(extractor: Extractor, lanes: Sequence[Lane]) -> Hypothesis:
    """Choose lanes greedily; a lane joins a stream if that makes frames whole."""
    if extractor.size == 1:
        for lane in lanes:
            lane.cut = _cut_of(lane)
    streams: list[_Stream] = []
    alone = sorted((_Stream([lane]) for lane in lanes), key=lambda one: -one.score)
    for one in alone[:_MOST_LANES]:
        joined = [_Stream([*stream.lanes, *one.lanes]) for stream in streams]
        gains = [new.score - old.score for new, old in zip(joined, streams, strict=True)]
        best = max(gains, default=0.0)
        if best > max(one.score, 0.0):
            streams[gains.index(best)] = joined[gains.index(best)]
        elif one.score > 0:
            streams.append(one)
    chosen = Hypothesis(extractor, [lane for stream in streams for lane in stream.lanes])
    chosen.lanes += alike(chosen.lanes, lanes)
    for stream in streams:
        chosen.frames += frames_in(stream.data)
        chosen.level += chance_level(stream.data)
        chosen.size += len(stream.data)
        chosen.score += stream.score
    return chosen


def alike(chosen: Sequence[Lane], lanes: Iterable[Lane]) -> list[Lane]:
    """The lanes that differ from a chosen one only by their label."""
    cuts = {without_labels(lane.key): lane.cut for lane in chosen}
    found = [lane for lane in lanes if lane not in chosen and without_labels(lane.key) in cuts]
    for lane in found:
        lane.cut = cuts[without_labels(lane.key)]
    return found
