"""Owns what flag bytes told of each motor, in words, for the pane and for `stats`.

It must not know where the words stand, nor how times are written: a function for them comes along.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, Final

from fte_sniff.tui.language import _, later

if TYPE_CHECKING:
    from fte_sniff.analysis.motor_stats import FlagNumbers, Seen

ERROR_BIT: Final = later("motor {motor}: ERROR bit {bit} set in {seen}")
NOT_ONLINE: Final = later("motor {motor}: not ONLINE in {seen}")
ONE_FRAME: Final = later("1 frame")
FRAMES: Final = later("{count:,} frames")
WHEN: Final = later("{frames}, {time}")
FROM_TO: Final = later("{start} to {end}")
LOST_ONCE: Final = later("lost once")
LOST: Final = later("lost {count:,} times")
ALL_IN_ORDER: Final = later("no ERROR bit was ever set, and every motor was always ONLINE")

When = Callable[[int | None], str]
"""The text of a time; a dash for none."""


def flag_words(flags: Sequence[FlagNumbers], when: When, *, in_order: bool) -> Iterator[str]:
    """A line for each thing that is not in order; `in_order` tells whether rows follow in time."""
    for one in flags:
        for bit, seen in one.error_bits.items():
            yield _(ERROR_BIT).format(motor=one.motor, bit=bit, seen=_seen(seen, when))
        if one.offline.frames:
            words = _(NOT_ONLINE).format(motor=one.motor, seen=_seen(one.offline, when))
            yield f"{words}; {_lost(one.times_lost)}" if in_order else words


def from_to(first_ns: int, last_ns: int | None, when: When) -> str:
    """`12:00:01.000 to 12:00:09.000`; one time where they are the same."""
    if first_ns == last_ns:
        return when(first_ns)
    return _(FROM_TO).format(start=when(first_ns), end=when(last_ns))


def _seen(seen: Seen, when: When) -> str:
    """`12 frames, 12:00:01.000 to 12:00:09.000`."""
    frames = _(ONE_FRAME) if seen.frames == 1 else _(FRAMES).format(count=seen.frames)
    if seen.first_ns is None:
        return frames
    return _(WHEN).format(frames=frames, time=from_to(seen.first_ns, seen.last_ns, when))


def _lost(times: int) -> str:
    return _(LOST_ONCE) if times == 1 else _(LOST).format(count=times)
