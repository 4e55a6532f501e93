"""Evidence for where the bytes are in a text: frames of the protocol distinguish them from chance.

The lines of a sample are read with every extractor. Its runs whose lines look the same before the
run form a lane. Whole frames in the bytes of lanes give the score of an extractor.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import cache, lru_cache
from itertools import product
from typing import Final

from fte_sniff.formats.logs.forms import Extractor, Run
from fte_sniff.formats.logs.times import masked
from fte_sniff.protocol.spec import FRAME_LENGTH, FTE_FORMAT, KINDS, TAIL

NUMBER_TOKEN: Final = (
    rb"(?<![A-Za-z])(?:0[xX])?[0-9A-Fa-f]*\d[0-9A-Fa-f]*(?:[.:\-][0-9A-Fa-f]*\d[0-9A-Fa-f]*)*"
    rb"|\b[0-9A-F]{2}\b|\b[0-9a-f]{2}\b"
)
_GOES_ON: Final = (
    rb"-[0-9A-Fa-f]{2}-|: ?[^\s.+\xe2]| [^\w\s.+]{0,2}[A-Za-z]{3}|[ ,;\t]+\d{3,}(?![\w.:-])"
)
"""After a run that is a part of something else: of words, or of numbers."""
_FRAME_SCORE: Final = 10.0
_OUTSIDE_SCORE: Final = -0.05
_LANE_SCORE: Final = -2.0
_LEAST_SHARE: Final = 0.05
_LEAST_SHARE_CUT: Final = 0.8
"""Of the bytes of lanes, how many are in frames; the same if numbers are left out."""
_ALMOST_ALL: Final = 0.95
LIKE_BYTES: Final = 4
"""Bytes of a run from which on it is no number by accident."""
_LONGEST_KEY: Final = 100
"""Characters before a run that make its lane."""
_MOST_LANES: Final = 48
_CUTS: Final = [slice(first, -last or None) for first, last in product(range(5), range(3))][1:]
"""Without offsets before the data of each run, and a count or sum after them."""
_SENT: Final = (
    r"(?i:(?<![a-z])(?:tx\d?|txd|out(?:going|put)?|transmit(?:ted)?|wrote|request|host|master|pc"
    r"|dte|t(?=\s?:)|(?:on|serial)?_?(?:send|sent|writ(?:e|es|ten|ing)))(?![a-z]))"
    r"|[a-z](?:Send|Sent|Write)|发[送出]?|写入?"
)
_RECEIVED: Final = (
    r"(?i:(?<![a-z])(?:rx\d?|rxd|in(?:coming|put)?|reply|response|device|slave|mcu|controller|dce"
    r"|r(?=\s?:)|(?:on|serial)?_?(?:recv|receiv(?:e|es|ed|ing)|reads?|reading))(?![a-z]))"
    r"|on(?:New)?Data|[a-z](?:Recv|Receiv|Read)|接?收到?|读取?"
)
_PATTERNS: Final = {
    "port": r"(?<![A-Za-z])(?:/dev/)?((?i:com\d+|tty[a-z]*\d+|cu\.[\w-]+|us?art[-_ ]?\d+"
    r"|serial\d+|ch(?:annel)?[-_ ]?\d+|port[-_ ]?\d+|peer\d+))(?![A-Za-z0-9])",
    "word": rf"(?P<tx>{_SENT})|(?P<rx>{_RECEIVED})",
    "arrow": r"(?P<tx>[→⇒►▶]|[=-]>|>+)|(?P<rx>[←⇐◄◀]|<[=-]|<+(?!\w))",
}
"""Of labels, by their kind."""


@cache
def _pattern(length: int) -> re.Pattern[bytes]:
    """Of frames, if they had this length."""
    starts = [
        b"".join(b"[%b]" % re.escape(one) if one else b"." for one in legal[:3])
        for legal in map(FTE_FORMAT.legal_bytes, KINDS)
    ]
    return re.compile(rb"(?s)(?:%b).{%d}\x%02x" % (b"|".join(starts), length - 4, TAIL))


def frames_in(data: bytes) -> list[bytes]:
    """The whole frames in these bytes, from left to right."""
    return _pattern(FRAME_LENGTH).findall(data)


def are_known(frames: Sequence[bytes], others: Sequence[bytes]) -> bool:
    """Whether almost all of these frames are among others."""
    return (Counter(frames) - Counter(others)).total() <= 0.1 * len(frames)


@lru_cache(maxsize=4096)
def label_of(kind: str, text: bytes) -> str | None:
    """The last `word`, `arrow` or `port` in a text, or the `first word`.

    `direction` is a word or an arrow, `both` a port with one, and `given` all the text.
    """
    readable = text.decode("utf-8", "replace")
    if kind == "given":
        return label_of("direction", text) or readable.strip(" \x01").lower()
    if kind == "both":
        port, direction = label_of("port", text), label_of("direction", text)
        return f"{port}-{direction}" if port and direction else None
    if kind == "direction":
        return label_of("word", text) or label_of("arrow", text)
    pattern = _PATTERNS[kind.removeprefix("first ")]
    found = [label.lastgroup or label[1].lower() for label in re.finditer(pattern, readable)]
    return found[0 if kind == "first word" else -1] if found else None


@lru_cache(maxsize=4096)
def without_labels(text: bytes) -> str:
    """The text without directions and ports."""
    readable = text.decode("utf-8", "replace")
    for pattern in _PATTERNS.values():
        readable = re.sub(pattern, "", readable)
    return readable


@lru_cache(maxsize=8192)
def folded(text: bytes) -> bytes:
    """The text with each number as 0, and white space as one space; a column is apart."""
    text = re.sub(NUMBER_TOKEN, b"0", re.sub(rb" {8,}", b" ~ ", text))
    return re.sub(rb"\s+", b" ", text) if text.strip(b" ") else b""


def runs_in_lanes(text: bytes, runs: Iterable[Run]) -> Iterator[tuple[Run, bytes]]:
    """Runs of a text with the keys of their lanes.

    The key is what is before a run in its line, with earlier runs as numbers, and whether words
    follow at once. In a line of many records, the end of that is the same for each of them.
    """
    before, end = b"", 0
    for run in runs:
        if line := text.rfind(b"\n", end, run.start) + 1:
            before, end = b"", line
        key, after = before + folded(text[end : run.start]), text[run.stop : run.stop + 8]
        key = key[-_LONGEST_KEY:]
        yield run, key + "…".encode() if re.match(_GOES_ON, after) else key
        if len(run.data) >= LIKE_BYTES:
            before, end = key + b"0", run.stop
        elif run.start - end > _LONGEST_KEY:
            before, end = key, run.start


class Lane:
    """Runs whose lines look the same before the run; or several such lanes that make frames."""

    def __init__(self, cuts: Mapping[bytes, slice], runs: list[tuple[int, bytes]]) -> None:
        self.cuts = cuts
        """By the text before the runs, which numbers of a run are data."""
        self.runs = runs
        """The offset of each run in the sample, and its data."""
        self.data = b"".join(data for _, data in sorted(runs))
        self.frames = frames_in(self.data)
        self.outside = len(self.data) - FRAME_LENGTH * len(self.frames)
        in_frames, outside = _FRAME_SCORE * len(self.frames), _OUTSIDE_SCORE * self.outside
        self.score = in_frames + outside + _LANE_SCORE * len(cuts)

    def cut(self) -> Lane:
        """The lane without numbers that are no data, if 80 % of the others are in frames."""
        found = [self]
        for cut in _CUTS if self.outside >= len(self.runs) > 1 else ():
            lane = Lane(dict.fromkeys(self.cuts, cut), [(at, data[cut]) for at, data in self.runs])
            found += [lane] * (FRAME_LENGTH * len(lane.frames) > _LEAST_SHARE_CUT * len(lane.data))
        return max(found, key=lambda lane: lane.score)

    @property
    def labels(self) -> set[str | None]:
        """What is before the runs."""
        return {label_of(kind, key) for kind in _PATTERNS for key in self.cuts}

    def repeats(self, other: Lane) -> bool:
        """Whether it has the frames of another of the same direction and port, as in JSON."""
        several = len(set(self.frames)) > 3
        return several and are_known(self.frames, other.frames) and self.labels == other.labels


class Hypothesis:
    """An extractor with the lanes that hold bytes."""

    def __init__(self, extractor: Extractor, lanes: Sequence[Lane]) -> None:
        self.extractor, self.lanes = extractor, lanes
        self.frames = [frame for lane in lanes for frame in lane.frames]
        self.score = sum(lane.score for lane in lanes)
        self.size = sum(len(lane.data) for lane in lanes)
        self.share = FRAME_LENGTH * len(self.frames) / max(self.size, 1)
        """Of the bytes, how many are in frames."""
        self.rank = len(self.frames), self.share >= _ALMOST_ALL
        """Whole frames, and whether there is almost nothing else."""
        self.cuts: dict[str, slice] = {}
        """By the text before the runs, without labels, which numbers of a run are data."""
        self._cuts = {key: cut for lane in lanes for key, cut in lane.cuts.items()}
        for key, cut in self._cuts.items():
            self.cuts.setdefault(without_labels(key), cut)

    def cut_of(self, key: bytes, size: int) -> slice | None:
        """Which numbers of a run of this lane and `size` are data; None if it is another lane.

        A number that is left out is not in the run where it is too large for a byte.
        """
        words = without_labels(key)
        if key in self._cuts or words in self.cuts or size < LIKE_BYTES:
            return self._cuts.get(key, self.cuts.get(words))
        before, missing = words.removesuffix("…"), 0
        while (cut := self.cuts.get(before, self.cuts.get(before.strip()))) is None:
            shorter = re.sub(r"0[ ,;\t]+$", "", before)
            if shorter == before:
                return None
            before, missing = shorter, missing + 1
        first, last = (cut.start or 0) - missing, (cut.stop or 0) + words.endswith("…")
        return slice(first, last or None) if first >= 0 >= last else None

    @property
    def accepted(self) -> bool:
        """Whether there are more frames than by chance."""
        patterns = [_pattern(length) for length in (7, 8, 9, 11, 12, 13)]
        wrong = sum(len(one.findall(lane.data)) for one in patterns for lane in self.lanes)
        enough = max(2 * wrong / len(patterns), 1)
        return len(self.frames) >= enough and self.share >= _LEAST_SHARE

    def __str__(self) -> str:
        found = f"frames: {len(self.frames)}, bytes: {self.size:,}, lanes: {len(self.cuts)}"
        return f'"{self.extractor.name}", {found}, score: {self.score:.1f}'


def hypotheses(
    lines: Sequence[bytes], extractors: Iterable[Extractor], needed: bytes = bytes([TAIL])
) -> list[Hypothesis]:
    """What extractors whose runs have the needed bytes find in lines, the best score first."""
    texts, found = (b"\n".join(lines), b"\n".join(map(masked, lines))), list[Hypothesis]()
    for one in extractors:
        text, lanes = texts[one.masks_times], dict[bytes, list[tuple[int, bytes]]]()
        runs = list(one.runs(text)) if re.search(one.needs, text) else []
        if any(needed in run.data for run in runs):
            for run, key in runs_in_lanes(text, runs):
                lanes.setdefault(key, []).append((run.start, run.data))
        whole = [Lane({key: slice(None)}, own) for key, own in lanes.items()]
        choices = [_chosen(whole), _chosen([lane.cut() for lane in whole])]
        found.append(max((Hypothesis(one, own) for own in choices), key=lambda own: own.score))
    return sorted(found, key=lambda one: -one.score)


def _chosen(lanes: Iterable[Lane]) -> list[Lane]:
    """Choose lanes greedily, each alone or joined with a chosen one, for the best score."""
    most = sorted(lanes, key=lambda lane: (-len(lane.frames), -len(lane.data)))[:_MOST_LANES]
    chosen = most[:1]
    for lane in most[1:]:
        if not any(lane.repeats(one) for one in chosen):
            both = (Lane({**own.cuts, **lane.cuts}, own.runs + lane.runs) for own in chosen)
            joined = ([*chosen[:at], one, *chosen[at + 1 :]] for at, one in enumerate(both))
            choices = [chosen, [*chosen, lane], *joined]
            chosen = max(choices, key=lambda choice: sum(one.score for one in choice))
    return chosen
