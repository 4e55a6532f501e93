"""Replaying files: rows, gaps and pages read again."""

from __future__ import annotations

import os
import queue
import threading
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import partial
from pathlib import Path
from shutil import copy

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fte_sniff.analysis.row_store import RowStore
from fte_sniff.analysis.search import find_fault
from fte_sniff.errors import FileError
from fte_sniff.protocol import KINDS, Damage, Fault, Frame, PortEvent, PortEventKind, Row, encode
from fte_sniff.protocol.rows import NO_ROWS, Codebook, Rows
from fte_sniff.recording import reader as recording_reader
from fte_sniff.recording.metadata import PortFacts
from fte_sniff.recording.reader import EVERYTHING, RecordingReader, TimeRange
from fte_sniff.recording.writer import RecordingWriter
from fte_sniff.session.inputs import InputBatch
from fte_sniff.session.replay import MAX_READ_AHEAD, Playback, RecordingPages, ReplaySession
from tests.examples import examples
from tests.slow import first
from tests.waiting import BOUND_S, while_waiting

FRAME = bytes.fromhex("AA0000000000000000EE")


def batches(count: int, size: int = 10) -> list[InputBatch]:
    return [
        InputBatch(
            Rows.from_rows([Frame("f", (b * size + i) * 10, FRAME, None) for i in range(size)])
        )
        for b in range(count)
    ]


def all_of(session: ReplaySession) -> list[Row]:
    rows: list[Row] = []
    for _ in while_waiting(lambda: f"the end of {session}"):
        update = session.poll()
        rows += update.rows
        if not update.state.running:
            break
    return rows


def test_all_rows_come_in_order() -> None:
    made = batches(100)
    session = ReplaySession(made, "file")
    assert all_of(session) == [row for batch in made for row in batch.rows]
    assert session.poll().state.ended is None
    assert list(session.poll().rows) == []


def test_reading_waits_for_the_view() -> None:
    read = []
    enough = threading.Event()

    def reading() -> Iterator[InputBatch]:
        for number, batch in enumerate(batches(60)):
            read.append(number)
            if len(read) > MAX_READ_AHEAD:
                enough.set()
            yield batch

    session = ReplaySession(reading(), "file")
    rows = first_of(session)
    rows += session.poll().rows
    assert enough.wait(BOUND_S)
    assert len(read) <= MAX_READ_AHEAD + 3
    assert len(rows) + len(all_of(session)) == 600


def test_no_more_than_the_first_batch_is_read_before_it_was_taken() -> None:
    read = []

    def reading() -> Iterator[InputBatch]:
        for number, batch in enumerate(batches(3)):
            read.append(number)
            yield batch

    session = ReplaySession(reading(), "file")
    assert len(first_of(session)) == 10
    assert read == [0]
    assert len(all_of(session)) == 20


def first_of(session: ReplaySession) -> list[Row]:
    rows: list[Row] = []
    for _ in while_waiting(lambda: "the first rows"):
        if rows := list(session.poll().rows):
            break
    return rows


def test_port_events_come_with_the_rows_among_which_they_stand() -> None:
    lost = PortEvent(5, "f", PortEventKind.LOST, "")
    made = batches(2)
    session = ReplaySession([made[0], InputBatch(made[1].rows.with_columns(events=[lost]))], "file")
    events: list[PortEvent] = []
    for _ in while_waiting(lambda: f"the end of {session}"):
        update = session.poll()
        events += update.events
        if not update.state.running:
            break
    assert events == [lost]


def test_what_cannot_be_read_ends_it_after_what_could() -> None:
    def reading() -> Iterator[InputBatch]:
        yield from batches(3)
        raise FileError("file: broken here")

    session = ReplaySession(reading(), "file")
    assert len(all_of(session)) == 30
    assert str(session.error) == "file: broken here"
    assert session.poll().state.ended == "file: broken here"


