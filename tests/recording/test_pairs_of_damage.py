"""Two damages of one sector each cost at most the chunks that they hit."""

import random
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.records import Channel, Chunk, Message, Schema
from mcap.stream_reader import StreamReader, breakup_chunk
from polars import DataFrame

from fte_sniff.errors import FileError, RecordingWarning
from fte_sniff.protocol import Row
from fte_sniff.protocol.rows import Codebook, Rows
from fte_sniff.recording import writer as writer_module
from fte_sniff.recording.mcap.writer import McapFile
from fte_sniff.recording.messages import MessageReader
from fte_sniff.recording.metadata import PortFacts, host_facts
from fte_sniff.recording.output_file import Existing
from fte_sniff.recording.reader import RecordingReader
from fte_sniff.recording.recorder import Recorder
from fte_sniff.recording.repair import Repair
from fte_sniff.recording.retention import RecordingOptions
from fte_sniff.recording.writer import BulkWriter, RecordingWriter
from fte_sniff.session.scan import read, scan
from tests.examples import examples
from tests.recording.conftest import START, entry_of, some_rows
from tests.slow import first
from tests.support.columns import in_columns
from tests.torture.damage import records

SECTOR = 512
CHUNK, DATA_END = 6, 15
FIRST, SECOND = PortFacts("/dev/ttyUSB0", 115_200), PortFacts("串口 B", 57_600)
FACTS = host_facts(START)


def _rows(count: int, ports: Sequence[PortFacts]) -> list[Row]:
    rows = some_rows(count, FIRST.name)
    return [replace(row, port=ports[n % len(ports)].name) for n, row in enumerate(rows)]


def _live(path: Path, rows: Sequence[Row], ports: Sequence[PortFacts], chunk: int = 40) -> None:
    with RecordingWriter(path, ports, FACTS) as writer:
        for start in range(0, len(rows), chunk):
            writer.write(in_columns(rows[start : start + chunk]))
            writer.flush()


def _one_port(path: Path) -> None:
    _live(path, _rows(400, [FIRST]), [FIRST])


def _two_ports(path: Path) -> None:
    _live(path, _rows(400, [FIRST, SECOND]), [FIRST, SECOND])


def _port_added_later(path: Path) -> None:
    rows = _rows(200, [FIRST]) + _rows(400, [FIRST, SECOND])[200:]
    _live(path, rows, [FIRST])


def _port_added_last(path: Path) -> None:
    """The second port has its definitions in the last chunk but one."""
    rows = _rows(320, [FIRST]) + _rows(400, [FIRST, SECOND])[320:]
    _live(path, rows, [FIRST])


def _short_chunks(path: Path) -> None:
    """Chunks that are shorter than a sector, so that one damage hits several."""
    _live(path, _rows(24, [FIRST, SECOND]), [FIRST, SECOND], 2)


def _under_way(path: Path) -> None:
    writer = RecordingWriter(path.with_suffix(".live"), [FIRST, SECOND], FACTS)
    rows = _rows(400, [FIRST, SECOND])
    for start in range(0, len(rows), 40):
        writer.write(in_columns(rows[start : start + 40]))
        writer.flush()
    path.write_bytes(path.with_suffix(".live").read_bytes())
    writer.close()


def _bulk(path: Path) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(writer_module, "CHUNK_ROWS", 40)
        writer = BulkWriter(path, [FIRST], {})
        writer.write(Rows.from_rows(_rows(200, [FIRST])))
        writer.write(Rows.from_rows(_rows(400, [FIRST, SECOND])[200:]))
        writer.close()


def _rotated(path: Path) -> None:
    options = RecordingOptions(rotate_bytes=20_000)
    recorder = Recorder(path, [FIRST, SECOND], FACTS, options=options)
    rows = _rows(600, [FIRST, SECOND])
    for start in range(0, len(rows), 40):
        recorder.write(in_columns(rows[start : start + 40]))
        recorder.flush()
    recorder.close()
    path.write_bytes(path.with_stem(f"{path.stem}_00002").read_bytes())


def _repaired(path: Path) -> None:
    damaged = path.with_suffix(".damaged")
    _two_ports(damaged)
    data = bytearray(damaged.read_bytes())
    chunk = next(start for opcode, start, _ in records(bytes(data)) if opcode == CHUNK)
    data[chunk + 200] ^= 1
    damaged.write_bytes(data)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(writer_module, "CHUNK_ROWS", 40)
        Repair(damaged).write(path, Existing.REPLACE)


FILES = {
    "one port": _one_port,
    "two ports": _two_ports,
    "port added later": _port_added_later,
    "port added last": _port_added_last,
    "short chunks": _short_chunks,
    "under way": _under_way,
    "bulk": _bulk,
    "rotated": _rotated,
    "repaired": _repaired,
}


@dataclass(frozen=True)
class Recorded:
    """An intact file, and the rows of each chunk by its start and end."""

    content: bytes
    chunks: dict[tuple[int, int], list[Row]]

    def left(self, damaged: bytes) -> list[Row]:
        """The rows of the chunks that are the same in a damaged file."""
        return [
            row
            for (start, end), rows in self.chunks.items()
            if damaged[start:end] == self.content[start:end]
            for row in rows
        ]


def _chunks_of(path: Path) -> Iterator[list[Row]]:
    """The rows of each chunk, as the mcap package finds them."""
    schemas: dict[int, Schema] = {}
    channels: dict[int, Channel] = {}
    with path.open("rb") as stream:
        for record in StreamReader(stream, emit_chunks=True).records:
            if not isinstance(record, Chunk):
                continue
            rows = []
            for one in breakup_chunk(record):
                if isinstance(one, Schema):
                    schemas[one.id] = one
                elif isinstance(one, Channel):
                    channels[one.id] = one
                elif isinstance(one, Message):
                    channel = channels[one.channel_id]
                    schema, port = schemas[channel.schema_id], channel.metadata["port"]
                    reader = MessageReader(channel.topic, port, schema.name, schema.data)
                    rows.append(entry_of(reader, one.data, one.log_time))
            yield rows


