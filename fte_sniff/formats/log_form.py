"""What a log is read as: what the user says of it, its kind, and the bytes of its streams."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, NamedTuple

from fte_sniff.protocol import DEFAULT_BAUD

if TYPE_CHECKING:
    import re
    from datetime import date, tzinfo

    import numpy as np
    import numpy.typing as npt

    from fte_sniff.formats.text_blocks import TextBlock

    Array = npt.NDArray[np.int64]

LATEST_NS: Final = 2**63 - 1
"""In 2262: a table's times are 64 bits, nanoseconds since 1970."""
NO_TIME: Final = -(2**63)


@dataclass(frozen=True, slots=True)
class LogOptions:
    """What the user says of a log."""

    day: date | None = None
    """The date of the first time that has none."""
    zone: tzinfo | None = None
    """Of times without one; None for UTC."""
    start_ns: int | None = None
    """When the seconds of the log, or its bytes, began."""
    form: str | None = None
    """The extractor."""
    pattern: re.Pattern[str] | None = None
    """A regular expression with the groups `data`, and perhaps `time` and `dir`."""
    whole: bool = True
    """Whether the text is a log; else a paste, of which a part may be bytes."""
    samplerate: int | None = None
    """Samples per second of a logic analyser, whose numbers are then times."""
    baud: int = DEFAULT_BAUD
    """Bits per second, for the time that bytes take."""


class StreamBytes(NamedTuple):
    """Bytes of consecutive lines of one stream of a log."""

    port: str
    data: bytes
    sizes: Sequence[int] | Array = ()
    """How many bytes are of each line."""
    order: Sequence[int] | Array = ()
    """Numbers that rise with the lines; none if the log is one stream without times."""
    times: Sequence[int] | Array | None = None
    """The times of the lines, nanoseconds since 1970 or `NO_TIME`; None if none has one."""
    gaps: Sequence[int] = ()
    """Offsets in the bytes where the log leaves out others, so that no frame goes on."""
    first: bool = False
    """Whether the first byte of a line began at its time; else the last one had arrived."""
    label: str | None = None
    """Of the stream: a direction, which its frames can contradict, or any other."""


class LogForm(ABC):
    """A kind of log: how blocks of lines become the bytes of streams."""

    resolution_ns: int | None = None
    """Of its times; None if it has none."""
    single: bool = False
    """Whether its rows have one port, whatever it says of directions."""
    rank: tuple[int, bool] = 0, False
    """Whole frames in its sample, and whether there is almost nothing else."""
    is_certain: bool = False
    """Whether its sample shows that no other kind of log is better."""
    is_chance: bool = False
    """Whether there are too few frames in its sample."""

    share: float | None = None
    """Of the bytes in its sample, how many are in frames; None where frames do not decide."""

    def ports(self, name: str) -> list[str]:
        """The ports of its rows, as far as the sample shows."""
        return [name]

    @property
    def is_one_stream(self) -> bool:
        """Whether its bytes follow each other, in one stream without times."""
        return self.single and self.resolution_ns is None

    @abstractmethod
    def read(self, block: TextBlock, name: str) -> Iterator[StreamBytes]:
        """The bytes of a block of the log of this name; raises InputTextError after the others."""

    def rest(self, name: str) -> Iterator[StreamBytes]:
        """The bytes that waited for a time below them, at the end of the log."""
        del name
        return iter(())

    def notes(self) -> list[str]:
        """How it was read, one line each."""
        return []

    @abstractmethod
    def explain(self) -> list[str]:
        """The form, lanes, times and directions, one line each."""
