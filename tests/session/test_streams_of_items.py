"""Streams of items: merge, inputs, following, and what a capture and its view tell each other."""

from __future__ import annotations

import errno
from collections.abc import Iterator, Sequence
from itertools import pairwise
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fte_sniff.protocol.framer import Framer
from fte_sniff.protocol.items import BaudChange, Chunk, Gap, GapKind, PortEvent, PortEventKind
from fte_sniff.protocol.rows import Item, Row, Rows
from fte_sniff.protocol.spec import KIND_BY_NAME, encode
from fte_sniff.recording.metadata import PortFacts, host_facts
from fte_sniff.recording.reader import Recording, TimeRange
from fte_sniff.recording.recorder import Recorder, RecordingOptions
from fte_sniff.session.following import Follower
from fte_sniff.session.inputs import (
    Input,
    InputReading,
    recording_input,
    with_effects,
    with_facts,
)
from fte_sniff.session.merge import Timed, merged
from tests.support.columns import rows_from

SECOND = 10**9
SPEED = encode(KIND_BY_NAME["speed"], {"motor": 1, "rpm": 100})


def rows_at(port: str, *times: int, frame: bytes = SPEED) -> Rows:
    framer = Framer(port, 115_200)
    for t_ns in times:
        framer.push(Chunk(port, t_ns, frame))
    framer.end()
    found = rows_from(list(framer.drain()))
    assert len(found) == len(times)
    return found


def each(items: Sequence[Item] | Iterator[Item]) -> list[Row | PortEvent | Gap | BaudChange]:
    """Items, rows one by one."""
    found: list[Row | PortEvent | Gap | BaudChange] = []
    for item in items:
        found += item if isinstance(item, Rows) else [item]
    return found


def cut(rows: Rows, cuts: Sequence[int]) -> list[Rows]:
    edges = [0, *sorted({one % (len(rows) + 1) for one in cuts}), len(rows)]
    return [rows[start:stop] for start, stop in pairwise(edges)]


TIMES = st.lists(st.integers(1, 50).map(lambda one: one * SECOND), max_size=12).map(sorted)
CUTS = st.lists(st.integers(0, 12), max_size=4)


@given(st.lists(st.tuples(TIMES, CUTS), min_size=1, max_size=3))
def test_a_merge_has_all_rows_in_the_order_of_time_however_streams_are_cut(
    streams: list[tuple[list[int], list[int]]],
) -> None:
    given_rows = [rows_at(f"p{number}", *times) for number, (times, _) in enumerate(streams)]
    timed = [
        Timed(int(rows.t_ns[0]) if len(rows) else None, lambda _beside, parts=parts: iter(parts))
        for rows, (_, cuts) in zip(given_rows, streams, strict=True)
        for parts in [cut(rows, cuts)]
    ]
    timed.sort(key=lambda one: (one.first_ns is None, one.first_ns or 0))
    found = Rows.concat([item for item in merged(timed) if isinstance(item, Rows)])
    assert sorted(found.t_ns.tolist()) == found.t_ns.tolist()
    for rows in given_rows:
        own = [row for row in found if row.port in rows.ports]
        assert own == list(rows)


@given(CUTS)
def test_what_is_between_rows_stays_between_them(cuts: list[int]) -> None:
    rows, other = rows_at("a", *range(SECOND, 9 * SECOND, SECOND)), rows_at("b", 5 * SECOND)
    gap = Gap(GapKind.DAMAGE, None, 3 * SECOND, 4 * SECOND, "cut")
    stream: list[Item] = [*cut(rows[:3], cuts), gap, *cut(rows[3:], cuts)]
    items = merged(
        [
            Timed(SECOND, lambda _beside: iter(stream)),
            Timed(5 * SECOND, lambda _beside: iter([other])),
        ]
    )
    found = each(items)
    assert [one for one in found if one not in list(other)] == each(stream)


