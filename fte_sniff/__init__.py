"""fte-sniff: a serial protocol analyzer and logger for the FTE four-motor controller.

One way, no back and forth:

    port   --Chunk--> capture -+-> Framer --rows--> recording (MCAP)
                               +-----------rows--> row store -> screen | plain lines
    file   ---------> reader --rows--> filter -> table | JSON lines | CSV | screen

The rooms, from the top of the import order down; each imports only from those below it:

    cli        one file a command; the exit codes
    tui        the screen; the only room that knows Textual
    session    the one place that wires capture to recording and to a view
    capture    bytes in: ports, the reader, the simulator      } these four
    recording  MCAP out and in                                 } do not know
    formats    other people's logs in; tables out              } each
    analysis   columns, filter, tally, row store               } other
    protocol   what the bytes mean: the frame table, codec, framer (compiled); no I/O
    errors     the exceptions, their tree, and the exit code of each
    said       sentences that keep their values, for the screen to say in its language

Three promises hold everywhere. Every byte that came in stands in exactly one row, in order, and
damage is labelled with its cause. A recording is complete in itself at every moment. Whatever a
user can do wrong ends in one line that says what, where, and the way out.
"""

# Nothing is imported here: `__main__` is to say first what Ctrl-C does.
TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

    from fte_sniff.errors import (
        FileError,
        FilterError,
        FteSniffError,
        InputTextError,
        PortError,
        RecordingWarning,
        UsageError,
        ValueRangeError,
    )
    from fte_sniff.protocol import (
        KINDS,
        Chunk,
        Damage,
        Fault,
        Frame,
        Framer,
        PortEvent,
        Row,
        Status,
        encode,
        record,
    )
    from fte_sniff.session.files.tables import read, scan

__all__ = [
    "KINDS",
    "Chunk",
    "Damage",
    "Fault",
    "FileError",
    "FilterError",
    "Frame",
    "Framer",
    "FteSniffError",
    "InputTextError",
    "PortError",
    "PortEvent",
    "RecordingWarning",
    "Row",
    "Status",
    "UsageError",
    "ValueRangeError",
    "encode",
    "read",
    "record",
    "scan",
]


def __getattr__(name: str) -> "Any":
    """Load the public names when they are asked for, so that the program can begin at once."""
    from importlib import import_module

    if name in __all__:
        for room in ("errors", "protocol", "session.files.tables"):
            module = import_module(f"{__name__}.{room}")
            if hasattr(module, name):
                return getattr(module, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
