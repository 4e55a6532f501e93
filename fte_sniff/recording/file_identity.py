"""Identity of a file that was written here, and its deletion if the path still leads to it.

Another program may put its own file on the name at any time, or overwrite ours. So a file is known
by its descriptor: device and inode, its size, and its last bytes, which hold the checksum of the
summary, for inodes are used again. Times do not count: `touch` does not make a file another one.

    compare | rename to a private name | compare | delete
                                                 | or give the name back

Between the first comparison and the rename another file may get the name; the second comparison
finds it, because nobody else uses the private name.
"""

from __future__ import annotations

import os
import stat
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from secrets import token_hex

from fte_sniff.platform import open_flags, read_at

_END = 64
"""Bytes at the end of a recording that are compared: footer, checksum and magic."""


@dataclass(frozen=True, slots=True)
class FileIdentity:
    """A file that is closed."""

    device: int
    inode: int
    size: int
    end: bytes
    """Its last bytes."""

    @classmethod
    def of(cls, descriptor: int) -> FileIdentity:
        """The file of an open descriptor; raises OSError if it cannot be read."""
        found = os.fstat(descriptor)
        end = read_at(descriptor, _END, max(0, found.st_size - _END))
        return cls(found.st_dev, found.st_ino, found.st_size, end)

    def is_at(self, path: Path) -> bool:
        """Whether a path leads to this file; a symbolic link does not.

        Raises OSError if the file there cannot be read.
        """
        try:
            found = path.lstat()
        except (FileNotFoundError, NotADirectoryError):
            return False
        if not stat.S_ISREG(found.st_mode) or found.st_size != self.size:
            return False
        if (found.st_dev, found.st_ino) != (self.device, self.inode):
            return False
        try:
            descriptor = os.open(path, open_flags("O_NOFOLLOW", "O_NONBLOCK", "O_CLOEXEC"))
        except FileNotFoundError:
            return False
        try:
            return FileIdentity.of(descriptor) == self
        finally:
            os.close(descriptor)

    def delete(self, path: Path) -> bool:
        """Delete the file; False if another one, or none, is there, which is left alone.

        Raises OSError if it cannot be deleted.
        """
        if not self.is_at(path):
            return False
        private = path.with_name(f".fte-sniff-{token_hex(8)}{path.suffix}")
        try:
            path.rename(private)
        except FileNotFoundError:
            return False
        if not self.is_at(private):
            _give_back(private, path)
            return False
        try:
            private.unlink()
        except OSError:
            _give_back(private, path)
            raise
        sync_folder(path.parent)
        return True


def _give_back(private: Path, path: Path) -> None:
    """Rename a file back; if its name is taken already, it keeps the private one."""
    with suppress(OSError):
        os.link(private, path, follow_symlinks=False)
        private.unlink()
        return
    if not os.path.lexists(path):  # a file system without hard links
        with suppress(OSError):
            private.rename(path)


def delete_own(path: Path, own: os.stat_result) -> None:
    """Delete the file of a descriptor if the path still leads to it; errors are ignored."""
    with suppress(OSError):
        if os.path.samestat(path.lstat(), own):
            path.unlink()
            sync_folder(path.parent)


def sync_folder(folder: Path) -> None:
    """Push a new, changed or deleted name to the disk, where the file system can do that."""
    with suppress(OSError):
        descriptor = os.open(folder, open_flags("O_CLOEXEC"))
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
