"""RecordingWriter: files that every reader opens, after every flush, error and kill."""

import errno
import os
import random
import socket
import struct
from collections.abc import Callable, Iterable
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import pytest
from mcap.reader import make_reader
from mcap.records import Chunk, McapRecord, Metadata, Statistics
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap_protobuf.decoder import DecoderFactory

from fte_sniff.errors import FileError, unwritable
from fte_sniff.protocol import Damage, Fault, PortEvent, PortEventKind, Row
from fte_sniff.recording.mcap import writer as mcap_file
from fte_sniff.recording.mcap.reader import parse
from fte_sniff.recording.messages import TOPICS, table_crc
from fte_sniff.recording.metadata import (
    PORTS_NAME,
    PortFacts,
    host_facts,
    ports_from_metadata,
    ports_to_metadata,
)
from fte_sniff.recording.output_file import stopped_by_error
from fte_sniff.recording.reader import RecordingReader
from fte_sniff.recording.writer import Existing, RecordingWriter
from tests.recording.conftest import file_size_limit, some_rows, unprivileged
from tests.support.columns import in_columns
from tests.support.recorded_rows import events_in
from tests.support.recording_kill import kill_one
from tests.torture.damage import CHUNK, METADATA, records

Rows = Callable[..., list[Row]]
PORT = PortFacts("/dev/ttyUSB0", 115_200)


def _statistics(path: Path) -> Statistics:
    """What the mcap package's seeking reader says, all checksums checked."""
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        assert summary is not None
        assert summary.statistics is not None
        assert sum(1 for _ in reader.iter_messages()) == summary.statistics.message_count
    with path.open("rb") as file:
        assert all(StreamReader(file, validate_crcs=True).records)
    return summary.statistics


def test_an_empty_capture_explains_itself_in_every_reader(tmp_path: Path) -> None:
    path = tmp_path / "empty.mcap"
    RecordingWriter(path, [PORT], host_facts(0) | {"host": "bench"}).close()
    statistics = _statistics(path)
    assert (statistics.message_count, statistics.chunk_count) == (0, 0)
    assert (statistics.message_start_time, statistics.message_end_time) == (0, 0)
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        assert summary is not None
        channels = summary.channels.values()
        assert [channel.topic for channel in channels] == [topic.name for topic in TOPICS]
        assert {tuple(channel.metadata.items()) for channel in channels} == {
            (("port", "/dev/ttyUSB0"), ("baud", "115200"))
        }
        header = reader.get_header()
        assert (header.profile, header.library) == ("", "fte-sniff 0.1.0")
        (metadata,) = reader.iter_metadata()
    assert metadata.name == "fte-sniff"
    assert metadata.metadata["start"] == "1970-01-01T00:00:00.000000000Z"
    assert metadata.metadata["host"] == "bench"
    assert metadata.metadata["port.1.baud"] == "115200"
    reader2 = RecordingReader(path)
    assert (list(reader2), reader2.ports) == ([], (PORT,))
    assert (reader2.ending, reader2.losses) == ("", ())
    assert reader2.metadata["fte-sniff"] == metadata.metadata


def _names(records: Iterable[McapRecord]) -> list[str]:
    return [type(record).__name__ for record in records]


def test_each_definition_exists_once_in_the_data_and_a_checksum_protects_it(
    recorded: tuple[Path, list[Row], list[PortEvent]],
) -> None:
    with recorded[0].open("rb") as file:
        records = list(StreamReader(file, emit_chunks=True, validate_crcs=True).records)
    data = records[: _names(records).index("DataEnd")]
    chunks = [record for record in data if isinstance(record, Chunk)]
    assert not {"Schema", "Channel"} & set(_names(data))
    inside = [_names(breakup_chunk(chunk, validate_crc=True)) for chunk in chunks]
    assert inside[0][: 6 + len(TOPICS)] == ["Schema"] * 6 + ["Channel"] * len(TOPICS)
    assert set(sum(inside[1:], inside[0][6 + len(TOPICS) :])) == {"Message"}
    assert len(chunks) == 4


