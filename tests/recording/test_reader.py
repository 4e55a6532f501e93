"""Recordings read back: batches, single rows, time ranges, files of other writers."""

import multiprocessing
import os
import tempfile
import threading
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.data_stream import RecordBuilder
from mcap.reader import make_reader
from mcap.records import Channel, DataEnd, Footer, Message, Schema
from mcap.stream_reader import StreamReader
from mcap.writer import MCAP0_MAGIC, CompressionType, IndexType, Writer

from fte_sniff.protocol import (
    HEADERS,
    KINDS,
    TAIL,
    Damage,
    Fault,
    Frame,
    PortEvent,
    PortEventKind,
    Row,
    encode,
)
from fte_sniff.protocol.rows import NO_TIME
from fte_sniff.recording.mcap.reader import cores
from fte_sniff.recording.metadata import PortFacts
from fte_sniff.recording.reader import JOB, RecordingReader, TimeRange
from fte_sniff.recording.writer import RecordingWriter
from tests.recording.conftest import entries_in, some_rows
from tests.support.columns import in_columns
from tests.support.recorded_rows import events_in
from tests.waiting import BOUND_S

Recorded = tuple[Path, list[Row], list[PortEvent]]
MakeRows = Callable[..., list[Row]]
WithDelays = Callable[[list[Row]], list[tuple[Row, int | None]]]

PORTS = ("/dev/ttyUSB0", "loop://", "串口 \x1b[31m[bold]")
times = st.integers(0, 2**63 - 1) | st.integers(1000, 1020)
delays = st.none() | st.integers(NO_TIME + 1, 2**63 - 1)
offsets = st.integers(0, 2**63 - 1)
faults = st.just(()) | st.lists(st.sampled_from(Fault), unique=True, max_size=4).map(tuple)


@st.composite
def frame_bytes(draw: st.DrawFn) -> bytes:
    if draw(st.booleans()):
        header = draw(st.sampled_from(list(HEADERS.values())))
        return bytes([header]) + draw(st.binary(min_size=8, max_size=8)) + bytes([TAIL])
    kind = draw(st.sampled_from(KINDS))
    values = {field.name: draw(st.integers(field.low, field.high)) for field in kind.fields}
    return encode(kind, values, draw(st.sampled_from(kind.cmds)))


orders = st.booleans()
frames = st.builds(
    Frame, st.sampled_from(PORTS), offsets, frame_bytes(), times, faults, delays, orders
)
damage = st.builds(
    Damage,
    st.sampled_from(PORTS),
    offsets,
    st.binary(min_size=1, max_size=40) | st.integers(1, 1024).map(lambda n: bytes(n)),
    times,
    faults,
    delays,
    orders,
)
events = st.builds(
    PortEvent,
    times,
    st.sampled_from(PORTS),
    st.sampled_from(PortEventKind),
    st.text(st.characters(codec="utf-8"), max_size=20),
    st.integers(0, 2**63),
)
Entry = Row | PortEvent


def _record(path: Path, batches: list[list[Entry]], ports: tuple[str, ...]) -> None:
    with RecordingWriter(path, [PortFacts(port) for port in ports]) as writer:
        for batch in batches:
            for entry in batch:
                if isinstance(entry, PortEvent):
                    writer.write(in_columns(entry))
                else:
                    writer.write(in_columns([entry]))
            writer.flush()


def _with_delay(entry: Entry) -> tuple[Entry, int | None, bool]:
    """An entry, and the attributes that rows ignore when they compare."""
    if isinstance(entry, PortEvent):
        return entry, None, False
    return entry, entry.read_delay_ns, entry.order_uncertain


@given(
    st.lists(st.lists(st.one_of(frames, damage, events), max_size=12), max_size=4),
    st.sampled_from([PORTS, PORTS[:1], ()]),
)
def test_rows_and_events_are_read_back_as_written(
    batches: list[list[Entry]], ports: tuple[str, ...]
) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "x.mcap"
        _record(path, batches, ports)
        reader = RecordingReader(path)
        found = entries_in(path)
        read = list(reader)
        read_events = events_in(reader)
        assert (reader.ending, reader.losses) == ("", ())
        with path.open("rb") as file:
            log_times = [
                message.log_time
                for _, _, message in make_reader(file, validate_crcs=True).iter_messages()
            ]
    assert [_with_delay(row) for row in read] == [
        _with_delay(entry) for entry in found if not isinstance(entry, PortEvent)
    ]
    assert read_events == [entry for entry in found if isinstance(entry, PortEvent)]
    given_entries = [entry for batch in batches for entry in batch]
    for port in PORTS:
        assert [_with_delay(entry) for entry in found if entry.port == port] == [
            _with_delay(entry) for entry in given_entries if entry.port == port
        ]
    assert log_times == sorted(log_times)
    assert len(log_times) == len(found)