def test_reading_rests_until_the_next_poll() -> None:
    read: queue.Queue[int] = queue.Queue()
    gate = threading.Semaphore(1)

    def reading() -> Iterator[InputBatch]:
        for number, batch in enumerate(batches(5)):
            assert gate.acquire(timeout=BOUND_S)
            read.put(number)
            yield batch

    session = ReplaySession(reading(), "file")
    first_of(session)
    session.poll()
    gate.release()
    assert [read.get(timeout=BOUND_S), read.get(timeout=BOUND_S)] == [0, 1]
    session.rest()
    gate.release(3)
    came = []
    with suppress(queue.Empty):
        while True:
            came.append(read.get(timeout=0.1))
    # A read that is under way when it is paused may still arrive.
    assert came in ([], [2])
    all_of(session)
    assert [read.get(timeout=BOUND_S) for _ in range(3 - len(came))][-1] == 4


def test_a_session_that_was_stopped_does_not_rest_for_ever() -> None:
    session = ReplaySession(batches(100), "file")
    session.stop()
    session.rest()
    session._thread.join(timeout=BOUND_S)
    assert not session._thread.is_alive()


def test_stop_ends_the_reading() -> None:
    def endless() -> Iterator[InputBatch]:
        while True:
            yield from batches(1)

    session = ReplaySession(endless(), "file")
    session.stop()
    session._thread.join(BOUND_S)
    assert not session._thread.is_alive()


def test_batches_come_in_order_with_their_progress() -> None:
    rows: list[Row] = [Frame("f", place * 10, FRAME, place) for place in range(1000)]
    parts = [Rows.from_rows(rows[at : at + 100]) for at in range(0, 1000, 100)]
    session = ReplaySession((InputBatch(part) for part in parts), "file", 1000)
    found: list[Row] = []
    reported = []
    for _ in while_waiting(lambda: f"the end of {session}"):
        update = session.poll()
        found += update.rows
        if not update.state.running:
            break
        reported.append((update.state.progress, len(found) / 1000))
    assert found == rows
    assert all(progress == share for progress, share in reported)
    assert session.poll().state.progress is None


def test_what_the_file_lacks_stands_as_soon_as_it_is_known() -> None:
    for count in (1, 3):
        losses = [f"bytes {number} are gone" for number in range(count)]
        session = ReplaySession([*batches(3), InputBatch(NO_ROWS, losses=losses)], "file")
        assert len(all_of(session)) == 30
        trouble = session.poll().state.trouble
        assert trouble is not None
        assert losses[0] in trouble
        assert ("2 more" in trouble) == (count == 3)
    whole = ReplaySession(batches(3), "file")
    all_of(whole)
    assert whole.poll().state.trouble is None


COUNT = 12_000
"""Rows of a file: more than one batch."""
FRAME_PAGES = encode(KINDS[0], {field.name: field.low for field in KINDS[0].fields})


def made(port: str, count: int) -> list[Row]:
    """Frames, and now and then damage of more than ten bytes."""
    rows: list[Row] = []
    for number in range(count):
        t_ns, offset = 1_000_000 * number + 10**18, 100 * number
        if number % 997:
            rows.append(Frame(port, offset, FRAME_PAGES, t_ns))
        else:
            rows.append(Damage(port, offset, bytes([number % 256]) * 40, t_ns, (Fault.NOISE,)))
    return rows


def written(path: Path, port: str, rows: list[Row]) -> Path:
    with RecordingWriter(path, [PortFacts(port)]) as writer:
        for start in range(0, len(rows), 2_000):  # a chunk each
            writer.write(Rows.from_rows(rows[start : start + 2_000]))
            writer.flush()
    return path


@pytest.fixture(autouse=True)
def small_batches(monkeypatch: pytest.MonkeyPatch) -> None:
    """Reading makes several batches of a file."""
    monkeypatch.setattr(recording_reader, "JOB", 200_000)
    monkeypatch.setattr(recording_reader, "_FIRST_JOB", 100_000)


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
            pages.append(partial(reader.read, passage), len(columns))
            found += columns
    return pages, found


def loaded(pages: RecordingPages, start: int, count: int) -> list[Row]:
    return list(pages.load(start, count, Codebook()))