def test_a_file_without_rows_has_its_definitions_until_a_chunk_holds_them(
    tmp_path: Path, make_rows: Rows
) -> None:
    path = tmp_path / "x.mcap"
    with RecordingWriter(path, [PORT]) as writer:
        for rows, outside in (([], True), ([], True), (make_rows(1), False)):
            writer.write(in_columns(rows))
            writer.write_metadata(Metadata("note", {}))
            writer.flush()
            with path.open("rb") as file:
                records = _names(StreamReader(file, emit_chunks=True, validate_crcs=True).records)
            data = records[: records.index("DataEnd")]
            assert data.count("Schema") == 6 * outside
            assert data.count("Channel") == len(TOPICS) * outside
            assert RecordingReader(path).ports == (PORT,)


def test_another_program_decodes_the_same_values(
    recorded: tuple[Path, list[Row], list[PortEvent]],
) -> None:
    path, rows, _ = recorded
    by_offset = {row.offset: row for row in rows}
    seen = set()
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        for _, channel, message, decoded in reader.iter_decoded_messages():
            assert message.log_time == message.publish_time
            if channel.topic == "/fte/port":
                continue
            row = by_offset[decoded.offset]
            seen.add(decoded.offset)
            assert decoded.raw == row.raw
            assert message.log_time == row.t_ns
            if channel.topic != "/fte/malformed":
                assert not isinstance(row, Damage)
                assert {name: getattr(decoded, name) for name in row.values} == row.values
                assert decoded.motor == int(channel.topic[-1]) if "motor" in row.values else True
    assert seen == set(by_offset)


def test_sequences_count_up_on_each_channel(
    recorded: tuple[Path, list[Row], list[PortEvent]],
) -> None:
    found: dict[int, list[int]] = {}
    with recorded[0].open("rb") as file:
        for _, channel, message in make_reader(file).iter_messages(log_time_order=False):
            found.setdefault(channel.id, []).append(message.sequence)
    assert all(numbers == list(range(len(numbers))) for numbers in found.values())


def test_the_file_is_whole_and_indexed_after_every_flush(tmp_path: Path, make_rows: Rows) -> None:
    path = tmp_path / "x.mcap"
    rows = make_rows(50)
    with RecordingWriter(path, [PORT]) as writer:
        for start in range(0, 50, 10):
            writer.write(in_columns(rows[start : start + 10]))
            assert writer.rows == start + 10
            assert writer.flushed_rows == start
            writer.flush()
            assert writer.flushed_rows == start + 10
            assert writer.size == path.stat().st_size
            assert _statistics(path).message_count == start + 10
            reader = RecordingReader(path)
            assert list(reader) == rows[: start + 10]
            assert (reader.ending, reader.losses) == ("", ())


