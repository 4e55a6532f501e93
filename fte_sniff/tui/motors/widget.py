"""Owns the pane of motors: their cards in a grid that suits the pane, and the window of time.

It must not know what a card says, nor where rows come from.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

from rich.text import Text

from fte_sniff.analysis.motors import Motors, MotorState
from fte_sniff.analysis.traces import Traces
from fte_sniff.tui.language import _, later
from fte_sniff.tui.motors.card import WORD_LINES, CardSize, compact, plots, words
from fte_sniff.tui.motors.look import DEFAULT_WINDOW, WINDOWS_NS, MotorsLook, zoomed
from fte_sniff.tui.pane import Pane, Sight
from fte_sniff.tui.quantities import span_text
from fte_sniff.tui.table.cells import clock_text
from fte_sniff.tui.table.palette import Palette

TITLE: Final = later("motors, {span}: line told, dots asked")
AS_OF: Final = later("as of row {row:,}, {time} - G: end")
AS_OF_ROW: Final = later("as of row {row:,} - G: end")
HINT: Final = later("z Z: time   J K: scroll   esc: close")
BEHIND: Final = later("reading: {rows:,} rows to go")

FOUR_ABREAST: Final = 160
"""Cells from which on all motors stand side by side."""

TWO_ABREAST: Final = 68
"""Cells from which on two motors stand side by side."""

LEAST_LINES: Final = 7
"""Lines of a card at least; where there are fewer, the pane scrolls."""

GAP: Final = 2
"""Cells between two cards."""

_MILLISECONDS: Final = 3


def grid(look: MotorsLook, width: int, height: int, palette: Palette) -> Text:
    """All motors in so many cells; in more lines where they do not fit."""
    abreast = 4 if width >= FOUR_ABREAST else 2 if width >= TWO_ABREAST else 1
    rows = -(-len(look.states) // abreast)
    if abreast == 1 and height < len(look.states) * WORD_LINES:
        return Text("\n").join(_compact(look, width, height, palette))
    size = CardSize((width + GAP) // abreast - GAP, max(LEAST_LINES, height // rows))
    lines: list[Text] = []
    for first in range(0, len(look.states), abreast):
        for parts in zip(
            *_row(look, look.states[first : first + abreast], size, palette), strict=True
        ):
            for part in parts[:-1]:
                part.pad_right(size.width + GAP - part.cell_len)
            lines.append(Text().join(parts))
    return Text("\n").join(lines)


def _compact(look: MotorsLook, width: int, height: int, palette: Palette) -> Iterator[Text]:
    """One below the other in all lines that there are; the first motors get what is left over."""
    each, more = divmod(height, len(look.states))
    for place, state in enumerate(look.states):
        yield from compact(look, state, width, each + (place < more), palette)


def _row(
    look: MotorsLook, states: Sequence[MotorState], size: CardSize, palette: Palette
) -> Iterator[list[Text]]:
    """Cards side by side, equally long; their plots begin on one line."""
    said = [words(look, state, size, palette) for state in states]
    most = min(size.height, max(len(lines) for lines in said))
    for state, lines in zip(states, said, strict=True):
        lines = lines[:most] + [Text() for _ in range(most - len(lines))]
        lines += plots(look, state, CardSize(size.width, size.height - most), palette)
        lines += [Text() for _ in range(size.height - len(lines))]
        for line in lines:
            line.truncate(size.width, overflow="ellipsis")
        yield lines


def _as_of(sight: Sight) -> str:
    """Which row is looked at, and the way to the newest; empty where that is looked at."""
    if sight.following or sight.row is None:
        return ""
    if sight.row.t_ns is None:
        return _(AS_OF_ROW).format(row=sight.place)
    time = clock_text(sight.row.t_ns, _MILLISECONDS, sight.zone)
    return _(AS_OF).format(row=sight.place, time=time)


@dataclass(frozen=True, slots=True)
class _Past:
    """What was found out about a row of the past, so that it is found out once."""

    index: int
    window_ns: int
    motors: Motors
    traces: Traces


class MotorsPane(Pane):
    """All motors at the cursor's row, or now."""

    EVERY_S = 1 / 6

    def __init__(self) -> None:
        super().__init__(HINT)
        self._window = DEFAULT_WINDOW
        self._past: _Past | None = None

    def zoom(self, by: int) -> None:
        """Look further back (by 1), or less far (by -1)."""
        self._window = zoomed(self._window, by)

    def see(self, sight: Sight) -> None:
        """Draw the motors as they were when the cursor's row had come."""
        title = _(TITLE).format(span=span_text(WINDOWS_NS[self._window]))
        as_of = _as_of(sight)
        self.entitle(*((f"{title}   {as_of}", as_of) if as_of else (title,)))
        look = self._look(sight)
        if look is None:
            self.draw(Text(_(BEHIND).format(rows=sight.models.behind)))
            return
        room = self.room
        self.draw(grid(look, room.width, room.height, sight.palette))

    def _look(self, sight: Sight) -> MotorsLook | None:
        models, now_ns, window_ns = sight.models, sight.now_ns, WINDOWS_NS[self._window]
        if sight.following or sight.index is None:
            self._past = None
            motors, traces = models.motors, models.traces
        else:
            past = self._looked_back(sight, sight.index, window_ns)
            if past is None:
                return None
            motors, traces = past.motors, past.traces
        states = tuple(motors.states(now_ns))
        return MotorsLook(states, traces, now_ns, window_ns, sight.bench, sight.zone)

    def _looked_back(self, sight: Sight, index: int, window_ns: int) -> _Past | None:
        past = self._past
        if past is not None and (past.index, past.window_ns) == (index, window_ns):
            return past
        motors = sight.models.motors_at(index)
        if motors is None:
            return None
        traces = sight.models.traces_at(index, (sight.now_ns or 0) - window_ns)
        self._past = _Past(index, window_ns, motors, traces)
        return self._past
