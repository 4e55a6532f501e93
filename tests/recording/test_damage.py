"""Damage to recordings: what is intact is read, what is lost is reported, nothing is invented."""

from __future__ import annotations

import os
import struct
import tracemalloc
from collections.abc import Iterable
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import lz4.frame
import pytest
import zstandard
from hypothesis import example, given
from hypothesis import strategies as st
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import Chunk, Message
from mcap.writer import Writer
from zlib_ng.zlib_ng import crc32

from fte_sniff.cli.repair import repaired
from fte_sniff.errors import FileError
from fte_sniff.protocol.rows import Row
from fte_sniff.recording.chunks import HEAD, LARGEST, MAGIC
from fte_sniff.recording.metadata import PortFacts
from fte_sniff.recording.output_file import Existing
from fte_sniff.recording.reader import EVERYTHING, Recording, TimeRange
from fte_sniff.recording.writer import RecordingWriter, bytes_of
from tests.examples import examples
from tests.recording.samples import (
    EVENTS,
    FIRST,
    WAYS,
    Recorded,
    events_in,
    flush_each,
    heads_of,
    recorded,
    records,
    rows_of,
    some_rows,
)
from tests.support.columns import rows_from

SECTOR = 512
CLAIMS = (0, 1, 2**31 - 1, 2**31, 2**32 - 1, 2**40, 2**63 - 1, 2**63, 2**64 - 1)
"""Lengths that a hostile file may claim."""


class Found(NamedTuple):
    """What a reader makes of a file."""

    rows: list[Row]
    reports: list[str]
    """What it reports of damage; the reason where it refuses the file."""
    recording: Recording | None


def found_in(path: Path, span: TimeRange = EVERYTHING) -> Found:
    """The rows of a file and what is reported."""
    try:
        recording = Recording(path)
        rows = rows_of(recording.items(span))
    except FileError as error:
        return Found([], [str(error)], None)
    return Found(rows, recording.losses, recording)


def check(one: Recorded, damaged: bytes, path: Path, span: TimeRange) -> Found:
    """Hold all readers of a damaged file to their promises."""
    path.write_bytes(damaged)
    rows, reports, recording = found = found_in(path)
    places = {(row.offset, row.raw, row.t_ns): number for number, row in enumerate(one.rows)}
    numbers = [places[row.offset, row.raw, row.t_ns] for row in rows]
    assert numbers == sorted(set(numbers)), "a row is read twice, or before an earlier one"
    own = [one.rows[number] for number in numbers]
    assert [row.faults for row in own] == [row.faults for row in rows], "a row is invented"
    names = {(theirs.port, row.port) for theirs, row in zip(own, rows, strict=True)}
    assert len(names) == len({name for _, name in names}), "rows of two ports are mixed"
    assert reports or rows == one.rows or damaged == one.content, "a loss is not reported"
    left = {places[row.offset, row.raw, row.t_ns] for row in one.left(damaged)}
    assert left <= {*numbers}, f"rows of whole chunks are not read: {reports}"
    inside = found_in(path, span)
    assert unnamed(inside.rows) == unnamed(rows_of(span.within([rows_from(rows)])))
    check_repair(one, path, found)
    if recording is not None:
        chunks = recording.contents.chunks
        again = [row for chunk in chunks for row in rows_of(recording.read([chunk]))]
        assert unnamed(again) == unnamed(rows)
        check_growing(path, found)
    return found


def check_repair(one: Recorded, path: Path, found: Found) -> None:
    """A repaired file is whole, and has the rows that were read."""
    mended, content = path.with_name("mended.mcap"), path.read_bytes()
    mended.unlink(missing_ok=True)
    try:
        repair = repaired(Recording(path), mended, Existing.REFUSE)
    except FileError:
        assert not found.rows
        assert not mended.exists()
        return
    assert path.read_bytes() == content
    if repair is None:
        assert (found.rows, found.reports) == (one.rows, [])
        assert not mended.exists()
        return
    again = found_in(mended)
    assert (again.rows, again.reports) == (found.rows, [])
    assert repaired(Recording(mended), path.with_name("again.mcap"), Existing.REFUSE) is None
    with mended.open("rb") as file:
        messages = sum(1 for _ in make_reader(file, validate_crcs=True).iter_messages())
    assert messages == repair.tally.rows == len(found.rows)