def test_rows_of_interleaved_ports_are_sorted_by_time(tmp_path: Path) -> None:
    kind = KINDS[0]
    raw = encode(kind, {})
    left = [Frame("left", 10 * n, raw, 1000 + 20 * n) for n in range(5)]
    right = [Frame("right", 10 * n, raw, 1010 + 20 * n) for n in range(5)]
    path = tmp_path / "two.mcap"
    with RecordingWriter(path, [PortFacts("left"), PortFacts("right")]) as writer:
        writer.write(in_columns(left))
        writer.write(in_columns(right))
    found = list(RecordingReader(path))
    assert [row.t_ns for row in found] == list(range(1000, 1100, 10))
    with path.open("rb") as file:
        messages = [message for _, _, message in make_reader(file).iter_messages()]
    assert [m.log_time for m in messages] == [m.publish_time for m in messages]
    assert [m.log_time for m in messages] == list(range(1000, 1100, 10))


def test_a_row_that_comes_after_its_chunk_keeps_its_own_time(tmp_path: Path) -> None:
    raw = encode(KINDS[0], {})
    path = tmp_path / "late.mcap"
    with RecordingWriter(path, []) as writer:
        writer.write(in_columns([Frame("a", 0, raw, 5000)]))
        writer.flush()
        writer.write(in_columns(Frame("b", 0, raw, 4000)))
    assert [row.t_ns for row in RecordingReader(path)] == [5000, 4000]
    with path.open("rb") as file:
        assert [m.log_time for _, _, m in make_reader(file).iter_messages()] == [5000, 5000]


def _columns(path: Path, span: TimeRange | None = None) -> tuple[list[Row], list[PortEvent]]:
    reader = RecordingReader(path)
    batches = list(reader.batches() if span is None else reader.batches(span=span))
    assert reader.losses == ()
    assert reader.ending == ""
    rows = [row for batch in batches for row in batch]
    return rows, [event for batch in batches for event in batch.events]


@pytest.fixture(scope="module")
def long(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, list[Row]]]:
    """A recording of many chunks, more than a batch, and the rows of its ports."""
    path = tmp_path_factory.mktemp("long") / "long.mcap"
    rows = {port: some_rows(30_000, port) for port in ("one", "two")}
    with RecordingWriter(path, [PortFacts(port) for port in rows]) as writer:
        for start in range(0, 30_000, 1000):
            for own in rows.values():
                writer.write(in_columns(own[start : start + 1000]))
            writer.flush()
    return path, rows


Long = tuple[Path, dict[str, list[Row]]]


def test_many_chunks_of_two_ports_stay_in_order(long: Long) -> None:
    """More than one batch, so that threads have something to bring out of order."""
    batches = list(RecordingReader(long[0]).batches())
    assert len(batches) > 1
    assert sum(len(batch) for batch in batches) > JOB // 200
    found = [row for batch in batches for row in batch]
    for port, rows in long[1].items():
        assert [row for row in found if row.port == port] == rows


def test_reading_again_starts_no_further_threads(long: Long) -> None:
    """The memory that the C library keeps for each thread would grow with the number of files."""
    threads: set[threading.Thread] = set()
    for _ in range(cores() + 1):
        for _ in RecordingReader(long[0]).batches():
            running = threading.enumerate()
            threads.update(one for one in running if one.name.startswith("unpacks chunks"))
    assert 0 < len(threads) <= cores()


@pytest.mark.skipif(not hasattr(os, "fork"), reason="this system cannot fork")
@pytest.mark.filterwarnings("ignore:.*fork:DeprecationWarning")
def test_a_forked_process_reads_with_threads_of_its_own(long: Long) -> None:
    def read_all() -> None:
        assert sum(len(batch) for batch in RecordingReader(long[0]).batches()) == 60_000

    read_all()
    child = multiprocessing.get_context("fork").Process(target=read_all)
    child.start()
    child.join(BOUND_S)
    child.kill()
    assert child.exitcode == 0