@cache
def recorded(name: str, copies: bool) -> Recorded:
    """A file of this kind; without copies of its ports, as earlier versions wrote it."""
    with TemporaryDirectory() as folder, pytest.MonkeyPatch.context() as patch:
        path = Path(folder) / "x.mcap"
        if not copies:
            patch.setattr(McapFile, "_copy_at", lambda *_: b"")
        FILES[name](path)
        content = path.read_bytes()
        spans = [(start, end) for opcode, start, end in records(content) if opcode == CHUNK]
        return Recorded(content, dict(zip(spans, _chunks_of(path), strict=True)))


def _damages(content: bytes) -> st.SearchStrategy[tuple[int, bytes]]:
    """Position and bytes of one damaged sector, or a part of it; mostly at the head of a record."""
    heads = [0, *(start for _, start, _ in records(content)), len(content) - 1]
    ends = [head for head in heads if head < 6_000 or head > len(content) - 6_000]
    position = st.one_of(
        st.integers(0, len(content) - 1),
        st.tuples(st.sampled_from(heads + 3 * ends), st.integers(-SECTOR, 40)).map(sum),
    ).map(lambda at: min(max(at, 0), len(content) - 1))
    size = st.sampled_from((1, 1, 16, 200, SECTOR))
    junk = st.one_of(
        size.map(bytes),
        size.map(lambda count: b"\xff" * count),
        size.map(lambda count: random.Random(count).randbytes(count)),
    )
    return st.tuples(position, junk)


def _with(content: bytes, *damages: tuple[int, bytes]) -> bytes:
    found = bytearray(content)
    for position, junk in damages:
        junk = junk[: len(content) - position]
        if found[position : position + len(junk)] == junk:
            junk = bytes(byte ^ 0x55 for byte in junk)
        found[position : position + len(junk)] = junk
    return bytes(found)


def _check(one: Recorded, damaged: bytes, path: Path) -> None:
    path.write_bytes(damaged)
    left, every = one.left(damaged), [row for rows in one.chunks.values() for row in rows]
    try:
        reader = RecordingReader(path)
        found = [row for batch in reader.batches() for row in batch]
    except FileError:
        assert not left
        return
    known = {(row.port, row.offset): row for row in every}
    assert [known.get((row.port, row.offset)) for row in found] == found
    missing = set(left) - set(found)
    assert not missing, f"{len(missing)} of {len(left)} rows: {reader.losses}, {reader.ending}"
    assert (reader.nothing_read is not None) <= (not found)


@pytest.mark.parametrize(
    ("name", "copies"),
    # Without copies as earlier versions wrote them.
    first(len(FILES) + 3, [(name, copies) for copies in (True, False) for name in FILES]),
)
def test_two_damaged_sectors_cost_at_most_their_chunks(
    name: str, copies: bool, tmp_path: Path
) -> None:
    one, path = recorded(name, copies), tmp_path / "damaged.mcap"

    @examples(20)
    @given(_damages(one.content), _damages(one.content))
    def check(first: tuple[int, bytes], second: tuple[int, bytes]) -> None:
        _check(one, _with(one.content, first, second), path)

    check()


@pytest.mark.parametrize("name", FILES)
def test_a_damaged_sector_and_a_cut_end_cost_at_most_their_chunks(
    name: str, tmp_path: Path
) -> None:
    one, path = recorded(name, True), tmp_path / "damaged.mcap"
    third = [start for start, _ in one.chunks][2]

    @examples(20)
    @given(_damages(one.content), st.integers(third, len(one.content) - 1))
    def check(damage: tuple[int, bytes], size: int) -> None:
        _check(one, _with(one.content, damage)[:size], path)

    check()


def _first_chunk_and_summary(one: Recorded) -> bytes:
    """The file with a byte damaged in its first chunk, and one in its summary."""
    (first, end), *_ = one.chunks
    summary = next(start for opcode, start, _ in records(one.content) if opcode == DATA_END) + 20
    return _with(one.content, ((first + end) // 2, b"?"), (summary, b"?"))


def _rows_of(table: DataFrame) -> list[tuple[str, int, str]]:
    return table.select("port", "offset", "raw").rows()


@pytest.mark.parametrize("name", FILES)
def test_every_reader_reads_what_two_damages_leave(name: str, tmp_path: Path) -> None:
    one = recorded(name, True)
    path, mended = tmp_path / "damaged.mcap", tmp_path / "mended.mcap"
    path.write_bytes(_first_chunk_and_summary(one))
    rows = one.left(path.read_bytes())
    found = [(row.port, row.offset, row.raw.hex().upper()) for row in rows]
    with pytest.warns(RecordingWarning):
        assert _rows_of(read(path)) == found
    with pytest.warns(RecordingWarning):
        assert _rows_of(scan(path).collect()) == found
    reader = RecordingReader(path)
    pages = [reader.read(part) for part, _ in reader.ranges()]
    assert [row for page in pages for row in page] == rows
    growing = RecordingReader(path, growing=True)
    batches = [*growing.added(Codebook())]
    growing.settle()
    batches += growing.added(Codebook())
    assert [row for _, batch in batches for row in batch] == rows
    Repair(path).write(mended, Existing.REPLACE)
    reader = RecordingReader(mended)
    assert list(reader) == rows
    assert reader.is_whole
    path.write_bytes(one.content)
    assert set(reader.ports) == set(RecordingReader(path).ports)