def check_growing(path: Path, found: Found) -> None:
    """A follower reads what it can up to the damage, and the rest when nobody writes any more."""
    growing = Recording(path, is_growing=True)
    rows = rows_of(growing.read(growing.contents.chunks))
    assert unnamed(rows) == unnamed(found.rows[: len(rows)])
    growing.grow(is_over=True)
    assert unnamed(rows_of([*growing.items()])) == unnamed(found.rows)


def unnamed(rows: Iterable[Row]) -> list[Row]:
    """Rows without the names of their ports: a name counts from where it is read on."""
    return [replace(row, port="") for row in rows]


def places_of(one: Recorded) -> st.SearchStrategy[int]:
    """Positions, mostly at the heads of records."""
    last = len(one.content) - 1
    heads = [0, *(start for _, start, _ in records(one.content)), last]
    ends = [head for head in heads if head < 6_000 or head > last - 6_000]
    near = st.tuples(st.sampled_from(heads + 3 * ends), st.integers(-SECTOR, 60)).map(sum)
    return st.one_of(st.integers(0, last), near).map(lambda at: min(max(at, 0), last))


def changes_to(one: Recorded) -> st.SearchStrategy[list[tuple[int, int, bytes]]]:
    """Changes of a file: a position, the number of bytes removed there, and what replaces them."""
    junk = st.tuples(st.sampled_from([1, 1, 16, 200, SECTOR]), st.sampled_from([0, 0xFF, 0xAA]))
    sector = junk.map(lambda two: bytes([two[1]]) * two[0]) | st.binary(min_size=1, max_size=SECTOR)
    starts = st.sampled_from([start for _, start, _ in records(one.content)])
    claims = st.sampled_from(CLAIMS).map(lambda length: length.to_bytes(8, "little"))
    overwritten = st.one_of(
        st.tuples(places_of(one), sector),
        st.tuples(starts.map(lambda start: start + 1), claims),
        st.tuples(starts, st.integers(0, 255).map(lambda opcode: bytes([opcode]))),
    ).map(lambda two: (two[0], len(two[1]), two[1]))
    spliced = st.tuples(places_of(one), st.integers(0, 60), st.binary(max_size=200))
    cut = st.tuples(places_of(one), st.just(len(one.content)), st.just(b""))
    return st.lists(st.one_of(overwritten, overwritten, spliced, cut), min_size=1, max_size=8)


def overwritten(content: bytes, *sectors: tuple[int, bytes]) -> bytes:
    """The content with other bytes in place; each differs from what was there."""
    altered = bytearray(content)
    for place, junk in sectors:
        junk = junk[: len(content) - place]
        if altered[place : place + len(junk)] == junk:
            junk = bytes(byte ^ 0x55 for byte in junk)
        altered[place : place + len(junk)] = junk
    return bytes(altered)


def spans_of(one: Recorded) -> st.SearchStrategy[TimeRange]:
    """Time spans with rows in them."""
    times = st.sampled_from([row.t_ns or 0 for row in one.rows])
    return st.tuples(times, times).map(lambda two: TimeRange(min(two), max(two) + 1))


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("count", [36, pytest.param(129, marks=pytest.mark.slow)])
def test_damage_costs_at_most_the_chunks_that_it_hits(way: str, count: int, tmp_path: Path) -> None:
    one = recorded(way)
    # Both copies of the definitions are lost, and a record behind the header is taken for it.
    header = [(18, 49, b""), (418, 60, b""), (17_666, 60, b"")]

    @example(header, EVERYTHING)
    @examples(count)
    @given(changes_to(one), spans_of(one))
    def holds(changes: list[tuple[int, int, bytes]], span: TimeRange) -> None:
        altered = bytearray(one.content)
        for place, removed, junk in changes:
            altered[place : place + removed] = junk
        check(one, bytes(altered), tmp_path / "x.mcap", span)

    holds()


def test_chunks_that_are_shifted_behind_a_whole_index_are_read(tmp_path: Path) -> None:
    one = recorded("one port")
    (first, _), (last, end) = [*one.chunks][2], [*one.chunks][6]
    altered = bytearray(one.content)
    altered[end - 30 : end - 30] = bytes(7)
    del altered[first + 60 : first + 67]
    assert len(altered) == len(one.content)
    rows = check(one, bytes(altered), tmp_path / "x.mcap", EVERYTHING).rows
    assert len(rows) == len(one.rows) - len(one.chunks[first, [*one.chunks][2][1]]) - len(
        one.chunks[last, end]
    )