def test_rows_outside_a_time_range_are_omitted(recorded: Recorded) -> None:
    path, rows, events = recorded
    times = [row.t_ns or 0 for row in rows]
    for first, end in [
        (times[3], times[50]),
        (times[25], times[26]),
        (0, times[0]),
        (times[59], 2**63 - 1),
    ]:
        span = TimeRange(first, end)
        found, found_events = _columns(path, span)
        assert found == [row for row in rows if first <= (row.t_ns or 0) < end]
        assert found_events == [event for event in events if first <= event.t_ns < end]


def test_a_time_range_unpacks_only_the_chunks_that_it_overlaps(recorded: Recorded) -> None:
    """The first chunk is damaged, and it does not matter to rows of the last."""
    path, rows, _ = recorded
    content = bytearray(path.read_bytes())
    chunk = content.index(b"zstd")
    content[chunk + 40] ^= 0xFF
    path.write_bytes(content)
    found, _ = _columns(path, TimeRange(rows[45].t_ns or 0))
    assert found == rows[45:]


def test_no_thread_is_left_after_a_reader_is_closed_early(long: Long) -> None:
    before = set(threading.enumerate())
    batches = RecordingReader(long[0]).batches()
    next(batches)
    batches.close()
    assert before >= set(threading.enumerate())


def test_a_channel_that_a_skipped_chunk_defines_is_known(
    tmp_path: Path, make_rows: MakeRows
) -> None:
    """A port that was not named at first is defined where its first rows stand."""
    rows = make_rows(60)
    path = tmp_path / "unnamed.mcap"
    with RecordingWriter(path, []) as writer:
        for start in range(0, len(rows), 20):
            writer.write(in_columns(rows[start : start + 20]))
            writer.flush()
    found, _ = _columns(path, TimeRange(rows[45].t_ns or 0))
    assert found == rows[45:]
    content = path.read_bytes()
    path.write_bytes(content[: content.index(b"fte.MotorControl", len(content) // 2)])
    reader = RecordingReader(path)
    batches = list(reader.batches(span=TimeRange(rows[45].t_ns or 0)))
    assert [row for batch in batches for row in batch] == rows[45:]
    assert reader.losses == ()


def _rewritten(source: Path, target: Path, *, port: bool = True, **options: object) -> None:
    """Copy the messages with the mcap package's writer, with another's topic between them."""
    with source.open("rb") as file, target.open("wb") as out:
        writer = Writer(out, **options)  # type: ignore[arg-type]
        writer.start()
        foreign = writer.register_channel("/tf", "json", 0)
        schemas: dict[int, int] = {}
        channels: dict[int, int] = {}
        for schema, channel, message in make_reader(file).iter_messages():
            assert schema is not None
            if schema.id not in schemas:
                schemas[schema.id] = writer.register_schema(
                    schema.name, schema.encoding, schema.data
                )
            if channel.id not in channels:
                channels[channel.id] = writer.register_channel(
                    channel.topic,
                    channel.message_encoding,
                    schemas[schema.id],
                    channel.metadata if port else {},
                )
            time = message.log_time
            writer.add_message(channels[channel.id], time, message.data, time, message.sequence)
            writer.add_message(foreign, time, b"{}", time)
        writer.finish()


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"compression": CompressionType.LZ4},
        {"compression": CompressionType.NONE},
        {"use_chunking": False},
        {"use_chunking": False, "enable_data_crcs": True},
        {"chunk_size": 300, "enable_crcs": False},
        {"chunk_size": 300, "repeat_channels": False, "repeat_schemas": False},
        {"use_statistics": False, "use_summary_offsets": False},
        {"index_types": IndexType.NONE, "chunk_size": 300},
    ],
)
def test_other_writers_files_are_read(
    recorded: Recorded, tmp_path: Path, options: dict[str, object]
) -> None:
    path = tmp_path / "other.mcap"
    _rewritten(recorded[0], path, **options)
    reader = RecordingReader(path)
    found = list(reader)
    assert found == recorded[1]
    assert [row.read_delay_ns for row in found] == [row.read_delay_ns for row in recorded[1]]
    assert events_in(reader) == recorded[2]
    assert (reader.ending, reader.losses) == ("", ())


def test_without_a_port_name_the_file_name_is_used(recorded: Recorded, tmp_path: Path) -> None:
    path = tmp_path / "other.mcap"
    _rewritten(recorded[0], path, port=False)
    assert {row.port for row in RecordingReader(path)} == {"other.mcap"}


