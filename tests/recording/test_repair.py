"""Repair of damaged recordings: everything intact is kept, every loss is counted."""

import random
import struct
import subprocess
import sys
import zlib
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path

import pytest
import zstandard
from mcap.reader import make_reader
from mcap.records import Chunk
from mcap.stream_reader import StreamReader

from fte_sniff.errors import FileError
from fte_sniff.protocol import PortEvent, Row
from fte_sniff.recording.mcap import writer as mcap_file
from fte_sniff.recording.mcap.writer import bytes_of
from fte_sniff.recording.metadata import PortFacts
from fte_sniff.recording.output_file import Existing
from fte_sniff.recording.reader import RecordingReader
from fte_sniff.recording.repair import FileDamage, Repair
from fte_sniff.recording.writer import RecordingWriter
from tests.recording.conftest import is_whole, some_rows
from tests.slow import first
from tests.support.columns import in_columns
from tests.support.recorded_rows import events_in
from tests.torture.damage import METADATA, records

Spans = list[tuple[int, int, list[Row]]]
"""Start and stop of each chunk's record in a file, and its rows."""
CHUNK_ROWS = 15
HEAD = 9 + 8 + 8
"""Bytes of a chunk's record that nothing guards, and that repair does without."""


def repair(path: Path, output: Path, existing: Existing) -> FileDamage:
    job = Repair(path)
    job.write(output, existing)
    return job.damage


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> tuple[bytes, Spans]:
    """A recording of four chunks."""
    path = tmp_path_factory.mktemp("small") / "small.mcap"
    rows = some_rows(4 * CHUNK_ROWS)
    with RecordingWriter(path, [PortFacts(rows[0].port, 115_200)], {"host": "bench"}) as writer:
        for start in range(0, len(rows), CHUNK_ROWS):
            writer.write(in_columns(rows[start : start + CHUNK_ROWS]))
            writer.flush()
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    starts = [(i.chunk_start_offset, i.chunk_length) for i in summary.chunk_indexes]
    spans = [
        (start, start + length, rows[n * CHUNK_ROWS : (n + 1) * CHUNK_ROWS])
        for n, (start, length) in enumerate(starts)
    ]
    assert len(spans) == 4
    return path.read_bytes(), spans


def _opens(path: Path) -> int:
    """Messages that the mcap package finds, seeking and in sequence, with every checksum right."""
    with path.open("rb") as file:
        count = sum(1 for _ in make_reader(file, validate_crcs=True).iter_messages())
    with path.open("rb") as file:
        assert list(StreamReader(file, validate_crcs=True).records)
    return count


def _repaired(folder: Path, content: bytes) -> tuple[list[Row], FileDamage] | None:
    """The rows that are kept of a damaged file; None where nothing can be."""
    path, output = folder / "damaged.mcap", folder / "repaired.mcap"
    path.write_bytes(content)
    try:
        damage = repair(path, output, Existing.REPLACE)
    except FileError as error:
        if "nothing to repair" not in str(error):
            raise
        return None
    assert path.read_bytes() == content
    rows = _read_by_all(output, output.read_bytes())
    assert damage.kept == len(rows)
    return list(rows), damage


@cache
def _read_by_all(path: Path, _content: bytes) -> Sequence[Row]:
    """The rows of a repaired file; many damages give the same bytes, which are read once."""
    reader = RecordingReader(path)
    rows = tuple(reader)
    assert (reader.ending, reader.losses) == ("", ())
    assert is_whole(path)
    assert _opens(path) == len(rows)
    return rows


def _untouched(spans: Spans, start: int, stop: int) -> list[Row]:
    """The rows of the chunks that a damage from `start` to `stop` leaves."""
    return [
        row for first, last, rows in spans if stop <= first + HEAD or start >= last for row in rows
    ]