@pytest.mark.parametrize("last", [7, 500])
def test_a_shift_among_many_chunks_costs_those_that_it_hits(last: int, tmp_path: Path) -> None:
    """A short one may be missed where the chunks are compared with the index."""
    path, rows = tmp_path / "x.mcap", rows_from(some_rows(1000))
    with RecordingWriter(path, [FIRST]) as writer:
        for number in range(len(rows)):
            writer.write(rows[number : number + 1])
            writer.flush(waits=False)
    starts, altered = heads_of(path.read_bytes(), Opcode.CHUNK), bytearray(path.read_bytes())
    altered[starts[last] + 80 : starts[last] + 80] = bytes(7)
    del altered[starts[5] + 60 : starts[5] + 67]
    path.write_bytes(altered)
    found = found_in(path)
    lost = {*range(5, last + 1)} if last == 7 else {5, last}
    assert found.rows == [row for number, row in enumerate(rows) if number not in lost]
    assert found.reports


def test_bytes_of_others_between_chunks_are_not_read(tmp_path: Path) -> None:
    one, path, size = recorded("under way"), tmp_path / "x.mcap", 1 << 24
    starts = [at for at, _ in one.chunks]
    with path.open("wb") as file:
        for start, stop in pairwise([0, *starts[1:], len(one.content)]):
            file.write(one.content[start:stop])
            if stop in starts:
                file.write(HEAD.pack(0xF1, size))
                file.seek(size, os.SEEK_CUR)
    tracemalloc.start()
    try:
        found = found_in(path)
        assert tracemalloc.get_traced_memory()[1] < size // 4
    finally:
        tracemalloc.stop()
    assert found.rows == one.rows


def test_a_chunk_is_found_wherever_long_damage_ends(tmp_path: Path) -> None:
    """Damage is searched in blocks of 64 KiB; the head of a chunk may lie in two of them."""
    one, path = recorded("under way"), tmp_path / "x.mcap"
    start, _ = [*one.chunks][2]
    block_end = 65_536 + max(at for _, at, end in records(one.content) if end <= start)
    for at in range(block_end - 80, block_end + 8, 4):
        path.write_bytes(one.content[:start] + bytes(at - start) + one.content[start:])
        assert found_in(path).rows == one.rows


def test_a_record_that_skips_whole_chunks_is_damage(tmp_path: Path) -> None:
    one = recorded("one port")
    start, end = [*one.chunks][2][0], [*one.chunks][5][0]
    private = struct.pack("<BQ", 0xF1, end - start)
    check(one, one.content[:start] + private + one.content[start:], tmp_path / "x", EVERYTHING)


@pytest.mark.parametrize("word", [b"protobuf", b"port"])
def test_rows_of_a_channel_with_a_damaged_definition_are_read(word: bytes, tmp_path: Path) -> None:
    """The definitions of the first chunk are lost; those of the index have no checksum."""
    one = recorded("bulk")
    first, after = next(iter(one.chunks))[0], heads_of(one.content, Opcode.DATA_END)[0]
    places = [at for at in range(after, len(one.content)) if one.content[at:].startswith(word)]
    damages = [(first + 100, b"x"), *((at, b"x") for at in places[::2])]
    assert places
    check(one, overwritten(one.content, *damages), tmp_path / "x", EVERYTHING)


@pytest.mark.parametrize("way", WAYS)
def test_without_any_definition_rows_are_read_by_our_own(way: str, tmp_path: Path) -> None:
    """The head, the first chunk and the summary are destroyed."""
    one = recorded(way)
    chunks = [*one.chunks]
    end = chunks[0][1] - 10
    after = heads_of(one.content, Opcode.DATA_END)[0]
    altered = bytes(end) + one.content[end:after] + bytes(len(one.content) - after)
    rows = check(one, altered, tmp_path / "x.mcap", EVERYTHING).rows
    assert len(rows) == len(one.rows) - len(one.chunks[chunks[0]])
    if way != "port added last":
        assert {row.port for row in rows} <= {"port 1", "port 2"}


