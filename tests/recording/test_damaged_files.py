"""Files that are damaged, hostile or no recordings: rows read are true, losses are reported."""

import os
import random
import re
import struct
import tracemalloc
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path

import lz4.frame
import pytest
import zstandard
from hypothesis import given
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.writer import Writer

from fte_sniff.errors import FileError
from fte_sniff.protocol import Damage, Fault, PortEvent, PortEventKind, Row
from fte_sniff.recording.mcap.reader import LARGEST, keep_freed_memory
from fte_sniff.recording.messages import TOPIC_BY_NAME, encode_event, encode_row
from fte_sniff.recording.metadata import PortFacts
from fte_sniff.recording.output_file import Existing
from fte_sniff.recording.reader import EVERYTHING, RecordingReader, TimeRange
from fte_sniff.recording.repair import Repair
from fte_sniff.recording.writer import RecordingWriter
from tests.beside import Work
from tests.cli.conftest import ROOT, plain_environment
from tests.cli.forked import Ended, Program
from tests.examples import examples
from tests.recording.conftest import START, some_rows, unprivileged
from tests.slow import first
from tests.support.columns import in_columns
from tests.support.recorded_rows import events_in
from tests.torture.damage import MAGIC
from tests.torture.damage import records as _records

Recorded = tuple[Path, list[Row], list[PortEvent]]
CHUNK = 6


def _read(path: Path) -> tuple[list[Row], RecordingReader]:
    reader = RecordingReader(path)
    return list(reader), reader


def _sizes(records: list[tuple[int, int, int]], length: int) -> list[int]:
    """Sizes around the ends of records and their heads, in chunks every 13th, elsewhere 97th."""
    ends = {place for _, *ends in records for place in ends}
    near = {place + step for place in ends for step in (-1, 0, 1, 8, 9, 10)}
    chunks = {size for opcode, *ends in records if opcode == CHUNK for size in range(*ends, 13)}
    sizes = near | chunks | set(range(0, length, 97))
    return sorted(size for size in sizes if len(MAGIC) <= size < length)


@pytest.mark.parametrize("every", first(1, [23, 1]))
def test_a_file_cut_anywhere_is_read_to_its_last_whole_chunk(
    recorded: Recorded, tmp_path: Path, every: int
) -> None:
    content, rows = recorded[0].read_bytes(), recorded[1]
    records = _records(content)
    ends = [end for opcode, _, end in records if opcode == CHUNK]
    path = tmp_path / "cut.mcap"
    for size in _sizes(records, len(content))[::every]:
        path.write_bytes(content[:size])
        found, reader = _read(path)
        whole = sum(end <= size for end in ends)
        assert found == rows[: min(20 * whole, len(rows))], size
        assert (reader.ending, reader.losses) != ("", ())
        assert reader.ending
        if any(start < size < end for _, start, end in records):
            assert f"the file ends at byte {size}" in reader.ending, (size, reader.ending)


def _assert_true(path: Path, rows: list[Row], where: object) -> list[Row]:
    """Whatever is read is among `rows` and in their order, or the file is refused."""
    try:
        found, reader = _read(path)
    except FileError:
        return []
    known = {row.offset: row for row in rows}
    assert [known.get(row.offset) for row in found] == found, where
    assert [row.offset for row in found] == sorted(row.offset for row in found), where
    assert [row.read_delay_ns for row in found] == [
        known[row.offset].read_delay_ns for row in found
    ], where
    assert (reader.ending, reader.losses) != ("", ()), where
    return found


def _heads(content: bytes) -> set[int]:
    """The first and the last record of each sort, before the chunks' end and behind it."""
    records = _records(content)
    behind = max(end for opcode, _, end in records if opcode == CHUNK)
    last = {(opcode, start >= behind): start for opcode, start, _ in records}
    first = {(opcode, start >= behind): start for opcode, start, _ in reversed(records)}
    return {*first.values(), *last.values()}


