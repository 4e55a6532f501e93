"""Lines that look the same: one of them is parsed, and shows where the others have their bytes.

A shape is a line with the places of its bytes, its time and other numbers; a regular expression
made of it reads the others. Words such as names may differ too, if they tell nothing of the bytes.
"""

from __future__ import annotations

import re
from bisect import bisect
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from itertools import accumulate, compress, pairwise
from operator import add
from typing import Any, Final, NamedTuple

import numpy as np

from fte_sniff.formats.logs.evidence import (
    GOES_ON,
    LIKE_BYTES,
    NUMBER_TOKEN,
    folded,
    label_of,
    runs_in_lanes,
)
from fte_sniff.formats.logs.layout import GAP, Found, Layout, without_bytes
from fte_sniff.formats.logs.text import NO_TIME
from fte_sniff.formats.logs.times import OF_CLOCK, Fields, beside_times, masked

_MOST_SHAPES: Final = 24
_LONGEST_SHAPE: Final = 4096
_MOST_KNOWN: Final = 1 << 16
"""Texts beside bytes whose check is kept."""
_LONGEST_NAMED: Final = 100
"""Characters before bytes in which names may differ."""
_NEXT_DIGIT: Final = bytes.maketrans(b"0123456789", b"1234567890")


class _Shape(NamedTuple):
    """A line, and where others of its shape may differ from it."""

    line: bytes
    found: list[Found]
    numbers: set[int]
    """Offsets of the digits of numbers that are neither bytes nor time, if they may differ."""

    @property
    def label(self) -> str | None:
        return self.found[0].label

    @property
    def fields(self) -> Fields:
        """Of its time."""
        return self.found[0].fields or {}