def test_a_flipped_bit_in_a_name_puts_no_row_on_another_port(tmp_path: Path) -> None:
    one = recorded("under way")
    for at in range(1, len(one.content)):
        is_packed = any(start <= at < end for start, end in one.chunks)
        if one.content[at : at + 7] == b"ttyUSB0" and not is_packed:
            altered = overwritten(one.content, (at + 6, b"1"))
            assert check(one, altered, tmp_path / "x.mcap", EVERYTHING).rows == one.rows


def test_a_loss_is_stated_in_bytes_and_is_a_gap_of_the_repaired_file(tmp_path: Path) -> None:
    one, path = recorded("one port"), tmp_path / "x.mcap"
    start, end = [*one.chunks][2]
    before, after = (one.chunks[[*one.chunks][number]] for number in (1, 3))
    damaged = overwritten(one.content, (end - 5, bytes(5)))
    reports = check(one, damaged, path, EVERYTHING).reports
    where = f"bytes {start} to {end}"
    assert reports == [f"{where} could not be read: a chunk that does not unpack"]
    (gap,) = Recording(tmp_path / "mended.mcap").gaps()
    assert (gap.start_ns, gap.end_ns) == ((before[-1].t_ns or 0) + 1, (after[0].t_ns or 0) - 1)
    assert gap.reason == "a chunk that does not unpack"


@pytest.mark.parametrize("way", ["one port", "under way"])
def test_bytes_behind_the_end_are_reported(way: str, tmp_path: Path) -> None:
    one = recorded(way)
    end = len(one.content)
    found = check(one, one.content + b"junk", tmp_path / "x.mcap", EVERYTHING)
    assert found.rows == one.rows
    assert found.reports == [
        f"bytes {end} to {end + 4} could not be read: they are behind the end of the recording"
    ]


def test_a_large_message_is_in_memory_once(tmp_path: Path) -> None:
    one, size = recorded("under way"), 32 << 20
    message = Message(channel_id=1, log_time=0, data=bytes(size), publish_time=0, sequence=0)
    records = bytes_of(message)
    packed = zstandard.ZstdCompressor().compress(records)
    chunk = bytes_of(Chunk("zstd", packed, 0, 0, crc32(records), len(records)))
    end = heads_of(one.content, Opcode.DATA_END)[0]
    (path := tmp_path / "x.mcap").write_bytes(one.content[:end] + chunk + one.content[end:])
    tracemalloc.start()
    try:
        found = found_in(path)
        assert tracemalloc.get_traced_memory()[1] < 1.5 * size
    finally:
        tracemalloc.stop()
    assert found.rows == one.rows
    (report,) = found.reports
    assert report.endswith("could not be read: 1 messages")


