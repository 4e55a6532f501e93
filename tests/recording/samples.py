"""Rows of every kind, and recordings of each way to write one."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

from mcap.opcode import Opcode

from fte_sniff.protocol.items import PortEvent, PortEventKind
from fte_sniff.protocol.rows import MOST_BYTES, Item, Row, Rows
from fte_sniff.protocol.spec import KINDS, Fault, encode
from fte_sniff.recording.chunks import HEAD, MAGIC
from fte_sniff.recording.metadata import PortFacts, host_facts
from fte_sniff.recording.reader import EVERYTHING, Recording, TimeRange
from fte_sniff.recording.recorder import Recorder, RecordingOptions
from fte_sniff.recording.writer import BulkWriter, RecordingWriter
from tests.support.columns import rows_from

START = 1_770_000_000_000_000_000
STEP = 868_000
FIRST, SECOND = PortFacts("/dev/ttyUSB0", 115_200), PortFacts("串口 B", 57_600)
BOTH = [FIRST, SECOND]
FACTS = host_facts(START)


def some_rows(count: int = 60, ports: Sequence[PortFacts] = (FIRST,)) -> list[Row]:
    """Rows that tile the streams of these ports in turn: every kind, motor, topic and fault."""
    rows: list[Row] = []
    offsets = dict.fromkeys(ports, 0)
    for number in range(count):
        port = ports[number % len(ports)]
        row = _row(number, port.name, offsets[port], START + number * STEP)
        offsets[port] += len(row.raw)
        rows.append(row)
    return rows


def _row(number: int, port: str, offset: int, t_ns: int) -> Row:
    if number % 11 == 10:
        raw = bytes(range(number % MOST_BYTES + 1))
        return Row(port, offset, raw, t_ns, (Fault.NOISE,), framed=False, delay_ns=number)
    kind = KINDS[number % len(KINDS)]
    given = {"motor": number // len(KINDS) % 4 + 1, "error": 0, "online": 15}
    values = {field.name: given.get(field.name, number % 30_000 - 30) for field in kind.fields}
    raw = bytearray(encode(kind, values))
    if number % 13 == 12:
        raw[1] = 0x77
        return Row(port, offset, bytes(raw), t_ns, (Fault.UNKNOWN_CMD,), delay_ns=number)
    faults = (Fault.AMBIGUOUS, Fault.LINE_ERROR) if number % 17 == 16 else ()
    delay = None if number % 19 == 18 else number
    return Row(port, offset, bytes(raw), t_ns, faults, delay_ns=delay, unordered=number % 7 == 6)


EVENTS = [
    PortEvent(START - 5, FIRST.name, PortEventKind.OPENED, "115200 8N1"),
    PortEvent(START + 30 * STEP + 5, FIRST.name, PortEventKind.LINE_ERROR, "2 framing", 2),
    PortEvent(START + 10**12, FIRST.name, PortEventKind.CLOSED, ""),
]


def whole(rows: Sequence[Row]) -> list[tuple[object, ...]]:
    """Rows with the values that their comparison leaves out."""
    return [(row, row.delay_ns, row.unordered) for row in rows]


def rows_of(items: Iterable[Item]) -> list[Row]:
    """The rows of some items."""
    return [row for item in items if isinstance(item, Rows) for row in item]


def rows_in(path: Path, span: TimeRange = EVERYTHING) -> list[Row]:
    """The rows of a recording."""
    return rows_of(Recording(path).items(span))


def events_in(path: Path) -> list[PortEvent]:
    """The port events of a recording."""
    return [item for item in Recording(path).items() if isinstance(item, PortEvent)]


def flush_each(writer: RecordingWriter | Recorder, rows: Sequence[Row], size: int = 40) -> None:
    """Write and flush so many rows at a time."""
    for start in range(0, len(rows), size):
        writer.write(rows_from(rows[start : start + size]))
        writer.flush()


def write(path: Path, rows: Sequence[Row], ports: Sequence[PortFacts], size: int = 40) -> None:
    """Write rows as a capture does."""
    with RecordingWriter(path, ports, FACTS) as writer:
        flush_each(writer, rows, size)


def under_way(path: Path) -> None:
    """Write the file of a capture that was killed."""
    writer = RecordingWriter(path, BOTH, FACTS)
    flush_each(writer, some_rows(400, BOTH))
    writer.output.close()


def bulk(path: Path) -> None:
    """Write as `decode -o` does, but for the size of chunks."""
    with path.open("wb") as file:
        writer = BulkWriter(file.fileno(), [FIRST])
        rows = some_rows(400, BOTH)
        for start in range(0, len(rows), 40):
            writer.write(rows_from(rows[start : start + 40]))
            writer.flush()
        writer.close()


def rotated(path: Path) -> None:
    """Write the second file of a capture."""
    recorder = Recorder(path, BOTH, FACTS, options=RecordingOptions(rotate_bytes=20_000))
    flush_each(recorder, some_rows(900, BOTH))
    recorder.close()
    path.write_bytes(path.with_stem(f"{path.stem}_00002").read_bytes())


WAYS: dict[str, Callable[[Path], None]] = {
    "one port": lambda path: write(path, some_rows(400), [FIRST]),
    "two ports": lambda path: write(path, some_rows(400, BOTH), BOTH),
    "port added last": lambda path: write(
        path, some_rows(320) + some_rows(400, BOTH)[320:], [FIRST]
    ),
    "chunks below a sector": lambda path: write(path, some_rows(24, BOTH), BOTH, 2),
    "under way": under_way,
    "bulk": bulk,
    "rotated": rotated,
}


@dataclass(frozen=True)
class Recorded:
    """An intact file, and the rows of each chunk by its start and end."""

    content: bytes
    chunks: dict[tuple[int, int], list[Row]]

    @property
    def rows(self) -> list[Row]:
        """All of them."""
        return [row for rows in self.chunks.values() for row in rows]

    def left(self, damaged: bytes) -> list[Row]:
        """The rows of the chunks that are whole in a damaged file, wherever they are in it."""
        return [
            row
            for (start, end), rows in self.chunks.items()
            if self.content[start:end] in damaged
            for row in rows
        ]


@cache
def recorded(way: str) -> Recorded:
    """A file that was written in this way."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "x.mcap"
        WAYS[way](path)
        recording = Recording(path)
        chunks = {
            (one.start, one.stop): rows_of(recording.read([one]))
            for one in recording.contents.chunks
        }
        return Recorded(path.read_bytes(), chunks)


def records(content: bytes) -> Iterator[tuple[int, int, int]]:
    """Opcode, start and end of each record of a whole file."""
    at = len(MAGIC)
    while at < len(content) - len(MAGIC):
        opcode, length = HEAD.unpack_from(content, at)
        yield opcode, at, at + HEAD.size + length
        at += HEAD.size + length


def heads_of(content: bytes, opcode: Opcode) -> list[int]:
    """The starts of the records of a kind."""
    return [start for own, start, _ in records(content) if own == opcode]