def test_any_rows_come_again_as_they_were(files: list[Path], rows: list[Row]) -> None:
    pages, found = noted(files)
    assert found == rows
    codebook = Codebook()

    @examples(15)
    @given(st.integers(0, len(rows) - 1), st.integers(1, 3000))
    def check(start: int, count: int) -> None:
        count = min(count, len(rows) - start)
        assert list(pages.load(start, count, codebook)) == rows[start : start + count]

    check()
    assert loaded(pages, COUNT - 100, 200) == rows[COUNT - 100 : COUNT + 100]
    assert loaded(pages, 0, len(rows)) == rows


def test_of_a_span_only_its_rows_come_again(files: list[Path], rows: list[Row]) -> None:
    span = TimeRange((rows[5_000].t_ns or 0) + 1, rows[11_000].t_ns or 0)
    pages, found = noted(files[:1], span)
    assert found == rows[5_001:11_000]
    assert loaded(pages, 0, len(found)) == found
    assert loaded(pages, 3_000, 10) == found[3_000:3_010]


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
    for start in range(0, len(rows), 3_000):
        store.append(Rows.from_rows(rows[start : start + 3_000]))
    assert len(store) == len(rows)
    assert [store.row(index) for index in (0, COUNT // 2, len(rows) - 1)] == [
        rows[0],
        rows[COUNT // 2],
        rows[-1],
    ]
    assert sum(len(batch) for batch in store.batches(0, len(rows))) == len(rows)
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


@pytest.mark.parametrize("happen", first(2, [vanish, be_cut, be_replaced, be_spoilt]))
def test_a_file_that_is_not_what_it_was_is_named(
    happen: Callable[[Path], None], files: list[Path], tmp_path: Path
) -> None:
    path = copy(files[0], tmp_path / "run.mcap")
    pages, _ = noted([path])
    happen(path)
    with pytest.raises(FileError, match=r"run\.mcap: (has changed|no such file)"):
        loaded(pages, COUNT // 2, COUNT // 4)


def timed_store(times: list[int | None]) -> RowStore:
    store = RowStore(block_rows=3)
    store.append(
        Rows.from_rows([Frame("f", 10 * number, FRAME, t_ns) for number, t_ns in enumerate(times)])
    )
    return store


def test_playback_shows_rows_at_their_pace_and_speed() -> None:
    store = timed_store([1000, 1010, None, 1020, 1035, 1100])
    play = Playback(store, 1, 1.0, now_ns=5)
    assert (len(store), play.tally.rows, play.t_ns) == (1, 1, 1010)
    assert len(play.advance(5)) == 2, "a row without a time comes with the one before it"
    assert len(play.advance(14)) == 0
    assert [row.t_ns for row in play.advance(15)] == [1020]
    play.paused = True
    assert len(play.advance(1000)) == 0
    play.paused = False
    play.change_speed(1)
    assert len(play.advance(1007)) == 0
    assert [row.t_ns for row in play.advance(1008)] == [1035]
    for _ in range(20):
        play.change_speed(1)
    assert play.speed == 100
    assert not play.is_over
    assert len(play.advance(1009)) == 1
    assert play.is_over
    assert play.tally.rows == len(store) == 6
    for _ in range(20):
        play.change_speed(-1)
    assert play.speed == 0.1
    play.stop()
    assert store.limit is None


@given(st.lists(st.integers(0, 500), max_size=60), st.lists(st.integers(0, 50), max_size=40))
def test_playback_is_the_same_however_often_it_is_polled(
    times: list[int], steps: list[int]
) -> None:
    """Times may fall a little, as those of two ports do."""
    one, other = timed_store([*times]), timed_store([*times])
    often, once = Playback(one, 0, 1.0, 0), Playback(other, 0, 1.0, 0)
    now = 0
    for step in (*steps, 0):
        now += step
        often.advance(now)
    once.advance(now)
    assert one.next == other.next
    assert often.tally.rows == once.tally.rows
