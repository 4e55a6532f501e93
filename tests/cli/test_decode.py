"""`decode`: formats, outputs, ranges, samples, and gaps in recordings."""

from __future__ import annotations

import csv
import io
import json
import struct
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest
from mcap.records import Metadata
from mcap.writer import Writer

from fte_sniff.protocol.columns import iso_time
from fte_sniff.protocol.items import Gap, GapKind, PortEvent, PortEventKind
from fte_sniff.protocol.rows import Row
from fte_sniff.protocol.spec import KIND_BY_NAME, encode
from fte_sniff.recording.metadata import LEFT_OUT_NAME, PortFacts, gap_to_metadata
from fte_sniff.recording.reader import Recording
from fte_sniff.recording.writer import RecordingWriter
from tests.cli.conftest import ROOT, SAMPLES
from tests.in_process import call
from tests.support.columns import entries


def jsonl(text: str) -> list[dict]:
    return [json.loads(line) for line in text.splitlines()]


TERMINAL_OBEYS = "\x85\x9b\u2028\u2029\u202e\u2066\ufeff"
"""Characters that a terminal obeys, or that change the order of the text around them."""


@pytest.mark.parametrize(
    ("command", "options"),
    [
        ("decode", ["--format", "jsonl"]),
        ("decode", ["--format", "jsonl", "--filter", "motor >= 0 OR motor IS NULL"]),
        ("stats", ["--format", "json"]),
    ],
)
def test_json_is_text_that_every_terminal_shows_as_it_is(
    run, tmp_path: Path, command: str, options: list[str]
) -> None:
    file = tmp_path / f"中文{TERMINAL_OBEYS}.raw"
    file.write_bytes(bytes.fromhex("AA0000000000000000EE") * 2)
    output = run(command, file, *options).stdout
    assert "中文" in output
    assert all(line.isprintable() for line in output.split("\n"))
    for found in [json.loads(output)] if command == "stats" else jsonl(output)[-1:]:
        assert ascii(TERMINAL_OBEYS)[1:-1] in ascii(found)


@pytest.mark.parametrize("name", ["clean", "damaged", "idle", "midstream"])
def test_a_recording_of_a_recording_holds_the_same(
    run, samples: Path, tmp_path: Path, name: str
) -> None:
    copy = tmp_path / "copy.mcap"
    done = run("decode", samples / f"{name}.mcap", "--format", "mcap", "-o", copy)
    assert done.returncode == 0, done.stderr
    assert done.stdout == ""
    original, again = (
        run("decode", path, "--format", "jsonl").stdout for path in (samples / f"{name}.mcap", copy)
    )
    assert again == original
    assert list(tmp_path.iterdir()) == [copy]


def test_serial_bytes_on_the_topic_of_another_program(run, samples: Path, tmp_path: Path) -> None:
    path = tmp_path / "robot.mcap"
    content = (samples / "clean.raw").read_bytes()
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        channel = writer.register_channel("/uart", "", 0)
        for at in range(0, len(content), 25):
            writer.add_message(channel, 10**18 + at * 86_800, content[at : at + 25], 0)
        writer.finish()

    def rows(*arguments: object) -> list[dict]:
        # Facts depend on the times, which the raw bytes have not.
        columns = "offset,length,direction,kind,status,faults,raw"
        done = run("decode", *arguments, "--format", "jsonl", "--columns", columns)
        assert done.returncode == 0, done.stderr
        return list(jsonl(done.stdout))

    every = rows(path, "--topic", "/uart")
    assert every == rows(samples / "clean.raw")
    later = rows(path, "--topic", "/uart", "--from", "+1ms")
    assert 0 < len(later) < len(every)
    assert later == every[-len(later) :]
    refusal = run("decode", path)
    assert refusal.returncode == 4
    assert "'/uart'; if one of them has serial bytes, name it with --topic" in refusal.stderr
    assert run("decode", samples / "clean.raw", "--topic", "/uart").returncode == 2


