"""Rows that are missing from recordings: nothing is measured across, and copies tell of them."""

from __future__ import annotations

import json
import struct
from pathlib import Path

import pytest

from fte_sniff.analysis.feed import BaudChange, shifted
from fte_sniff.analysis.live_models import LiveModels
from fte_sniff.analysis.row_store import RowStore
from fte_sniff.analysis.statistics import LineSetup
from fte_sniff.protocol import (
    KIND_BY_NAME,
    Frame,
    Gap,
    GapKind,
    PortEvent,
    PortEventKind,
    Row,
    encode,
    iso_time,
)
from fte_sniff.recording.metadata import PortFacts
from fte_sniff.recording.reader import RecordingReader
from fte_sniff.recording.recorder import Recorder
from fte_sniff.recording.retention import RecordingOptions, TriggerWindow
from fte_sniff.recording.writer import RecordingWriter
from fte_sniff.session.inputs import RecordingInput
from fte_sniff.session.pipeline import Viewing

START, STEP = 1_770_000_000_000_000_000, 10_000_000
CHUNK = 6
FACTS = {"start": iso_time(START), "host": "bench"}


def rows_of(first: int, stop: int, port: str = "p") -> list[Row]:
    """Commands a hundredth of a second apart, whose RPM is their number."""
    raws = [encode(KIND_BY_NAME["speed"], {"motor": 1, "rpm": at}) for at in range(first, stop)]
    return [
        Frame(port, 10 * at, raw, START + at * STEP, (), 0) for at, raw in enumerate(raws, first)
    ]


def recorded(
    path: Path,
    rows: list[Row],
    facts: dict[str, str] | None = None,
    event: PortEvent | None = None,
    baud: int = 115_200,
) -> Path:
    """A recording with a chunk for every twenty rows."""
    with RecordingWriter(path, [PortFacts("p", baud)], facts or {}) as writer:
        for at in range(0, len(rows), 20):
            writer.write(rows[at : at + 20])
            if event is not None and event.t_ns < (rows[min(at + 20, len(rows)) - 1].t_ns or 0):
                writer.write_event(event)
                event = None
            writer.flush()
    return path


