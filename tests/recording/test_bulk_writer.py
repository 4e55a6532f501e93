"""Recordings written from columns: message for message what the recorder of captures writes."""

import errno
import os
import resource
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.reader import make_reader

from fte_sniff.errors import FileError
from fte_sniff.protocol import KINDS, Damage, Fault, PortEvent, PortEventKind, Row, encode
from fte_sniff.protocol.rows import Codebook, Rows
from fte_sniff.recording.mcap.reader import cores
from fte_sniff.recording.metadata import PortFacts
from fte_sniff.recording.reader import RecordingReader
from fte_sniff.recording.writer import CHUNK_ROWS, RecordingWriter
from tests.recording.conftest import entries_in
from tests.recording.test_reader import PORTS, damage, frames
from tests.support.columns import in_columns
from tests.support.recorded_rows import write_recording

MakeRows = Callable[..., list[Row]]


def _messages(path: Path) -> list[tuple[object, ...]]:
    """What any MCAP reader sees of a file, in the order of the file."""
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        found = [
            (
                channel.topic,
                channel.metadata,
                schema and (schema.name, schema.data),
                message.log_time,
                message.publish_time,
                message.sequence,
                message.data,
            )
            for schema, channel, message in reader.iter_messages(log_time_order=False)
        ]
        assert summary is not None
        assert summary.statistics is not None
        assert summary.statistics.message_count == len(found)
        return found


@given(st.lists(st.one_of(frames, frames, damage), min_size=1, max_size=30))
def test_messages_are_those_that_a_capture_writes(
    tmp_path_factory: pytest.TempPathFactory, rows: list[Row]
) -> None:
    rows.sort(key=lambda row: row.t_ns or 0)
    folder = tmp_path_factory.mktemp("both")
    ports = [PortFacts(PORTS[0], 115_200), PortFacts(PORTS[1])]
    with RecordingWriter(folder / "capture.mcap", ports) as writer:
        writer.write(in_columns(rows))
    write_recording(folder / "bulk.mcap", ports, [Rows.from_rows(rows)])
    assert _messages(folder / "bulk.mcap") == _messages(folder / "capture.mcap")


def _chunks(count: int) -> Iterator[Rows]:
    """So many chunks of frames, each with other values than the one before."""
    codebook, raw = Codebook(), encode(KINDS[0], {})
    for number in range(count):
        columns = Rows.allocate(codebook, CHUNK_ROWS)
        at = np.arange(number * CHUNK_ROWS, (number + 1) * CHUNK_ROWS)
        columns.t_ns[:] = at * 1000
        columns.offset[:] = at * len(raw)
        columns.delay_ns[:] = at * 7919 % 10_000
        columns.port[:] = codebook.port_code("p")
        columns.raw[:] = np.frombuffer(raw, np.uint8)
        yield columns


def test_chunks_that_threads_pack_stay_in_order(tmp_path: Path) -> None:
    path, count = tmp_path / "long.mcap", 4 * cores() + 3
    write_recording(path, [PortFacts("p")], _chunks(count))
    reader = RecordingReader(path)
    columns = Rows.concat(list(reader.batches()))
    assert (reader.ending, reader.losses) == ("", ())
    at = np.arange(count * CHUNK_ROWS)
    assert (columns.t_ns == at * 1000).all()
    assert (columns.delay_ns == at * 7919 % 10_000).all()


def test_few_chunks_are_under_way(tmp_path: Path) -> None:
    """Else what is to be written would pile up in memory."""
    path, sizes = tmp_path / "long.mcap", list[int]()

    def observed() -> Iterator[Rows]:
        for columns in _chunks(3 * cores() + 6):
            sizes.append(path.stat().st_size)
            yield columns

    write_recording(path, [PortFacts("p")], observed())
    most = cores() + 1
    assert all(new > old for old, new in zip(sizes[most:], sizes[most + 1 :], strict=False))


@pytest.mark.parametrize("room", [100_000, 1_000_000])
def test_a_full_disk_is_an_error_and_no_thread_is_left(tmp_path: Path, room: int) -> None:
    path, before = tmp_path / "full.mcap", set(threading.enumerate())
    old = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (room, old[1]))
    try:
        with pytest.raises(OSError, match=os.strerror(errno.EFBIG)):
            write_recording(path, [PortFacts("p")], _chunks(50))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, old)
    assert before >= set(threading.enumerate())


def test_an_error_of_the_batches_is_raised_and_no_thread_is_left(tmp_path: Path) -> None:
    def cut_short() -> Iterator[Rows]:
        yield from _chunks(3)
        raise FileError("the input went away")

    before = set(threading.enumerate())
    with pytest.raises(FileError, match="went away"):
        write_recording(tmp_path / "x.mcap", [PortFacts("p")], cut_short())
    assert before >= set(threading.enumerate())


def test_falling_times_and_unnamed_ports(tmp_path: Path, make_rows: MakeRows) -> None:
    path = tmp_path / "falls.mcap"
    rows = [*make_rows(50, "new"), *make_rows(50, "newer", 10**18)]
    write_recording(path, [], [Rows.from_rows(rows)])
    reader = RecordingReader(path)
    assert list(reader) == rows
    assert (reader.ending, reader.losses) == ("", ())
    times = [log_time for _, _, _, log_time, *_ in _messages(path)]
    assert times == sorted(times)


def test_events_are_in_order_of_time(tmp_path: Path, make_rows: MakeRows) -> None:
    path = tmp_path / "events.mcap"
    rows = make_rows(40, "p")
    times = [row.t_ns or 0 for row in rows]
    events = [
        PortEvent(times[0] - 1, "p", PortEventKind.OPENED, "8N1"),
        PortEvent(times[20] + 1, "p", PortEventKind.LOST, "gone"),
        PortEvent(times[-1] + 1, "p", PortEventKind.CLOSED, ""),
    ]
    write_recording(path, [PortFacts("p")], [Rows.from_rows(rows, events=events)])
    entries = entries_in(path)
    assert entries == [events[0], *rows[:21], events[1], *rows[21:], events[2]]


def test_a_recording_without_rows_has_ports_and_facts(tmp_path: Path) -> None:
    path = tmp_path / "idle.mcap"
    write_recording(path, [PortFacts("p", 9600)], [], {"host": "bench"})
    reader = RecordingReader(path)
    assert list(reader) == []
    assert (reader.ending, reader.losses) == ("", ())
    assert reader.ports == (PortFacts("p", 9600),)
    assert reader.metadata["fte-sniff"]["host"] == "bench"


def test_a_path_without_folder_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        write_recording(tmp_path / "none" / "x.mcap", [], [])


@pytest.mark.parametrize("t_ns", [None, -1])
def test_rows_without_time_cannot_be_recorded(tmp_path: Path, t_ns: int | None) -> None:
    rows = [Damage("p", at, b"x", at_ns, (Fault.NOISE,)) for at, at_ns in enumerate((5, t_ns))]
    with pytest.raises(FileError, match="'p', offset 1, has no time since 1970"):
        write_recording(tmp_path / "untimed.mcap", [], [Rows.from_rows(rows)])