@pytest.mark.parametrize("value", first(1, [0xFF, 0x05]))
def test_every_byte_of_the_record_heads_may_be_wrong(
    recorded: Recorded, tmp_path: Path, value: int
) -> None:
    content = recorded[0].read_bytes()
    path = tmp_path / "heads.mcap"
    for start in _heads(content):
        for place in range(start, start + 9):
            altered = bytearray(content)
            if altered[place] == value:
                continue
            altered[place] = value
            path.write_bytes(altered)
            _assert_true(path, recorded[1], (place, value))


@pytest.mark.parametrize("field", range(0, 60, 3))
def test_a_damaged_chunk_costs_only_its_own_rows(
    recorded: Recorded, tmp_path: Path, field: int
) -> None:
    """Not even those if only the head of its record or its times are damaged."""
    content, rows = recorded[0].read_bytes(), recorded[1]
    _, start, _ = [record for record in _records(content) if record[0] == CHUNK][1]
    altered = bytearray(content)
    altered[start + field] ^= 0x41
    path = tmp_path / "x.mcap"
    path.write_bytes(altered)
    found = _assert_true(path, rows, field)
    others = rows[:20] + rows[40:]
    if field == 45:  # the length of the compressed data, which zstd knows itself
        assert found in (rows, others)
    else:
        assert found == (rows if field < 25 else others)


def test_a_chunk_whose_length_reaches_over_the_next_costs_no_row(
    recorded: Recorded, tmp_path: Path
) -> None:
    content, rows = bytearray(recorded[0].read_bytes()), recorded[1]
    chunks = [record for record in _records(bytes(content)) if record[0] == CHUNK]
    struct.pack_into("<Q", content, chunks[1][1] + 1, chunks[2][2] - chunks[1][1] - 9)
    path = tmp_path / "x.mcap"
    path.write_bytes(content)
    assert _assert_true(path, rows, "swallowed") == rows


def test_losses_are_reported(recorded: Recorded, tmp_path: Path) -> None:
    content = recorded[0].read_bytes()
    _, start, end = [record for record in _records(content) if record[0] == CHUNK][1]
    path = tmp_path / "x.mcap"
    path.write_bytes(content[: end - 20] + bytes(20) + content[end:])
    found, reader = _read(path)
    assert len(found) == 40
    assert len(reader.losses) == 2
    assert reader.losses[0].startswith(f"a chunk that does not unpack at byte {start} (")
    assert reader.losses[1] == "20 of 62 messages are missing"


def _mutate(content: bytes, changes: list[tuple[int, int, bytes]]) -> bytes:
    """Replace bytes: position, number of the old ones, and the new ones."""
    changed = bytearray(content)
    for position, old, new in changes:
        position %= len(changed) + 1
        changed[position : position + old] = new
    return bytes(changed)


mutations = st.lists(
    st.tuples(st.integers(0, 2**16), st.integers(0, 60), st.binary(max_size=60))
    | st.tuples(st.integers(0, 2**16), st.just(1), st.binary(min_size=1, max_size=1))
    | st.tuples(st.integers(0, 2**16), st.just(2**20), st.just(b"")),
    min_size=1,
    max_size=6,
)


def _read_or_refused(path: Path, span: TimeRange = EVERYTHING) -> tuple[list[Row], list[str]]:
    """The rows, and what is reported."""
    try:
        reader = RecordingReader(path)
        rows = [row for batch in reader.batches(span=span) for row in batch]
    except FileError as error:
        return [], [str(error)]
    return rows, [loss for loss in (*reader.losses, reader.ending) if loss]


def test_no_change_invents_a_row_or_goes_unnoticed(recorded: Recorded, tmp_path: Path) -> None:
    content = recorded[0].read_bytes()
    path = tmp_path / "changed.mcap"

    @examples(150)
    @given(mutations)
    def check(changes: list[tuple[int, int, bytes]]) -> None:
        changed = _mutate(content, changes)
        path.write_bytes(changed)
        if changed != content:
            _assert_true(path, recorded[1], changes)

    check()


