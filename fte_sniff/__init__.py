"""fte-sniff: a serial protocol analyzer and logger for the FTE four-motor controller.

Data flows in one direction, and the recording is the interface between a capture and its views:

    port --Chunk--> Framer --rows--> recording (MCAP)        the capture, a process of its own
    recording, also one that grows --> rows, events, gaps -+-> screen | lines | UDP, WebSocket
    log --Chunk--> Framer --rows---------------------------+-> table, CSV, JSON lines, MCAP ...
                                                           +-> findings, stats, check, compare

The packages, from the top of the import order to the bottom. A package imports only from those
below it; capture, recording, formats and analysis do not import each other:

    cli        one module per command; exit codes
    tui        the screen; the only package that imports Textual
    session    connects capture to recording and view, and inputs to outputs
    capture    bytes in: serial and network ports, the bridge, the simulator
    recording  MCAP recordings: write, read, repair, rotate
    formats    logs of other tools in; tables and exports out
    analysis   filter, relations between rows, statistics, findings, row store
    protocol   what the bytes mean: frame definitions, framer; no I/O
    errors     the exceptions and their exit codes; messages that can be translated
    i18n       translation: the screen, the report, and errors in the language of the user
    platform   what this system has, and Windows lacks
    ahead      a thread that makes the next items while one is used
    real_number   a number as a type of an option; nan is not one

Three rules hold everywhere. Every received byte is in exactly one row, in order, and damage is
labelled with its cause. A recording is a valid file at every moment. An error that a user can cause
is one line: what happened, where, and how to fix it.
"""

__version__ = "0.1.0"

# Imports are lazy, so that `__main__` sets the handling of Ctrl-C first.
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
    from fte_sniff.protocol.columns import record
    from fte_sniff.protocol.framer import Framer
    from fte_sniff.protocol.items import Chunk, PortEvent
    from fte_sniff.protocol.rows import Row
    from fte_sniff.protocol.spec import KINDS, Fault, Status, encode
    from fte_sniff.session.measured import check, compare, findings, stats
    from fte_sniff.session.scan import read, scan

__all__ = [
    "KINDS",
    "Chunk",
    "Fault",
    "FileError",
    "FilterError",
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
    "check",
    "compare",
    "encode",
    "findings",
    "read",
    "record",
    "scan",
    "stats",
]


_MODULES = (
    "errors",
    "protocol.spec",
    "protocol.items",
    "protocol.columns",
    "protocol.framer",
    "session.scan",
    "session.measured",
)
"""Where the public names are."""


def __dir__() -> list[str]:
    """The public names, also before they are imported."""
    return __all__


def __getattr__(name: str) -> "Any":
    """Import a public name on first use."""
    from importlib import import_module

    if name in __all__:
        for path in _MODULES:
            module = import_module(f"{__name__}.{path}")
            if hasattr(module, name):
                return getattr(module, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
