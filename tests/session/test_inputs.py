"""Inputs and the reading of several: every split of rows gives the same rows, in bounded memory."""

from __future__ import annotations

import io
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.opcode import Opcode

from fte_sniff.analysis.filter.row_filter import RowFilter
from fte_sniff.analysis.model import StreamChange
from fte_sniff.cli.input_files import InputQuery
from fte_sniff.errors import FileError, InputTextError, UsageError
from fte_sniff.formats.writers import TEXT_FORMATS, OutputFormat, RowWriter, row_writer
from fte_sniff.protocol import (
    KINDS,
    Chunk,
    Fault,
    Framer,
    Gap,
    GapKind,
    PortEvent,
    PortEventKind,
    Row,
    encode,
)
from fte_sniff.protocol.rows import Rows, fault_bits, faults_in
from fte_sniff.recording.chunks import HEAD, MAGIC
from fte_sniff.recording.metadata import PortFacts
from fte_sniff.recording.reader import TimeRange
from fte_sniff.recording.writer import RecordingWriter
from fte_sniff.session import save
from fte_sniff.session.framing import rows_of_chunks
from fte_sniff.session.inputs import (
    ChunkInput,
    InputBatch,
    InputKind,
    TimedInput,
    kind_of_file,
    merged_by_time,
    within,
)
from fte_sniff.session.save import UNKNOWN, open_sink, write_rows
from tests.protocol.streams import raw_bytes
from tests.support.columns import entries, fed

FRAME = bytes.fromhex("AA 01 01 03 E8 00 00 00 00 EE")
CUT = ["f: ends in the middle of a frame (4 of 10 bytes)"]


def test_the_first_bytes_decide_the_format_where_the_name_does_not(tmp_path: Path) -> None:
    path = tmp_path / "minicom.cap"
    path.write_text("[12:00:01] RX: 55 01 01 03 E8 00 00 00 0F EE\n")
    assert kind_of_file(path) is InputKind.HEX
    path.write_bytes(MAGIC)
    assert kind_of_file(path) is InputKind.MCAP
    for unknown in (b"", bytes.fromhex("55 01 01 03 E8 00 00 00 0F EE")):
        path.write_bytes(unknown)
        with pytest.raises(UsageError, match="its name does not show its format"):
            kind_of_file(path)


def rows_of(log: ChunkInput, notes: list[str], span: TimeRange | None = None) -> list[list[Row]]:
    return [list(batch.rows) for batch in log.batches(span, notes.append)]


