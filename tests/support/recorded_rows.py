"""Rows of two wires at full line rate; the events of a recording."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from fte_sniff.protocol.items import PortEvent
from fte_sniff.protocol.rows import Row, Rows
from fte_sniff.protocol.spec import DEFAULT_BAUD, FRAME_LENGTH, KIND_BY_NAME, byte_time_ns, encode
from fte_sniff.recording.metadata import PortFacts
from fte_sniff.recording.reader import Recording
from fte_sniff.recording.writer import BulkWriter
from tests.support.columns import rows_from

PORTS = ("/dev/ttyUSB0", "/dev/ttyUSB1")
START_NS = 1_770_000_000_000_000_000
_FRAME_NS = FRAME_LENGTH * byte_time_ns(DEFAULT_BAUD)
_SECOND_NS = 1_000_000_000
_KINDS = {PORTS[0]: ("speed", "position", "mecanum"), PORTS[1]: ("speed_feedback",) * 3}


def events_in(reader: Recording) -> list[PortEvent]:
    """The port events, in file order."""
    return [item for item in reader.items() if isinstance(item, PortEvent)]


def rows_of(first: int, count: int) -> list[Row]:
    """`count` frames of each wire from number `first` on, in order of time."""
    rows: list[Row] = []
    for number in range(first, first + count):
        rows += [recorded_row(port, number) for port in PORTS]
    return rows


def rows_a_second() -> int:
    """Frames a second of one full wire."""
    return _SECOND_NS // _FRAME_NS


def recorded_row(port: str, number: int) -> Row:
    """The frame of a wire with this number."""
    kind = KIND_BY_NAME[_KINDS[port][number // 4 % 3]]
    given = {"motor": number % 4 + 1, "error": 0, "online": 15}
    values = {field.name: given.get(field.name, number % 3000 - 1500) for field in kind.fields}
    offset, t_ns = number * FRAME_LENGTH, START_NS + number * _FRAME_NS
    return Row(
        port, offset, encode(kind, values), t_ns, (), delay_ns=1_000_000 + number % 997 * 1000
    )


def write_recording(
    path: Path,
    ports: Sequence[PortFacts],
    batches: Iterable[Rows],
    facts: Mapping[str, str] | None = None,
    events: Iterable[PortEvent] = (),
) -> None:
    """Write a recording of batches, and of events with the first; raises as `BulkWriter`."""
    with path.open("xb", buffering=0) as file:
        writer = BulkWriter(file.fileno(), ports, facts)
        for batch in batches:
            writer.write(batch, *events)
            events = ()
        writer.close()


GAP_NS = 10_000_000


def make_recordings(folder: Path, files: int, rows: int) -> None:
    """Write recordings of the same rows, each after the one before."""
    batch = rows_from(rows_of(0, rows // 2))
    span_ns = int(batch.t_ns[-1]) - START_NS + GAP_NS
    for number in range(files):
        shifted = batch.replace(t_ns=batch.t_ns + number * span_ns)
        write_recording(
            folder / f"{number:05}.mcap", [PortFacts(name) for name in PORTS], [shifted]
        )
