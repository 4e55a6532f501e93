"""Exception classes and TranslatableText (a message that is translated when shown).

This module knows no other part of the program but `said`, in which a message keeps its values.

    FteSniffError                 anything below; `exit_code` and a one-line message
    ├── UsageError          2     the command line contradicts itself
    │   ├── InputTextError  2     text that cannot be read (hex, a filter, a number)
    │   │   └── FilterError 2     a filter that does not parse or names what is not there
    │   └── ValueRangeError 2     a value that does not fit its field in a frame
    ├── PortError           3     a serial port: absent, busy, forbidden, lost
    └── FileError           4     a file: unreadable, not what it should be, in the way

    RecordingWarning              beside the tree: what was read lacks something

Each message is one line that says what happened, where, and the way out.
"""

from __future__ import annotations

import errno
from collections.abc import Mapping
from types import MappingProxyType
from typing import ClassVar


class TranslatableText(str):
    """A text out of a form with named places, `expected {wanted}`, and what stands in them.

    It goes from process to process whole.
    """

    __slots__ = ("form", "values")

    form: str
    values: Mapping[str, object]
    """Values that are `TranslatableText` are translated too; other texts are not."""

    def __new__(cls, form: str, **values: object) -> TranslatableText:
        """The form with the values in their places."""
        made = super().__new__(cls, form.format(**values))
        made.form, made.values = form, MappingProxyType(values)
        return made

    def __reduce__(self) -> tuple[object, ...]:
        return _again, (self.form, dict(self.values))


def _again(form: str, values: dict[str, object]) -> TranslatableText:
    return TranslatableText(form, **values)


_MOST_QUOTED = 60


def printable(text: str) -> str:
    """Text from outside (a name, metadata) on one line, its control characters made visible."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


def shortened(text: str) -> str:
    """What a user wrote; of what would fill a screen only the beginning."""
    return text if len(text) <= _MOST_QUOTED else f"{text[:_MOST_QUOTED]}…"


def quoted(text: str) -> str:
    """The same in quotation marks."""
    return repr(shortened(text))


class FteSniffError(Exception):
    """The base of every error that a user can cause; its text is one line for the terminal."""

    exit_code: ClassVar[int] = 2

    def __init__(self, message: str, **values: object) -> None:
        """The message; with `values`, a form that has their names in braces, translatable."""
        super().__init__(TranslatableText(message, **values) if values else message)

    def __str__(self) -> str:
        return printable(super().__str__())

    @property
    def message(self) -> str:
        """The message with the form and the values it was made of, where it keeps them."""
        message = self.args[0] if len(self.args) == 1 else None
        return message if isinstance(message, TranslatableText) else str(self)


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


class RecordingWarning(UserWarning):
    """A recording is damaged: what could be read was, and the text says in one line what is lost.

    A category of `warnings`, and no error: `warnings.simplefilter("error", RecordingWarning)` makes
    it one.
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
"""The commonest reasons, in the system's own English words but for the first two."""


def reason_of(error: OSError) -> str:
    """Why the system refused, in words."""
    return _REASONS.get(error.errno or 0, error.strerror or str(error))


def unreadable(path: object, error: OSError) -> FileError:
    """What to tell the user when a file cannot be opened or read."""
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
    """What to tell the user when a file cannot be made or written."""
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
