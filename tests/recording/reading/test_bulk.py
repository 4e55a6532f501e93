"""Recordings by columns: what record by record reading gives, many rows at once."""

import threading
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.writer import CompressionType, Writer

from fte_sniff.protocol import KINDS, Damage, Fault, Frame, PortEvent, Row, encode
from fte_sniff.recording.messages.codec import MessageReader, encode_row
from fte_sniff.recording.messages.schema import schema_data, schema_name, topic_of
from fte_sniff.recording.metadata import PortFacts
from fte_sniff.recording.output_file import Existing
from fte_sniff.recording.parallel import JOB
from fte_sniff.recording.reader import RecordingReader
from fte_sniff.recording.row_ranges import TimeRange
from fte_sniff.recording.writer import RecordingWriter
from fte_sniff.row_batch import Capacity, RowColumns, Words
from tests.examples import examples

Recorded = tuple[Path, list[Row], list[PortEvent]]
MakeRows = Callable[..., list[Row]]
Told = Callable[[list[Row]], list[tuple[Row, int | None]]]


def _columns(path: Path, span: TimeRange | None = None) -> tuple[list[Row], list[PortEvent]]:
    reader = RecordingReader(path)
    batches = list(reader.batches() if span is None else reader.batches(span=span))
    assert reader.losses == ()
    assert reader.ending == ""
    rows = [row for batch in batches for row in batch.rows()]
    return rows, [event for batch in batches for event in batch.events]


@st.composite
def _rows(draw: st.DrawFn) -> list[Row]:
    """Rows of one port as no framer gives them, but as a file may hold them."""
    rows: list[Row] = []
    for number in range(draw(st.integers(1, 40))):
        t_ns = draw(st.sampled_from([number * 1000, number * 1000 - 3000, 2**62])) % 2**62
        uncertain = draw(st.booleans())
        delay = draw(st.sampled_from([None, 0, -1, 2**40]))
        faults = tuple(draw(st.lists(st.sampled_from(list(Fault)), max_size=6)))
        if draw(st.booleans()):
            kind = draw(st.sampled_from(KINDS))
            values = {field.name: draw(st.integers(field.low, field.high)) for field in kind.fields}
            rows.append(Frame("p", number, encode(kind, values), t_ns, faults, delay, uncertain))
        else:
            size = draw(st.sampled_from([1, 9, 10, 11, 127, 128, 129, 1024]))
            rows.append(
                Damage(
                    "p",
                    number,
                    bytes([draw(st.integers(0, 255))]) * size,
                    t_ns,
                    faults,
                    delay,
                    uncertain,
                )
            )
    return rows


@given(_rows())
def test_any_row_comes_back_as_it_was(
    tmp_path_factory: pytest.TempPathFactory, rows: list[Row]
) -> None:
    path = tmp_path_factory.mktemp("bulk") / "any.mcap"
    with RecordingWriter(path, [PortFacts("p")]) as writer:
        writer.write(rows)
    reader = RecordingReader(path)
    one_by_one = list(reader)
    found, _ = _columns(path)
    assert found == one_by_one
    assert sorted(found, key=lambda row: row.offset) == rows
    assert [(row.read_delay_ns, row.order_uncertain) for row in found] == [
        (row.read_delay_ns, row.order_uncertain) for row in one_by_one
    ]


def test_columns_hold_the_rows_and_the_events(recorded: Recorded, told: Told) -> None:
    rows, events = _columns(recorded[0])
    assert told(rows) == told(recorded[1])
    assert events == recorded[2]


def test_many_chunks_of_two_ports_stay_in_order(tmp_path: Path, make_rows: MakeRows) -> None:
    """More than one batch, so that threads have something to bring out of order."""
    path = tmp_path / "long.mcap"
    one = make_rows(30_000, "one")
    two = make_rows(30_000, "two", one[0].t_ns)
    with RecordingWriter(path, [PortFacts("one"), PortFacts("two")]) as writer:
        for start in range(0, len(one), 1000):
            writer.write(one[start : start + 1000])
            writer.write(two[start : start + 1000])
    reader = RecordingReader(path)
    batches = list(reader.batches())
    assert len(batches) > 1
    assert sum(len(batch) for batch in batches) > JOB // 200
    assert [row for batch in batches for row in batch.rows()] == list(reader)


def test_every_usual_message_has_a_layout(make_rows: MakeRows) -> None:
    """The way of numpy is really gone: the first layout of the length is that of the message."""
    for row in make_rows(200):
        topic = topic_of(row)
        data = encode_row(topic, row, row.t_ns or 0)
        reader = MessageReader(topic.name, "p", schema_name(topic), schema_data(topic.schema))
        assert reader.layouts is not None
        fitting = [
            layout
            for layout in reader.layouts.of_length(len(data))
            if all(
                byte & mask == wanted
                for byte, mask, wanted in zip(data, layout.mask, layout.expected, strict=True)
            )
        ]
        assert len(fitting) == 1
        assert fitting[0].raw_length == len(row.raw)
        assert fitting[0].fault_count == len(row.faults)


def test_a_message_that_only_looks_equally_long_is_not_misread(
    tmp_path: Path, make_rows: MakeRows, told: Told
) -> None:
    """Without delay but with a time of its own a message is as long as the other way round."""
    rows = [row for row in make_rows(400) if isinstance(row, Frame) and not row.faults]
    late = [
        Frame(row.port, row.offset, row.raw, (row.t_ns or 0) - 10**9, (), None)
        for row in rows[1::2]
    ]
    path = tmp_path / "mixed.mcap"
    mixed: list[Row] = []
    with RecordingWriter(
        path, [PortFacts("a"), PortFacts("b")], existing=Existing.REFUSE
    ) as writer:
        for even, odd in zip(rows[::2], late, strict=False):
            other = Frame("b", odd.offset, odd.raw, odd.t_ns, (), None)
            for row in (even, other):
                writer.write([row])
                writer.flush()
                mixed.append(row)
    found, _ = _columns(path)
    assert told(found) == told(mixed)


