"""Rows of every kind, and what a disk may do, for the tests of recordings and of their users."""

import os
import resource
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from fte_sniff.protocol.items import PortEvent
from fte_sniff.protocol.rows import Row, Rows
from fte_sniff.recording.metadata import PortFacts
from fte_sniff.recording.reader import Recording
from tests.recording import samples
from tests.recording.samples import START


def some_rows(count: int = 60, port: str = "/dev/ttyUSB0", start: int = START) -> list[Row]:
    """Rows that tile a stream: every kind, motor and topic, suspect frames and damage too."""
    rows = samples.some_rows(count, [PortFacts(port)])
    return [replace(row, t_ns=(row.t_ns or 0) + start - START) for row in rows]


def entries_in(path: Path) -> list[Row | PortEvent]:
    """The rows and events of a recording, in file order."""
    found: list[Row | PortEvent] = []
    for item in Recording(path).items():
        if isinstance(item, PortEvent):
            found.append(item)
        elif isinstance(item, Rows):
            found += item
    return found


@contextmanager
def unprivileged() -> Iterator[None]:
    """As a user whom permissions bind, also where the tests run as root."""
    root = os.geteuid() == 0
    if root:
        os.seteuid(65_534)
    try:
        yield
    finally:
        if root:
            os.seteuid(0)


@contextmanager
def file_size_limit(size: int) -> Iterator[None]:
    """In this context, and in processes started in it, no file can grow beyond `size` bytes."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
