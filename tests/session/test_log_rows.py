"""The streams of a log: merged by time over a whole file, whatever its reads, in bounded memory."""

from __future__ import annotations

import random
from io import BytesIO
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fte_sniff.errors import FileError
from fte_sniff.formats.logs import text as log_text
from fte_sniff.formats.logs.reader import LogReader
from fte_sniff.formats.logs.text import LogOptions
from fte_sniff.protocol import KIND_BY_NAME, Row, byte_time_ns, encode
from fte_sniff.session import log_rows
from fte_sniff.session.log_rows import raw_chunks, rows_of_log
from tests.examples import examples

TX = encode(KIND_BY_NAME["speed"], {"motor": 1, "rpm": 100})
RX = encode(KIND_BY_NAME["speed_feedback"], {"motor": 1, "rpm": 7, "error": 0, "online": 15})


@given(st.binary(max_size=300_000))
def test_raw_bytes_come_as_they_are(data: bytes) -> None:
    chunks = list(raw_chunks(BytesIO(data), "f"))
    assert b"".join(chunk.data for chunk in chunks) == data
    assert all(chunk.t_ns is None and chunk.port == "f" for chunk in chunks)


def line(way: str, us: int, data: bytes) -> str:
    seconds, us = divmod(us, 1_000_000)
    clock = f"{10 + seconds // 3600:02}:{seconds // 60 % 60:02}:{seconds % 60:02}.{us:06}"
    return f"2026-01-31T{clock}Z {way}: {data.hex(' ')}\n"


def rows_of(reader: LogReader) -> list[Row]:
    return [row for rows in rows_of_log(reader, lambda _: None) for row in rows]


def times_of(rows: list[Row]) -> list[int]:
    return [row.t_ns or 0 for row in rows]


SECTIONS = "".join(
    line(way, 20_000 * number + late, data)
    for way, late, data in (("TX", 0, TX), ("RX", 3000, RX))
    for number in range(200)
)
"""First all that was sent, then all that was received."""


@pytest.mark.parametrize("size", [3000, 1 << 20])
def test_a_file_with_one_direction_after_the_other_is_merged_by_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, size: int
) -> None:
    monkeypatch.setattr(log_text, "BLOCK_BYTES", size)
    path = tmp_path / "x.log"
    path.write_text(SECTIONS)
    rows = rows_of(LogReader(str(path)))
    assert [row.port[-2:] for row in rows] == ["tx", "rx"] * 200
    assert times_of(rows) == sorted(times_of(rows))