def test_a_long_summary_waits_for_data_and_the_file_is_readable_meanwhile(
    tmp_path: Path, make_rows: Rows, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(mcap_file, "LONG_SUMMARY", 0)
    path = tmp_path / "x.mcap"
    rows = make_rows(400)
    summaries = []
    with RecordingWriter(path, [PORT]) as writer:
        for number in range(40):
            writer.write(in_columns(rows[10 * number : 10 * number + 10]))
            writer.flush()
            with path.open("rb") as file:
                reader = make_reader(file, validate_crcs=True)
                summaries.append(reader.get_summary() is not None)
                assert sum(1 for _ in reader.iter_messages()) == 10 * number + 10
            ours = RecordingReader(path)
            assert list(ours) == rows[: 10 * number + 10]
            assert (ours.ending, ours.losses) == ("", ())
    assert True in summaries
    assert False in summaries
    assert _statistics(path).message_count == 400


def test_close_can_be_repeated_and_writing_afterwards_is_a_mistake(
    tmp_path: Path, make_rows: Rows
) -> None:
    writer = RecordingWriter(tmp_path / "x.mcap", [PORT])
    writer.close()
    writer.close()
    with pytest.raises(ValueError, match="closed"):
        writer.write(in_columns(make_rows(1)))


def test_a_port_that_nobody_named_gets_its_channels(tmp_path: Path, make_rows: Rows) -> None:
    path = tmp_path / "x.mcap"
    with RecordingWriter(path, [PORT]) as writer:
        writer.write(in_columns(make_rows(3)))
        writer.flush()
        writer.write(in_columns(make_rows(30, port="late")))
    reader = RecordingReader(path)
    assert reader.ports == (PORT, PortFacts("late"))
    assert sum(row.port == "late" for row in reader) == 30
    assert _statistics(path).channel_count == 2 * len(TOPICS)


def test_text_that_utf8_cannot_hold_is_escaped(tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    port = "tty\udcff"
    with RecordingWriter(path, [PortFacts(port)], {"host\udcfe": "\udcfd"}) as writer:
        writer.write(in_columns(Damage(port, 0, b"x", 5, (Fault.NOISE,))))
        writer.write(in_columns(PortEvent(6, port, PortEventKind.LOST, "\udc80")))
    reader = RecordingReader(path)
    assert [row.port for row in reader] == ["tty\\udcff"]
    assert [event.detail for event in events_in(reader)] == ["\\udc80"]


@pytest.mark.parametrize("t_ns", [None, -1])
def test_a_row_without_a_time_is_refused_and_costs_nothing_else(
    tmp_path: Path, make_rows: Rows, t_ns: int | None
) -> None:
    path = tmp_path / "x.mcap"
    rows = make_rows(5)
    with RecordingWriter(path, [PORT]) as writer:
        writer.write(in_columns(rows))
        with pytest.raises(FileError, match="offset 77, has no time"):
            writer.write(in_columns(Damage(PORT.name, 77, b"x", t_ns, (Fault.NOISE,))))
    assert list(RecordingReader(path)) == rows


def test_an_existing_file_is_kept_unless_replacing_was_asked_for(
    tmp_path: Path, make_rows: Rows
) -> None:
    path = tmp_path / "x.mcap"
    path.write_bytes(b"precious" * 10_000)
    with pytest.raises(FileError, match=r"x\.mcap exists already.*--force"):
        RecordingWriter(path, [PORT])
    assert path.read_bytes() == b"precious" * 10_000
    with RecordingWriter(path, [PORT], existing=Existing.REPLACE) as writer:
        writer.write(in_columns(make_rows(5)))
    assert _statistics(path).message_count == 5


def test_paths_where_no_recording_can_be(tmp_path: Path) -> None:
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(str(tmp_path / "socket"))
    (tmp_path / "file").touch()
    cases = [
        (tmp_path / "absent" / "x.mcap", Existing.REFUSE, "folder does not exist"),
        (tmp_path, Existing.REPLACE, "is a directory"),
        (tmp_path, Existing.REFUSE, "is a directory"),
        (tmp_path / "file", Existing.REFUSE, "exists already"),
        (tmp_path / "socket", Existing.REPLACE, "not a regular file"),
        (Path("/dev/full"), Existing.REPLACE, "the disk is full"),
        (tmp_path / "file" / "x.mcap", Existing.REFUSE, "a file, not a folder"),
    ]
    for path, existing, message in cases:
        with pytest.raises(FileError, match=message) as caught:
            RecordingWriter(path, [PORT], existing=existing)
        assert "\n" not in str(caught.value)
        assert str(path) in str(caught.value)


def test_a_folder_that_forbids_writing(tmp_path: Path) -> None:
    tmp_path.chmod(0o500)
    with unprivileged(), pytest.raises(FileError, match="no permission to write there"):
        RecordingWriter(tmp_path / "x.mcap", [PORT])


@pytest.mark.parametrize(
    ("number", "words"),
    [(errno.ENOSPC, "the disk is full"), (errno.EDQUOT, "quota"), (errno.EIO, "error")],
)
def test_why_a_recording_stopped_is_one_line(number: int, words: str) -> None:
    error = OSError(number, os.strerror(number))
    for error_text in (
        stopped_by_error(Path("x.mcap"), error, 5),
        unwritable(Path("x.mcap"), error),
    ):
        assert words in str(error_text)
        assert "x.mcap" in str(error_text)
        assert "\n" not in str(error_text)


@pytest.mark.parametrize("space", [1, 500, 3000])
def test_a_write_that_fails_leaves_all_that_was_flushed_in_a_valid_file(
    tmp_path: Path, make_rows: Rows, space: int
) -> None:
    path = tmp_path / "x.mcap"
    rows = make_rows(3000)
    with RecordingWriter(path, [PORT]) as writer:
        writer.write(in_columns(rows[:100]))
        writer.flush()
        size = writer.size
        with file_size_limit(size + space):
            writer.write(in_columns(rows[100:]))
            with pytest.raises(FileError, match=r"recording stopped: .*\(100 rows\)") as caught:
                writer.flush()
            with pytest.raises(FileError) as again:
                writer.write(in_columns(rows[:1]))
        assert again.value is caught.value
        assert writer.failure is caught.value
    assert path.stat().st_size == size
    assert _statistics(path).message_count == 100
    reader = RecordingReader(path)
    assert list(reader) == rows[:100]
    assert (reader.ending, reader.losses) == ("", ())


def test_the_message_records_have_the_form_of_the_format(tmp_path: Path, make_rows: Rows) -> None:
    """Offsets in the message index point at the opcode of a message of that time and channel."""
    path = tmp_path / "x.mcap"
    with RecordingWriter(path, [PORT]) as writer:
        writer.write(in_columns(make_rows(40)))
    from mcap.data_stream import ReadDataStream
    from mcap.records import MessageIndex
    from mcap.stream_reader import get_chunk_data_stream

    with path.open("rb") as file:
        records = list(StreamReader(file, emit_chunks=True).records)
    (chunk,) = [record for record in records if isinstance(record, Chunk)]
    stream, length = get_chunk_data_stream(chunk, validate_crc=True)
    assert isinstance(stream, ReadDataStream)
    data = stream.read(length)
    places = [
        (index.channel_id, time, offset)
        for index in records
        if isinstance(index, MessageIndex)
        for time, offset in index.records
    ]
    assert len(places) == 40
    for channel_id, time, offset in places:
        assert struct.unpack_from("<B8xH4xQQ", data, offset) == (5, channel_id, time, time)


@pytest.mark.parametrize(("every_s", "rotates"), [(0.0, False), (0.0, True), (0.2, False)])
def test_what_was_flushed_is_there_whenever_the_writer_is_killed(
    tmp_path: Path, every_s: float, rotates: bool
) -> None:
    left = kill_one(tmp_path / "x.mcap", every_s, random.uniform(0.0, 0.5), rotate=rotates)
    assert left.problem == ""
    assert left.missing == 0
    assert left.found <= left.written
    assert left.files > 1 or not rotates or left.written < 10_000


def _copies(path: Path) -> list[tuple[int, list[PortFacts]]]:
    """Offset and ports of each copy of the ports."""
    content = path.read_bytes()
    found = []
    for opcode, start, end in records(content):
        if opcode == METADATA:
            one = parse(Metadata, content[start + 9 : end])
            if one.name == PORTS_NAME:
                found.append((start, ports_from_metadata(one.metadata, table_crc())))
    return found


def test_the_ports_are_repeated_at_twice_the_distance_each_time(tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    rows = some_rows(2000)
    with RecordingWriter(path, [PORT]) as writer:
        for start in range(0, len(rows), 20):
            writer.write(in_columns(rows[start : start + 20]))
            writer.flush()
    copies = _copies(path)
    chunks = [(start, end) for opcode, start, end in records(path.read_bytes()) if opcode == CHUNK]
    assert all(ports == [PORT] for _, ports in copies)
    assert chunks[0][1] < copies[0][0] < chunks[1][0]
    assert 4 < len(copies) < 10
    for (before, _), (place, _) in pairwise(copies):
        assert 2 * before <= place < 2 * before + 2 * (chunks[-1][0] - chunks[-2][0])


def test_a_port_that_is_added_later_is_repeated_too(tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    rows = some_rows(400)
    with RecordingWriter(path, [PORT]) as writer:
        for start in range(0, len(rows), 20):
            port = "later\udcff" if start >= 300 else PORT.name
            writer.write(in_columns([replace(row, port=port) for row in rows[start : start + 20]]))
            writer.flush()
    later = [ports for _, ports in _copies(path) if len(ports) > 1]
    assert later[1:]
    assert all(ports == [PORT, PortFacts("later\\udcff")] for ports in later)


def test_a_damaged_copy_of_the_ports_names_none() -> None:
    items = ports_to_metadata([PORT, PortFacts("b")], 7)
    assert ports_from_metadata(items, 7) == [PORT, PortFacts("b")]
    assert ports_from_metadata(items, 8) == []
    for name, value in items.items():
        assert ports_from_metadata(items | {name: value + "x"}, 7) == []
        assert ports_from_metadata({one: items[one] for one in items if one != name}, 7) == []
