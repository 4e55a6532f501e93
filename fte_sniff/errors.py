"""The exceptions that a user of fte-sniff can cause, and the exit code of each.

This module knows no other part of the program: it stands at the bottom of the import order.

    FteSniffError                 anything below; `exit_code` and a one-line message
    ├── UsageError          2     the command line contradicts itself
    │   ├── InputTextError  2     text that cannot be read (hex, a filter, a number)
    │   │   └── FilterError 2     a filter that does not parse or names what is not there
    │   └── ValueRangeError 2     a value that does not fit its field in a frame
    ├── PortError           3     a serial port: absent, busy, forbidden, lost
    └── FileError           4     a file: unreadable, not what it should be, in the way

Each message is one line that says what happened, where, and the way out.
"""

from __future__ import annotations

from typing import ClassVar


def shown(text: str) -> str:
    """Text from outside (a name, metadata) on one line, its control characters made visible."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


class FteSniffError(Exception):
    """The base of every error that a user can cause; its text is one line for the terminal."""

    exit_code: ClassVar[int] = 2

    def __str__(self) -> str:
        return shown(super().__str__())


class UsageError(FteSniffError):
    """The command line asks for what cannot be done as asked."""


class InputTextError(UsageError):
    """Text that the user typed or pasted cannot be read."""


class FilterError(InputTextError):
    """A filter expression does not parse, or names a field or a word that does not exist."""


class ValueRangeError(UsageError):
    """A value does not fit the field of the frame it was given for."""


class PortError(FteSniffError):
    """A serial port cannot be opened, or was lost."""

    exit_code: ClassVar[int] = 3


class FileError(FteSniffError):
    """A file cannot be read, is not what it should be, or must not be overwritten."""

    exit_code: ClassVar[int] = 4
