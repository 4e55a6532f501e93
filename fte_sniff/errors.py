"""Exceptions, their exit codes, and texts that can be translated.

    FteSniffError                 exit code and a one-line message; base of all below
    ├── UsageError          2     the command line contradicts itself
    │   ├── InputTextError  2     text that cannot be read (hex, a number, a log)
    │   │   └── FilterError 2     a filter that does not parse or names an unknown field
    │   └── ValueRangeError 2     a value that does not fit its field in a frame
    ├── PortError           3     a serial port: absent, busy, forbidden, lost
    └── FileError           4     a file: unreadable, of the wrong kind, already there

    RecordingWarning              a category of `warnings`: a recording is damaged

Each message is one line: what happened, where, and how to fix it.
"""

from __future__ import annotations

import errno
from collections.abc import Mapping
from types import MappingProxyType
from typing import ClassVar


class TranslatableText(str):
    """A text made from a form such as `expected {wanted}` and the values of its names.

    The text itself is English. The screen translates the form and inserts the values; values that
    are `TranslatableText` are translated too. Pickling keeps form and values.
    """

    __slots__ = ("form", "values")

    form: str
    values: Mapping[str, object]

    def __new__(cls, form: str, **values: object) -> TranslatableText:
        """Insert the values into the form."""
        text = super().__new__(cls, form.format(**values))
        text.form, text.values = form, MappingProxyType(values)
        return text

    def __reduce__(self) -> tuple[object, ...]:
        return _unpickled, (self.form, dict(self.values))


def _unpickled(form: str, values: dict[str, object]) -> TranslatableText:
    return TranslatableText(form, **values)


_MOST_QUOTED = 60


def printable(text: str) -> str:
    """Escape the control characters of a text from outside, so that it is one line."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


def shortened(text: str) -> str:
    """Cut a text that the user wrote to at most 60 characters."""
    return text if len(text) <= _MOST_QUOTED else f"{text[:_MOST_QUOTED]}…"


def quoted(text: str) -> str:
    """Shorten a text that the user wrote, escape it, and put it in quotation marks."""
    return repr(shortened(text))


class FteSniffError(Exception):
    """Base of all errors that a user can cause; the text is one line for the terminal."""

    exit_code: ClassVar[int] = 2

    def __init__(self, message: str, **values: object) -> None:
        """Set the message; with `values` it is a form with their names, and can be translated."""
        super().__init__(TranslatableText(message, **values) if values else message)

    def __str__(self) -> str:
        return printable(super().__str__())

    @property
    def message(self) -> str:
        """The message; a `TranslatableText` if it can be translated."""
        message = self.args[0] if len(self.args) == 1 else None
        return message if isinstance(message, TranslatableText) else str(self)


class UsageError(FteSniffError):
    """The command line contradicts itself, or needs something that is absent."""


class InputTextError(UsageError):
    """Text that the user typed or pasted cannot be read."""


class FilterError(InputTextError):
    """A filter does not parse, or names an unknown field or word."""


class ValueRangeError(UsageError):
    """A value does not fit its field in a frame."""


class PortError(FteSniffError):
    """A serial port cannot be opened, or was lost."""

    exit_code: ClassVar[int] = 3


class FileError(FteSniffError):
    """A file cannot be read or written, is of the wrong kind, or must not be overwritten."""

    exit_code: ClassVar[int] = 4


class RecordingWarning(UserWarning):
    """A recording is damaged; all readable rows were read, and the text says what is lost.

    `warnings.simplefilter("error", RecordingWarning)` turns it into an error.
    """


_REASONS = {
    errno.ENOSPC: TranslatableText("the disk is full"),
    errno.EDQUOT: TranslatableText("the disk quota is used up"),
    errno.EPERM: TranslatableText("Operation not permitted"),
    errno.ENOENT: TranslatableText("No such file or directory"),
    errno.EIO: TranslatableText("Input/output error"),
    errno.ENXIO: TranslatableText("No such device or address"),
    errno.EACCES: TranslatableText("Permission denied"),
    errno.EBUSY: TranslatableText("Device or resource busy"),
    errno.ENODEV: TranslatableText("No such device"),
    errno.EINVAL: TranslatableText("Invalid argument"),
    errno.EMFILE: TranslatableText("Too many open files"),
    errno.EFBIG: TranslatableText("File too large"),
    errno.EROFS: TranslatableText("Read-only file system"),
    errno.ENAMETOOLONG: TranslatableText("File name too long"),
    errno.ECONNREFUSED: TranslatableText("Connection refused"),
    errno.ECONNRESET: TranslatableText("Connection reset by peer"),
    errno.ETIMEDOUT: TranslatableText("Connection timed out"),
}
"""Frequent reasons, so that they are translated; all but the first two in the system's words."""


def reason_of(error: OSError) -> str:
    """The reason of a system error, in words."""
    return _REASONS.get(error.errno or 0, error.strerror or str(error))


def unreadable(path: object, error: OSError) -> FileError:
    """The error of a file that cannot be opened or read."""
    match error:
        case FileNotFoundError():
            return FileError(
                "{path}: there is no such file; check the name and the folder", path=path
            )
        case IsADirectoryError():
            return FileError("{path} is a directory; name the files in it", path=path)
        case PermissionError():
            return FileError(
                "{path}: no permission to read it; try `ls -l` and `chmod u+r`", path=path
            )
    return FileError(
        "{path} cannot be read: {reason}; copy it and try again",
        path=path,
        reason=reason_of(error),
    )


def unwritable(path: object, error: OSError) -> FileError:
    """The error of a file that cannot be created or written."""
    match error:
        case FileExistsError():
            return FileError("{path} exists already; name another file, or use --force", path=path)
        case FileNotFoundError():
            return FileError(
                "{path}: its folder does not exist; make it with `mkdir -p`", path=path
            )
        case NotADirectoryError():
            return FileError(
                "{path}: part of this path is a file, not a folder; name another", path=path
            )
        case IsADirectoryError():
            return FileError("{path} is a directory; name a file in it", path=path)
        case PermissionError():
            return FileError(
                "{path}: no permission to write there; name another place with -o", path=path
            )
    return FileError(
        "{path} cannot be written: {reason}; name another place with -o",
        path=path,
        reason=reason_of(error),
    )
