"""Owns the saving of rows to a new file, in the form that the file's name asks for.

It must not know where the rows come from or how many there will be: they come in pieces, and the
file has its name only when the last of them is in it. Until then it lies beside it as `NAME.part`.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Final

from fte_sniff.errors import FileError, FteSniffError, Said, UsageError, reason_of
from fte_sniff.protocol import Row
from fte_sniff.session.saving.origin import Origin
from fte_sniff.session.saving.sinks import SINKS, Sink

OVERWRITE: Final = "!"
"""What stands behind a name whose file may be replaced."""

EXAMPLE: Final = "rows.csv"
"""A name as one would type it."""

FORMS: Final = MappingProxyType(SINKS)
"""By the end of a file's name, what is written to it."""


@dataclass(frozen=True, slots=True)
class Target:
    """A file to save to."""

    path: Path
    replace: bool
    """Whether a file that is there may be replaced."""
    in_use: Sequence[str] = ()
    """Files that rows come from or are recorded to; none of them is ever replaced."""

    @classmethod
    def parse(cls, line: str, in_use: Sequence[str] = ()) -> Target:
        """The file that a line names; `!` behind the name lets a file be replaced.

        Args:
            line: as it was typed.
            in_use: files that may not be replaced in any case.

        Raises:
            UsageError: the name's end is none of `FORMS`.
            FileError: the file is there already or in use, or there is no such folder.
        """
        name = line.strip()
        replace = name.endswith(OVERWRITE)
        path = Path(name.removesuffix(OVERWRITE).rstrip())
        with suppress(RuntimeError):  # no such user
            path = path.expanduser()
        if path.suffix.lower() not in FORMS:
            raise UsageError(
                Said("the name's end says what is written: {forms}", forms=" ".join(FORMS))
            )
        target = cls(path, replace, in_use)
        target.check()
        return target

    def check(self) -> None:
        """See whether a file can be made there now.

        Raises:
            FileError: it cannot.
        """
        if self.path.is_dir():
            raise FileError(Said("{path} is a folder; name a file in it", path=self.path))
        if not self.path.parent.is_dir():
            raise FileError(
                Said("{folder} does not exist; name a folder that does", folder=self.path.parent)
            )
        if any(_same(self.path, one) for one in self.in_use):
            raise FileError(
                Said("{path} holds what is shown, and would be lost; name another", path=self.path)
            )
        if os.path.lexists(self.path) and not self.replace:
            raise FileError(
                Said(
                    "{path} exists already; name another, or replace it with {name}{overwrite}",
                    path=self.path,
                    name=self.path.name,
                    overwrite=OVERWRITE,
                )
            )
        if self.replace and self.path.exists() and not self.path.is_file():
            raise FileError(Said("{path} is no regular file; name another", path=self.path))


def _same(path: Path, other: str) -> bool:
    """Whether both are one file, by whatever names; a file that is gone is none."""
    try:
        return path.samefile(other)
    except OSError:
        return False


class Saving:
    """One file under way."""

    def __init__(self, target: Target, origin: Origin) -> None:
        """Begin the file.

        Args:
            target: where it is to lie.
            origin: where the rows come from.

        Raises:
            FileError: it cannot be made there.
        """
        target.check()
        self._target = target
        self._part = target.path.with_name(f"{target.path.name}.part")
        self.rows = 0
        """Rows written so far."""
        try:
            with self._part.open("xb"):
                pass
        except FileExistsError as error:
            raise FileError(
                Said("{path} is in the way; delete it, or name another", path=self._part)
            ) from error
        except OSError as error:
            raise self._refused(error) from error
        try:
            self._sink = self._made(origin)
        except (OSError, FteSniffError):
            self._part.unlink(missing_ok=True)
            raise

    def _made(self, origin: Origin) -> Sink:
        try:
            return FORMS[self._target.path.suffix.lower()](self._part, origin)
        except OSError as error:
            raise self._refused(error) from error

    @property
    def path(self) -> Path:
        """Where the file will lie."""
        return self._target.path

    def write(self, rows: Sequence[Row]) -> None:
        """Write the next rows.

        Raises:
            FileError: they cannot be written, or the form cannot hold them; nothing is left.
        """
        with self._all_or_nothing():
            self._sink.write(rows)
        self.rows += len(rows)

    def finish(self) -> None:
        """End the file, and give it its name.

        Raises:
            FileError: it cannot be ended, or a file of that name has come meanwhile; nothing is
                left.
        """
        with self._all_or_nothing():
            self._sink.end()
            self._target.check()
            self._part.replace(self._target.path)

    def abandon(self) -> None:
        """Leave nothing."""
        with suppress(OSError, FteSniffError):
            self._sink.abandon()
        with suppress(OSError):
            self._part.unlink(missing_ok=True)

    @contextmanager
    def _all_or_nothing(self) -> Iterator[None]:
        """What fails leaves nothing, and its error is one of ours."""
        try:
            yield
        except OSError as error:
            self.abandon()
            raise self._refused(error) from error
        except FteSniffError:
            self.abandon()
            raise

    def _refused(self, error: OSError) -> FileError:
        return FileError(
            Said(
                "{path} cannot be written: {reason}; name another place",
                path=self.path,
                reason=reason_of(error),
            )
        )