def test_rows_that_wait_for_a_direction_are_limited(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(log_rows, "_MOST_HELD", 100)
    monkeypatch.setattr(log_text, "BLOCK_BYTES", 3000)
    path = tmp_path / "x.log"
    path.write_text(SECTIONS)
    batches = rows_of_log(LogReader(str(path)), lambda _: None)
    assert len(next(batches)) < 200
    assert sum(len(rows) for rows in batches) > 200


def test_lines_whose_bytes_overlap_are_in_the_order_of_their_first_bytes(tmp_path: Path) -> None:
    path = tmp_path / "x.log"
    path.write_text("".join(
        line("TX", at, TX) + line("RX", at + 1000, RX * 3) for at in range(0, 2_000_000, 20_000)
    ))  # fmt: skip
    rows = rows_of(LogReader(str(path)))
    assert times_of(rows) == sorted(times_of(rows))
    assert [row.port[-2:] for row in rows[:4]] == ["rx", "tx", "rx", "rx"]


def test_after_the_clock_was_set_back_the_order_is_that_of_the_lines(tmp_path: Path) -> None:
    steps = [*range(100), *range(40, 140)]
    path = tmp_path / "x.log"
    path.write_text("".join(
        line("TX", 100_000 * at, TX) + line("RX", 100_000 * at + 5000, RX) for at in steps
    ))  # fmt: skip
    notes: list[str] = []
    rows = [row for rows in rows_of_log(LogReader(str(path)), notes.append) for row in rows]
    assert [row.port[-2:] for row in rows] == ["tx", "rx"] * 200
    assert any("line 201 steps back in time: '5.905 s'" in note for note in notes)


@given(st.integers(0, 10**6), st.sampled_from([100, 999, 5000]))
@examples(8)
def test_the_reads_of_a_file_change_neither_rows_nor_their_order(
    tmp_path_factory: pytest.TempPathFactory, seed: int, size: int
) -> None:
    rng, us, lines = random.Random(seed), 0, list[str]()
    for _ in range(rng.randint(20, 120)):
        way, data = rng.choice([("TX", TX), ("RX", RX)])
        us += rng.choice([0, 100, 900, 20_000])
        cut = rng.choice([10, 10, 10, rng.randint(1, 9)])
        lines.append(line(way, us, data[:cut]))
        if cut < 10:
            us += 900
            lines.append(line(way, us, data[cut:]))
        lines += ["port opened\n"] * (rng.random() < 0.1)
    path = tmp_path_factory.mktemp("x") / "x.log"
    path.write_text("".join(lines))
    whole = rows_of(LogReader(str(path)))
    assert times_of(whole) == sorted(times_of(whole))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(log_text, "BLOCK_BYTES", size)
        assert rows_of(LogReader(str(path))) == whole
        split = rows_of(LogReader("x", None, BytesIO(path.read_bytes())))
    piped = rows_of(LogReader("x", None, BytesIO(path.read_bytes())))
    assert split == piped


def test_a_stream_that_waits_for_the_end_of_a_frame_does_not_hold_back_the_other() -> None:
    content = line("RX", 0, RX[:4]) + "".join(line("TX", 20_000 * n, TX) for n in range(1, 200))
    content = line("RX", 0, RX) * 9 + content
    rows = rows_of(LogReader("x", None, BytesIO(content.encode())))
    assert sum(row.framed for row in rows) == 208


@pytest.mark.parametrize("baud", [9600, 115_200])
def test_bytes_without_times_follow_each_other_at_the_baud(tmp_path: Path, baud: int) -> None:
    options = LogOptions(start_ns=10**18, baud=baud)
    plain, labelled = TX.hex(" ") + "\n", f"TX: {TX.hex(' ')}\n"
    for content in (plain * 50, labelled * 50, labelled * 600):
        rows = rows_of(LogReader("x", options, BytesIO(content.encode())))
        step = 10 * byte_time_ns(baud)
        assert times_of(rows) == [10**18 + step * number for number in range(len(rows))]


def test_the_first_byte_of_a_line_began_at_its_stamp() -> None:
    lines = (
        f"{1 + at * 0.001:.3f},0x{byte:02X}\n"
        for at, byte in enumerate(bytes.fromhex("AA010103E800000000EE") * 3)
    )
    log = BytesIO(("Time [s],Value\n" + "".join(lines)).encode())
    reader = LogReader("x", LogOptions(start_ns=0), log)
    rows = [row for rows in rows_of_log(reader, lambda _: None) for row in rows]
    assert [row.t_ns for row in rows] == [1_000_000_000, 1_010_000_000, 1_020_000_000]


def test_a_block_of_zeros_is_skipped_and_reported_and_no_frame_goes_on_behind_it(
    tmp_path: Path,
) -> None:
    path = tmp_path / "x.log"
    before = "".join(line("TX", 20_000 * at, TX) for at in range(100)) + line("TX", 0, TX[:5])[:-1]
    after = line("TX", 0, TX[5:]) + "".join(line("TX", 20_000 * at, TX) for at in range(100))
    path.write_bytes(before.encode() + bytes(100_000) + after.encode())
    for reader in (LogReader(str(path)), LogReader("x", None, BytesIO(path.read_bytes()))):
        notes: list[str] = []
        rows = [row for rows in rows_of_log(reader, notes.append) for row in rows]
        assert sum(row.framed for row in rows) == 200
        assert b"".join(row.raw for row in rows) == TX * 201
        (skipped,) = [note for note in notes if "NUL" in note]
        assert f": 100,000 NUL bytes at offset {len(before):,} are skipped" in skipped


@pytest.mark.parametrize("zeros", [100_000, 40_960])
def test_a_log_that_begins_and_ends_with_zeros_is_read(tmp_path: Path, zeros: int) -> None:
    path = tmp_path / "x.log"
    content = "".join(line("TX", 20_000 * at, TX) for at in range(100))
    path.write_bytes(bytes(zeros) + content.encode() + bytes(zeros))
    notes: list[str] = []
    rows = [row for rows in rows_of_log(LogReader(str(path)), notes.append) for row in rows]
    assert len(rows) == 100
    assert any(f"2 blocks of NUL bytes are skipped, {2 * zeros:,} bytes" in note for note in notes)


def test_a_file_of_zeros_is_named_so(tmp_path: Path) -> None:
    path = tmp_path / "x.log"
    path.write_bytes(bytes(100_000))
    with pytest.raises(FileError, match="no bytes to decode; 100,000 NUL bytes at offset 0 are"):
        rows_of(LogReader(str(path)))


def test_a_line_that_is_too_long_for_a_log_is_refused_by_its_number(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(log_text, "LONGEST_LINE", 600)
    monkeypatch.setattr(log_text, "BLOCK_BYTES", 200)
    path = tmp_path / "x.log"
    path.write_text("opened\n" + f"Recv: {TX.hex(' ')} " * 20)
    with pytest.raises(FileError, match=r"line 2 is longer than .* only if it is plain hex; write"):
        rows_of(LogReader(str(path)))
