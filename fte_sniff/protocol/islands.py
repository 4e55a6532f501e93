"""Islands and gaps: which bytes are certain frames, and which are divided.

A frame is strict if each of its bytes is legal. Two strict frames in step are an island: neither
chance nor damage makes one. The frames of an island are certain as long as another strict frame
follows in step. What is between two islands is a gap, which `gap.divide` divides:

    island                  gap                            island
    frame frame frame frame | frame damage noise frame | frame frame frame ...

A gap ends at the next island if its first frame is certain in that division, too. Where that is
not so, or no island is near, the bytes are divided in windows of fixed places in the stream, each
with a margin on both sides, until one of them contains a certain island:

            margin |      core      | margin
                            margin  |      core      | margin

Silence is a wall, which no frame crosses; only the start of a frame may go on behind a soft one.
So every decision depends on the bytes and on silence, never on how the bytes were cut into chunks.

All gaps that can be foreseen are divided at once: the walk assumes that gaps end where the next
island begins, and walks again from the first one that does not.
"""

from __future__ import annotations

from array import array
from bisect import bisect_left
from typing import Final, NamedTuple, TypeAlias

import numpy as np

from fte_sniff.protocol.gap import IS_HEADER, LEGAL, LONGEST, Divided, Gaps, divide
from fte_sniff.protocol.rows import NO_KIND, Array, Codes, Ints, kind_of
from fte_sniff.protocol.spec import CMD_OFFSET, FRAME_LENGTH, TAIL

CERTAIN: Final = 0.9995
"""A frame in a gap that is less probable is `ambiguous`."""
NEAR: Final = 64
"""An island that begins this many bytes behind the start of a gap ends it; a farther one does not
by itself."""
CORE: Final = 64
"""Bytes of a window whose segments are taken."""
MARGIN: Final = 2 * LONGEST
"""Bytes on each side of it that are divided with it."""
_ISLAND: Final = 2 * FRAME_LENGTH
_OUT_OF_STEP: Final = np.setdiff1d(np.arange(1, _ISLAND), FRAME_LENGTH)
_FAR: Final = 2**62

_LIMITED: Final = [
    (offset, LEGAL[:, offset].reshape(-1))
    for offset in range(CMD_OFFSET + 1, FRAME_LENGTH - 1)
    if not LEGAL[:, offset].all()
]
"""The offsets of a frame with illegal bytes, and by kind * 256 + byte whether it is legal."""


def strict_frames(data: Codes) -> Ints:
    """The offsets at which a complete frame begins that is legal at every byte."""
    if len(data) < FRAME_LENGTH:
        return np.empty(0, np.int64)
    found: Ints = np.flatnonzero(data[FRAME_LENGTH - 1 :] == TAIL)
    kinds = kind_of(data.take(found), data.take(found + CMD_OFFSET))
    is_strict = kinds != NO_KIND
    found, kinds = found[is_strict], kinds[is_strict].astype(np.uint16) << np.uint16(8)
    is_strict = np.ones(len(found), np.bool_)
    for offset, legal in _LIMITED:
        is_strict &= legal.take(kinds | data.take(found + offset))
    strict: Ints = found.compress(is_strict)
    return strict


def is_start(raw: bytes) -> bool:
    """Whether these bytes, fewer than a frame has, can be the first ones of a strict frame."""
    own = np.frombuffer(raw, np.uint8)
    return bool(LEGAL[:, np.arange(len(own)), own].all(axis=1).any())


class Wall(NamedTuple):
    """A place where silence was."""

    at: int
    is_soft: bool
    """Whether a frame that has begun may go on."""


_NO_WALL: Final = Wall(_FAR, is_soft=False)


class State(NamedTuple):
    """How far a stream is decided."""

    at: int
    """Offset up to which all is decided."""
    wall: int
    """Offset of the last wall: what is before it has no influence."""
    number: int = 0
    """Of the next wall."""
    in_window: bool = False
    """Whether the bytes are divided in windows."""


_Part: TypeAlias = tuple[int, int, int] | None
"""Division of a division: the number of its round, the first and the last segment."""


class _Step(NamedTuple):
    """A decision: the state after it, and what it found."""

    state: State
    part: _Part = None
    run: tuple[int, int, int, int] | None = None
    """Start and stop of frames in step, the wall before them, and where their bytes end."""


class Division(NamedTuple):
    """Division that are not noise, and where noise ends, in columns, in the order of the stream."""

    start: Ints
    stop: Ints
    """Equal to `start` for a place where noise ends and no segment is."""
    probability: Array
    """Of a whole frame; 0 for all other segments, and for a frame with another reading."""


