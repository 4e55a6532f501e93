"""Owns what a command that runs on says on standard error, and outputs that nobody takes.

It must not know any command. That something cannot be told never ends what a command does.
"""

from __future__ import annotations

import os
import select
import sys
from contextlib import suppress

import click

from fte_sniff.cli.streams.stdout import abandon
from fte_sniff.errors import shown


def tell(line: str) -> None:
    """Say one line on standard error; where that is refused, it and the lines to come are lost."""
    try:
        click.echo(shown(line), err=True)
    except OSError:
        abandon(sys.stderr.fileno())


def abandon_blocked() -> None:
    """Abandon standard output and standard error where a write would wait for their reader.

    To be called from a signal handler: the write that waits is then done over, and goes nowhere.
    """
    stdout, stderr = 1, 2
    if _blocked(stderr):
        abandon(stderr)
    if _blocked(stdout):
        abandon(stdout)
        with suppress(OSError):
            os.write(stderr, b"nobody takes the output; the rest of it is not printed\n")


def _blocked(descriptor: int) -> bool:
    poll = select.poll()
    poll.register(descriptor, select.POLLOUT)
    return not poll.poll(0)


def nobody_reads(descriptor: int) -> bool:
    """Whether a pipe has lost its reader."""
    poll = select.poll()
    poll.register(descriptor, 0)
    return any(event & select.POLLERR for _, event in poll.poll(0))