def triggered(path: Path) -> Path:
    """A recording of which a trigger kept the rows 0-99, 200-299 and 400-499 of 500."""
    recorder = Recorder(
        path,
        [PortFacts("p")],
        keeping=RecordingOptions(around=TriggerWindow(0, 0)),
        select=lambda given: [row for row in given if row.values["rpm"] // 100 % 2 == 0],
    )
    recorder.write(rows_of(0, 500))
    recorder.close()
    return path


def chunk_of(content: bytes, number: int) -> tuple[int, int]:
    """Where a chunk's record begins and ends."""
    found, place = [], 8
    while place < len(content) - 8:
        opcode, length = struct.unpack_from("<BQ", content, place)
        if opcode == CHUNK:
            found.append((place, place + 9 + length))
        place += 9 + length
    return found[number]


def without_chunk(path: Path, *, summary: bool = True, head: bool = False) -> Path:
    """The same file, whose second chunk is damaged: its packed bytes, or its length."""
    content = bytearray(path.read_bytes())
    start, end = chunk_of(bytes(content), 1)
    if head:
        content[start + 1] ^= 0x41
    content[end - 30 : end - 10] = bytes(20)
    path.write_bytes(content if summary else content[: content.rindex(b"\x0f\x04\0\0\0\0\0\0\0")])
    return path


def parts(folder: Path) -> list[Path]:
    """The first and the third file of a capture; what the second held is not there."""
    sides = [(0, 20, "1"), (40, 60, "3")]
    return [
        recorded(folder / f"a_{part}.mcap", rows_of(first, stop), FACTS | {"part": part})
        for first, stop, part in sides
    ]


def lost(path: Path) -> Path:
    event = PortEvent(START + 20 * STEP - 1, "p", PortEventKind.LOST, "gone")
    return recorded(path, [*rows_of(0, 20), *rows_of(40, 60)], event=event)


GAPS = {
    "a damaged chunk": lambda folder: [without_chunk(recorded(folder / "a.mcap", rows_of(0, 60)))],
    "a damaged chunk head": lambda folder: [
        without_chunk(recorded(folder / "a.mcap", rows_of(0, 60)), head=True)
    ],
    "a damaged chunk head, and no summary": lambda folder: [
        without_chunk(recorded(folder / "a.mcap", rows_of(0, 60)), summary=False, head=True)
    ],
    "a missing part": parts,
    "a lost port": lambda folder: [lost(folder / "a.mcap")],
    "another capture": lambda folder: [
        recorded(folder / "a.mcap", rows_of(0, 20)),
        recorded(folder / "b.mcap", rows_of(40, 60)),
    ],
}
"""Recordings of 20 rows, and 20 more after a gap of as many."""


def stats(run, *arguments: str | Path) -> dict:
    done = run("stats", *arguments, "--format", "json")
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.mark.parametrize("gap", GAPS)
def test_nothing_is_measured_across_a_gap(run, tmp_path: Path, gap: str) -> None:
    """Neither by `stats`, nor on the screen, nor in a copy of what is left."""
    paths = GAPS[gap](tmp_path)
    assert run("decode", *paths, "-o", "copy.mcap").returncode == 0
    for some in (paths, [tmp_path / "copy.mcap"]):
        told = stats(run, *some)
        (port,) = told["ports"]
        assert port["rows"] == 40
        assert port["silences"]["count"] == 2 * 19
        assert port["streams"][0]["period"]["longest_s"] == STEP / 1e9
        assert told["motors"][0]["neither"] == 2
        models = viewed(some)
        assert models.statistics.ports()[0].silences.count == 2 * 19
        assert models.motors.states(None)[0].unanswered == 2 * 19


def viewed(paths: list[Path]) -> LiveModels:
    """The models of the screen, once it has seen these recordings."""
    store = RowStore()
    models = LiveModels(store, LineSetup())
    inputs = [RecordingInput(RecordingReader(path)) for path in paths]
    for read in Viewing(inputs, None, None, None, print):
        models.add_changes(shifted(read.changes, store.next))
        store.append(read.rows)
        models.statistics.observe_events(read.events)
    while not models.step(1000):
        pass
    return models


def test_parts_that_follow_each_other_are_one(run, tmp_path: Path) -> None:
    for first, part in ((0, "1"), (20, "2")):
        facts = FACTS | {"part": part}
        recorded(tmp_path / f"a_{part}.mcap", rows_of(first, first + 20), facts)
    (port,) = stats(run, "a_1.mcap", "a_2.mcap")["ports"]
    assert port["silences"]["count"] == 39
    models = viewed([tmp_path / "a_1.mcap", tmp_path / "a_2.mcap"])
    assert models.statistics.ports()[0].silences.count == 39


def test_the_screen_measures_nothing_across_what_was_left_out(tmp_path: Path) -> None:
    models = viewed([triggered(tmp_path / "a.mcap")])
    (stream,) = models.statistics.streams(None)
    assert (stream.periods.count, stream.periods.longest_ns) == (3 * 99, STEP)
    assert models.motors.states(None)[0].unanswered == 3 * 99


def test_the_screen_takes_the_baud_from_the_recording(tmp_path: Path) -> None:
    slow = recorded(tmp_path / "a.mcap", rows_of(0, 20), baud=9600)
    assert viewed([slow]).statistics.ports()[0].baud == 9600
    said = Viewing([RecordingInput(RecordingReader(slow))], None, 1200, None, print)
    assert not [one for read in said for one in read.changes if isinstance(one.what, BaudChange)]
    assert said.origin.bauds == {"p": 1200}


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        ([], [(100, 100, 199), (100, 300, 399)]),
        (["--filter", "rpm < 50"], [(100, 100, 199), (100, 300, 399)]),
        (["--from", "+1.5s", "--to", "+3s"], [(None, 150, 199)]),
        (["--to", "+3.005s"], [(100, 100, 199), (None, 300, 300)]),
        (["--limit", "150"], [(100, 100, 199)]),
        (["--limit", "100"], []),
    ],
)
def test_a_copy_tells_what_was_left_out_among_its_rows(
    run, tmp_path: Path, options: list[str], expected: list[tuple[int | None, int, int]]
) -> None:
    triggered(tmp_path / "a.mcap")
    done = run("decode", "a.mcap", "-o", "copy.mcap", *options)
    assert done.returncode == 0, done.stderr
    for one, (rows, first, last) in zip(
        RecordingReader(tmp_path / "copy.mcap").gaps(), expected, strict=True
    ):
        assert one.rows == rows
        assert one.reason == "the trigger did not ask for them"
        assert abs((one.start_ns or 0) - (START + first * STEP)) <= STEP
        assert abs((one.end_ns or 0) - (START + last * STEP)) <= STEP


def test_a_selection_says_so(run, tmp_path: Path) -> None:
    recorded(tmp_path / "a.mcap", rows_of(0, 60))
    assert run("decode", "a.mcap", "--filter", "rpm < 50", "-o", "b.mcap").returncode == 0
    assert run("decode", "b.mcap", "--filter", "rpm > 10", "-o", "c.mcap").returncode == 0
    lines = run("stats", "c.mcap").stdout.splitlines()
    assert "selection  only those of 60 rows for which this held: rpm < 50" in lines
    assert "selection  only those of 50 rows for which this held: rpm > 10" in lines
    assert stats(run, "c.mcap")["selections"] == [
        {"filter": "rpm < 50", "rows_read": 60},
        {"filter": "rpm > 10", "rows_read": 50},
    ]
    assert stats(run, "a.mcap")["selections"] == []


def test_a_gap_of_unknown_length_is_reported_as_such(run, tmp_path: Path) -> None:
    paths = GAPS["another capture"](tmp_path)
    assert run("decode", *paths, "-o", "copy.mcap").returncode == 0
    times = START + 19 * STEP + 1, START + 40 * STEP - 1
    between = Gap(GapKind.LEFT_OUT, None, *times, "another recording begins here")
    assert RecordingReader(tmp_path / "copy.mcap").gaps() == [between]
    words = "left out   nobody knows how many rows in 1 place: another recording begins here\n"
    assert words in run("stats", "copy.mcap").stdout
    assert stats(run, "copy.mcap")["left_out"][0]["rows"] is None