def test_jumps_are_the_same_rows_live_in_files_and_in_check(run, tmp_path: Path) -> None:
    jump = "abs(rpm - previous(rpm)) > 100"
    port = "sim://?seed=2&rate=400&drop=0.05&flip=0.05&noise=0.05"
    live = run("live", port, "--plain", "--count", "600", "--filter", jump, "-o", "x.mcap")
    assert live.returncode == 0, live.stderr
    rows = jsonl(run("decode", "x.mcap", "--format", "jsonl").stdout)
    last, expected = dict[tuple[str, int], int](), []
    for row in rows:
        if row["rpm"] is not None:
            key = row["kind"], row["motor"]
            if key in last and abs(row["rpm"] - last[key]) > 100:
                expected.append(row["offset"])
            last[key] = row["rpm"]
    assert expected
    found = run("decode", "x.mcap", "--filter", jump)
    assert found.stdout == live.stdout
    assert [int(line.split()[1]) for line in found.stdout.splitlines()[1:]] == expected
    (tmp_path / "x.raw").write_bytes(bytes.fromhex("".join(row["raw"] for row in rows)))
    piped = run(
        "decode", "-", "--filter", jump, "--format", "csv", stdin=(tmp_path / "x.raw").read_bytes()
    )
    assert [int(row["offset"]) for row in csv.DictReader(io.StringIO(piped.stdout))] == expected
    counted = run("check", "x.mcap", "--expect", f"count({jump}) == {len(expected)}")
    assert counted.returncode == 0, counted.stdout


EXPECTED = sorted((SAMPLES / "expected").iterdir())
FORMS = {".txt": "table", ".jsonl": "jsonl", ".csv": "csv"}


def test_every_sample_is_here_in_three_forms_with_its_text() -> None:
    names = {path.name.removesuffix(".txt") for path in EXPECTED if path.suffix == ".txt"}
    stories = ("clean", "damaged", "idle", "midstream")
    assert names == {f"{story}.{form}" for story in stories for form in ("mcap", "raw", "hex")}
    assert all((SAMPLES / name).is_file() for name in names)


@pytest.mark.parametrize("expected", EXPECTED, ids=lambda path: path.name)
def test_decode_prints_what_is_expected(expected: Path, variables: dict[str, str]) -> None:
    words = ["decode", f"samples/{expected.stem}", "--format", FORMS[expected.suffix]]
    done = call(words, b"", ROOT, variables)
    assert (done.code, done.output) == (0, expected.read_bytes())


START, STEP = 1_770_000_000_000_000_000, 10_000_000
CHUNK = 6
FACTS = {"start": iso_time(START), "host": "bench"}


def rows_of(first: int, stop: int, port: str = "p") -> list[Row]:
    """Commands a hundredth of a second apart, whose RPM is their number."""
    raws = [encode(KIND_BY_NAME["speed"], {"motor": 1, "rpm": at}) for at in range(first, stop)]
    return [
        Row(port, 10 * at, raw, START + at * STEP, (), delay_ns=0)
        for at, raw in enumerate(raws, first)
    ]


def recorded(
    path: Path,
    rows: list[Row],
    facts: dict[str, str] | None = None,
    events: Sequence[PortEvent] = (),
    baud: int = 115_200,
) -> Path:
    """A recording with a chunk for every twenty rows."""
    with RecordingWriter(path, [PortFacts("p", baud)], facts or {}) as writer:
        for at in range(0, len(rows), 20):
            writer.write(*entries(rows[at : at + 20]))
            last_ns = rows[min(at + 20, len(rows)) - 1].t_ns or 0
            while events and events[0].t_ns < last_ns:
                writer.write(*entries(events[0]))
                events = events[1:]
            writer.flush()
    return path


LEFT_OUT = "they are outside of what was kept"


