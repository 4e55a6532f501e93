"""Owns what a capture's recording is to keep: bounds, rotation, what surrounds an event.

It must not know how that is done.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

DEFAULT_FLUSH_S = 1.0
"""Seconds that rows wait for the disk at most, which are what a kill or a power cut can cost.

A shorter time would cost more than it saves: a flush takes two waits for the disk and a new index,
whatever is in it, and each chunk makes the index longer, so that twice as many flushes a second
mean twice as many files in a long capture. One second is also what people expect to lose.
"""

DEFAULT_MOST_INDEX = 512 * 1024
"""Bytes of index at which the next file begins if nobody says else.

Every flush writes the index twice, as guard and as tail. At this length that takes a flush of two
full wires some 3 ms of processor time in addition to 4; a file spans 50 to 80 minutes then, at a
flush a second and ten to four channels. Up to twice this length the guard holds against a power cut
too, which leaves room for whatever comes between two looks at the length.
"""

DEFAULT_MOST_BYTES = 20_000_000_000
"""What a capture's files may take together if nobody says else: over a week of two full wires."""

DEFAULT_FREE_BYTES = 1_000_000_000
"""What is left free on the disk if nobody says else; less where it is small or nearly full."""


class OnFull(StrEnum):
    """What to do when there is no room for more."""

    STOP = "stop"
    """Stop recording, and go on once there is room again."""
    ROTATE_OLDEST = "rotate-oldest"
    """Delete the capture's own oldest file."""


@dataclass(frozen=True, slots=True)
class Surroundings:
    """What to keep around each row that a trigger picks."""

    before_s: float
    """Seconds of rows before it."""
    after_s: float
    """Seconds of rows behind it."""


@dataclass(frozen=True, slots=True)
class Keeping:
    """What a recording is to keep."""

    flush_every_s: float = DEFAULT_FLUSH_S
    """Seconds that rows wait for the disk at most."""
    rotate_bytes: int | None = None
    """Begin the next file when one has so many bytes; None for any number."""
    most_index: int | None = DEFAULT_MOST_INDEX
    """Begin the next file when one's index has so many bytes, so that each has it at every moment.
    None for any number: then a long file is without its index for some flushes at a time."""
    rotate_s: float | None = None
    """Begin the next file when one spans so many seconds of rows; None for any number."""
    on_full: OnFull = OnFull.STOP
    most_bytes: int | None = DEFAULT_MOST_BYTES
    """Bytes that the capture's files may take together; None for any number."""
    free_bytes: int | None = None
    """Bytes to leave free on the disk; None for the default, which spares small and full disks."""
    around: Surroundings | None = None
    """What to keep around the rows of the trigger; None to keep all rows."""

    @property
    def rotates(self) -> bool:
        """Whether the recording is a sequence of files from the beginning, by their names too."""
        return (
            self.rotate_bytes is not None
            or self.rotate_s is not None
            or self.on_full is OnFull.ROTATE_OLDEST
        )