def _every(count: int, most: int) -> range:
    return range(0, count, max(1, count // most))


@pytest.mark.parametrize("count", first(1, [30, 150]))
def test_a_file_cut_anywhere_keeps_every_chunk_before_the_cut(
    tmp_path: Path, small: tuple[bytes, Spans], count: int
) -> None:
    content, spans = small
    places = {*_every(len(content), count), *(p for a, b, _ in spans for p in (a, a + 1, b - 1, b))}
    for place in places:
        left = _repaired(tmp_path, content[:place])
        rows, damage = left or ([], None)
        assert rows == [row for _, last, rows in spans if last <= place for row in rows]
        if damage is not None and place > spans[-1][1]:
            assert damage.gaps == [] or f" to {place} (" in damage.gaps[-1].reason


@pytest.mark.parametrize("part", first(1, range(4)))
def test_a_flipped_bit_anywhere_costs_no_more_than_its_chunk(
    tmp_path: Path, small: tuple[bytes, Spans], part: int
) -> None:
    content, spans = small
    rng = random.Random(part)
    everything = [row for *_, rows in spans for row in rows]
    first, last = spans[0][0], spans[-1][1]
    places = [*range(first, last, 11), *range(0, first, 97), *range(last, len(content), 97)]
    for place in places[part::4]:
        flipped = bytearray(content)
        flipped[place] ^= 1 << rng.randrange(8)
        left = _repaired(tmp_path, bytes(flipped))
        assert left is not None
        rows, damage = left
        # A bit that nothing depends on leaves the chunk as good as it was.
        assert rows in (_untouched(spans, place, place + 1), everything), place
        lost = len(everything) - len(rows)
        assert damage.messages.lost in (None, lost)
        if damage.messages.lost is None:
            assert damage.messages.least_lost <= lost


def test_statistics_that_contradict_themselves_count_nothing(
    tmp_path: Path, small: tuple[bytes, Spans]
) -> None:
    content, spans = small
    everything = sum(len(rows) for *_, rows in spans)
    metadata = sum(opcode == METADATA for opcode, *_ in records(content))
    counts = struct.pack("<QHIIII", everything, 6, 12, 0, metadata, len(spans))
    place = content.rindex(counts)
    for bit in range(0, 64, 3):
        flipped = bytearray(content)
        flipped[place + bit // 8] ^= 1 << bit % 8
        left = _repaired(tmp_path, bytes(flipped))
        assert left is not None
        assert left[1].messages.lost in (None, 0)


@pytest.mark.parametrize("count", first(1, [100, 400]))
def test_a_flipped_bit_anywhere_is_noticed(
    tmp_path: Path, small: tuple[bytes, Spans], count: int
) -> None:
    content, _ = small
    path = tmp_path / "x.mcap"
    for place in _every(len(content), count):
        flipped = bytearray(content)
        flipped[place] ^= 16
        path.write_bytes(flipped)
        assert not is_whole(path), place
    path.write_bytes(content)
    assert is_whole(path)


def test_losses_are_reported_in_bytes_times_and_messages(
    tmp_path: Path, small: tuple[bytes, Spans]
) -> None:
    content, spans = small
    start, stop, rows = spans[2]
    broken = content[: stop - 5] + b"\0\0\0\0\0" + content[stop:]
    left = _repaired(tmp_path, broken)
    assert left is not None
    damage = left[1]
    (gap,) = damage.gaps
    assert gap.reason == f"bytes {start} to {stop} ({stop - start} bytes)"
    assert (gap.start_ns, gap.end_ns) == (spans[1][2][-1].t_ns, spans[3][2][0].t_ns)
    assert (damage.messages.lost, damage.messages.chunks) == (len(rows), 3)
    assert damage.messages.least_lost >= 1
    with (tmp_path / "repaired.mcap").open("rb") as file:
        reported = {one.name: one.metadata for one in make_reader(file).iter_metadata()}
    assert reported["fte-sniff"]["host"] == "bench"
    assert reported["fte-sniff.repair"]["lost.bytes"] == str(stop - start)
    assert reported["fte-sniff.repair"]["lost.messages"] == str(len(rows))


def test_garbage_between_chunks_and_after_the_end_costs_no_row(
    tmp_path: Path, small: tuple[bytes, Spans]
) -> None:
    content, spans = small
    rng = random.Random(7)
    everything = [row for *_, rows in spans for row in rows]
    for place in (spans[1][0], spans[3][0], len(content)):
        for size in (1, 9, 100, 5000):
            torn = content[:place] + rng.randbytes(size) + content[place:]
            left = _repaired(tmp_path, torn)
            assert left is not None
            assert left[0] == everything
            assert left[1].lost_bytes >= size


def test_chunks_missing_from_the_middle_are_counted_by_their_numbers(
    tmp_path: Path, small: tuple[bytes, Spans]
) -> None:
    """Without a summary only the numbers of the messages tell how many there were."""
    content, spans = small
    left = _repaired(tmp_path, content[: spans[1][0]] + content[spans[2][0] : spans[3][1]])
    assert left is not None
    assert left[0] == [row for n in (0, 2, 3) for row in spans[n][2]]
    assert left[1].messages.lost is None
    assert 0 < left[1].messages.least_lost <= CHUNK_ROWS


@pytest.mark.parametrize("seed", range(20))
def test_no_garbage_breaks_the_repair(
    tmp_path: Path, small: tuple[bytes, Spans], seed: int
) -> None:
    content, spans = small
    rng = random.Random(seed)
    torn = bytearray(content)
    for _ in range(rng.randrange(1, 30)):
        place = rng.randrange(len(torn))
        match rng.randrange(3):
            case 0:
                torn[place : place + rng.randrange(200)] = rng.randbytes(rng.randrange(200))
            case 1:
                del torn[place : place + rng.randrange(50)]
            case _:
                torn[place] = rng.randrange(256)
    left = _repaired(tmp_path, bytes(torn))
    if left is not None:
        known = {id(row): row for *_, rows in spans for row in rows}
        assert all(row in known.values() for row in left[0])


def test_pure_garbage_is_refused_in_one_line(tmp_path: Path) -> None:
    rng = random.Random(3)
    for size in (0, 1, 8, 37, 5000):
        assert _repaired(tmp_path, rng.randbytes(size)) is None
    assert not (tmp_path / "repaired.mcap").exists()


BOUNDED = """
import resource, sys
from pathlib import Path
from fte_sniff.recording.output_file import Existing
from fte_sniff.recording.repair import Repair
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
path = Path(sys.argv[1])
job = Repair(path)
job.write(path.with_name("repaired.mcap"), Existing.REFUSE)
print(job.is_whole, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before)
"""


UNPACKED = 2**31


@cache
def _two_gigabytes() -> bytes:
    packer = zstandard.ZstdCompressor().compressobj()
    block = bytes(2**20)
    return b"".join(packer.compress(block) for _ in range(UNPACKED >> 20)) + packer.flush()


@pytest.mark.parametrize("claimed", first(2, [None, 2**27, 2**20, 2**62]))
def test_a_chunk_that_unpacks_to_gigabytes_is_left_out_and_takes_no_memory(
    tmp_path: Path, small: tuple[bytes, Spans], claimed: int | None
) -> None:
    """70 KB that unpack to 2 GB, whatever size the chunk claims."""
    content, spans = small
    bomb = _two_gigabytes()
    assert len(bomb) < 100_000
    size = claimed or UNPACKED
    chunk = Chunk("zstd", bomb, 5, 5, zlib.crc32(bytes(10)), size)
    path = tmp_path / "bomb.mcap"
    place = spans[2][0]
    path.write_bytes(content[:place] + bytes_of(chunk) + content[place:])
    done = subprocess.run(
        [sys.executable, "-c", BOUNDED, str(path)], capture_output=True, text=True, check=True
    )
    whole, grown = done.stdout.split()
    assert whole == "False"
    assert int(grown) * 1024 < UNPACKED / 3
    assert len(list(RecordingReader(tmp_path / "repaired.mcap"))) == 4 * CHUNK_ROWS


def test_sizes_in_a_record_are_not_trusted(tmp_path: Path, small: tuple[bytes, Spans]) -> None:
    content, spans = small
    for length in (2**63, 2**40, 2**31, len(content)):
        broken = bytearray(content)
        struct.pack_into("<Q", broken, spans[1][0] + 1, length)
        left = _repaired(tmp_path, bytes(broken))
        assert left is not None
        assert len(left[0]) == 4 * CHUNK_ROWS


def test_the_growing_file_of_a_capture_that_runs_can_be_repaired(
    tmp_path: Path, make_rows: Callable[..., list[Row]]
) -> None:
    rows = make_rows(50)
    path = tmp_path / "growing.mcap"
    with RecordingWriter(path, [PortFacts(rows[0].port)]) as writer:
        writer.write(in_columns(rows))
        writer.flush()
        assert is_whole(path)
        repair(path, tmp_path / "copy.mcap", Existing.REFUSE)
    assert list(RecordingReader(tmp_path / "copy.mcap")) == rows


def test_a_file_without_summary_gets_one(
    tmp_path: Path, make_rows: Callable[..., list[Row]], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(mcap_file, "LONG_SUMMARY", 0)
    rows = make_rows(60)
    path = tmp_path / "long.mcap"
    with RecordingWriter(path, [PortFacts(rows[0].port)]) as writer:
        for start in range(0, 60, 20):
            writer.write(in_columns(rows[start : start + 20]))
            writer.flush()
        bare = path.read_bytes()
    with (tmp_path / "bare.mcap").open("wb") as file:
        file.write(bare)
    assert not is_whole(tmp_path / "bare.mcap")
    damage = repair(tmp_path / "bare.mcap", tmp_path / "repaired.mcap", Existing.REFUSE)
    assert (damage.gaps, damage.kept) == ([], 60)
    assert is_whole(tmp_path / "repaired.mcap")
    assert list(RecordingReader(tmp_path / "repaired.mcap")) == rows


def test_events_are_kept_too(
    tmp_path: Path, recorded: tuple[Path, list[Row], list[PortEvent]]
) -> None:
    path, rows, events = recorded
    content = path.read_bytes()
    path.write_bytes(content[:-20])
    damage = repair(path, tmp_path / "repaired.mcap", Existing.REFUSE)
    reader = RecordingReader(tmp_path / "repaired.mcap")
    assert events_in(reader) == events
    assert (damage.kept, damage.messages.lost) == (len(rows) + len(events), 0)


def test_a_file_is_not_repaired_over_another_unless_asked(
    tmp_path: Path, recorded: tuple[Path, list[Row], list[PortEvent]]
) -> None:
    other = tmp_path / "other.mcap"
    other.write_bytes(b"precious")
    with pytest.raises(FileError, match="exists already"):
        repair(recorded[0], other, Existing.REFUSE)
    assert other.read_bytes() == b"precious"
    with pytest.raises(FileError, match="no such file"):
        repair(tmp_path / "absent.mcap", tmp_path / "x.mcap", Existing.REFUSE)
