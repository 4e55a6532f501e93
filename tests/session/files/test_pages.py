"""Rows of recordings by their number, read again from the files."""

from __future__ import annotations

import os
from collections.abc import Callable
from functools import partial
from pathlib import Path
from shutil import copy

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fte_sniff.analysis.row_store import RowStore
from fte_sniff.analysis.search import find_fault
from fte_sniff.errors import FileError
from fte_sniff.protocol import KINDS, Damage, Fault, Frame, Row, encode
from fte_sniff.recording.bulk_writer import write_recording
from fte_sniff.recording.metadata import PortFacts
from fte_sniff.recording.reader import RecordingReader
from fte_sniff.recording.row_ranges import EVERYTHING, TimeRange
from fte_sniff.row_batch import Codebook, RowBatch, unpack
from fte_sniff.session.replay import RecordingPages
from tests.examples import examples

COUNT = 150_000
"""Rows of a file: more than one batch."""
FRAME = encode(KINDS[0], {field.name: field.low for field in KINDS[0].fields})


def made(port: str, count: int) -> list[Row]:
    """Frames, and now and then damage of more than ten bytes."""
    rows: list[Row] = []
    for number in range(count):
        t_ns, offset = 1_000_000 * number + 10**18, 100 * number
        if number % 997:
            rows.append(Frame(port, offset, FRAME, t_ns))
        else:
            rows.append(Damage(port, offset, bytes([number % 256]) * 40, t_ns, (Fault.NOISE,)))
    return rows


def written(path: Path, port: str, rows: list[Row]) -> Path:
    write_recording(path, [PortFacts(port)], [RowBatch.from_rows(rows)])
    return path


@pytest.fixture(scope="module")
def rows() -> list[Row]:
    return [*made("a", COUNT), *made("b", 1000)]


@pytest.fixture(scope="module")
def files(rows: list[Row], tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    folder = tmp_path_factory.mktemp("recorded")
    return [
        written(folder / "a.mcap", "a", rows[:COUNT]),
        written(folder / "b.mcap", "b", rows[COUNT:]),
    ]


def noted(files: list[Path], span: TimeRange = EVERYTHING) -> tuple[RecordingPages, list[Row]]:
    """The pages of the files, read once, and their rows."""
    pages, found = RecordingPages(), list[Row]()
    for path in files:
        reader = RecordingReader(path)
        for passage, columns in reader.ranges(span=span):
            pages.add(partial(reader.read, passage), len(columns))
            found += columns
    return pages, found


def loaded(pages: RecordingPages, start: int, count: int) -> list[Row]:
    codebook = Codebook()
    packed, long = pages.load(start, count, codebook)
    return unpack(packed, long, codebook)


def test_any_rows_come_again_as_they_were(files: list[Path], rows: list[Row]) -> None:
    pages, found = noted(files)
    assert found == rows
    codebook = Codebook()

    @examples(30)
    @given(st.integers(0, len(rows) - 1), st.integers(1, 3000))
    def check(start: int, count: int) -> None:
        count = min(count, len(rows) - start)
        packed, long = pages.load(start, count, codebook)
        assert unpack(packed, long, codebook) == rows[start : start + count]

    check()
    assert loaded(pages, COUNT - 100, 200) == rows[COUNT - 100 : COUNT + 100]
    assert loaded(pages, 0, len(rows)) == rows


def test_of_a_span_only_its_rows_come_again(files: list[Path], rows: list[Row]) -> None:
    span = TimeRange((rows[20_000].t_ns or 0) + 1, rows[90_000].t_ns or 0)
    pages, found = noted(files[:1], span)
    assert found == rows[20_001:90_000]
    assert loaded(pages, 0, len(found)) == found
    assert loaded(pages, 40_000, 10) == found[40_000:40_010]


def test_rows_of_a_damaged_file_come_again_as_far_as_they_came(
    files: list[Path], tmp_path: Path
) -> None:
    data = bytearray(files[0].read_bytes())
    data[len(data) // 2] ^= 0xFF
    path = tmp_path / "damaged.mcap"
    path.write_bytes(data[: len(data) * 9 // 10])
    pages, found = noted([path])
    assert 0 < len(found) < COUNT
    assert loaded(pages, 0, len(found)) == found


def test_a_store_of_few_blocks_holds_every_row(files: list[Path], rows: list[Row]) -> None:
    pages, _ = noted(files)
    store = RowStore(2**62, 4096, pages, 3)
    for start in range(0, len(rows), 10_000):
        store.append(rows[start : start + 10_000])
    assert len(store) == len(rows)
    assert [store.row(index) for index in (0, 75_000, len(rows) - 1)] == [
        rows[0],
        rows[75_000],
        rows[-1],
    ]
    assert sum(len(packed) for packed in store.packed(0, len(rows))) == len(rows)
    assert find_fault(store, 0, 1) == 997
    assert find_fault(store, COUNT - 1, -1) == (COUNT - 1) // 997 * 997


def vanish(path: Path) -> None:
    path.unlink()


def be_replaced(path: Path) -> None:
    other = written(path.with_name("other.mcap"), "a", made("a", 1000))
    other.replace(path)


def be_cut(path: Path) -> None:
    os.truncate(path, path.stat().st_size // 4)


def be_spoilt(path: Path) -> None:
    with path.open("r+b") as stream:
        stream.seek(path.stat().st_size // 2)
        stream.write(bytes(path.stat().st_size // 4))


@pytest.mark.parametrize("happen", [vanish, be_replaced, be_cut, be_spoilt])
def test_a_file_that_is_not_what_it_was_is_named(
    happen: Callable[[Path], None], files: list[Path], tmp_path: Path
) -> None:
    path = copy(files[0], tmp_path / "run.mcap")
    pages, _ = noted([path])
    happen(path)
    with pytest.raises(FileError, match=r"run\.mcap: (has changed|there is no such file)"):
        loaded(pages, COUNT // 2, COUNT // 4)
