"""Rows of every kind for the tests of recordings."""

import os
import resource
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest
from mcap.reader import make_reader

from fte_sniff.errors import FileError
from fte_sniff.protocol import KINDS, Damage, Fault, Frame, PortEvent, PortEventKind, Row, encode
from fte_sniff.protocol.rows import NO_TIME
from fte_sniff.recording.messages import TOPIC_BY_NAME, MessageReader
from fte_sniff.recording.metadata import PortFacts
from fte_sniff.recording.repair import Repair
from fte_sniff.recording.writer import RecordingWriter
from tests.support.columns import in_columns

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
        return Damage(port, offset, bytes(range(number % 30 + 1)), t_ns, (Fault.NOISE,), number)
    kind = KINDS[number % len(KINDS)]
    given = {"motor": number // len(KINDS) % 4 + 1, "error": 0, "online": 15}
    values = {field.name: given.get(field.name, number % 30_000 - 30) for field in kind.fields}
    raw = bytearray(encode(kind, values))
    if number % 13 == 12:
        raw[1] = 0x77
        return Frame(port, offset, bytes(raw), t_ns, (Fault.UNKNOWN_CMD,), number)
    faults = (Fault.AMBIGUOUS, Fault.LINE_ERROR) if number % 17 == 16 else ()
    return Frame(port, offset, bytes(raw), t_ns, faults, number)


@pytest.fixture
def make_rows() -> Callable[..., list[Row]]:
    return some_rows


@pytest.fixture
def recorded(tmp_path: Path) -> tuple[Path, list[Row], list[PortEvent]]:
    """A recording of three chunks, its rows and its events."""
    path = tmp_path / "recorded.mcap"
    rows = some_rows()
    port = rows[0].port
    events = [
        PortEvent(START - 5, port, PortEventKind.OPENED, "115200 8N1"),
        PortEvent(START + 10**9, port, PortEventKind.CLOSED, ""),
    ]
    with RecordingWriter(path, [PortFacts(port, 115_200)], {"host": "bench"}) as writer:
        writer.write(in_columns(events[0]))
        for start in range(0, len(rows), 20):
            writer.write(in_columns(rows[start : start + 20]))
            writer.flush()
        writer.write(in_columns(events[1]))
    return path, rows, events


def entry_of(reader: MessageReader, message: bytes, log_time: int) -> Row | PortEvent:
    """The row or event of one message, by protobuf; raises ValueError if it has none."""
    found = reader.read(message, log_time)
    if isinstance(found, PortEvent):
        return found
    t_ns, offset, delay_ns, framed, unordered, faults, raw = found
    made: type[Row] = Frame if framed else Damage
    delay = None if delay_ns == NO_TIME else delay_ns
    return made(reader.port, offset, raw, t_ns, faults, delay, unordered)


def entries_in(path: Path) -> list[Row | PortEvent]:
    """The rows and events, message by message, as the mcap package finds them in the file."""
    found: list[Row | PortEvent] = []
    with path.open("rb") as file:
        for schema, channel, message in make_reader(file).iter_messages(log_time_order=False):
            if channel.topic not in TOPIC_BY_NAME:
                continue
            assert schema is not None
            port = channel.metadata.get("port", path.name)
            reader = MessageReader(channel.topic, port, schema.name, schema.data)
            with suppress(ValueError):
                found.append(entry_of(reader, message.data, message.log_time))
    return found


def is_whole(path: Path) -> bool:
    try:
        return Repair(path).is_whole
    except FileError:
        return False


@pytest.fixture
def replaced() -> Callable[[bytes, bytes, bytes], bytes]:
    """Replace bytes by the same number of others, at least once."""

    def replace(content: bytes, old: bytes, new: bytes) -> bytes:
        assert len(old) == len(new)
        assert old in content
        return content.replace(old, new)

    return replace


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