@examples(80)
@given(st.data())
def test_whatever_a_message_says_columns_say_what_reading_one_by_one_says(
    tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    """Without checksums a changed byte reaches the messages; the others stay as they are."""
    path = tmp_path_factory.mktemp("bulk") / "changed.mcap"
    kinds = data.draw(st.sampled_from([KINDS[:1], KINDS[3:4], KINDS]))
    with path.open("wb") as file:
        writer = Writer(file, compression=CompressionType.NONE, enable_crcs=False)
        writer.start()
        channels: dict[str, int] = {}
        for number in range(70):
            kind = kinds[number % len(kinds)]
            values = {field.name: max(1, field.low) for field in kind.fields}
            row = Frame("p", number * 10, encode(kind, values), number, (), 5)
            topic = topic_of(row)
            if topic.name not in channels:
                schema = writer.register_schema(
                    schema_name(topic), "protobuf", schema_data(topic.schema)
                )
                channels[topic.name] = writer.register_channel(topic.name, "protobuf", schema)
            changed = bytearray(encode_row(topic, row, number))
            if number == 33:
                place = data.draw(st.integers(0, len(changed) - 1))
                changed[place] = data.draw(
                    st.one_of(st.sampled_from([*changed, 0xAA, 0x55, 0xEE]), st.integers(0, 255))
                )
            time = data.draw(st.sampled_from([number, 2**63])) if number == 34 else number
            writer.add_message(channels[topic.name], time, bytes(changed), time)
        writer.finish()
    reader = RecordingReader(path)
    rows = list(reader)
    lost = reader.losses
    batches = list(reader.batches())
    assert [row for batch in batches for row in batch.rows()] == rows
    assert reader.losses == lost


def test_a_span_leaves_out_what_is_outside(recorded: Recorded) -> None:
    path, rows, events = recorded
    times = [row.t_ns or 0 for row in rows]
    for first, end in [
        (times[3], times[50]),
        (times[25], times[26]),
        (0, times[0]),
        (times[59], 2**63 - 1),
    ]:
        span = TimeRange(first, end)
        found, told_events = _columns(path, span)
        assert found == [row for row in rows if first <= (row.t_ns or 0) < end]
        assert told_events == [event for event in events if first <= event.t_ns < end]


def test_a_span_unpacks_only_the_chunks_that_it_touches(recorded: Recorded) -> None:
    """The first chunk is damaged, and it does not matter to rows of the last."""
    path, rows, _ = recorded
    content = bytearray(path.read_bytes())
    chunk = content.index(b"zstd")
    content[chunk + 40] ^= 0xFF
    path.write_bytes(content)
    found, _ = _columns(path, TimeRange(rows[45].t_ns or 0))
    assert found == rows[45:]


def test_columns_are_joined_and_parted_with_their_long_rows(make_rows: MakeRows) -> None:
    rows, words = make_rows(100), Words()
    columns = RowColumns.of_rows(words, rows)
    assert list(columns.rows()) == rows
    parts = [columns.parted(slice(0, 33)), columns.parted(slice(33, 100))]
    assert list(RowColumns.joined(parts).rows()) == rows
    assert list(columns.parted(columns.length > 10).rows()) == [r for r in rows if len(r.raw) > 10]


def test_a_reader_that_is_left_early_leaves_no_thread_behind(
    tmp_path: Path, make_rows: MakeRows
) -> None:
    path = tmp_path / "left.mcap"
    with RecordingWriter(path, [PortFacts("p")]) as writer:
        writer.write(make_rows(60_000, "p"))
    before = threading.active_count()
    batches = RecordingReader(path).batches()
    next(batches)
    batches.close()
    assert threading.active_count() == before


def test_a_channel_that_a_chunk_defines_is_known_when_the_chunk_is_passed_over(
    tmp_path: Path, make_rows: MakeRows
) -> None:
    """A port that was not named at first is defined where its first rows stand."""
    rows = make_rows(60)
    path = tmp_path / "unnamed.mcap"
    with RecordingWriter(path, []) as writer:
        for start in range(0, len(rows), 20):
            writer.write(rows[start : start + 20])
            writer.flush()
    found, _ = _columns(path, TimeRange(rows[45].t_ns or 0))
    assert found == rows[45:]
    content = path.read_bytes()
    path.write_bytes(content[: content.index(b"fte.MotorControl", len(content) // 2)])
    reader = RecordingReader(path)
    batches = list(reader.batches(span=TimeRange(rows[45].t_ns or 0)))
    assert [row for batch in batches for row in batch.rows()] == rows[45:]
    assert reader.losses == ()


def test_room_is_one_only_if_all_that_was_taken_fits() -> None:
    room = Capacity(Words(), 10)
    for start, end in ((0, 4), (4, 10)):
        taken = room.take(end - start)
        taken.t_ns[:] = range(start, end)
    whole = room.taken()
    assert whole is not None
    assert whole.t_ns.tolist() == list(range(10))
    assert len(room.take(3)) == 3
    assert room.taken() is None
    assert whole.t_ns.tolist() == list(range(10))