def test_many_losses_are_summed_up(tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    with RecordingWriter(path, [PortFacts("p")]) as writer:
        flush_each(writer, some_rows(100), 1)
    content = path.read_bytes()
    chunks = [(at + 90, b"\xff") for at in heads_of(content, Opcode.CHUNK)]
    path.write_bytes(overwritten(content, *chunks))
    found = found_in(path)
    assert found.recording is not None
    assert "no row in it could be read" in str(found.recording.nothing_read)
    assert found.reports[-1] == "90 more damaged spans"


def chunk(name: bytes, packed: bytes, claimed: int, length: int | None = None) -> bytes:
    """A chunk that claims these sizes."""
    body = struct.pack("<QQQI", 0, 0, claimed, 0) + struct.pack("<I", len(name)) + name
    body += struct.pack("<Q", len(packed)) + packed
    return struct.pack("<BQ", Opcode.CHUNK, len(body) if length is None else length) + body


NAMELESS = zstandard.ZstdCompressor(write_content_size=False)
ZEROS = bytes(64 << 20)
HOSTILE = [
    chunk(b"zstd", zstandard.compress(ZEROS), 1000),
    chunk(b"zstd", NAMELESS.compress(ZEROS), 1000),
    chunk(b"zstd", zstandard.compress(b"x"), 2**62),
    chunk(b"zstd", zstandard.compress(b"x"), LARGEST + 1),
    chunk(b"zstd", NAMELESS.compress(b"x"), LARGEST + 1),
    chunk(b"lz4", lz4.frame.compress(ZEROS), 1000),
    chunk(b"", b"", 2**62),
    chunk(b"", b"x" * 100, 100, length=2**62),
    chunk(b"", b"x" * 100, 100, length=LARGEST),
    chunk(b"brotli", b"x" * 100, 100),
    chunk(b"", struct.pack("<BQ", 5, 2**62), 9),
    chunk(b"", b"\x05" * 5, 5),
    struct.pack("<BQ", Opcode.CHUNK, 0),
    struct.pack("<BQ", Opcode.CHUNK, 2**64 - 1),
    struct.pack("<BQI", Opcode.CHANNEL, 4, 2**32 - 1),
]


@pytest.mark.parametrize("record", HOSTILE)
def test_sizes_in_a_file_are_not_trusted(tmp_path: Path, record: bytes) -> None:
    one, path = recorded("one port"), tmp_path / "x.mcap"
    end = heads_of(one.content, Opcode.DATA_END)[0]
    path.write_bytes(one.content[:end] + record + one.content[end:])
    tracemalloc.start()
    try:
        rows, reports, _ = found_in(path)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert rows == one.rows
    assert reports
    assert peak < 16 << 20


@pytest.mark.parametrize(
    ("opcode", "place"),
    [(Opcode.CHUNK_INDEX, 16), (Opcode.CHUNK_INDEX, 24), (Opcode.METADATA_INDEX, 0)],
)
@pytest.mark.parametrize("claim", CLAIMS)
def test_places_in_a_summary_are_not_trusted(
    opcode: Opcode, place: int, claim: int, tmp_path: Path
) -> None:
    """The checksum of the summary is right."""
    one = recorded("one port")
    altered, footer = bytearray(one.content), heads_of(one.content, Opcode.FOOTER)[0]
    struct.pack_into("<Q", altered, heads_of(one.content, opcode)[0] + HEAD.size + place, claim)
    (start,) = struct.unpack_from("<Q", altered, footer + HEAD.size)
    crc_at = footer + HEAD.size + 16
    struct.pack_into("<I", altered, crc_at, crc32(altered[start:crc_at]))
    assert check(one, bytes(altered), tmp_path / "x.mcap", EVERYTHING).rows == one.rows


def mcap(path: Path, topics: list[str], encoding: str = "json") -> None:
    """A recording of another program."""
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema("x", "jsonschema", b"{}")
        for topic in topics:
            writer.add_message(writer.register_channel(topic, encoding, schema), 5, b"{}", 5)
        writer.finish()


REFUSED = {
    "absent": (lambda path: None, "no such file"),
    "folder": (Path.mkdir, "is a directory"),
    "empty": (Path.touch, "is empty"),
    "hex": (lambda path: path.write_text("AA 01 01 03 E8 00"), "decode --input hex LOG -o"),
    "raw": (lambda path: path.write_bytes(b"\xaa"), "decode --input hex LOG -o"),
    "short": (lambda path: path.write_bytes(MAGIC[:4]), "is not an MCAP recording"),
    "topics": (lambda path: mcap(path, ["/tf", "/e\x1b[31m"]), r"'/e\x1b[31m'"),
    "many topics": (lambda path: mcap(path, [f"/t{n:02}" for n in range(23)]), "'/t09', ..."),
    "no topics": (lambda path: mcap(path, []), "no topics at all"),
    "encoding": (lambda path: mcap(path, ["/fte/control/motor1"]), "/fte/control/motor1"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_not_a_recording_is_one_line(tmp_path: Path, name: str) -> None:
    path = tmp_path / "x.mcap"
    make, words = REFUSED[name]
    make(path)  # type: ignore[operator]
    (report,) = found_in(path).reports
    assert words in report
    assert str(path) in report
    assert report.isprintable()
    with pytest.raises(FileError):
        repaired(Recording(path), tmp_path / "mended.mcap", Existing.REPLACE)
    assert not (tmp_path / "mended.mcap").exists()


def test_a_repaired_file_has_the_events_and_replaces_none_unasked(tmp_path: Path) -> None:
    path, other = tmp_path / "x.mcap", tmp_path / "other.mcap"
    with RecordingWriter(path, [FIRST]) as writer:
        flush_each(writer, some_rows())
        writer.write(*EVENTS)
    path.write_bytes(path.read_bytes()[:-20])
    other.write_bytes(b"precious")
    with pytest.raises(FileError, match="exists already"):
        repaired(Recording(path), other, Existing.REFUSE)
    assert other.read_bytes() == b"precious"
    repair = repaired(Recording(path), other, Existing.REPLACE)
    assert events_in(other) == EVENTS
    assert repair is not None
    assert repair.tally.rows == len(some_rows())