@settings(max_examples=30, deadline=None)
@given(raw_bytes, st.integers(1, 9), st.booleans(), st.sampled_from([0, 10**18]))
def test_rows_are_the_framers(data: bytes, repeated: int, idle: bool, start_ns: int) -> None:
    data = data * (4000 * repeated // (len(data) + 1) + 1)
    cut = [data[at : at + 40_000] for at in range(0, len(data), 40_000)]
    chunks = [
        Chunk("f", start_ns + at if start_ns else None, piece) for at, piece in enumerate(cut)
    ]
    framer = Framer("f")
    expected = [row for chunk in chunks for row in fed(framer, chunk)] + list(framer.finish())
    if idle:
        chunks = [one for chunk in chunks for one in (chunk, Chunk("f", None, b""))]
    if data:
        parts = rows_of_chunks(chunks, lambda _: None)
        assert [row for rows in parts for row in rows] == expected


def test_rows_do_not_wait_for_bytes_that_are_not_there_yet() -> None:
    asked: list[int] = []

    def chunks() -> Iterator[Chunk]:
        for at in range(3):
            asked.append(at)
            yield Chunk("f", None, FRAME * 5)
            yield Chunk("f", None, b"")

    handed: list[tuple[int, int]] = []
    for batch in ChunkInput(chunks(), "f").batches(None, lambda _: None):
        handed.append((len(asked), len(batch.rows)))
    assert handed == [(1, 4), (2, 5), (3, 5), (3, 1)]  # a frame waits for the next one, or the end


def test_the_end_is_reported() -> None:
    notes: list[str] = []
    rows_of(ChunkInput([Chunk("f", None, FRAME * 3000 + FRAME[:4])], "f"), notes)
    assert notes == CUT
    with pytest.raises(FileError, match="f: is empty"):
        rows_of(ChunkInput([], "f"), notes)


def test_rows_before_an_error_are_not_lost() -> None:
    def chunks() -> Iterator[Chunk]:
        yield Chunk("f", None, FRAME * 3)
        yield Chunk("f", None, FRAME[:4])
        raise InputTextError("no hex")

    batches = ChunkInput(chunks(), "f").batches(None, lambda _: None)
    assert [len(row.raw) for row in next(batches).rows] == [10, 10, 10, 4]
    with pytest.raises(InputTextError):
        next(batches)


@pytest.mark.parametrize("count", [10, 20_000])
def test_a_span_takes_what_lies_in_it(count: int) -> None:
    chunks = [Chunk("f", 10**18 + at * 10**9, FRAME) for at in range(count)]
    notes: list[str] = []
    inside = TimeRange(10**18 + 2 * 10**9, 10**18 + 5 * 10**9)
    found = rows_of(ChunkInput(chunks, "f"), notes, inside)
    assert [row.offset for rows in found for row in rows] == [30, 40, 50]
    assert not notes
    assert not any(rows_of(ChunkInput(chunks, "f"), notes, TimeRange(0, 10)))
    assert f"none of its {count:,} rows is between" in notes[0]


PORTS = [
    "/dev/ttyUSB0",
    "",
    'a "quoted", port',
    "zwei\nZeilen",
    "тест ✓",
    "back\\slash",
    "\x1b[31m",
]
TIMES = st.integers(0, 2**63 - 1) | st.sampled_from([0, 1, 10**9, 1_770_000_000_000_000_000])
FAULTS = st.sets(st.sampled_from(Fault), max_size=3).map(lambda own: faults_in(fault_bits(own)))


@st.composite
def row(draw: st.DrawFn) -> Row:
    port, t_ns, faults = draw(st.sampled_from(PORTS)), draw(TIMES), draw(FAULTS)
    offset = draw(st.integers(0, 2**63 - 1))
    if draw(st.booleans()):
        raw = draw(st.binary(min_size=1, max_size=16))
        return Row(port, offset, raw, t_ns, faults, framed=False)
    kind = draw(st.sampled_from(KINDS))
    raw = encode(kind, {f.name: draw(st.integers(f.low, f.high)) for f in kind.fields})
    if draw(st.booleans()):
        raw = raw[:1] + b"\x77" + raw[2:]
    return Row(port, offset, raw, t_ns, faults)


ROWS = st.lists(row(), max_size=12)
UNTIMED = st.lists(
    st.builds(lambda row, kept: row if kept else replace(row, t_ns=None), row(), st.booleans()),
    max_size=12,
)


def written(write: Callable[[RowWriter], None], form: OutputFormat) -> str:
    stream = io.StringIO()
    writer = row_writer(form, stream, ports=True)
    write(writer)
    writer.close()
    return stream.getvalue()


@pytest.mark.parametrize("form", [*TEXT_FORMATS, OutputFormat.HEX])
@given(rows=ROWS | UNTIMED)
def test_columns_are_written_byte_for_byte_as_rows(form: OutputFormat, rows: list[Row]) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(save, "_FEWEST", 0)
        by_columns = written(lambda writer: write_rows(writer, Rows.of(rows), 10**9), form)
    assert by_columns == written(lambda writer: writer.write(rows), form)


@given(
    ROWS,
    st.sampled_from(
        [
            "motor = 1 AND rpm * 1000 > 500",
            "faults = 'noise'",
            "faults IS NULL",
            "malformed OR length > 10",
            "raw LIKE 'AA 01%'",
            "time > '2026-01-31'",
            "port = ''",
            "kind IS DISTINCT FROM 'speed'",
            "online & 1 = 0",
            "TRUE",
        ]
    ),
)
def test_a_filter_selects_each_row_by_itself(rows: list[Row], text: str) -> None:
    wanted = RowFilter.parse(text)
    one_by_one = [row for row in rows if wanted.select(Rows.of([row]))]
    assert list(InputBatch(Rows.of(rows)).select(wanted).rows) == one_by_one


@given(ROWS, st.integers(0, 14))
def test_the_first_rows(rows: list[Row], count: int) -> None:
    assert list(InputBatch(Rows.of(rows)).first(count).rows) == rows[:count]


@given(ROWS, st.integers(0, 2**63 - 1), st.integers(0, 2**63 - 1))
def test_a_span_holds_the_same(rows: list[Row], first_ns: int, end_ns: int) -> None:
    span = TimeRange(first_ns, end_ns)
    inside = [row for row in rows if row.t_ns is not None and span.contains(row.t_ns)]
    assert list(within(Rows.of(rows), span)) == inside


@given(UNTIMED.filter(lambda rows: any(row.t_ns is None for row in rows)))
def test_a_recording_takes_no_row_without_time(
    tmp_path_factory: pytest.TempPathFactory, rows: list[Row]
) -> None:
    sink = open_sink(OutputFormat.MCAP, tmp_path_factory.getbasetemp() / "x", UNKNOWN)
    with pytest.raises(FileError, match="has no time since 1970"):
        sink.write(Rows.of(rows))
    sink.abandon()


START = 1_770_000_000_000_000_000
SPEED = encode(KINDS[0], {field.name: field.low for field in KINDS[0].fields})


def batch_of(rows: Sequence[Row], *, at: int) -> InputBatch:
    """The rows, an event before the first, and a change before the last."""
    events, changes = list[PortEvent](), list[StreamChange]()
    if rows:
        t_ns = rows[0].t_ns or 0
        events.append(PortEvent(t_ns, rows[0].port, PortEventKind.OPENED, str(at)))
        gap = Gap(GapKind.DAMAGE, rows=rows[-1].offset, port=rows[-1].port)
        changes.append(StreamChange(len(rows) - 1, gap))
    batch = Rows.of(rows, events=events)
    return InputBatch(
        batch,
        reload=lambda: batch,
        changes=changes,
        origin=int(rows[0].port) if rows else 0,
    )


@st.composite
def inputs(draw: st.DrawFn, *, falling: bool = False) -> list[list[InputBatch]]:
    """Inputs of some batches with some rows each; their times rise unless `falling`."""
    found = []
    for number in range(draw(st.integers(1, 5))):
        sizes = draw(st.lists(st.integers(0, 5), min_size=1, max_size=5))
        steps = st.integers(-4 if falling else 0, 4)
        t_ns, batches, offset = START + draw(st.integers(0, 30)), [], 0
        for at, size in enumerate(sizes):
            rows: list[Row] = []
            for _ in range(size):
                t_ns += draw(steps)
                raw = SPEED if draw(st.booleans()) else bytes(draw(st.integers(1, 16)))
                rows.append(Row(str(number), offset, raw, t_ns, (), framed=raw is SPEED))
                offset += len(raw)
            batches.append(batch_of(rows, at=at))
        found.append(batches)
    return found


def first_ns(batches: Sequence[InputBatch]) -> int | None:
    return next((row.t_ns for batch in batches for row in batch.rows), None)


def merge(given_: Sequence[Sequence[InputBatch]]) -> tuple[list[Sequence[InputBatch]], list]:
    """The inputs in order of time, and their merged batches."""
    ordered = sorted(given_, key=lambda one: (first_ns(one) is None, first_ns(one) or 0))

    def opening(batches: Sequence[InputBatch]) -> TimedInput:
        return TimedInput(first_ns(batches), lambda _others: iter(batches))

    return ordered, list(merged_by_time([opening(one) for one in ordered]))


@given(inputs())
def test_every_split_of_rows_gives_the_sorted_rows(given_: list[list[InputBatch]]) -> None:
    ordered, merged = merge(given_)
    rows = [row for batches in ordered for batch in batches for row in batch.rows]
    assert [row for batch in merged for row in batch.rows] == sorted(
        rows, key=lambda row: row.t_ns or 0
    )


@given(inputs(), st.integers(0, 20))
def test_each_row_keeps_the_number_of_its_input(given_: list[list[InputBatch]], count: int) -> None:
    for batch in merge(given_)[1]:
        for part in (batch, batch.first(count)):
            origins = np.broadcast_to(part.origin, len(part.rows)).tolist()
            assert origins == [int(row.port) for row in part.rows]


@given(inputs(falling=True))
def test_nothing_is_lost_and_each_input_keeps_its_order(given_: list[list[InputBatch]]) -> None:
    ordered, merged = merge(given_)
    for batches in ordered:
        rows = [row for batch in batches for row in batch.rows]
        port = rows[0].port if rows else None
        assert [row for batch in merged for row in batch.rows if row.port == port] == rows
        events = [event for batch in batches for event in batch.rows.events]
        assert [e for batch in merged for e in batch.rows.events if e.port == port] == events


@given(inputs())
def test_a_change_stays_before_its_row(given_: list[list[InputBatch]]) -> None:
    ordered, merged = merge(given_)
    changes = [change for batch in merged for change in batch.changes]
    assert len(changes) == sum(len(b.changes) for batches in ordered for b in batches)
    for batch in merged:
        for change in batch.changes:
            row = batch.rows[change.index]
            assert isinstance(change.what, Gap)
            assert (row.port, row.offset) == (change.what.port, change.what.rows)


def columns(first: int, count: int, port: str) -> Rows:
    """Rows a microsecond apart from a number on."""
    return Rows.blank(count, (port,), t_ns=START + (first + np.arange(count)) * 1000)


def test_an_error_comes_after_the_rows_before_it() -> None:
    def broken() -> Iterator[InputBatch]:
        yield InputBatch(columns(0, 10, "a"))
        raise InputTextError("no hex")

    given_ = [
        TimedInput(START, lambda _: broken()),
        TimedInput(START, lambda _: iter([InputBatch(columns(0, 100, "b"))])),
    ]
    merged = merged_by_time(given_)
    assert len(next(merged).rows) == 19
    with pytest.raises(InputTextError):
        next(merged)


def recorded(
    path: Path, numbers: range, port: str, facts: dict[str, str] | None = None
) -> list[Row]:
    rows: list[Row] = [
        Row(port, 10 * at, SPEED, START + number * 1000) for at, number in enumerate(numbers)
    ]
    with RecordingWriter(path, [PortFacts(port, 115_200)], facts or {}) as writer:
        for at in range(0, len(rows), 50):
            writer.write(*entries(rows[at : at + 50]))
            writer.flush()
    return rows


def in_time(*inputs_: list[Row]) -> list[Row]:
    return sorted((row for rows in inputs_ for row in rows), key=lambda row: row.t_ns or 0)


def test_recordings_are_merged(tmp_path: Path) -> None:
    one = recorded(tmp_path / "b.mcap", range(0, 2000, 2), "one")
    other = recorded(tmp_path / "a.mcap", range(501, 1501, 2), "other")
    for files in ([tmp_path], [tmp_path / "*.mcap"], sorted(tmp_path.iterdir(), reverse=True)):
        reading = InputQuery(tuple(files)).read(None)
        batches = list(reading)
        assert [row for batch in batches for row in batch.rows] == in_time(one, other)
        assert not [gap for gap in reading.source.gaps if gap.start_ns is not None]


def test_an_overlapping_recording_interrupts_its_own_ports_only(tmp_path: Path) -> None:
    recorded(tmp_path / "a.mcap", range(0, 1000, 2), "one")
    recorded(tmp_path / "b.mcap", range(501, 601, 2), "other")
    reading = InputQuery((tmp_path,)).read(None)
    gaps = [
        (change.what.kind, change.what.port)
        for batch in reading
        for change in batch.changes
        if isinstance(change.what, Gap)
    ]
    assert gaps == [(GapKind.OTHER_RECORDING, None), (GapKind.OTHER_RECORDING, "other")]


def test_the_files_of_a_capture_follow_each_other_beside_another(tmp_path: Path) -> None:
    """Also if the clock was set back between them."""
    facts = {"start": "2026-01-31T12:00:00Z", "host": "bench"}
    parts = [range(0, 400, 2), range(400, 800, 2), range(700, 1000, 2)]
    capture = [
        recorded(tmp_path / f"a{number}.mcap", numbers, "one", facts | {"part": str(number)})
        for number, numbers in enumerate(parts, 1)
    ]
    other = recorded(tmp_path / "b.mcap", range(1, 1001, 2), "other")
    merged = list(InputQuery((tmp_path,)).read(None))
    rows = [row for batch in merged for row in batch.rows]
    assert [row for row in rows if row.port == "one"] == [row for one in capture for row in one]
    assert [row for row in rows if row.port == "other"] == other
    assert len([change for batch in merged for change in batch.changes]) == 4  # two bauds, two gaps


def test_span_filter_and_limit_are_those_of_the_merged_rows(tmp_path: Path) -> None:
    one = recorded(tmp_path / "a.mcap", range(0, 2000, 2), "one")
    other = recorded(tmp_path / "b.mcap", range(501, 1501, 2), "other")
    query = InputQuery((tmp_path,), since="+600us", until="+900us", filter_text="offset > 100")
    rows = [
        row
        for row in in_time(one, other)
        if 600_000 <= (row.t_ns or 0) - START < 900_000 and row.offset > 100
    ]
    for limit in (0, 1, 130, 10_000):
        reading = query.read(query.row_filter(), limit)
        assert [row for batch in reading for row in batch.rows] == rows[:limit]
        assert reading.written == len(rows[:limit])


def chunk_starts(content: bytes) -> list[int]:
    """The position of each chunk in a recording."""
    starts, at = [], len(MAGIC)
    while at < len(content) - len(MAGIC):
        opcode, length = HEAD.unpack_from(content, at)
        if opcode == Opcode.CHUNK:
            starts.append(at)
        at += HEAD.size + length
    return starts


@pytest.mark.parametrize("summary", [True, False])
def test_a_damaged_recording_is_merged_too(tmp_path: Path, summary: bool) -> None:
    one = recorded(tmp_path / "a.mcap", range(0, 2000, 2), "one")
    recorded(tmp_path / "b.mcap", range(501, 1501, 2), "other")
    content = bytearray((tmp_path / "b.mcap").read_bytes())
    starts = chunk_starts(bytes(content))
    content[starts[3] + 60 : starts[3] + 80] = bytes(20)
    (tmp_path / "b.mcap").write_bytes(content if summary else content[: starts[8] + 60])
    reading = InputQuery((tmp_path,)).read(None)
    rows = [row for batch in reading for row in batch.rows]
    assert [row for row in rows if row.port == "one"] == one
    assert rows == sorted(rows, key=lambda row: row.t_ns or 0)
    assert len(rows) - len(one) == (450 if summary else 350)
    assert any("b.mcap" in note for note in reading.notes)


def test_logs_and_recordings_merge_and_inputs_without_times_come_last(tmp_path: Path) -> None:
    recorded(tmp_path / "a.mcap", range(0, 20_000_000, 1_000_000), "one")
    clock = "2026-02-02T02:40:"
    lines = [f"{clock}{second:02}.500Z  {SPEED.hex(' ').upper()}\n" for second in range(19)]
    (tmp_path / "b.log").write_text("".join(lines))
    (tmp_path / "c.bin").write_bytes(SPEED * 3)
    files = [tmp_path / name for name in ("c.bin", "b.log", "a.mcap")]
    found = [row for batch in InputQuery(tuple(files)).read(None) for row in batch.rows]
    assert [row.t_ns for row in found[-3:]] == [None] * 3
    times = [row.t_ns or 0 for row in found[:-3]]
    assert times == sorted(times)
    assert len({row.port for row in found[:20]}) == 2
    assert len(found) == 20 + 19 + 3
