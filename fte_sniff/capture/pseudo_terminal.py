"""Owns a pseudo-terminal that other programs open as if it were a port, and the link to it.

It must not know what is carried through it.
"""

from __future__ import annotations

import contextlib
import os
import tty
from pathlib import Path

from fte_sniff.errors import FileError, shown

_DEVICES = "/dev/pts/"


class PseudoTerminal:
    """A device for other programs, raw from the start, and its other end in `descriptor`."""

    def __init__(self, link: Path | None = None) -> None:
        """Make the device, and `link` to it where asked.

        Raises:
            FileError: something is in the way of `link`, or it cannot be made.
        """
        if link is not None:
            # Before there is a device: it would often get the number that a left link leads to.
            _remove_left_over(link)
        self.descriptor, theirs = os.openpty()
        """Our end; it does not block."""
        os.set_blocking(self.descriptor, False)
        # Raw, so that nothing is echoed; then let go, so that it shows whether anyone listens.
        tty.setraw(theirs)
        self.device = os.ttyname(theirs)
        """The device file that programs open, as `/dev/pts/3`."""
        os.close(theirs)
        self._link: Path | None = None
        try:
            self._make(link)
        except FileError:
            os.close(self.descriptor)
            raise

    @property
    def name(self) -> str:
        """What people are told to open: the link, or else the device."""
        return self.device if self._link is None else str(self._link)

    def close(self) -> None:
        """Take away the device and, if it still leads there, the link."""
        if self._link is not None:
            with contextlib.suppress(OSError):
                if str(self._link.readlink()) == self.device:
                    self._link.unlink()
        os.close(self.descriptor)

    def _make(self, link: Path | None) -> None:
        if link is None:
            return
        try:
            link.symlink_to(self.device)
        except FileExistsError:
            named = shown(str(link))
            raise FileError(f"{named} is in the way: remove it, or name another") from None
        except (OSError, ValueError) as error:
            raise _refusal(link, error) from error
        self._link = link


def _remove_left_over(link: Path) -> None:
    """Remove a link that a killed run left: one to a pseudo-terminal that is gone."""
    try:
        if link.is_symlink() and str(link.readlink()).startswith(_DEVICES) and not link.exists():
            link.unlink()
    except (OSError, ValueError) as error:
        raise _refusal(link, error) from error


def _refusal(link: Path, error: OSError | ValueError) -> FileError:
    told = error.strerror if isinstance(error, OSError) else error
    return FileError(f"{shown(str(link))} cannot be made: {told}")
