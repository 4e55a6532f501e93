"""Evidence for where the bytes are in a text: frames of the protocol distinguish them from chance.

The lines of a sample are read with every extractor. Its runs whose lines look the same before the
run form a lane. Whole frames in the bytes of lanes give the score of an extractor.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import cache, lru_cache
from itertools import combinations, product
from typing import Final

from fte_sniff.formats.logs.forms import Extractor, Run
from fte_sniff.formats.logs.times import masked
from fte_sniff.protocol.spec import FRAME_LENGTH, KINDS, TAIL, FrameKind

NUMBER_TOKEN: Final = (
    rb"(?<![A-Za-z])(?:0[xX])?[0-9A-Fa-f]*\d[0-9A-Fa-f]*(?:[.:\-][0-9A-Fa-f]*\d[0-9A-Fa-f]*)*"
    rb"|\b[0-9A-F]{2}\b|\b[0-9a-f]{2}\b"
)
_GOES_ON: Final = (
    rb"-[0-9A-Fa-f]{2}-|: ?[^\s.+\xe2]| [^\w\s.+]{0,2}[A-Za-z]{3}|[ ,;\t]+\d{3,}(?![\w.:-])"
)
"""After a run that is a part of something else: of words, or of numbers."""
_MORE: Final = (b" ", b":", b"-", b",", b";", b"\t")
_FRAME_SCORE: Final = 10.0
_OUTSIDE_SCORE: Final = -0.05
_LANE_SCORE: Final = -2.0
_CUT_SCORE: Final = -0.02
"""For each run of which numbers are left out: less than they would cost as bytes."""
_LEAST_SHARE: Final = 0.05
"""Of the bytes of the chosen lanes, how many are in frames."""
_LEAST_SHARE_CUT: Final = 0.8
"""The same for a lane of whose runs numbers are left out."""
_ALMOST_ALL: Final = 0.95
LIKE_BYTES: Final = 4
"""Bytes of a run from which on it is no number by accident."""
_LONGEST_KEY: Final = 100
"""Characters before a run that make its lane."""
_MOST_LANES: Final = 48
_COPIED: Final = 0.9
"""Share of the runs of a lane that repeat those of another from which on it is a copy."""
_MOST_HALVES: Final = 4
"""Lanes of which two may make frames only together, such as the halves of a dump."""
_CUTS: Final = [(first, last) for first, last in product(range(5), range(3)) if first + last]
"""Numbers of each run that are no data: offsets before the others, a count or sum after them."""
_WRONG_LENGTHS: Final = (7, 8, 9, 11, 12, 13)
_SENT: Final = (
    r"(?i:(?<![a-z])(?:tx\d?|txd|out(?:going|put)?|transmit(?:ted)?|wrote|request|host|master|pc|dte"
    r"|t(?=\s?:))(?![a-z])|(?<![a-z])(?:on|serial)?_?(?:send|sent|writ(?:e|es|ten|ing))(?![a-z]))"
    r"|[a-z](?:Send|Sent|Write)|发[送出]?|写入?"
)
_RECEIVED: Final = (
    r"(?i:(?<![a-z])(?:rx\d?|rxd|in(?:coming|put)?|reply|response|device|slave|mcu|controller|dce|r(?=\s?:))(?![a-z])"
    r"|(?<![a-z])(?:on|serial)?_?(?:recv|receiv(?:e|es|ed|ing)|reads?|reading)(?![a-z]))"
    r"|on(?:New)?Data|[a-z](?:Recv|Receiv|Read)|接?收到?|读取?"
)
_WORD: Final = rf"(?P<tx>{_SENT})|(?P<rx>{_RECEIVED})"
_ARROW: Final = r"(?P<tx>[→⇒►▶]|[=-]>|>+)|(?P<rx>[←⇐◄◀]|<[=-]|<+(?!\w))"
_PORT: Final = (
    r"(?<![A-Za-z])(?:/dev/)?((?i:com\d+|tty[a-z]*\d+|cu\.[\w-]+|us?art[-_ ]?\d+|serial\d+"
    r"|ch(?:annel)?[-_ ]?\d+|port[-_ ]?\d+|peer\d+))(?![A-Za-z0-9])"
)
_PATTERNS: Final = {"word": _WORD, "arrow": _ARROW, "port": _PORT}


def _start(kind: FrameKind) -> bytes:
    cmds = b"".join(b"\\x%02x" % cmd for cmd in kind.cmds)
    return b"\\x%02x[%b]%b" % (kind.header, cmds, rb"[\1-\4]" if kind.names_motor else b".")


@cache
def _pattern(length: int) -> re.Pattern[bytes]:
    starts = b"|".join(map(_start, KINDS))
    return re.compile(rb"(?s)(?:%b).{%d}\x%02x" % (starts, length - 4, TAIL))


def frames_in(data: bytes) -> list[bytes]:
    """The whole frames in these bytes, from left to right."""
    return _pattern(FRAME_LENGTH).findall(data)


def chance_level(data: bytes) -> float:
    """The mean number of patterns like frames, but of a wrong length."""
    found = [len(_pattern(length).findall(data)) for length in _WRONG_LENGTHS]
    return sum(found) / len(found)


@lru_cache(maxsize=4096)
def label_of(kind: str, text: bytes) -> str | None:
    """The label of a kind in a text.

    `word`, `arrow` and `port` are the last of their kind, `first word` is the first word, `both` a
    port with a direction, and `given` is all the text.
    """
    readable = text.decode("utf-8", "replace").strip(" \x01").lower()
    if kind == "given":
        return direction_of(text) or readable
    if kind == "both":
        port, direction = label_of("port", text), direction_of(text)
        return f"{port}-{direction}" if port and direction else None
    found = list(re.finditer(_PATTERNS[kind.split()[-1]], text.decode("utf-8", "replace")))
    label = found[0 if kind == "first word" else -1] if found else None
    return label and (label.lastgroup or label[1].lower())


def direction_of(text: bytes) -> str | None:
    """`tx` or `rx`, by a word or an arrow."""
    return label_of("word", text) or label_of("arrow", text)


@lru_cache(maxsize=4096)
def without_labels(text: bytes) -> str:
    """The text without directions and ports."""
    return re.sub(f"{_PORT}|{_SENT}|{_RECEIVED}|{_ARROW}", "", text.decode("utf-8", "replace"))


@lru_cache(maxsize=8192)
def folded(text: bytes) -> bytes:
    """The text with each number as 0, and white space as one space; a column is apart."""
    if b" " * 8 in text:
        text = re.sub(rb" {8,}", b" ~ ", text)
    text = re.sub(NUMBER_TOKEN, b"0", text)
    if not text.strip(b" "):
        return b""
    return re.sub(rb"\s+", b" ", text) if b"  " in text or b"\t" in text else text


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
        goes_on = after[:1] in _MORE and re.match(_GOES_ON, after)
        yield run, key + "…".encode() if goes_on else key
        if len(run.data) >= LIKE_BYTES:
            before, end = key + b"0", run.stop
        elif run.start - end > _LONGEST_KEY:
            before, end = key, run.start


class Lane:
    """Runs whose lines look the same before the run; or several such lanes that make frames."""

    def __init__(self, cuts: Mapping[bytes, slice], pieces: list[tuple[int, bytes]]) -> None:
        self.cuts = cuts
        """By the text before the runs, which numbers of a run are data."""
        self.pieces = pieces
        """The offset of each run in the sample, and its data."""
        self.data = b"".join(data for _, data in sorted(pieces))
        self.frames = frames_in(self.data)
        self.outside = len(self.data) - FRAME_LENGTH * len(self.frames)
        self.score = (
            _FRAME_SCORE * len(self.frames)
            + _OUTSIDE_SCORE * self.outside
            + _LANE_SCORE * len(cuts)
            + _CUT_SCORE * len(pieces) * any(cut != slice(None) for cut in cuts.values())
        )

    def joined(self, other: Lane) -> Lane:
        """Both."""
        return Lane({**self.cuts, **other.cuts}, self.pieces + other.pieces)

    def without_numbers(self) -> Lane:
        """The lane without numbers that are no data, if 80 % of the others are in frames."""
        sizes = sorted(len(data) for _, data in self.pieces)
        best, least = self, sizes[len(sizes) // 10]  # the last line may be shorter
        if len(self.pieces) < 2 or self.outside < 0.8 * len(self.pieces):
            return self
        for first, last in _CUTS:
            if first + last < least:
                cut = slice(first, -last or None)
                lane = Lane(
                    dict.fromkeys(self.cuts, cut), [(at, data[cut]) for at, data in self.pieces]
                )
                share = FRAME_LENGTH * len(lane.frames) / max(len(lane.data), 1)
                if share >= _LEAST_SHARE_CUT and lane.score > best.score:
                    best = lane
        return best


class Hypothesis:
    """An extractor with the lanes that hold bytes."""

    def __init__(self, extractor: Extractor, lanes: Sequence[Lane]) -> None:
        self.extractor, self.lanes = extractor, lanes
        self.frames = [frame for lane in lanes for frame in lane.frames]
        self.score = sum(lane.score for lane in lanes)
        self.size = sum(len(lane.data) for lane in lanes)
        self.share = FRAME_LENGTH * len(self.frames) / max(self.size, 1)
        """Of the bytes, how many are in frames."""
        self.cuts: dict[str, slice] = {}
        """By the text before the runs, without labels, which numbers of a run are data."""
        for lane in lanes:
            for key, cut in lane.cuts.items():
                self.cuts.setdefault(without_labels(key), cut)

    def cut_of(self, key: bytes) -> slice | None:
        """Which numbers of a run of this lane are data; None if it is another lane.

        A number that is left out is not in the run where it is too large for a byte.
        """
        words = without_labels(key)
        if words in self.cuts:
            return self.cuts[words]
        before, missing = words.removesuffix("…"), 0
        while (cut := self.cuts.get(before, self.cuts.get(before.strip()))) is None:
            shorter = re.sub(r"0[ ,;\t]+$", "", before)
            if shorter == before:
                return None
            before, missing = shorter, missing + 1
        first, last = (cut.start or 0) - missing, (cut.stop or 0) + words.endswith("…")
        return slice(first, last or None) if first >= 0 >= last else None

    @property
    def rank(self) -> tuple[int, bool]:
        """Whole frames, and whether there is almost nothing else."""
        return len(self.frames), self.share >= _ALMOST_ALL

    @property
    def accepted(self) -> bool:
        """Whether there are more frames than by chance."""
        level = sum(chance_level(lane.data) for lane in self.lanes)
        return len(self.frames) >= max(2 * level, 1) and self.share >= _LEAST_SHARE

    def __str__(self) -> str:
        frames = "frame" if len(self.frames) == 1 else "frames"
        return (
            f'"{self.extractor.name}": {len(self.frames)} {frames} in {self.size:,} bytes of'
            f" {sum(len(lane.cuts) for lane in self.lanes)} lanes, score {self.score:.1f}"
        )


class Sample:
    """Lines of a text, in which extractors find lanes."""

    def __init__(self, lines: Sequence[bytes]) -> None:
        self.lines = lines
        self._text = b"\n".join(lines)
        self._masked = b"\n".join(map(masked, lines))

    def hypotheses(self, extractors: Iterable[Extractor]) -> list[Hypothesis]:
        """What the extractors find, the best score first; only those with frames."""
        found = [Hypothesis(one, _chosen(one, self.lanes(one, TAIL))) for one in extractors]
        return sorted((one for one in found if one.frames), key=lambda one: -one.score)

    def longest(self, extractors: Iterable[Extractor]) -> list[Hypothesis]:
        """The lane with the most bytes, if it has more than one."""
        found = [Hypothesis(one, [lane]) for one in extractors for lane in self.lanes(one)]
        best = max(found, key=lambda one: one.size, default=None)
        return [best] if best and best.size > 1 else []

    def lanes(self, extractor: Extractor, needed: int | None = None) -> list[Lane]:
        """The runs of an extractor by what is before them; none if no byte is the needed one.

        A lane whose runs repeat those before them, such as a second key of JSON, is none.
        """
        text = self._masked if extractor.masks_times else self._text
        runs = list(extractor.runs(text)) if re.search(extractor.needs, text) else []
        if needed is not None and not any(needed in run.data for run in runs):
            return []
        lanes, same = dict[bytes, list[tuple[int, bytes]]](), Counter[tuple[bytes, bytes]]()
        last, last_key = Run(0, 0, b""), b""
        for run, key in runs_in_lanes(text, runs):
            lanes.setdefault(key, []).append((run.start, run.data))
            if last.data == run.data:
                same[last_key, key] += 1
            last, last_key = run, key
        copies = {
            key
            for (other, key), count in same.items()
            if count >= _COPIED * len(lanes[key])
            and len({data for _, data in lanes[key]}) > 3
            and other != key
            and _alike(other, key)
        }
        return [Lane({key: slice(None)}, own) for key, own in lanes.items() if key not in copies]


def _alike(one: bytes, other: bytes) -> bool:
    """Whether two lanes have the same direction and port, or none."""
    return all(label_of(kind, one) == label_of(kind, other) for kind in ("word", "arrow", "port"))


def _chosen(extractor: Extractor, lanes: Sequence[Lane]) -> list[Lane]:
    """The lanes with the best score; numbers are left out only if that is better for all."""
    choices = [_joined(lanes)]
    if not extractor.swaps:
        choices.append(_joined([lane.without_numbers() for lane in lanes]))
    return max(choices, key=lambda chosen: sum(lane.score for lane in chosen))


def _joined(lanes: Iterable[Lane]) -> list[Lane]:
    """Choose lanes greedily; a lane joins another if that makes frames whole."""
    most = sorted(lanes, key=lambda lane: (-len(lane.frames), -len(lane.data)))[:_MOST_LANES]
    poor = [lane for lane in most if 2 * lane.outside > len(lane.data)][:_MOST_HALVES]
    pairs = [(one.joined(two), one, two) for one, two in combinations(poor, 2)]
    both, *halves = max(pairs, key=lambda pair: pair[0].score, default=(Lane({}, []),))
    chosen = [both] * (both.score > sum(max(half.score, 0) for half in halves))
    most = [lane for lane in most if not chosen or lane not in halves]
    for lane in sorted(most, key=lambda one: -one.score):
        joined = [one.joined(lane) for one in chosen]
        gains = [new.score - old.score for new, old in zip(joined, chosen, strict=True)]
        best = max(gains, default=0.0)
        if best > max(lane.score, 0.0):
            chosen[gains.index(best)] = joined[gains.index(best)]
        elif lane.score > 0:
            chosen.append(lane)
    return chosen