def test_what_a_port_event_does_to_decoding_is_an_item_after_it() -> None:
    kinds = (PortEventKind.LOST, PortEventKind.FOUND_AGAIN)
    events = [PortEvent(SECOND, "a", kind, "") for kind in kinds]
    found = each(with_effects(events, set()))
    assert [type(one) for one in found] == [PortEvent, Gap, PortEvent, Gap] or [
        type(one) for one in found
    ] == [PortEvent, Gap, PortEvent]


@given(CUTS)
def test_facts_do_not_depend_on_how_rows_are_cut(cuts: list[int]) -> None:
    rows = rows_at("a", *range(SECOND, 12 * SECOND, SECOND))
    whole = each(with_facts([rows]))
    assert each(with_facts(cut(rows, cuts))) == whole
    assert len(whole) == len(rows)


def recorded(path: Path, *entries: Rows | PortEvent, **options: int) -> Input:
    ports = [PortFacts(name) for one in entries if isinstance(one, Rows) for name in one.ports]
    recorder = Recorder(path, ports, options=RecordingOptions(**options))
    recorder.write(*entries)
    recorder.close()
    return recording_input(Recording(recorder.path))


def test_two_wires_in_two_files_are_paired_where_nothing_is_in_doubt(tmp_path: Path) -> None:
    control = recorded(tmp_path / "c.mcap", rows_at("c", *range(SECOND, 90 * SECOND, SECOND)))
    frame = bytes.fromhex("550101000500000000EE")
    answers = rows_at("r", *range(SECOND + 9, 90 * SECOND, SECOND), frame=frame)
    other = recorded(tmp_path / "r.mcap", answers)
    later = recorded(
        tmp_path / "l.mcap", rows_at("r", *range(200 * SECOND, 290 * SECOND, SECOND), frame=frame)
    )
    same = recorded(tmp_path / "s.mcap", rows_at("s", *range(SECOND, 90 * SECOND, SECOND)))
    assert InputReading([other, control]).groups == [[control, other]]
    assert InputReading([control, later]).groups == [[control], [later]]
    assert InputReading([control, later], is_pair=True).groups == [[control, later]]
    assert InputReading([control, same]).groups == [[control], [same]]


def test_several_inputs_are_read_in_the_order_of_time_and_counted_once(tmp_path: Path) -> None:
    names = ("b", "a")
    inputs = [
        recorded(tmp_path / f"{name}.mcap", rows_at(name, *range(at, 9 * SECOND, SECOND)))
        for at, name in enumerate(names, SECOND)
    ]
    reading = InputReading(inputs)
    rows = Rows.concat([item for item in reading if isinstance(item, Rows)])
    assert rows.t_ns.tolist() == sorted(rows.t_ns.tolist())
    assert (len(rows), reading.tally.rows, reading.written) == (16, 16, 16)
    assert not reading.notes


def test_files_of_a_capture_follow_each_other_by_number(tmp_path: Path) -> None:
    """The clock was set back during the capture."""
    facts, options = host_facts(SECOND), RecordingOptions(rotate_bytes=1)
    recorder = Recorder(tmp_path / "x.mcap", [PortFacts("a")], facts, options=options)
    for second in (20, 10, 30):
        recorder.write(rows_at("a", second * SECOND))
        recorder.flush()
    recorder.close()
    own = [recording_input(Recording(path)) for path in recorder.files]
    other = recorded(tmp_path / "y.mcap", rows_at("a", SECOND))
    assert InputReading([*reversed(own), other]).groups == [[other], own]
    assert len(own) > 2


def test_a_follower_has_the_rows_of_a_file_that_grows_and_of_the_next_files(tmp_path: Path) -> None:
    options = RecordingOptions(rotate_bytes=1)
    recorder = Recorder(tmp_path / "x.mcap", [PortFacts("a")], options=options)
    follower = Follower(Recording(recorder.path, is_growing=True))
    rows = rows_at("a", *range(SECOND, 31 * SECOND, SECOND))
    items = follower.items(None, lambda _note: None)
    for start in range(0, 30, 10):
        recorder.write(rows[start : start + 10])
        recorder.flush()
        found = Rows.concat([one for one in until_rows(items, 10) if isinstance(one, Rows)])
        assert found.t_ns.tolist() == rows.t_ns[start : start + 10].tolist()
    recorder.close()
    assert not any(len(one) for one in items if isinstance(one, Rows))
    assert follower.ended is not None
    assert len(list(tmp_path.iterdir())) in (3, 4)