@pytest.mark.parametrize("options", [{}, {"use_chunking": False}])
def test_truncated_files_of_other_writers_are_read(
    recorded: Recorded, tmp_path: Path, options: dict[str, object]
) -> None:
    path = tmp_path / "other.mcap"
    _rewritten(recorded[0], path, chunk_size=300, **options)
    content = path.read_bytes()
    path.write_bytes(content[: len(content) // 2])
    reader = RecordingReader(path)
    found = list(reader)
    assert 0 < len(found) < len(recorded[1])
    assert found == recorded[1][: len(found)]
    assert (reader.ending, reader.losses) != ("", ())


def test_a_schema_without_a_needed_field_is_a_loss(
    recorded: Recorded, tmp_path: Path, replaced: Callable[[bytes, bytes, bytes], bytes]
) -> None:
    path = tmp_path / "other.mcap"
    _rewritten(recorded[0], path, compression=CompressionType.NONE, enable_crcs=False)
    path.write_bytes(replaced(path.read_bytes(), b"offset", b"beside"))
    reader = RecordingReader(path)
    assert list(reader) == []
    assert events_in(reader) == recorded[2]
    assert any(
        "/fte/control/motor1: its messages (fte.MotorControl) have no offset" in loss
        for loss in reader.losses
    )


def test_an_unknown_fault_is_a_loss(
    recorded: Recorded, tmp_path: Path, replaced: Callable[[bytes, bytes, bytes], bytes]
) -> None:
    path = tmp_path / "newer.mcap"
    _rewritten(recorded[0], path, compression=CompressionType.NONE, enable_crcs=False)
    path.write_bytes(replaced(path.read_bytes(), b"FAULT_NOISE", b"FAULT_NOVEL"))
    reader = RecordingReader(path)
    known = [row for row in recorded[1] if Fault.NOISE not in row.faults]
    assert list(reader) == known
    lost = len(recorded[1]) - len(known)
    assert reader.losses == (
        f"/fte/malformed: a word that this version does not know (number 7) ({lost} times)",
    )


def test_a_channel_may_be_described_after_its_first_messages(
    recorded: Recorded, tmp_path: Path
) -> None:
    with recorded[0].open("rb") as file:
        records = list(StreamReader(file, validate_crcs=True).records)
    definitions = [record for record in records if isinstance(record, Schema | Channel)]
    messages = [record for record in records if isinstance(record, Message)]
    builder = RecordBuilder()
    for record in (*messages[:5], *definitions, *messages[5:], DataEnd(0), Footer(0, 0, 0)):
        record.write(builder)
    path = tmp_path / "late.mcap"
    path.write_bytes(MCAP0_MAGIC + builder.end() + MCAP0_MAGIC)
    reader = RecordingReader(path)
    assert list(reader) == recorded[1]
    assert reader.losses == ()


def test_repeated_and_foreign_definitions_hide_no_rows(recorded: Recorded, tmp_path: Path) -> None:
    with recorded[0].open("rb") as file:
        records = list(StreamReader(file, validate_crcs=True).records)
    definitions = [record for record in records if isinstance(record, Schema | Channel)]
    messages = [record for record in records if isinstance(record, Message)]
    foreign = [
        Schema(id=number, data=b"", encoding="", name=f"other{number}")
        for number in range(1000, 4000)
    ]
    builder = RecordBuilder()
    all_definitions = [*foreign, *definitions * 300]
    for record in (*all_definitions, *messages, DataEnd(0), Footer(0, 0, 0)):
        record.write(builder)
    path = tmp_path / "repeated.mcap"
    path.write_bytes(MCAP0_MAGIC + builder.end() + MCAP0_MAGIC)
    reader = RecordingReader(path)
    assert list(reader) == recorded[1]
    assert reader.losses == ()


@pytest.mark.parametrize("baud", ["9" * 5000, "fast", "-1", "²", ""])
def test_an_invalid_baud_is_ignored(tmp_path: Path, baud: str) -> None:
    path = tmp_path / "baud.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema("fte.Reset", "protobuf", b"")
        writer.register_channel("/fte/control/reset", "protobuf", schema, {"baud": baud})
        writer.finish()
    assert RecordingReader(path).ports == (PortFacts("baud.mcap", None),)