class Alike(NamedTuple):
    """Lines that have a shape."""

    rows: Any
    """Their indices in the text, int64."""
    data: bytes
    """Of all of them, in their order."""
    sizes: Any
    """How many bytes are of each, an int64 column, or one for all."""
    label: str | None
    stamps: Any
    """Their times, an int64 column, or one for all."""

    def is_sound(self, layout: Layout, line_of: Callable[[int], bytes]) -> bool:
        """Whether the first of the lines, one in the middle, and the last are read so alone.

        `line_of` returns the line with an index in the text.
        """
        count = len(self.rows)
        sizes, stamps = (np.broadcast_to(own, count) for own in (self.sizes, self.stamps))
        for at in (0, count // 2, count - 1):
            found, other = layout.read(line_of(self.rows[at]))
            if other or not found or any(one.gap for one in found):
                return False
            start = int(sizes[:at].sum())
            read = self.label, int(stamps[at]), self.data[start : start + int(sizes[at])]
            data = b"".join(one.data for one in found)
            if read != (found[0].label, found[0].stamp, data):
                return False
        return True


def _shape_of(line: bytes, layout: Layout) -> _Shape | None:
    """The shape of a line; None if lines like it must be parsed one by one."""
    found, another = layout.read(line)
    if another or not found or any(one.gap for one in found):
        return None
    if any((one.label, one.fields) != (found[0].label, found[0].fields) for one in found):
        return None
    untimed = found[0].fields is None and layout.times.where in ("before", "after")
    if untimed:
        return None
    fields = found[0].fields or {}
    tokens = NUMBER_TOKEN.finditer(without_bytes(line, found))
    numbers = {at for token in tokens for at in range(*token.span())}
    numbers -= {at for span in fields.values() for at in range(*span)}
    numbers = {at for at in numbers if re.match(rb"\d(?![xX])", line[at : at + 2])}
    other = bytearray(line)
    for at in numbers:
        other[at] = _NEXT_DIGIT[line[at]]
    if layout.read(bytes(other)) != (found, b""):
        numbers = set()  # they are labels
    return _Shape(line, found, numbers)


class _Bytes(NamedTuple):
    """A run of bytes in the lines of a shape."""

    group: int
    """Of the regular expression, from 0; so are those below."""
    is_short: bool
    """Whether it is a number by accident, if it is in no lane."""
    cut: slice


class _Pattern(NamedTuple):
    """A regular expression for lines of a shape."""

    find: Callable[[bytes], list[tuple[bytes, ...]]]
    """Of each line of a text, the groups; they are empty if the line has another shape."""
    runs: list[_Bytes]
    names: dict[int, int | None]
    """The groups of words that may differ, with what they have in common."""
    tails: dict[int, Tail]
    """The group of the text after the bytes, and what it is like."""
    clock: dict[tuple[int, int], int]
    """The groups of the numbers of the time, by where they are in the line."""


Tail = tuple[bool, bool, bytes | None]
"""Whether words follow the bytes at once, whether bytes are left out, and other numbers."""


class _Checked(dict[bytes, Any]):
    """What texts beside bytes are like, of as many as memory should hold."""

    def __init__(self, check: Callable[[bytes], Any]) -> None:
        super().__init__()
        self._check = check

    def __missing__(self, text: bytes) -> Any:
        if len(self) >= _MOST_KNOWN:
            self.clear()
        return self.setdefault(text, self._check(text))

    def unlike(self, texts: Iterable[bytes], like: Any) -> set[bytes]:
        """Those of the texts that are like something else."""
        return {text for text in {*texts} if self[text] != like}


def _column(columns: Sequence[Sequence[bytes]], pattern: _Pattern, start: int, stop: int) -> Any:
    """The numbers of the time that are between two offsets in the line of a pattern."""
    return np.array([*map(int, columns[pattern.clock[start, stop]])], np.int64)


class _Names(_Checked):
    """The words before bytes that tell nothing of them, and may differ.

    Each has how many numbers are in it; None of a word that makes a lane, a direction or bytes.
    """

    def __init__(self, layout: Layout) -> None:
        super().__init__(self._numbers_in)
        self._common = layout.hypothesis.common
        self._run = re.compile(layout.hypothesis.extractor.pattern)

    def places(self, shape: _Shape) -> list[tuple[int, int]]:
        """Where such words are in a line of a shape."""
        ends = (one.start for one in shape.found if one.stop)
        text, times = shape.line[: next(ends, 0)], shape.fields.values()
        if self._common is None or len(text) > _LONGEST_NAMED:
            return []
        words = (word.span() for word in re.finditer(rb"\S+", text))
        return [
            (start, stop)
            for start, stop in words
            if all(stop <= begin or end <= start for begin, end in times)
            and self[text[start:stop]] is not None
        ]

    def _numbers_in(self, word: bytes) -> int | None:
        key = folded(word)
        labels = (label_of(kind, word) for kind in ("word", "arrow", "port"))
        matters = key in (self._common or ()) or self._run.search(word) or any(labels)
        return None if matters or word.split() != [word] else key.count(b"0")


class Shapes:
    """The shapes of the lines of a log with a layout."""

    def __init__(self, layout: Layout) -> None:
        self._layout, self._extractor = layout, layout.hypothesis.extractor
        self._common, self._names = layout.hypothesis.common, _Names(layout)
        self._run = re.compile(self._extractor.pattern)
        self._beside_times = beside_times(self._extractor.pattern)
        above = {"above", "below"} & {layout.labelled, layout.times.where}
        self._has_headings = bool(above)
        self._is_tail_free = "after" not in (layout.labelled, layout.times.where)
        self._tails = _Checked(self._tail_of)

    def alike_lines(self, lines: Sequence[bytes]) -> Iterator[Alike]:
        """The lines of a text that have the shape of another line, shape by shape.

        Lines that hold no bytes come with a size of 0, unless they are headings.
        """
        left = [at for at, line in enumerate(lines) if 0 < len(line) <= _LONGEST_SHAPE]
        foreign = list[int]()
        for _ in range(_MOST_SHAPES):
            first = self._first_with_bytes(lines, left)
            foreign += left[:first]
            left = left[first:]
            if not left:
                break
            shape = _shape_of(lines[left[0]], self._layout)
            own = shape and self._alike(shape, lines, left)
            if own:
                which, alike = own
                yield alike
                left = [one for one, is_own in zip(left, which, strict=True) if not is_own]
            else:
                del left[0]
        foreign += compress(left, self._are_foreign([lines[at] for at in left]))
        if foreign:
            yield Alike(np.array(sorted(foreign), np.int64), b"", 0, None, NO_TIME)

    def _first_with_bytes(self, lines: Sequence[bytes], left: Sequence[int]) -> int:
        """How many of the lines that are left come before the first that is not foreign."""
        at, size = 0, 1
        while at < len(left):
            are_foreign = self._are_foreign([lines[one] for one in left[at : at + size]])
            if not all(are_foreign):
                return at + are_foreign.index(False)
            at, size = at + size, 2 * size
        return len(left)

    def _are_foreign(self, lines: Sequence[bytes]) -> list[bool]:
        """Which lines have nothing that is read."""
        if self._has_headings:
            return [False] * len(lines)
        # After a line with `*`, a dump leaves out lines like that before.
        are_foreign = [line.strip() != b"*" for line in lines]
        extractor, hypothesis = self._extractor, self._layout.hypothesis
        ends = [*accumulate(len(line) + 1 for line in lines)]
        text = b"\n".join(lines)
        places: Sequence[int] = range(len(lines))
        if extractor.masks_times:  # most lines have no numbers beside their time
            found = self._beside_times.finditer(text)
            places = [bisect(ends, one.start()) for one in found]
            lines = [lines[at] for at in places]
            ends = [*accumulate(len(line) + 1 for line in lines)]
            text = masked(b"\n".join(lines))
        for run, key in runs_in_lanes(text, extractor.runs(text), self._common):
            size = len(run.data)
            if size >= LIKE_BYTES or hypothesis.cut_of(key, size) is not None:
                are_foreign[places[bisect(ends, run.start)]] = False
        return are_foreign

    def _alike(
        self, shape: _Shape, lines: Sequence[bytes], left: Sequence[int]
    ) -> tuple[list[bool], Alike] | None:
        """Which of the lines that are left have a shape, and what they hold."""
        pattern = self._pattern_of(shape)
        found = pattern.find(b"\n".join([*(lines[at] for at in left), b""]))
        which = [one[-1] != b"" for one in found]
        if sum(which) < 2:
            return None
        columns: list[Sequence[bytes]] = [*zip(*compress(found, which), strict=True)]
        rows = [at for at, is_own in zip(left, which, strict=True) if is_own]
        data, fits = self._data_of(pattern, columns, len(rows))
        if self._extractor.swaps:  # the last word before another line may be half empty
            fits = [
                own and next_ == at + 1
                for own, (at, next_) in zip(fits, pairwise([*rows, -1]), strict=True)
            ]
        if not all(fits):
            rows, data = [*compress(rows, fits)], [*compress(data, fits)]
            columns = [[*compress(column, fits)] for column in columns]
            every = iter(fits)
            which = [is_own and next(every) for is_own in which]
        if len(rows) < 2:
            return None
        stamps: Any = NO_TIME
        if shape.fields:
            read = partial(_column, columns, pattern)
            stamps = self._layout.times.stamp(shape.line, shape.fields, read)
        if stamps is None:
            return None
        sizes = np.array([*map(len, data)], np.int64)
        indices = np.array(rows, np.int64)
        alike = Alike(indices, b"".join(data), sizes, shape.label, stamps)
        return (which, alike) if alike.is_sound(self._layout, lines.__getitem__) else None

    def _data_of(
        self, pattern: _Pattern, columns: Sequence[Sequence[bytes]], count: int
    ) -> tuple[list[bytes], list[bool]]:
        """The bytes of lines that match a pattern, and which need not be parsed."""
        data, fits = [b""] * count, [True] * count
        alike: list[tuple[int, _Checked, Any]] = [
            (at, self._tails, tail) for at, tail in pattern.tails.items()
        ]
        alike += [(at, self._names, common) for at, common in pattern.names.items()]
        for at, checked, like in alike:
            if others := checked.unlike(columns[at], like):
                fits = [
                    own and text not in others for own, text in zip(fits, columns[at], strict=True)
                ]
        for group, is_short, cut in pattern.runs:
            run = [*map(self._extractor.bytes_of, columns[group])]
            fits = [
                own and (len(one) < LIKE_BYTES) == is_short and one != b""
                for own, one in zip(fits, run, strict=True)
            ]
            run = run if cut == slice(None) else [one[cut] for one in run]
            data = run if len(pattern.runs) == 1 else [*map(add, data, run)]
        return data, fits

    def _pattern_of(self, shape: _Shape) -> _Pattern:
        """The regular expression of a shape."""
        line, fields = shape.line, shape.fields
        runs = [one for one in shape.found if one.stop]
        names = self._names.places(shape)
        end = runs[-1].stop if runs and self._is_tail_free else len(line)
        clock = {fields[name]: name for name in fields.keys() & OF_CLOCK}
        groups = {one.start: (one.stop, b"(%b)" % self._extractor.pattern) for one in runs}
        for (start, stop), name in clock.items():
            groups[start] = stop, b"([0-9]+)" if name == "n" else b"([0-9]{%d})" % (stop - start)
        groups |= {start: (stop, rb"(\S+)") for start, stop in names}
        if runs and self._is_tail_free:
            groups[end] = len(line), b"(.*)"
        parts, at = list[bytes](), 0
        for start, (stop, pattern) in sorted(groups.items()):
            parts += [self._literal(shape, at, start), pattern]
            at = stop
        parts.append(self._literal(shape, at, len(line)))
        order = {start: group for group, start in enumerate(sorted(groups))}
        return _Pattern(
            re.compile(rb"%b(\n)|.*\n" % b"".join(parts)).findall,
            [self._run_in(one, line, order[one.start]) for one in runs],
            {order[start]: self._names[line[start:stop]] for start, stop in names},
            {order[end]: self._tails[line[end:]]} if runs and self._is_tail_free else {},
            {span: order[span[0]] for span in clock},
        )

    def _run_in(self, found: Found, line: bytes, group: int) -> _Bytes:
        size = len(self._extractor.bytes_of(line[found.start : found.stop]))
        return _Bytes(group, size < LIKE_BYTES, found.cut)

    @staticmethod
    def _literal(shape: _Shape, start: int, stop: int) -> bytes:
        """A part of a line, in which some numbers may differ."""
        parts, was = list[bytes](), False
        for at in range(start, stop):
            is_number = at in shape.numbers
            if not is_number:
                parts.append(re.escape(shape.line[at : at + 1]))
            elif not was:
                parts.append(b"[0-9]+")
            was = is_number
        return b"".join(parts)

    def _tail_of(self, text: bytes) -> Tail:
        """What the text after bytes is like."""
        has_numbers = self._run.search(b"0" + text, 1)
        numbers = re.sub(rb"\d+", b"0", text) if has_numbers else None
        goes_on = GOES_ON.match(text[:8]) is not None
        return goes_on, GAP.match(text[:32]) is not None, numbers