def with_rows_left_out(path: Path) -> Path:
    """A recording of 500 rows that has the rows 0-99, 200-299 and 400-499."""
    rows = rows_of(0, 500)
    kept = [row for at, row in enumerate(rows) if at // 100 % 2 == 0]
    gaps = [
        Metadata(LEFT_OUT_NAME, gap_to_metadata(Gap(GapKind.LEFT_OUT, 100, first, last, LEFT_OUT)))
        for first, last in ((rows[100].t_ns, rows[199].t_ns), (rows[300].t_ns, rows[399].t_ns))
    ]
    with RecordingWriter(path, [PortFacts("p")]) as writer:
        writer.write(*entries(kept))
        for gap in gaps:
            writer.write_metadata(gap)
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
    """A file whose second chunk is damaged: its packed bytes, or its length."""
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
    gone = PortEvent(START + 20 * STEP - 1, "p", PortEventKind.LOST, "gone")
    back = PortEvent(START + 40 * STEP - 1, "p", PortEventKind.FOUND_AGAIN, "back")
    return recorded(path, [*rows_of(0, 20), *rows_of(40, 60)], events=(gone, back))


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
    """Neither by `stats`, nor in a copy of what is left."""
    paths = GAPS[gap](tmp_path)
    assert run("decode", *paths, "-o", "copy.mcap").returncode == 0
    for some in (paths, [tmp_path / "copy.mcap"]):
        reported = stats(run, *some)
        (port,) = reported["ports"]
        assert port["rows"] == 40
        assert port["silences"]["count"] == 2 * 19
        assert port["streams"][0]["period"]["longest_s"] == STEP / 1e9
        assert (reported["motors"][0]["unanswered"], reported["motors"][0]["neither"]) == (None, 40)


def test_parts_that_follow_each_other_are_one(run, tmp_path: Path) -> None:
    for first, part in ((0, "1"), (20, "2")):
        facts = FACTS | {"part": part}
        recorded(tmp_path / f"a_{part}.mcap", rows_of(first, first + 20), facts)
    (port,) = stats(run, "a_1.mcap", "a_2.mcap")["ports"]
    assert port["silences"]["count"] == 39


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
def test_a_copy_names_the_gaps_between_its_rows(
    run, tmp_path: Path, options: list[str], expected: list[tuple[int | None, int, int]]
) -> None:
    with_rows_left_out(tmp_path / "a.mcap")
    done = run("decode", "a.mcap", "-o", "copy.mcap", *options)
    assert done.returncode == 0, done.stderr
    for one, (rows, first, last) in zip(
        Recording(tmp_path / "copy.mcap").gaps(), expected, strict=True
    ):
        assert one.rows == rows
        assert one.reason == LEFT_OUT
        assert abs((one.start_ns or 0) - (START + first * STEP)) <= STEP
        assert abs((one.end_ns or 0) - (START + last * STEP)) <= STEP


def test_a_gap_of_unknown_length_is_reported_as_such(run, tmp_path: Path) -> None:
    paths = GAPS["another capture"](tmp_path)
    assert run("decode", *paths, "-o", "copy.mcap").returncode == 0
    times = START + 19 * STEP + 1, START + 40 * STEP - 1
    between = Gap(GapKind.LEFT_OUT, None, *times, "another recording begins here")
    assert Recording(tmp_path / "copy.mcap").gaps() == [between]
    words = "left out   rows in 1 gap: another recording begins here\n"
    assert words in run("stats", "copy.mcap").stdout
    assert stats(run, "copy.mcap")["left_out"][0]["rows"] is None


_PEAK = """
import resource, subprocess, sys
subprocess.run([sys.executable, "-m", "fte_sniff", *sys.argv[1:]], stdout=subprocess.DEVNULL)
print(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss // 1024)
"""


@pytest.mark.slow
@pytest.mark.parametrize("form", ["jsonl", "csv"])
def test_text_of_a_million_rows_needs_at_most_300_mb(tmp_path: Path, form: str) -> None:
    frames = encode(KIND_BY_NAME["speed"], {"motor": 1, "rpm": 100}) * 1_000_000
    (tmp_path / "rows.raw").write_bytes(frames)
    converted = [sys.executable, "-m", "fte_sniff", "decode", "rows.raw", "-o", "rows.mcap"]
    subprocess.run([*converted, "--start", "2026-01-31T12:00:00Z"], cwd=tmp_path, check=True)
    measured = [sys.executable, "-c", _PEAK, "decode", "rows.mcap", "--format", form]
    found = subprocess.run(measured, cwd=tmp_path, check=True, capture_output=True, text=True)
    assert 50 < int(found.stdout) <= 300
