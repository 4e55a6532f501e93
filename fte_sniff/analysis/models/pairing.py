"""Owns which feedback answers which command, for one motor.

It must not know what a command asks for, nor where rows are kept. The protocol does not say whether
feedback is asked for or periodic (PROTOCOL.md, "What the document leaves open"); so this is the
measurement that can be made without knowing:

    A command is answered by the first feedback of its motor that has the same CMD and comes
    before the next command to that motor. Where the next command comes first, it is unanswered.
    The last command is neither until one of the two has come: it waits.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass
from typing import Final

import numpy as np

from fte_sniff.analysis.accumulators.recent import Recent
from fte_sniff.analysis.columns.fields import NO_TIME, Bools, Decoded, Ints
from fte_sniff.protocol import KINDS, Direction

ANSWERABLE: Final = np.array(
    sorted({cmd for kind in KINDS if kind.direction is Direction.FEEDBACK for cmd in kind.cmds})
)
"""The CMDs that feedback can have: a command with another awaits nothing."""

_BEFORE: Final = -1
_NEVER: Final = 2**62


@dataclass(frozen=True, slots=True)
class Delays:
    """How long answers took, as far as that can be measured."""

    delays_ns: Ints
    """From a command's first byte to that of its answer, nanoseconds."""
    ends_ns: Ints
    """When each answer came, nanoseconds since 1970 UTC."""


_NO_DELAYS: Final = Delays(np.empty(0, np.int64), np.empty(0, np.int64))


@dataclass(frozen=True, slots=True)
class Moments:
    """Some frames of a batch, in order."""

    places: Ints
    """Where in the batch they stand, from 0, rising."""
    cmds: Ints
    t_ns: Ints
    """Nanoseconds since 1970 UTC, or `NO_TIME`."""

    @classmethod
    def of(cls, rows: Decoded, places: Ints) -> Moments:
        """Those of the rows that stand at these places."""
        return cls(places, rows.cmds[places].astype(np.int64), rows.t_ns[places])

    def before(self, cmd: int, t_ns: int) -> Moments:
        """The same with one more that came before the batch."""
        return Moments(
            np.concatenate(([_BEFORE], self.places)),
            np.concatenate(([cmd], self.cmds)),
            np.concatenate(([t_ns], self.t_ns)),
        )


class Pairing:
    """The commands to one motor so far, and how many of them were answered."""

    def __init__(self) -> None:
        self.answered = 0
        self.unanswered = 0
        self.delays = Recent()
        """From a command's first byte to that of its answer, nanoseconds, the latest of them."""
        self._waiting: tuple[int, int] | None = None

    def interrupt(self) -> None:
        """Frames are missing here: whether the last command was answered will never be known."""
        self._waiting = None

    def copied(self) -> Pairing:
        """The same, which later frames do not change."""
        other = copy(self)
        other.delays = copy(self.delays)
        return other

    @property
    def waiting(self) -> bool:
        """Whether the last command may still be answered."""
        return self._waiting is not None

    @property
    def waiting_since_ns(self) -> int | None:
        """The time of the command that waits, if there is one and it has a time."""
        if self._waiting is None or self._waiting[1] == NO_TIME:
            return None
        return self._waiting[1]

    def add(self, commands: Moments, feedback: Moments) -> Delays:
        """Take the commands to this motor, and its feedback, in the next batch of rows.

        Returns:
            The delays of the answers that it found.
        """
        if self._waiting is not None:
            commands = commands.before(*self._waiting)
        if not len(commands.places):
            return _NO_DELAYS
        answers, answered = _answers(commands, feedback)
        found = _delays(commands.t_ns[answered], feedback.t_ns[answers[answered]])
        self.delays.add(found.delays_ns)
        awaits = np.isin(commands.cmds, ANSWERABLE)
        waits = bool(awaits[-1] and not answered[-1])
        self._waiting = (int(commands.cmds[-1]), int(commands.t_ns[-1])) if waits else None
        self.answered += int(answered.sum())
        self.unanswered += int((awaits & ~answered).sum()) - waits
        return found


def _delays(asked_ns: Ints, answered_ns: Ints) -> Delays:
    measured = (asked_ns != NO_TIME) & (answered_ns != NO_TIME) & (answered_ns >= asked_ns)
    return Delays((answered_ns - asked_ns)[measured], answered_ns[measured])


def _answers(commands: Moments, feedback: Moments) -> tuple[Ints, Bools]:
    """For every command the place in `feedback` of its answer, and whether it has one."""
    answers = np.zeros(len(commands.places), np.int64)
    answered = np.zeros(len(commands.places), np.bool_)
    ends = np.append(commands.places[1:], _NEVER)
    for cmd in ANSWERABLE:
        asking = np.flatnonzero(commands.cmds == cmd)
        same = np.flatnonzero(feedback.cmds == cmd)
        if not len(asking) or not len(same):
            continue
        places = feedback.places[same]
        first = np.searchsorted(places, commands.places[asking], side="right")
        found = first < len(same)
        found[found] = places[first[found]] < ends[asking[found]]
        answered[asking[found]] = True
        answers[asking[found]] = same[first[found]]
    return answers, answered
