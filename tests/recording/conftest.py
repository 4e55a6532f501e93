"""Rows of every kind, and what a disk may do, for the tests of recordings and of their users."""

import os
import resource
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from fte_sniff.protocol import KINDS, Fault, PortEvent, Row, Rows, encode
from fte_sniff.recording.reader import Recording

START = 1_770_000_000_000_000_000
STEP = 868_000


def some_rows(count: int = 60, port: str = "/dev/ttyUSB0", start: int = START) -> list[Row]:
    """Rows that tile a stream: every kind, motor and topic, suspect frames and damage too."""
    rows: list[Row] = []
    offset = 0
    for number in range(count):
        row = _row(number, port, offset, start + number * STEP)
        offset += len(row.raw)
        rows.append(row)
    return rows


def _row(number: int, port: str, offset: int, t_ns: int) -> Row:
    if number % 11 == 10:
        return Row(port, offset, bytes(range(number % 16 + 1)), t_ns, (Fault.NOISE,), False, number)
    kind = KINDS[number % len(KINDS)]
    given = {"motor": number // len(KINDS) % 4 + 1, "error": 0, "online": 15}
    values = {field.name: given.get(field.name, number % 30_000 - 30) for field in kind.fields}
    raw = bytearray(encode(kind, values))
    if number % 13 == 12:
        raw[1] = 0x77
        return Row(port, offset, bytes(raw), t_ns, (Fault.UNKNOWN_CMD,), True, number)
    faults = (Fault.AMBIGUOUS, Fault.LINE_ERROR) if number % 17 == 16 else ()
    return Row(port, offset, bytes(raw), t_ns, faults, True, number)


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
