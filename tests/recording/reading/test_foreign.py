"""Recordings that other writers made: other packing, other order, other topics between ours."""

from collections.abc import Callable
from pathlib import Path

import pytest
from mcap.data_stream import RecordBuilder
from mcap.reader import make_reader
from mcap.records import Channel, DataEnd, Footer, Message, Schema
from mcap.stream_reader import StreamReader
from mcap.writer import MCAP0_MAGIC, CompressionType, IndexType, Writer

from fte_sniff.protocol import Fault, PortEvent, Row
from fte_sniff.recording.metadata import PortFacts
from fte_sniff.recording.reader import RecordingReader

Recorded = tuple[Path, list[Row], list[PortEvent]]


def _rewritten(source: Path, target: Path, *, port: bool = True, **options: object) -> None:
    """The same messages by the mcap package's own writer, with another's topic between them."""
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
    assert list(reader.events()) == recorded[2]
    assert (reader.ending, reader.losses) == ("", ())
    batches = list(reader.batches())
    assert [row for batch in batches for row in batch.rows()] == recorded[1]
    assert [event for batch in batches for event in batch.events] == recorded[2]
    assert (reader.ending, reader.losses) == ("", ())


def test_where_no_port_is_named_the_file_stands_in(recorded: Recorded, tmp_path: Path) -> None:
    path = tmp_path / "other.mcap"
    _rewritten(recorded[0], path, port=False)
    assert {row.port for row in RecordingReader(path)} == {"other.mcap"}


@pytest.mark.parametrize("options", [{}, {"use_chunking": False}])
def test_other_writers_files_may_be_cut_too(
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


def test_a_schema_that_lacks_what_rows_are_made_of(
    recorded: Recorded, tmp_path: Path, replaced: Callable[[bytes, bytes, bytes], bytes]
) -> None:
    path = tmp_path / "other.mcap"
    _rewritten(recorded[0], path, compression=CompressionType.NONE, enable_crcs=False)
    path.write_bytes(replaced(path.read_bytes(), b"offset", b"beside"))
    reader = RecordingReader(path)
    assert list(reader) == []
    assert list(reader.events()) == recorded[2]
    assert any(
        "/fte/control/motor1: its messages (fte.MotorControl) have no offset" in loss
        for loss in reader.losses
    )


def test_a_fault_that_this_version_does_not_know_is_told(
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
    assert list(reader) == recorded[1][4:]
    assert any("which nothing describes" in loss for loss in reader.losses)


@pytest.mark.parametrize("baud", ["9" * 5000, "fast", "-1", "²", ""])
def test_a_baud_that_is_none_is_not_told(tmp_path: Path, baud: str) -> None:
    path = tmp_path / "baud.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema("fte.Reset", "protobuf", b"")
        writer.register_channel("/fte/control/reset", "protobuf", schema, {"baud": baud})
        writer.finish()
    assert RecordingReader(path).ports == (PortFacts("baud.mcap", None),)