class _Key(NamedTuple):
    start: int
    stop: int
    is_open_before: bool
    is_open_after: bool


class _Round(NamedTuple):
    """Gaps that were divided together: the segments of gap n are those from bound n to n + 1."""

    found: Divided
    bounds: list[int]
    starts: list[int]
    stops: list[int]
    probabilities: list[float]


class Walk:
    """Decides the bytes of a buffer, from a state on."""

    def __init__(self, data: bytes, base: int, state: State, walls: list[Wall]) -> None:
        """Offsets in `state` and `walls` are in the data; `base` is that of its first byte."""
        self.data, self.state, self.walls = data, state, walls
        self._first_wall = state.wall
        self._bytes = np.frombuffer(data, np.uint8)
        self._phase = base % CORE
        strict = strict_frames(self._bytes)
        self._run_ends = _run_ends(strict)
        self._strict = _numbers(strict)
        self._ends = _numbers(self._run_ends)
        is_strict = np.zeros(len(data) + FRAME_LENGTH, np.bool_)
        is_strict[strict] = True
        self._is_first = is_strict[strict + FRAME_LENGTH]
        self._starts = strict[self._is_first]
        self._is_island = np.zeros(len(is_strict), np.bool_)
        self._is_island[self._starts] = True
        """The offsets of islands: of the first one of two frames."""
        self._islands = _numbers(self._starts)
        self._runs: dict[int, int] = {}
        """By first island of frames in step: where these end."""
        self._next: dict[int, int] = {}
        """By start of a gap: the next island, if it is near and no other frame overlaps it."""
        self._divisions: dict[_Key, tuple[int, int]] = {}
        self._wanted: dict[_Key, None] = {}
        self._rounds: list[_Round] = []
        self._known: dict[State, _Step] = {}
        self._steps: list[_Step] = []
        self._is_guess = False
        """Whether the last step depends on a gap that is yet to be divided."""

    def segments(self) -> Division:
        """All that is decided; afterwards `state` is where that ends."""
        self._foresee()
        while self._wanted or self._walk():
            self._divide()
        parts = [self._marks(), self._frames(), *self._divided()]
        columns = [np.concatenate(column) for column in zip(*parts, strict=True)]
        order = np.argsort(columns[0], kind="stable")
        return Division(*(column[order] for column in columns))

    # The walk

    def _walk(self) -> bool:
        """Go as far as possible; returns whether gaps must be divided to go further."""
        state = self.state
        while True:
            step = self._known.get(state)
            if step is None:
                self._is_guess = False
                step = self._step(state)
                if step is None:
                    return bool(self._wanted)
                if not self._is_guess:
                    self._known[state] = step
            if not self._wanted:
                self._steps.append(step)
                self.state = step.state
            state = step.state

    def _step(self, state: State) -> _Step | None:
        """The next decision; None where more bytes are needed."""
        wall = self.walls[state.number] if state.number < len(self.walls) else _NO_WALL
        if state.in_window:
            return self._window(state, wall)
        return self._up_to_wall(state, state.at, wall) or self._gap(state, wall)

    def _up_to_wall(self, state: State, at: int, wall: Wall, part: _Part = None) -> _Step | None:
        """Strict frames in step up to a wall, or up to a frame that may go on behind it."""
        if wall is _NO_WALL:
            return None
        rest = (wall.at - at) % FRAME_LENGTH
        stop = wall.at - rest
        if stop > at and self._end_of(at) < stop:
            return None
        if rest and not (wall.is_soft and is_start(self.data[stop : wall.at])):
            return None
        following = State(stop, stop, state.number + 1)
        return _Step(following, part, (at, stop, state.wall, wall.at))

    def _frames_from(self, state: State, island: int, wall: Wall, part: _Part = None) -> _Step:
        """The frames in step from an island on that are followed by another one."""
        if (step := self._up_to_wall(state, island, wall, part)) is not None:
            return step
        end = min(self._end_of(island), wall.at - (wall.at - island) % FRAME_LENGTH)
        stop = end - FRAME_LENGTH
        following = State(stop, state.wall, state.number)
        return _Step(following, part, (island, stop, state.wall, end))

    def _end_of(self, at: int) -> int:
        """Where the strict frames in step from an offset on end."""
        if at in self._runs:
            return self._runs[at]
        row = bisect_left(self._strict, at)
        return self._ends[row] if row < len(self._strict) and self._strict[row] == at else at

    def _gap(self, state: State, wall: Wall) -> _Step | None:
        at = state.at
        island = self._next.get(at)
        is_plain = island is not None
        if island is None:
            number = bisect_left(self._islands, at)
            island = self._islands[number] if number < len(self._islands) else _FAR
        if island + _ISLAND > wall.at:
            island = _FAR
        if island == at:
            return self._frames_from(state, island, wall)
        if island <= at + NEAR and (is_plain or not self._is_contested(island, state.wall)):
            return self._up_to_island(state, island, wall)
        if island > at + NEAR and wall.at <= at + NEAR + _ISLAND:
            return self._settled(state, wall, _Key(at, wall.at, False, False))
        if island > at + NEAR and len(self.data) < at + NEAR + _ISLAND:
            return None
        return _Step(state._replace(in_window=True))

    def _is_contested(self, island: int, wall: int) -> bool:
        """Whether another strict frame overlaps the first one of an island."""
        first = bisect_left(self._strict, max(wall, island - FRAME_LENGTH + 1))
        return bisect_left(self._strict, island + FRAME_LENGTH, first) - first > 1

    def _up_to_island(self, state: State, island: int, wall: Wall) -> _Step:
        """Divide the bytes up to an island, if it is one after all."""
        found = self._look_up(_Key(state.at, island + _ISLAND, False, False))
        if found is not None and not self._is_certain(found, island):
            return _Step(state._replace(in_window=True))
        return self._frames_from(state, island, wall, self._taken(found, state.at, island))

    def _settled(self, state: State, wall: Wall, key: _Key) -> _Step:
        """Divide all bytes up to a wall."""
        found, stop = self._look_up(key), wall.at
        if found is not None and wall.is_soft:
            own, first, behind = self._rows(found, wall.at - FRAME_LENGTH + 1, wall.at)
            if behind > first and own.stops[behind - 1] == wall.at:
                start = own.starts[behind - 1]
                stop = start if start >= state.at and IS_HEADER[self._bytes[start]] else stop
        following = State(stop, stop, state.number + 1)
        return _Step(following, self._taken(found, state.at, stop))

    def _window(self, state: State, wall: Wall) -> _Step | None:
        """Divide the core that contains the state, up to a certain island in it."""
        core = state.at - (state.at + self._phase) % CORE
        start = max(core - MARGIN, state.wall)
        key = _Key(start, core + CORE + MARGIN, start > state.wall, True)
        if wall.at <= key.stop:
            return self._settled(state, wall, key._replace(stop=wall.at, is_open_after=False))
        if len(self.data) < key.stop:
            return None
        found = self._look_up(key)
        first = bisect_left(self._islands, state.at)
        for island in self._islands[first : bisect_left(self._islands, core + CORE)]:
            if found is None or self._is_certain(found, island):
                part = self._taken(found, state.at, island)
                return self._frames_from(state, island, wall, part)
        part = self._taken(found, state.at, core + CORE)
        stop = core + CORE
        if part is not None and part[2] > part[1]:
            stop = max(stop, self._rounds[part[0]].stops[part[2] - 1])
        return _Step(state._replace(at=stop), part)

    def _foresee(self) -> None:
        """Want the gaps between frames in step and the next islands, as if there were no walls."""
        is_first = ~self._is_island[self._starts - FRAME_LENGTH]
        ends = self._run_ends[self._is_first][is_first]
        self._runs = dict(zip(self._starts[is_first].tolist(), ends.tolist(), strict=True))
        at = ends - FRAME_LENGTH
        number = np.searchsorted(self._starts, at)
        is_known = (at >= self.state.at) & (number < len(self._starts))
        first, island = at[is_known], self._starts[number[is_known]]
        around = np.searchsorted(self._strict, [island - FRAME_LENGTH + 1, island + FRAME_LENGTH])
        is_plain = (island - first <= NEAR) & (around[1] - around[0] == 1)
        self._next = dict(zip(first[is_plain].tolist(), island[is_plain].tolist(), strict=True))
        keys = (_Key(at, island + _ISLAND, False, False) for at, island in self._next.items())
        self._wanted = dict.fromkeys(keys)

    # Divisions

    def _look_up(self, key: _Key) -> tuple[int, int] | None:
        """The round and the number of a gap; None if it is yet to be divided."""
        found = self._divisions.get(key)
        if found is None:
            self._wanted[key] = None
            self._is_guess = True
        return found

    def _divide(self) -> None:
        """Divide the gaps that are wanted."""
        columns = np.array(list(self._wanted), np.int64).T
        is_open = columns[2:].astype(np.bool_)
        found = divide(self._bytes, Gaps(columns[0], columns[1], is_open[0], is_open[1]))
        bounds = np.searchsorted(found.gap, np.arange(len(self._wanted) + 1)).tolist()
        lists = found.start.tolist(), found.stop.tolist(), found.probability.tolist()
        for number, key in enumerate(self._wanted):
            self._divisions[key] = len(self._rounds), number
        self._wanted = {}
        self._rounds.append(_Round(found, bounds, *lists))

    def _rows(self, found: tuple[int, int], first: int, last: int) -> tuple[_Round, int, int]:
        """The round of a gap, and its segments that begin in a range of offsets."""
        own = self._rounds[found[0]]
        low, high = own.bounds[found[1]], own.bounds[found[1] + 1]
        start = bisect_left(own.starts, first, low, high)
        return own, start, bisect_left(own.starts, last, start, high)

    def _taken(self, found: tuple[int, int] | None, first: int, last: int) -> _Part:
        """The segments of a gap that begin in a range of offsets."""
        return None if found is None else (found[0], *self._rows(found, first, last)[1:])

    def _is_certain(self, found: tuple[int, int], island: int) -> bool:
        """Whether the first frame of an island is certain in a gap."""
        own, row, behind = self._rows(found, island, island + 1)
        return behind > row and own.probabilities[row] >= CERTAIN

    # What was found

    def _frames(self) -> Division:
        """The frames in step; where an island overlaps one from before, it has another reading."""
        runs = [step.run for step in self._steps if step.run is not None]
        bounds = np.array(runs, np.int64).reshape(-1, 4)
        counts = (bounds[:, 1] - bounds[:, 0]) // FRAME_LENGTH
        start = _ranges(bounds[:, 0], counts, FRAME_LENGTH)
        probability = np.ones(len(start))
        probability[self._overlapped(start, bounds)] = 0
        return Division(start, start + FRAME_LENGTH, probability)

    def _overlapped(self, start: Ints, runs: Ints) -> Ints:
        """Which of the frames of runs another island overlaps from before, not in step."""
        is_frame = np.zeros(len(self._is_island) + _ISLAND, np.bool_)
        is_frame[start] = True
        is_own = is_frame[self._starts] & is_frame[self._starts + FRAME_LENGTH]
        others = self._starts[~is_own]
        number, behind = np.nonzero(is_frame[others[:, None] + _OUT_OF_STEP])
        island = others[number]
        frame = island + _OUT_OF_STEP[behind]
        own = runs[np.searchsorted(runs[:, 0], frame, "right") - 1]
        is_seen = (island >= own[:, 2]) & (island + _ISLAND <= own[:, 3])
        return np.searchsorted(start, frame[is_seen])

    def _divided(self) -> list[Division]:
        """The segments of gaps."""
        taken = [step.part for step in self._steps if step.part is not None]
        parts = np.array(taken, np.int64).reshape(-1, 3)
        found = []
        for number, (divided, *_) in enumerate(self._rounds):
            own = parts[parts[:, 0] == number]
            rows = _ranges(own[:, 1], own[:, 2] - own[:, 1])
            found.append(Division(*(column[rows] for column in divided[1:])))
        return found

    def _marks(self) -> Division:
        """The walls, where noise ends."""
        found = {step.state.wall for step in self._steps} - {self._first_wall}
        walls = np.array(sorted(found), np.int64)
        return Division(walls, walls, np.zeros(len(walls)))


def _ranges(first: Ints, counts: Ints, step: int = 1) -> Ints:
    """From each first number on, as many numbers as its count."""
    before = np.cumsum(counts) - counts
    return np.repeat(first - step * before, counts) + step * np.arange(int(counts.sum()))


def _numbers(column: Ints) -> array[int]:
    """The numbers of a column, for code that reads single ones."""
    return array("q", column.tobytes())


def _run_ends(strict: Ints) -> Ints:
    """By strict frame: where the frames in step from there on end."""
    order = np.argsort((strict % FRAME_LENGTH).astype(np.uint8), kind="stable")
    in_order = strict[order]
    is_last = np.append(np.diff(in_order) != FRAME_LENGTH, True)[: len(strict)]
    last = np.flatnonzero(is_last)
    ends = np.empty(len(strict), np.int64)
    ends[order] = in_order[last].repeat(np.diff(last, prepend=-1)) + FRAME_LENGTH
    return ends