def test_repair_keeps_what_decode_reads(recorded: Recorded, tmp_path: Path) -> None:
    content = recorded[0].read_bytes()
    path, repaired = tmp_path / "damaged.mcap", tmp_path / "repaired.mcap"

    @examples(150)
    @given(mutations)
    def check(changes: list[tuple[int, int, bytes]]) -> None:
        path.write_bytes(_mutate(content, changes))
        rows, _ = _read_or_refused(path)
        try:
            Repair(path).write(repaired, Existing.REPLACE)
        except FileError:
            assert rows == []
            return
        assert _read_or_refused(repaired) == (rows, [])

    check()


def test_a_time_range_has_the_rows_of_the_whole_file_or_damage_is_reported(
    recorded: Recorded, tmp_path: Path
) -> None:
    content, times = recorded[0].read_bytes(), [row.t_ns or 0 for row in recorded[1]]
    path = tmp_path / "damaged.mcap"

    @examples(150)
    @given(mutations, st.sampled_from(times), st.sampled_from(times))
    def check(changes: list[tuple[int, int, bytes]], one: int, other: int) -> None:
        span = TimeRange(min(one, other), max(one, other) + 1)
        path.write_bytes(_mutate(content, changes))
        everything, _ = _read_or_refused(path)
        rows, reported = _read_or_refused(path, span)
        assert rows == [row for row in everything if span.contains(row)] or reported

    check()


