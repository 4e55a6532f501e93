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
import os
from collections.abc import Iterable, Mapping
from enum import StrEnum
from functools import partial, reduce
from types import MappingProxyType
from typing import ClassVar, Self


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


class ExplainedWord(StrEnum):
    """Words, each with a meaning for the help: `NAME = word, meaning`."""

    meaning: str

    def __new__(cls, word: str, meaning: str = "") -> Self:
        """Create the word; its value is the word alone."""
        member = str.__new__(cls, word)
        member._value_, member.meaning = word, meaning
        return member


class Joint(StrEnum):
    """Forms of the words between the items of a list."""

    COMMA = "{before}, {after}"
    OR = "{before} or {after}"
    AND = "{before} and {after}"


def listed(items: Iterable[object], joint: Joint = Joint.COMMA) -> str:
    """The items, which may be translatable, with a translatable word between them."""
    texts = (item if isinstance(item, str) else str(item) for item in items)
    joined = partial(TranslatableText, joint.value)
    return reduce(lambda before, after: joined(before=before, after=after), texts, next(texts, ""))


_MOST_QUOTED = 60


def printable(text: str) -> str:
    """Escape the control characters of a text from outside, so that it is one line."""
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


def encodable(text: str) -> str:
    """Escape the bytes of a name that are not UTF-8, so that every form of text can have it."""
    return text.encode("utf-8", "backslashreplace").decode("utf-8")


def shortened(text: str) -> str:
    """Cut a text that the user wrote to at most 60 characters."""
    return text if len(text) <= _MOST_QUOTED else f"{text[:_MOST_QUOTED]}…"


def quoted(text: str) -> str:
    """Shorten a text that the user wrote, escape it, and put it in quotation marks."""
    return repr(shortened(text))


def size_text(size: int) -> str:
    """A size with three digits: `1.5 GB`."""
    for unit, name in ((10**12, "TB"), (10**9, "GB"), (10**6, "MB"), (10**3, "kB")):
        if size >= 0.9995 * unit:  # what rounds to a thousand of the next smaller unit
            return f"{size / unit:.3g} {name}"
    return f"{size} bytes"


def unframed_text(lowest: int, highest: int, count: int, seconds: int) -> TranslatableText:
    """What bytes without a frame are: their lowest and highest value, number, and time."""
    if lowest == highest == 0:
        return TranslatableText(
            "only 00 for {seconds} s: the wire is held low (a break, no power, no ground), or "
            "far slower than the baud",
            seconds=seconds,
        )
    if lowest == highest:
        return TranslatableText(
            "only {byte} for {seconds} s: an open wire, swapped polarity, or another baud",
            byte=f"{lowest:02X}",
            seconds=seconds,
        )
    return TranslatableText(
        "no frame in {count:,} bytes for {seconds} s: another baud, swapped polarity, or "
        "another device",
        count=count,
        seconds=seconds,
    )


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
    """A recording is damaged or lacks rows; the text says what is lost. All others were read.

    `warnings.simplefilter("error", RecordingWarning)` turns it into an error.
    """


REASONS: Mapping[int, TranslatableText] = {
    errno.ENOSPC: TranslatableText("the disk is full"),
    errno.EDQUOT: TranslatableText("the disk quota is used up"),
    **{
        code: TranslatableText(os.strerror(code))
        for code in (
            *(errno.EPERM, errno.ENOENT, errno.EIO, errno.ENXIO, errno.EACCES, errno.EBUSY),
            *(errno.ENODEV, errno.EINVAL, errno.EMFILE, errno.EFBIG, errno.EROFS),
            *(errno.ENAMETOOLONG, errno.ECONNREFUSED, errno.ECONNRESET, errno.ETIMEDOUT),
        )
    },
}
"""Frequent reasons, so that they are translated; all but the first two in the system's words."""


def reason_of(error: OSError) -> str:
    """The reason of a system error, in words."""
    return REASONS.get(error.errno or 0, error.strerror or str(error))


TOO_MANY_FILES = TranslatableText("too many open files; try `ulimit -n 4096`")
"""The limit of the process or the system is reached: no fault of the file."""

UNREADABLE: Mapping[type[OSError], str] = {
    FileNotFoundError: "{path}: no such file; check the name and the folder",
    IsADirectoryError: "{path} is a directory; name the files in it",
    PermissionError: "{path}: no permission to read it; try `ls -l` and `chmod u+r`",
    OSError: "{path} cannot be read: {reason}; copy it and try again",
}
"""Forms of the errors of a file that cannot be opened or read."""

UNWRITABLE: Mapping[type[OSError], str] = {
    FileExistsError: "{path} exists already; name another file, or use --force",
    FileNotFoundError: "{path}: its folder does not exist; make it with `mkdir -p`",
    NotADirectoryError: "{path}: part of this path is a file, not a folder; name another",
    IsADirectoryError: "{path} is a directory; name a file in it",
    PermissionError: "{path}: no permission to write there; name another place with -o",
    OSError: "{path} cannot be written: {reason}; name another place with -o",
}
"""Forms of the errors of a file that cannot be created or written."""


def unreadable(path: object, error: OSError) -> FileError:
    """The error of a file that cannot be opened or read."""
    return _file_error(UNREADABLE, path, error)


def unwritable(path: object, error: OSError) -> FileError:
    """The error of a file that cannot be created or written."""
    if isinstance(error, FileNotFoundError) and os.path.isdir(os.path.dirname(str(path)) or "."):  # noqa: PTH112, PTH120
        form = "{path}: nothing can be made in this folder; name another place with -o"
        return FileError(form, path=path)
    return _file_error(UNWRITABLE, path, error)


def _file_error(forms: Mapping[type[OSError], str], path: object, error: OSError) -> FileError:
    if error.errno in (errno.EMFILE, errno.ENFILE):
        return FileError(TOO_MANY_FILES)
    form = next(form for kind, form in forms.items() if isinstance(error, kind))
    return FileError(form, path=path, reason=reason_of(error))
