"""What is written is read: rows, events, gaps; in each range of time; while the file grows."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path
from threading import Thread, active_count

import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.opcode import Opcode
from mcap.reader import NonSeekingReader, make_reader
from mcap.records import Channel, Header, Metadata
from mcap_protobuf.decoder import DecoderFactory
from zstandard import ZstdDecompressor

from fte_sniff.errors import FileError
from fte_sniff.protocol.items import Gap, GapKind
from fte_sniff.protocol.rows import Row, Rows
from fte_sniff.protocol.spec import Fault
from fte_sniff.recording import schema
from fte_sniff.recording.chunks import HEAD, MAGIC, records_in, unpack
from fte_sniff.recording.metadata import LEFT_OUT_NAME, PortFacts, gap_to_metadata
from fte_sniff.recording.output_file import Existing
from fte_sniff.recording.reader import Recording, TimeRange
from fte_sniff.recording.writer import END, MOST_PORTS, BulkWriter, RecordingWriter, bytes_of
from tests.examples import examples
from tests.recording.samples import (
    BOTH,
    EVENTS,
    FACTS,
    FIRST,
    SECOND,
    START,
    STEP,
    WAYS,
    events_in,
    flush_each,
    heads_of,
    recorded,
    records,
    rows_in,
    rows_of,
    some_rows,
    whole,
    write,
)
from tests.support.columns import rows_from
from tests.support.recorded_rows import write_recording


@pytest.mark.parametrize("way", WAYS)
def test_rows_come_back_in_order_with_all_that_they_have(way: str, tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    WAYS[way](path)
    found = rows_in(path)
    expected = {(row.port, row.offset): row for row in some_rows(900, BOTH)}
    if way in ("one port", "port added last"):
        expected |= {(row.port, row.offset): row for row in some_rows(400)}
    assert found
    if way not in ("rotated", "port added last"):
        assert whole(found) == whole([expected[row.port, row.offset] for row in found])
    assert Recording(path).losses == []
    assert Recording(path).contents.is_indexed == (way != "under way")


rows_at = st.lists(
    st.tuples(
        st.integers(0, 1),
        st.integers(-20, 50),
        st.binary(min_size=1, max_size=16),
        st.sets(st.sampled_from(Fault), max_size=3),
        st.none() | st.integers(0, 2**40),
        st.booleans(),
    ),
    min_size=1,
    max_size=40,
)


@examples(100)
@given(rows_at, st.integers(1, 40))
def test_any_row_comes_back(
    tmp_path_factory: pytest.TempPathFactory,
    given_rows: list[tuple[int, int, bytes, set[Fault], int | None, bool]],
    size: int,
) -> None:
    offsets, times, rows = [0, 0], [START, START], []
    for port, pause, raw, faults, delay, unordered in given_rows:
        times[port] += pause
        framed = len(raw) == 10 and raw[0] in (0xAA, 0x55) and raw[9] == 0xEE
        ordered = tuple(fault for fault in Fault if fault in faults)
        rows.append(
            Row(BOTH[port].name, offsets[port], raw, times[port], ordered, framed, delay, unordered)
        )
        offsets[port] += len(raw)
    path = tmp_path_factory.mktemp("rows") / "x.mcap"
    write(path, rows, BOTH, size)
    found = rows_in(path)
    for port in BOTH:
        own = [row for row in rows if row.port == port.name]
        assert whole([row for row in found if row.port == port.name]) == whole(own)


@pytest.mark.parametrize("size", [0x16, 0x30, 0x5A])
def test_bytes_like_the_head_of_a_message_begin_none(size: int, tmp_path: Path) -> None:
    """Small chunks are read together; some of these heads end where a message begins."""
    raw = bytes([Opcode.MESSAGE, size, 0, 0, 0, 0, 0, 0, 0])
    rows = [
        replace(row, offset=16 * at, raw=bytes(at % 8) + raw, faults=(Fault.NOISE,), framed=False)
        for at, row in enumerate(some_rows(200))
    ]
    write(tmp_path / "x.mcap", rows, BOTH, 5)
    assert whole(rows_in(tmp_path / "x.mcap")) == whole(rows)


def test_a_file_has_as_many_ports_as_channels_have_numbers(tmp_path: Path) -> None:
    ports = [PortFacts(f"port {number}") for number in range(MOST_PORTS + 1)]
    rows = rows_from(some_rows(MOST_PORTS + 1, ports))
    with (tmp_path / "x.mcap").open("wb") as file:
        writer = BulkWriter(file.fileno(), ports)
        writer.write(rows[1:])
        writer.close()
        assert rows_in(tmp_path / "x.mcap") == list(rows[1:])
        writer = BulkWriter(file.fileno(), ports)
        writer.write(rows)
        with pytest.raises(FileError, match="at most 5,461 ports"):
            writer.close()


def test_frames_of_every_kind_are_decoded_by_the_schema_in_the_file(tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    rows = some_rows(400)
    write(path, rows, [FIRST])
    with path.open("rb") as file:
        decoded = make_reader(file, decoder_factories=[DecoderFactory()]).iter_decoded_messages()
        for row, (_, channel, message, values) in zip(rows, decoded, strict=True):
            topic = schema.topic_of(row)
            assert (channel.topic, message.log_time) == (topic.name, row.t_ns)
            assert (values.offset, values.raw) == (row.offset, row.raw)
            if topic is not schema.MALFORMED:
                assert {name: getattr(values, name) for name in row.values} == row.values
            absent = {"rpm", "pulses"} - row.values.keys()
            for name in absent.intersection(values.DESCRIPTOR.fields_by_name):
                assert getattr(values, name) != getattr(values, name), f"{name} is not NaN"


def test_events_and_gaps_are_items_between_the_rows(tmp_path: Path) -> None:
    path, rows = tmp_path / "x.mcap", some_rows()
    gap = Gap(GapKind.LEFT_OUT, 3, START + 40 * STEP + 1, START + 41 * STEP - 1, "why")
    with RecordingWriter(path, [FIRST]) as writer:
        writer.write(EVENTS[0], rows_from(rows[:20]))
        writer.flush()
        writer.write(rows_from(rows[20:]), EVENTS[1], EVENTS[2])
        writer.flush()
        writer.write_metadata(Metadata(LEFT_OUT_NAME, gap_to_metadata(gap)))
    items = [*Recording(path).items()]
    kinds = [len(item) if isinstance(item, Rows) else item for item in items]
    assert kinds == [EVENTS[0], 31, EVENTS[1], 10, gap, 19, EVENTS[2]]
    assert rows_of(items) == rows
    assert Recording(path).gaps() == [gap]


def test_rows_of_two_ports_are_sorted_and_a_late_one_keeps_its_time(tmp_path: Path) -> None:
    path, rows = tmp_path / "x.mcap", some_rows(40, BOTH)
    late = replace(rows[5], t_ns=START - STEP)
    with RecordingWriter(path, BOTH) as writer:
        for port in BOTH:
            writer.write(rows_from([row for row in rows[:30] if row.port == port.name]))
        writer.flush()
        writer.write(rows_from([late, *rows[30:]]))
    assert rows_in(path) == [*rows[:30], late, *rows[30:]]
    with path.open("rb") as file:
        times = [message.log_time for _, _, message in NonSeekingReader(file).iter_messages()]
    assert times == sorted(times)


def test_a_growing_file_is_followed_to_its_end(tmp_path: Path) -> None:
    path, rows = tmp_path / "x.mcap", some_rows(120, BOTH)
    writer = RecordingWriter(path, [FIRST], FACTS)
    recording = Recording(path, is_growing=True)
    assert recording.contents.chunks == []
    assert recording.has_writer
    found: list[Row] = []
    for start in range(0, 120, 40):
        writer.write(rows_from(rows[start : start + 40]))
        assert recording.grow() == []
        writer.flush()
        found += rows_of(recording.read(recording.grow()))
        assert found == rows[: start + 40]
    gap = Gap(GapKind.WRITE_ERROR, 3, START, START + 1, "why")
    writer.write_metadata(Metadata("fte-sniff.gap", gap_to_metadata(gap)))
    recording.grow()
    assert recording.gaps() == [gap]
    writer.write(*EVENTS)
    writer.close()
    assert not recording.has_writer
    assert [*recording.read(recording.grow(is_over=True))] == EVENTS
    assert recording.losses == []
    assert recording.ports == [FIRST, replace(SECOND, baud=None)]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda path: path.unlink(), "no such file"),
        (lambda path: path.write_bytes(path.read_bytes()[:3000]), "or cut off, while it was"),
        (
            lambda path: (path.rename(path.with_suffix(".old")), path.write_bytes(b"x" * 9000)),
            "was replaced by another file",
        ),
    ],
)
def test_a_followed_file_that_is_gone_is_reported(change, words: str, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    path = tmp_path / "x.mcap"
    path.write_bytes(recorded("under way").content)
    recording = Recording(path, is_growing=True)
    change(path)
    with pytest.raises(FileError, match=words):
        recording.grow()


def test_an_empty_recording_explains_itself(tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    with RecordingWriter(path, BOTH, {"host": "bench"}):
        pass
    recording = Recording(path)
    assert (recording.ports, recording.facts["host"], recording.count) == (BOTH, "bench", 0)
    assert [*recording.items()] == []
    assert recording.nothing_read is None
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    assert {one.topic for one in summary.channels.values()} == {*schema.TOPIC_BY_NAME}


def test_each_summary_figure_is_right(tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    with RecordingWriter(path, [FIRST]) as writer:
        flush_each(writer, some_rows(100), 30)
        writer.write(*EVENTS)
    with path.open("rb") as file:
        reader = make_reader(file)
        summary = reader.get_summary()
        messages = [*reader.iter_messages()]
    assert summary is not None
    figures = summary.statistics
    assert figures is not None
    times = [message.log_time for _, _, message in messages]
    assert figures.message_count == len(messages) == 103
    assert (figures.message_start_time, figures.message_end_time) == (min(times), max(times))
    assert (figures.chunk_count, len(summary.chunk_indexes)) == (5, 5)
    assert figures.schema_count == len(summary.schemas)
    assert figures.channel_count == len(summary.channels)
    assert sum(figures.channel_message_counts.values()) == len(messages)


@pytest.mark.parametrize("way", WAYS)
def test_each_definition_exists_once_in_its_section(way: str) -> None:
    """Otherwise `mcap doctor` remarks it."""
    seen: dict[tuple[int, bytes], int] = {}
    content = recorded(way).content
    data_end = heads_of(content, Opcode.DATA_END)[0]
    for opcode, start, end in records(content):
        body = content[start + HEAD.size : end]
        inner = unpack(body, ZstdDecompressor()) if opcode == Opcode.CHUNK else content[start:end]
        for own, at, _ in records_in(inner):
            if own in (Opcode.SCHEMA, Opcode.CHANNEL):
                key = own * 2 + (start > data_end), inner[at + HEAD.size : at + HEAD.size + 2]
                seen[key] = seen.get(key, 0) + 1
    assert set(seen.values()) == {1}


def test_text_from_outside_is_encodable(tmp_path: Path) -> None:
    path, port = tmp_path / "x.mcap", "/dev/\udcfftty"
    with RecordingWriter(path, [replace(FIRST, name=port)], {"host": "\udc80"}) as writer:
        writer.write(rows_from([replace(row, port=port) for row in some_rows(3)]))
        writer.write(replace(EVENTS[0], detail="\udc90", port=port))
    assert events_in(path)[0].detail == r"\udc90"
    assert {row.port for row in rows_in(path)} == {r"/dev/\udcfftty"}
    assert Recording(path).facts["host"] == r"\udc80"


def test_a_row_without_time_is_refused(tmp_path: Path) -> None:
    row = replace(some_rows(1)[0], t_ns=None)
    with (tmp_path / "x.mcap").open("wb") as file:
        writer = BulkWriter(file.fileno(), [FIRST])
        writer.write(rows_from([row]))
        with pytest.raises(ValueError, match="must have a time"):
            writer.close()


@pytest.mark.parametrize("existing", Existing)
def test_an_existing_file_is_kept_unless_it_may_be_replaced(
    existing: Existing, tmp_path: Path
) -> None:
    path = tmp_path / "x.mcap"
    path.write_bytes(b"precious")
    if existing is Existing.REFUSE:
        with pytest.raises(FileError, match="exists already"):
            RecordingWriter(path, [FIRST], existing=existing)
    else:
        writer = RecordingWriter(path, [FIRST], existing=existing)
        writer.close()
        assert writer.path.name == ("x.mcap" if existing is Existing.REPLACE else "x-2.mcap")
        assert Recording(writer.path).is_whole
    replaced = existing is Existing.REPLACE
    assert (path.read_bytes() == b"precious") == (not replaced)
    assert not [one for one in tmp_path.iterdir() if one.name.startswith(".")]


def test_a_file_that_is_written_is_not_replaced(tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    with (
        RecordingWriter(path, [FIRST]),
        pytest.raises(FileError, match="is being recorded to by another program"),
    ):
        RecordingWriter(path, [FIRST], existing=Existing.REPLACE)
    assert [one.name for one in tmp_path.iterdir()] == ["x.mcap"]


@pytest.mark.parametrize("existing", Existing)
def test_a_link_is_not_written_through(existing: Existing, tmp_path: Path) -> None:
    path, target = tmp_path / "x.mcap", tmp_path / "target"
    target.write_bytes(b"precious")
    path.symlink_to(target)
    with pytest.raises(FileError, match="is a link; name the file itself"):
        RecordingWriter(path, [FIRST], existing=existing)
    assert target.read_bytes() == b"precious"
    assert path.is_symlink()


def test_a_recording_can_be_opened_while_its_end_is_replaced(tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    rows = [rows_from([row]) for row in some_rows(1000)]
    with RecordingWriter(path, [PortFacts("p")]) as writer:
        writer.write(rows[0])
        writer.flush()  # the definitions are in a chunk now, which stays as it is

        def record() -> None:
            for row in rows[1:]:
                writer.write(row)
                writer.flush(waits=False)

        recording = Thread(target=record)
        recording.start()
        while recording.is_alive():
            assert not Recording(path, is_growing=True).losses
            assert Recording(path).path == path
        recording.join()
    assert len(rows_in(path)) == 1000


def test_a_row_at_the_end_of_a_span_is_outside_it(tmp_path: Path) -> None:
    path, rows = tmp_path / "x.mcap", some_rows()
    with RecordingWriter(path, [FIRST]) as writer:
        flush_each(writer, rows, 60)
    assert rows_in(path, TimeRange(START + 3 * STEP, START + 7 * STEP)) == rows[3:7]


def test_reading_that_is_given_up_leaves_no_thread(tmp_path: Path) -> None:
    """Threads unpack batches ahead, with the descriptor of the file."""
    path, rows = tmp_path / "x.mcap", rows_from(some_rows(2000))
    write_recording(path, [FIRST], [Rows.concat([rows] * 100)])
    before = active_count()
    for count in range(4):
        items = Recording(path).items()
        seen = sum(len(item) for _, item in zip(range(count), items, strict=False))
        assert seen < 200_000
        del items
        assert active_count() == before


def test_a_file_that_ends_with_its_last_chunk_is_followed(tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    with RecordingWriter(path, [FIRST]) as writer:
        flush_each(writer, some_rows(), 60)
    recording = Recording(path, is_growing=True)
    os.truncate(path, heads_of(path.read_bytes(), Opcode.DATA_END)[0])
    assert recording.grow() == []


@pytest.mark.parametrize(("count", "is_cut"), [(10, False), (11, True)])
def test_at_most_ten_foreign_topics_are_listed(count: int, is_cut: bool, tmp_path: Path) -> None:
    channels = [Channel(one, f"/t{one}", "", {}, 0) for one in range(1, count + 1)]
    path = tmp_path / "x.mcap"
    path.write_bytes(MAGIC + bytes_of(Header("", "other"), *channels) + END)
    with pytest.raises(FileError) as caught:
        Recording(path)
    assert ("..." in str(caught.value).partition("it has")[2]) == is_cut