@pytest.mark.parametrize("place", ["index", "chunk"])
def test_an_index_is_trusted_only_where_the_chunk_agrees(
    recorded: Recorded, tmp_path: Path, place: str
) -> None:
    """Each bit of the times of the second chunk, or of its index, with the summary's checksum."""
    content, rows = recorded[0].read_bytes(), recorded[1]
    records = _records(content)
    chunk = [start for opcode, start, _ in records if opcode == CHUNK][1]
    index = [start for opcode, start, _ in records if opcode == 8][1]
    summary = next(end for opcode, _, end in records if opcode == 15)
    span = TimeRange(rows[25].t_ns or 0, rows[35].t_ns or 0)
    path = tmp_path / "x.mcap"
    for bit in range(2 * 64):
        altered = bytearray(content)
        altered[(index if place == "index" else chunk) + 9 + bit // 8] ^= 1 << bit % 8
        struct.pack_into("<I", altered, len(content) - 12, zlib.crc32(altered[summary:-12]))
        path.write_bytes(altered)
        assert _read_or_refused(path, span)[0] == rows[25:35], bit


def test_bytes_after_the_end_are_reported(recorded: Recorded, tmp_path: Path) -> None:
    content = recorded[0].read_bytes()
    path = tmp_path / "x.mcap"
    path.write_bytes(content + b"garbage")
    found, reader = _read(path)
    assert found == recorded[1]
    assert "other bytes follow its end" in reader.ending


def _chunk(compression: bytes, packed: bytes, claimed: int, length: int | None = None) -> bytes:
    body = struct.pack("<QQQI", 0, 0, claimed, 0)
    body += struct.pack("<I", len(compression)) + compression
    body += struct.pack("<Q", len(packed)) + packed
    return struct.pack("<BQ", CHUNK, len(body) if length is None else length) + body


def _full_chunk(records: bytes, compression: bytes = b"zstd") -> bytes:
    """A chunk with the right checksum."""
    pack = zstandard.compress if compression == b"zstd" else lz4.frame.compress
    content = bytearray(_chunk(compression, pack(records), len(records)))
    struct.pack_into("<I", content, 9 + 24, zlib.crc32(records))
    return bytes(content)


def _message(channel: int, data: bytes = b"") -> bytes:
    return struct.pack("<BQHIQQ", 5, 22 + len(data), channel, 0, START, START) + data


def _malformed(size: int) -> bytes:
    """A message of the topic with this many zero bytes."""
    row = Damage("p", 0, bytes(size), START, (Fault.NOISE,), 5)
    return encode_row(TOPIC_BY_NAME["/fte/malformed"], row, START)


def _rows_of_many_lengths(channel: int) -> bytes:
    lengths = (_message(channel, _malformed(size)) * 50 for size in range(1, 300))
    padding = random.Random(1).randbytes(60_000)
    return b"".join(lengths) + struct.pack("<BQ", 0x80, len(padding)) + padding


def _channels_of_other_topics() -> bytes:
    """Ten thousand channels."""
    random_bytes = random.Random(1).randbytes
    bodies = (
        struct.pack("<HHI20sI4sI", number, 0, 20, random_bytes(10).hex().encode(), 4, b"json", 0)
        for number in range(1000, 11_000)
    )
    return b"".join(struct.pack("<BQ", 4, len(body)) + body for body in bodies)


def _different_metadata() -> bytes:
    """Twenty thousand metadata records."""
    bodies = (
        struct.pack("<I9sII5sI1s", 9, b"fte-sniff", 14, 5, b"%05d" % number, 1, b"v")
        for number in range(20_000)
    )
    return b"".join(struct.pack("<BQ", 12, len(body)) + body for body in bodies)


OPENED = encode_event(PortEvent(START, "p", PortEventKind.OPENED, ""), START)
PRIVATE = struct.pack("<BQ", 0x80, 0)

BOMBS: dict[str, Callable[[dict[str, int]], bytes]] = {
    "zeros": lambda _: _full_chunk(bytes(600 * 2**20)),
    "zeros in lz4": lambda _: _full_chunk(bytes(60 * 2**20), b"lz4"),
    "opcode 0": lambda _: _full_chunk(bytes(10_000)),
    "private records outside": lambda _: PRIVATE,
    "chunk in a chunk": lambda _: _full_chunk(_full_chunk(bytes(2**24))),
    "empty messages": lambda ids: _full_chunk(_message(ids["/fte/port"]) * 6_000_000),
    "short chunks of them": lambda ids: _full_chunk(_message(ids["/fte/port"]) * 30),
    "port events": lambda ids: _full_chunk(_message(ids["/fte/port"], OPENED) * 14),
    "long rows": lambda ids: _full_chunk(_message(ids["/fte/malformed"], _malformed(1024)) * 10),
    "rows of many lengths": lambda ids: _full_chunk(_rows_of_many_lengths(ids["/fte/malformed"])),
    "one large message": lambda ids: _full_chunk(_message(ids["/fte/port"], bytes(39 * 2**20))),
    "marks": lambda _: b"\x04\0\0\0zstd",
    "overlapping chunks": lambda _: _chunk(b"zstd", zstandard.compress(bytes(2**25)), 2**25, 0),
    "different metadata": lambda _: _different_metadata(),
    "junk between chunks": lambda _: _full_chunk(PRIVATE) + b"\0",
}
"""Records for the channel ids by topic; the file has as many as fit."""

SCAN = "import sys, fte_sniff; print(fte_sniff.scan(sys.argv[1]).collect().height)"
COMMANDS: dict[str, tuple[str, ...]] = {
    "decode": ("decode", "{file}", "--format", "csv", "-o", "rows.csv", "--force"),
    "repair": ("repair", "{file}", "-o", "repaired.mcap", "--force"),
    "scan": ("{file}",),
    "stats": ("stats", "{file}"),
    "report": ("report", "{file}", "-o", "report.html", "--force"),
    "check": ("check", "{file}", "--expect", "count(malformed) >= 0"),
}
DEAREST = ("port events", "long rows", "junk between chunks")
LARGEST_BOMB = 900_000
MINUTE_ROWS = 69_120
MOST_MINUTES = 40
"""Minutes of a full wire whose cost the largest bomb may have on the same machine."""
MOST_BYTES = 300 << 20
SMALL = LARGEST_BOMB // 8
BOMB_CASES = first(
    len(BOMBS) + len(DEAREST),
    [
        *((name, "repair", SMALL) for name in BOMBS),
        *((name, "decode", SMALL) for name in DEAREST),
        # The other commands read as `decode` does. A report takes seconds, whatever it reads.
        *((name, "decode", LARGEST_BOMB) for name in BOMBS),
        *((name, "repair", LARGEST_BOMB) for name in BOMBS),
        *((name, command, LARGEST_BOMB) for name in DEAREST for command in COMMANDS),
    ],
)
"""Bombs, what reads them, and the bytes that they have."""


class Costs:
    """What commands cost in processes that have loaded the program."""

    def __init__(self, program: Program, folder: Path) -> None:
        self._program = program
        self._folder = folder
        self._environment = plain_environment() | {"POLARS_MAX_THREADS": "2"}
        self._best: dict[tuple[str, Path], Ended] = {}
        self.tiny = _written(folder / "tiny.mcap", 60, 20)
        self.minute = _written(folder / "minute.mcap", MINUTE_ROWS, 1152)

    def best(self, command: str, file: Path, again: bool = False) -> Ended:
        """The cheapest run of a command so far, which is done: a busy machine only adds to it."""
        known = self._best.get((command, file))
        if known is None or again:
            words = [word.format(file=file.name) for word in COMMANDS[command]]
            code = SCAN if command == "scan" else None
            ended = self._program.run(words, b"", file.parent, self._environment, code)
            assert ended.code == 0, (command, ended.errors)
            known = min(known or ended, ended, key=lambda run: run.cpu_s)
            self._best[command, file] = known
        return known

    def are_bounded(self, command: str, bomb: Path, most_minutes: float) -> bool:
        """Whether a bomb costs no more than it may, in the best of some runs."""
        files = (self.tiny, self.minute, bomb)
        for again in (False, *[True] * 7):
            tiny, minute, found = (self.best(command, file, again) for file in files)
            if found.cpu_s - tiny.cpu_s <= most_minutes * (minute.cpu_s - tiny.cpu_s):
                return found.peak_bytes - tiny.peak_bytes < MOST_BYTES
        return False


def _written(path: Path, rows: int, chunk: int) -> Path:
    with RecordingWriter(path, [PortFacts("/dev/ttyUSB0", 115_200)]) as writer:
        made = some_rows(rows)
        for start in range(0, rows, chunk):
            writer.write(in_columns(made[start : start + chunk]))
            writer.flush()
    return path


@pytest.fixture(scope="module")
def costs(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Costs]:
    with Program(plain_environment(), ROOT) as program:
        yield Costs(program, tmp_path_factory.mktemp("costs"))


@pytest.mark.parametrize(("name", "command", "size"), BOMB_CASES)
def test_no_small_file_takes_much_memory_or_time(
    recorded: Recorded, tmp_path: Path, costs: Costs, name: str, command: str, size: int
) -> None:
    """And the rows before and after the bomb are read."""
    content = recorded[0].read_bytes()
    with recorded[0].open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    bomb = BOMBS[name]({channel.topic: channel.id for channel in summary.channels.values()})
    bomb *= max(1, size // len(bomb))
    place = summary.chunk_indexes[1].chunk_start_offset
    path = tmp_path / "bomb.mcap"
    path.write_bytes(content[:place] + bomb + content[place:])
    assert path.stat().st_size < 1_000_000
    most_minutes = MOST_MINUTES * max(size, len(bomb)) / LARGEST_BOMB
    assert costs.are_bounded(command, path, most_minutes)
    if command == "decode":
        lines = (tmp_path / "rows.csv").read_text().splitlines()
        assert len({line for line in lines if "/dev/ttyUSB0" in line}) >= len(recorded[1])
    if command == "repair":
        kept = {(row.offset, row.raw) for row in RecordingReader(tmp_path / "repaired.mcap")}
        assert kept >= {(row.offset, row.raw) for row in recorded[1]}


def test_any_number_of_other_channels_may_be_before_the_rows(
    recorded: Recorded, tmp_path: Path
) -> None:
    """Also without a summary, so that the rows' own channels come after all others."""
    content = recorded[0].read_bytes()
    chunks = [(start, end) for opcode, start, end in _records(content) if opcode == CHUNK]
    start, end = chunks[0][0], chunks[-1][1]
    path = tmp_path / "x.mcap"
    path.write_bytes(
        content[:start] + _full_chunk(_channels_of_other_topics()) + content[start:end]
    )
    assert [row.raw for row in _read(path)[0]] == [row.raw for row in recorded[1]]


NAMELESS = zstandard.ZstdCompressor(write_content_size=False)
BOMB = b"\0" * (64 * 1024 * 1024)


@pytest.mark.parametrize(
    "chunk",
    [
        _chunk(b"zstd", zstandard.compress(BOMB), 1000),
        _chunk(b"zstd", NAMELESS.compress(BOMB), 1000),
        _chunk(b"zstd", zstandard.compress(b"x"), 2**62),
        _chunk(b"zstd", zstandard.compress(b"x"), LARGEST + 1),
        _chunk(b"zstd", NAMELESS.compress(b"x"), LARGEST + 1),
        _chunk(b"lz4", lz4.frame.compress(BOMB), 1000),
        _chunk(b"", b"", 2**62),
        _chunk(b"", b"x" * 100, 100, length=2**62),
        _chunk(b"", b"x" * 100, 100, length=LARGEST),
        _chunk(b"brotli", b"x" * 100, 100),
        _chunk(b"", struct.pack("<BQ", 5, 2**62), 9),
        _chunk(b"\xff" * 100, b"", 0),
        struct.pack("<BQ", CHUNK, 0),
        struct.pack("<BQ", CHUNK, 2**64 - 1),
        struct.pack("<BQI", 4, 4, 2**32 - 1),
        struct.pack("<BQ", 5, 3) + b"abc",
    ],
)
def test_sizes_in_a_file_are_not_trusted(tmp_path: Path, chunk: bytes) -> None:
    path = tmp_path / "hostile.mcap"
    RecordingWriter(path, [PortFacts("p")]).close()
    content = path.read_bytes()
    data_end = next(start for opcode, start, _ in _records(content) if opcode == 15)
    path.write_bytes(content[:data_end] + chunk + content[data_end:])
    keep_freed_memory()  # once for the process, whatever the file says
    tracemalloc.start()
    try:
        found, reader = _read(path)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert found == []
    assert (reader.ending, reader.losses) != ("", ())
    assert peak < 8 * 1024 * 1024


def test_a_definition_without_valid_checksum_is_not_trusted(
    recorded: Recorded, tmp_path: Path
) -> None:
    """A flipped bit in a port's name would put the rows on another port."""
    content = bytearray(recorded[0].read_bytes())
    names = [found.start() for found in re.finditer(b"ttyUSB0", content)]
    assert len(names) > 10
    path = tmp_path / "x.mcap"
    for name in names:
        altered = content.copy()
        altered[name + 6] ^= 1
        path.write_bytes(altered)
        assert _assert_true(path, recorded[1], name) == recorded[1]


def test_a_summary_that_does_not_match_its_checksum_leads_nowhere(
    recorded: Recorded, tmp_path: Path
) -> None:
    content, rows = bytearray(recorded[0].read_bytes()), recorded[1]
    start = next(start for opcode, start, _ in _records(bytes(content)) if opcode == 8)
    struct.pack_into("<Q", content, start + 9 + 16, 20)  # where the chunk begins, it says
    path = tmp_path / "x.mcap"
    path.write_bytes(content)
    assert _assert_true(path, rows, "summary") == rows


def test_many_losses_are_summed_up(tmp_path: Path, make_rows: Callable[..., list[Row]]) -> None:
    path = tmp_path / "x.mcap"
    with RecordingWriter(path, [PortFacts("p")]) as writer:
        for number in range(100):
            writer.write(in_columns(make_rows(1, start=10**18 + number)))
            writer.flush()
    content = bytearray(path.read_bytes())
    for opcode, start, end in _records(bytes(content)):
        if opcode == CHUNK:
            content[start + 40] ^= 0xFF
            assert zlib.crc32(content[start:end])
    path.write_bytes(content)
    found, reader = _read(path)
    assert found == []
    assert len(reader.losses) == 22
    assert "more could not be read (80 times)" in reader.losses


@pytest.mark.parametrize("summary", ["whole", "unguarded", "cut off"])
def test_after_a_damaged_beginning_the_rows_of_all_whole_chunks_are_read(
    recorded: Recorded, tmp_path: Path, summary: str
) -> None:
    """Without a copy of the ports and a summary, nothing shows which ports the rows are of."""
    content, rows = bytearray(recorded[0].read_bytes()), recorded[1]
    chunks = [(start, end) for opcode, start, end in _records(bytes(content)) if opcode == CHUNK]
    if summary == "unguarded":
        content[-12:-8] = bytes(4)
    elif summary == "cut off":
        del content[chunks[-1][1] :]
    path = tmp_path / "x.mcap"
    sizes = [1, 8, 50, *(place + step for chunk in chunks for place in chunk for step in (-1, 1))]
    for size in sizes:
        path.write_bytes(bytes(size) + content[size:])
        # A chunk's own head is not needed; the last one holds an event alone.
        whole = sum(start + 9 >= size for start, _ in chunks[:3])
        if size > chunks[-1][0] + 9 and summary == "whole":
            assert _assert_true(path, rows, size) == []
            continue
        if size > chunks[-1][0] + 9:
            with pytest.raises(FileError, match="is not an MCAP recording"):
                RecordingReader(path)
            continue
        found = _assert_true(path, rows, size)
        if whole < 3 and summary == "cut off" and b"fte-sniff.ports" not in content[size:]:
            assert found == []
            continue
        assert found == rows[len(rows) - 20 * whole :], size
        reader = RecordingReader(path)
        assert [port.baud for port in reader.ports] == [115_200]
        list(reader)
        assert str(reader.losses[0]).startswith("the first ")


def test_intact_chunks_after_a_damaged_one_are_found_without_a_summary(
    recorded: Recorded, tmp_path: Path
) -> None:
    """Also where the damaged chunk claims those behind it for its own."""
    content, rows = recorded[0].read_bytes(), recorded[1]
    chunks = [(start, end) for opcode, start, end in _records(content) if opcode == CHUNK]
    content = content[: chunks[-1][1]]
    path = tmp_path / "x.mcap"
    (start, end), (_, last) = chunks[1], chunks[2]
    for length in (0, 7, end - start, last - start - 9, last - start - 8, 2**40, 2**63):
        altered = bytearray(content)
        struct.pack_into("<Q", altered, start + 1, length)
        path.write_bytes(altered)
        assert _assert_true(path, rows, length) == rows, length
        reader = RecordingReader(path)
        for passage, columns in list(reader.ranges()):
            assert list(reader.read(passage)) == list(columns)
        altered[end - 30] ^= 0x41
        path.write_bytes(altered)
        assert _assert_true(path, rows, length) == rows[:20] + rows[40:], length


def _mcap(path: Path, topics: list[str], encoding: str = "json") -> None:
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema("x", "jsonschema", b"{}")
        for topic in topics:
            channel = writer.register_channel(topic, encoding, schema)
            writer.add_message(channel, 5, b"{}", 5)
        writer.finish()


def _refusal(path: Path) -> str:
    with pytest.raises(FileError) as caught:
        list(RecordingReader(path))
    text = str(caught.value)
    assert "\n" not in text
    assert str(path) in text
    assert text.isprintable()
    return text


def test_files_that_are_not_recordings(tmp_path: Path) -> None:
    (tmp_path / "empty.mcap").touch()
    (tmp_path / "hex.mcap").write_text("AA 01 01 03 E8 00 00 00 00 EE\n")
    (tmp_path / "short.mcap").write_bytes(b"\x89MCA")
    (tmp_path / "short.raw").write_bytes(b"\xaa")
    assert "no such file" in _refusal(tmp_path / "absent.mcap")
    assert "is a directory" in _refusal(tmp_path)
    assert "is empty" in _refusal(tmp_path / "empty.mcap")
    assert "`fte-sniff decode --input hex LOG -o" in _refusal(tmp_path / "hex.mcap")
    assert "`fte-sniff decode --input hex LOG -o" in _refusal(tmp_path / "short.raw")
    assert "cut after 4 bytes" in _refusal(tmp_path / "short.mcap")


def test_a_file_that_may_not_be_read(tmp_path: Path) -> None:
    path = tmp_path / "secret.mcap"
    path.touch()
    path.chmod(0)
    with unprivileged():
        assert "no permission to read" in _refusal(path)


def test_an_mcap_of_another_program_is_refused_with_its_topics(tmp_path: Path) -> None:
    path = tmp_path / "robot.mcap"
    _mcap(path, ["/tf", "/odom", "/evil\x1b[31m", *(f"/t{n:02}" for n in range(20))])
    text = _refusal(path)
    assert "'/odom'" in text
    assert "'/evil\\x1b[31m'" in text
    assert "and 13 more" in text


def test_an_mcap_of_another_program_without_a_summary(tmp_path: Path) -> None:
    path = tmp_path / "robot.mcap"
    _mcap(path, ["/tf"])
    path.write_bytes(path.read_bytes()[:-20])
    assert "it has '/tf'" in _refusal(path)


def test_an_mcap_with_nothing_in_it_has_no_topics(tmp_path: Path) -> None:
    path = tmp_path / "nothing.mcap"
    _mcap(path, [])
    assert "no topics at all" in _refusal(path)


def test_our_topics_in_another_encoding(tmp_path: Path) -> None:
    path = tmp_path / "json.mcap"
    _mcap(path, ["/fte/control/motor1"])
    assert "/fte/control/motor1 is 'json'; fte-sniff reads protobuf" in _refusal(path)


def test_a_pipe_is_read_as_often_as_wanted(
    tmp_path: Path, recorded: tuple[Path, list[Row], list[PortEvent]]
) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    content = recorded[0].read_bytes()
    feeder = Work(pipe.write_bytes, content)
    reader = RecordingReader(pipe)
    feeder.ended()
    assert list(reader) == recorded[1]
    assert list(reader) == recorded[1]
    assert events_in(reader) == recorded[2]
    assert (reader.ending, reader.losses) == ("", ())


def test_rows_come_before_the_file_is_read_to_its_end(
    tmp_path: Path, make_rows: Callable[..., list[Row]]
) -> None:
    from fte_sniff.recording.writer import RecordingWriter

    path = tmp_path / "long.mcap"
    rows = make_rows(20_000)
    with RecordingWriter(path, []) as writer:
        for start in range(0, 20_000, 100):
            writer.write(in_columns(rows[start : start + 100]))
            writer.flush()
    reader = RecordingReader(path)
    coming = iter(reader)
    first = next(coming)
    os.truncate(path, path.stat().st_size // 2)
    found = [first, *coming]
    assert found == rows[: len(found)]
    assert 100 < len(found) < 20_000
    assert (reader.ending, reader.losses) != ("", ())