def until_rows(items: Iterator[Item], count: int) -> list[Item]:
    """The next items, up to as many rows."""
    found = list[Item]()
    while sum(len(one) for one in found if isinstance(one, Rows)) < count:
        found.append(next(items))
    return found


def test_a_gap_that_several_files_of_a_capture_report_is_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("fte_sniff.recording.recorder.RETRY_S", 0.0)
    options = RecordingOptions(rotate_s=15)
    recorder = Recorder(tmp_path / "x.mcap", [PortFacts("a")], options=options)
    rows = rows_at("a", *range(SECOND, 61 * SECOND, SECOND))
    for start in range(0, 60, 10):
        if start == 10:
            recorder.path.unlink()
        recorder.write(rows[start : start + 10])
        recorder.flush()
    recorder.close()
    files = sorted(tmp_path.iterdir())
    (gap,) = Recording(files[0]).gaps()
    assert [Recording(path).gaps() for path in files] == [[gap]] * len(files)
    assert len(files) > 1
    reading = InputReading([recording_input(Recording(path)) for path in files])
    assert [item for item in reading if isinstance(item, Gap) and item.rows] == [gap]
    assert gap.start_ns is not None
    for before_ns in (0, 1):  # of a part, the number of rows is unknown
        span = TimeRange(gap.start_ns - before_ns, gap.start_ns - before_ns + 1)
        reading = InputReading([recording_input(Recording(path)) for path in files], span)
        part = gap._replace(rows=None, end_ns=gap.start_ns)
        list(reading)
        assert reading.reported_gaps == [part] * (before_ns == 0)
    follower = Follower(Recording(files[0], is_growing=True))
    found = until_rows(follower.items(None, lambda _note: None), 50)
    assert [item for item in found if isinstance(item, Gap)] == [gap]


def test_follower_waits_for_a_capture_whose_disk_stays_full(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("fte_sniff.recording.recorder.RETRY_S", 0.0)
    monkeypatch.setattr("fte_sniff.session.following.RELEASE_S", 0.0)
    recorder = Recorder(tmp_path / "x.mcap", [PortFacts("a")])
    follower = Follower(Recording(recorder.path, is_growing=True))
    items, rows = follower.items(None, lambda _note: None), rows_at("a", SECOND, 2 * SECOND)
    recorder.write(rows[:1])
    with monkeypatch.context() as full:
        full.setattr("os.open", refused)
        full.setattr("fte_sniff.recording.writer.write_at", refused)
        recorder.flush()
        recorder.flush()
    assert recorder.is_stopped
    assert [len(next(items)) for _ in range(5)] == [0] * 5
    recorder.flush()
    assert each(until_rows(items, 1)) == list(rows[:1])
    recorder.write(rows[1:])
    recorder.close()
    assert each(items) == list(rows[1:])


def refused(*_given: object) -> None:
    raise OSError(errno.ENOSPC, "No space left on device")


def test_an_error_of_the_disk_between_flushes_stops_the_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    recorder = Recorder(tmp_path / "x.mcap", [PortFacts("a")])

    def fail(_descriptor: int) -> None:
        raise OSError(5, "Input/output error")

    monkeypatch.setattr("fte_sniff.recording.writer.sync_data", fail)
    recorder.write(rows_at("a", SECOND))
    recorder.flush(waits=False)
    assert recorder.failure is None
    recorder.flush()
    assert recorder.trouble is not None
    recorder.close()
    assert recorder.failure is not None
    assert "Input/output error" in recorder.failure.message
