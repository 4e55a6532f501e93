"""`decode`: formats, outputs, ranges, samples, and gaps in recordings."""

from __future__ import annotations

import csv
import gc
import io
import json
import os
import re
import struct
import warnings
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path

import polars
import pytest
from mcap.reader import make_reader
from mcap.writer import Writer
from mcap_protobuf.decoder import DecoderFactory

from fte_sniff.analysis.live_models import LiveModels
from fte_sniff.analysis.model import BaudChange, shifted
from fte_sniff.analysis.row_store import RowStore
from fte_sniff.analysis.statistics import LineSetup
from fte_sniff.cli.input_files import InputQuery
from fte_sniff.errors import FileError
from fte_sniff.formats.writers import FORMAT_BY_SUFFIX
from fte_sniff.protocol import (
    COLUMN_BY_NAME,
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
from fte_sniff.session.inputs import InputKind, InputReading, RecordingInput
from tests.beside import running
from tests.cli.conftest import ROOT, SAMPLES
from tests.cli.forked import Program
from tests.cli.processes import ended, started
from tests.slow import crossed
from tests.support.columns import in_columns


def jsonl(text: str) -> list[dict]:
    return [json.loads(line) for line in text.splitlines()]


@pytest.mark.parametrize("name", ["clean", "damaged", "idle", "midstream"])
def test_recording_raw_and_hex_have_equal_rows(run, samples: Path, name: str) -> None:
    def rows(ending: str) -> list[dict]:
        done = run("decode", samples / f"{name}.{ending}", "--format", "jsonl")
        assert done.returncode == 0
        timed = dict.fromkeys(("time", "port", "answer_ms"))
        return [row | timed for row in jsonl(done.stdout)]

    raw = rows("raw")
    assert (
        "".join(row["raw"] for row in raw) == (samples / f"{name}.raw").read_bytes().hex().upper()
    )
    assert rows("hex") == raw
    recorded = rows("mcap")
    assert "".join(row["raw"] for row in recorded) == "".join(row["raw"] for row in raw)
    if name == "clean":
        assert recorded == raw


@pytest.mark.parametrize(("name", "end"), crossed(["clean", "damaged"], ["txt", "csv", "jsonl"]))
def test_what_it_wrote_it_reads_back_at_the_same_times(
    run, samples: Path, tmp_path: Path, end: str, name: str
) -> None:
    def reported(file: Path) -> list[tuple[str, str, list[str]]]:
        rows = jsonl(run("decode", file, "--format", "jsonl").stdout)
        return [(row["time"], row["raw"], row["faults"]) for row in rows]

    written = tmp_path / f"rows.{end}"
    assert run("decode", samples / f"{name}.mcap", "-o", written).returncode == 0
    assert reported(written) == reported(samples / f"{name}.mcap")


def test_times_ports_and_order_come_from_the_recording(run, samples: Path) -> None:
    rows = jsonl(run("decode", samples / "clean.mcap", "--format", "jsonl").stdout)
    times = [row["time"] for row in rows]
    assert times == sorted(times)
    assert times[0].startswith("2026-01-31T12:00:00.")
    assert times[0].endswith("Z")
    assert {row["port"] for row in rows} == {"sim://?seed=1&rate=30&frames=1200"}


def test_csv_has_the_contract_as_its_header(run, samples: Path) -> None:
    text = run("decode", samples / "clean.raw", "--format", "csv").stdout
    rows = list(csv.DictReader(io.StringIO(text)))
    assert list(rows[0]) == list(COLUMN_BY_NAME)
    assert rows[0]["time"] == ""


def test_filter_limit_and_summary(run, samples: Path) -> None:
    wanted = "motor = 1 AND kind = 'speed'"
    done = run("decode", samples / "clean.mcap", "--format", "jsonl", "--filter", wanted)
    rows = jsonl(done.stdout)
    assert rows
    assert {(row["motor"], row["kind"]) for row in rows} == {(1, "speed")}
    assert f"1,200 rows read, {len(rows)} written" in done.stderr
    few = run(
        "decode", samples / "clean.mcap", "--format", "jsonl", "--filter", wanted, "--limit=2"
    )
    assert jsonl(few.stdout) == rows[:2]
    none = run("decode", samples / "clean.mcap", "--format", "jsonl", "--limit", "0")
    assert none.stdout == ""


def test_summary_names_faults_and_the_time_covered(run, samples: Path) -> None:
    reported = run("decode", samples / "damaged.mcap").stderr
    assert "malformed" in reported
    assert "%" in reported
    assert "s from 2026-01-31T12:00:0" in reported
    assert "nothing malformed" in run("decode", samples / "clean.raw").stderr


def test_several_files_are_distinguished(run, samples: Path) -> None:
    done = run("decode", samples / "idle.raw", samples / "idle.hex")
    assert "idle.raw" in done.stdout
    assert "idle.hex" in done.stdout


@pytest.mark.parametrize("ending", ["mcap", "raw", "hex"])
def test_standard_input_is_recognised(run, samples: Path, ending: str) -> None:
    file = samples / f"idle.{ending}"
    done = run("decode", "-", "--format", "jsonl", stdin=file.read_bytes())
    expected = run("decode", file, "--format", "jsonl")
    assert [row["raw"] for row in jsonl(done.stdout)] == [
        row["raw"] for row in jsonl(expected.stdout)
    ]


def test_input_overrules_the_name(run, tmp_path: Path, samples: Path) -> None:
    (tmp_path / "bytes.txt").write_bytes((samples / "idle.raw").read_bytes())
    done = run("decode", "bytes.txt", "--input", "raw", "--format", "jsonl")
    assert len(jsonl(done.stdout)) == 12


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


def test_output_to_a_file(run, tmp_path: Path, samples: Path) -> None:
    done = run("decode", samples / "idle.raw", "--format", "csv", "-o", "rows.csv")
    assert done.stdout == ""
    assert (tmp_path / "rows.csv").read_text().count("\n") == 13
    again = run("decode", samples / "idle.raw", "-o", "rows.csv")
    assert again.returncode == 4
    assert "--force" in again.stderr
    forced = run("decode", samples / "idle.raw", "-o", "rows.csv", "--force")
    assert forced.returncode == 0
    assert (tmp_path / "rows.csv").read_text().count("\n") == 13


def test_a_recording_that_is_cut_before_its_rows_gets_no_advice_about_wires(
    run, tmp_path: Path, samples: Path
) -> None:
    (tmp_path / "cut.mcap").write_bytes((samples / "clean.mcap").read_bytes()[:400])
    for command in ("decode", "stats"):
        errors = run(command, "cut.mcap").stderr
        assert "it is cut" in errors
        assert "wire" not in errors


def test_a_file_cut_anywhere_is_decoded_to_its_end(run, tmp_path: Path, samples: Path) -> None:
    (tmp_path / "cut.raw").write_bytes((samples / "clean.raw").read_bytes()[:96])
    done = run("decode", "cut.raw", "--format", "jsonl")
    assert done.returncode == 0
    assert sum(row["length"] for row in jsonl(done.stdout)) == 96
    assert "cut.raw: ends in the middle of a frame (6 of 10 bytes)" in done.stderr
    whole = (samples / "clean.mcap").read_bytes()
    (tmp_path / "cut.mcap").write_bytes(whole[: len(whole) * 3 // 4])
    cut = run("decode", "cut.mcap", "--format", "jsonl")
    assert cut.returncode == 0
    assert "cut.mcap: " in cut.stderr


def test_the_input_is_never_the_output(run, tmp_path: Path, samples: Path) -> None:
    before = (samples / "idle.mcap").read_bytes()
    (tmp_path / "x.mcap").write_bytes(before)
    for output in ("x.mcap", "./x.mcap"):
        done = run("decode", "x.mcap", "--force", "-o", output)
        assert done.returncode == 2
        assert "is an input" in done.stderr
    assert (tmp_path / "x.mcap").read_bytes() == before


def test_a_command_that_fails_leaves_an_old_output_and_no_new_one(run, tmp_path: Path) -> None:
    (tmp_path / "old.txt").write_text("old")
    assert run("decode", "none.raw", "--force", "-o", "old.txt").returncode == 4
    assert (tmp_path / "old.txt").read_text() == "old"
    assert run("decode", "none.raw", "-o", "new.txt").returncode == 4
    assert [path.name for path in tmp_path.iterdir()] == ["old.txt"]


def test_rows_before_a_fault_are_on_standard_output_and_in_no_file(run, tmp_path: Path) -> None:
    """A file with its name would look whole; what is on standard output is out already."""
    (tmp_path / "x.hex").write_text("AA 00 00 00 00 00 00 00 00 EE\n" * 40 + "zz\n")
    done = run("decode", "x.hex")
    assert (done.returncode, done.stdout.count("reset")) == (2, 40)
    assert run("decode", "x.hex", "-o", "rows.txt").returncode == 2
    assert not (tmp_path / "rows.txt").exists()


def test_standard_output_has_two_names(run, samples: Path) -> None:
    plain = run("decode", samples / "idle.raw").stdout
    assert run("decode", samples / "idle.raw", "-o", "-").stdout == plain
    assert run("decode", samples / "idle.raw", "-o", "/dev/stdout").stdout == plain


def test_standard_input_is_named_once(run, samples: Path) -> None:
    done = run("decode", "-", "-", stdin=(samples / "idle.raw").read_bytes())
    assert done.returncode == 2
    assert "once" in done.stderr


def test_losses_inside_a_recording_are_reported(run, tmp_path: Path, samples: Path) -> None:
    with (samples / "clean.mcap").open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    chunk = summary.chunk_indexes[len(summary.chunk_indexes) // 2]
    data = bytearray((samples / "clean.mcap").read_bytes())
    data[chunk.chunk_start_offset + chunk.chunk_length // 2] ^= 0xFF
    (tmp_path / "flip.mcap").write_bytes(data)
    done = run("decode", "flip.mcap", "--format", "jsonl")
    assert done.returncode == 0
    assert len(jsonl(done.stdout)) < 1200
    assert all(line.startswith("fte-sniff: flip.mcap: ") for line in done.stderr.splitlines()[:-1])
    assert "missing" in done.stderr or "lost" in done.stderr


def test_a_limit_is_not_taken_for_the_whole_file(run, samples: Path) -> None:
    reported = run("decode", samples / "clean.mcap", "--limit", "2").stderr
    assert "stopped at the limit" in reported
    assert "malformed" not in reported


def test_what_is_known_of_an_input_is_reported_also_at_the_limit(
    run, samples: Path, tmp_path: Path
) -> None:
    lines = (
        f"03/04/2026 12:00:{n // 10:02}.{n % 10} AA 01 01 03 E8 00 00 00 00 EE" for n in range(500)
    )
    (tmp_path / "log.txt").write_text("\n".join(lines))
    whole = (samples / "clean.mcap").read_bytes()
    (tmp_path / "cut.mcap").write_bytes(whole[: len(whole) // 2])
    for name, known in [("log.txt", ["day or month first", "zone"]), ("cut.mcap", ["cut off"])]:
        for limit in ([], ["--limit", "3"]):
            notes = run("decode", name, *limit).stderr.splitlines()[:-1]
            for words in known:
                assert len([one for one in notes if words in one]) == 1, notes
    merged = run("decode", "log.txt", "cut.mcap", "--limit", "800").stderr
    assert "day or month first" in merged


def test_lines_of_hex_without_end(run, tmp_path: Path) -> None:
    (tmp_path / "long.hex").write_text("AA 00 00 00 00 00 00 00 00 EE " * 50_000)
    done = run("decode", "long.hex", "--format", "jsonl", "--filter", "NOT reset")
    assert done.stdout == ""
    assert "50,000 rows read, 0 written" in done.stderr


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


def test_parquet_and_mcap_need_a_file(run, samples: Path) -> None:
    for form in ("parquet", "mcap"):
        done = run("decode", samples / "clean.mcap", "--format", form)
        assert done.returncode == 2
        assert f"{form} is not text: name a file to write it to with -o" in done.stderr


@pytest.mark.parametrize("form", ["raw", "mcap"])
def test_what_is_written_in_sequence_goes_to_a_pipe(
    program: Program, environment, samples: Path, tmp_path: Path, form: str
) -> None:
    source = samples / "damaged.mcap"
    words = ["decode", str(source), "--format", form, "-o", "-"]
    done = program.run(words, b"", tmp_path, environment)
    assert done.code == 0, done.errors
    copy = tmp_path / f"copy.{form}"
    copy.write_bytes(done.output)
    words = ["decode", str(copy), "--format", "raw", "-o", "-"]
    raw = program.run(words, b"", tmp_path, environment)
    assert raw.output == (samples / "damaged.raw").read_bytes()


@pytest.mark.parametrize("form", ["raw", "mcap"])
def test_a_pipe_that_is_closed_ends_it_quietly(
    environment, samples: Path, tmp_path: Path, form: str
) -> None:
    reading, writing = os.pipe()
    os.close(reading)
    words = ("decode", str(samples / "damaged.mcap"), "--format", form, "-o", "-")
    with started(environment, tmp_path, *words, stdout=writing) as process:
        os.close(writing)
        code, _, errors = ended(process)
    assert (code, errors) == (0, "")


def test_a_recording_from_a_pipe_is_not_called_by_the_name_of_its_copy(run) -> None:
    done = run("decode", "-", "--input", "mcap", stdin="no recording at all")
    assert done.returncode == 4
    assert "stdin is not an MCAP recording" in done.stderr
    assert "/tmp" not in done.stderr


@pytest.mark.parametrize("name", ["damaged.mcap", "damaged.raw", "damaged.hex", "make.py"])
def test_a_pipe_is_closed(tmp_path: Path, samples: Path, name: str) -> None:
    pipe = tmp_path / name
    os.mkfifo(pipe)
    query = InputQuery((pipe,), InputKind.MCAP if name == "make.py" else None)
    with warnings.catch_warnings(record=True, category=ResourceWarning) as found:
        warnings.simplefilter("always")
        with running(["cp", samples / name, pipe]):
            try:
                assert sum(len(batch.rows) for batch in query.read(None)) > 500
            except FileError:
                assert name == "make.py"
        gc.collect()
    assert not [one.message for one in found if str(pipe) in str(one.message)]


def test_a_parquet_file_holds_what_is_asked_for(run, samples: Path, tmp_path: Path) -> None:
    path = tmp_path / "rows.parquet"
    done = run(
        "decode", samples / "clean.mcap", "--format", "parquet", "-o", path, "--filter", "motor = 1"
    )
    assert done.returncode == 0, done.stderr
    frame = polars.read_parquet(path)
    assert frame.columns == list(COLUMN_BY_NAME)
    assert set(frame["motor"]) == {1}
    assert f"{frame.height} written" in done.stderr


def test_what_has_no_times_cannot_become_a_recording(run, samples: Path, tmp_path: Path) -> None:
    path = tmp_path / "new.mcap"
    done = run("decode", samples / "clean.raw", "--format", "mcap", "-o", path)
    assert done.returncode == 4
    assert "has no time since 1970, and a recording needs one" in done.stderr
    assert list(tmp_path.iterdir()) == []


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
    assert "'/uart'; if one of them holds serial bytes, name it with --topic" in refusal.stderr
    assert run("decode", samples / "clean.raw", "--topic", "/uart").returncode == 2


@pytest.mark.parametrize(
    ("name", "options", "begins"),
    [
        ("x.parquet", [], b"PAR1"),
        ("x.MCAP", [], b"\x89MCAP"),
        ("x.csv", [], b"time,port,"),
        ("x.jsonl", [], b'{"time"'),
        ("x.txt", [], b"time "),
        ("x", [], b"time "),
        ("x.what", ["--format", "table"], b"time "),
        ("x.hex", [], b"AA 00 00 00 00 00 00 00 00 EE\n55 01 01 "),
        ("x.bin", [], b"\xaa\x00\x00"),
        ("x.RAW", [], b"\xaa\x00\x00"),
        ("x.txt", ["--format", "hex"], b"AA 00 "),
        ("x.csv", ["--format", "jsonl"], b'{"time"'),
        ("x.parquet", ["--format", "table"], b"time "),
    ],
)
def test_the_suffix_of_the_output_chooses_the_format(
    run, samples: Path, tmp_path: Path, name: str, options: list[str], begins: bytes
) -> None:
    done = run("decode", samples / "clean.mcap", "-o", tmp_path / name, *options)
    assert done.returncode == 0
    assert (tmp_path / name).read_bytes().startswith(begins)


@pytest.mark.parametrize("name", ["x.json", "x.log", "rows.pcap"])
def test_an_unknown_suffix_is_refused_before_anything_is_read(
    run, samples: Path, tmp_path: Path, name: str
) -> None:
    done = run("decode", samples / "clean.mcap", "-o", name)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.count("\n") == 1
    assert f"{name}: the extension selects the format" in done.stderr
    assert " ".join(FORMAT_BY_SUFFIX) in done.stderr
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(("source", "end"), crossed(["mcap", "raw", "hex"], ["raw", "hex", "bin"]))
def test_bytes_that_are_written_are_read_back(
    run, samples: Path, tmp_path: Path, source: str, end: str
) -> None:
    first = run("decode", samples / f"damaged.{source}", "-o", f"x.{end}")
    assert (first.returncode, first.stdout) == (0, "")
    assert run("decode", f"x.{end}", "-o", "y.raw").returncode == 0
    assert (tmp_path / "y.raw").read_bytes() == (samples / "damaged.raw").read_bytes()


def test_raw_bytes_need_a_file(run, samples: Path) -> None:
    done = run("decode", samples / "idle.hex", "--format", "raw")
    assert done.returncode == 2
    assert "raw is not text: name a file to write it to with -o" in done.stderr
    text = run("decode", samples / "idle.raw", "--format", "hex").stdout
    assert bytes.fromhex(text) == (samples / "idle.raw").read_bytes()


def test_rows_that_no_filter_or_span_lets_through_are_not_missed_on_the_wire(
    run, samples: Path
) -> None:
    filtered = run("decode", samples / "clean.mcap", "--filter", "rpm > 30000").stderr
    assert filtered.endswith("; none of them matches the filter: rpm > 30000\n")
    assert "1,200 rows read, 0 written" in filtered
    later = run("decode", samples / "clean.mcap", "--from", "2027-01-01")
    assert later.returncode == 0
    *_, reported, total = later.stderr.splitlines()
    assert "clean.mcap: none of its 1,20" in reported
    assert "they go from 2026-01-31T12:00:00.000000000Z to 2026-01-31T12:00:" in reported
    assert total == "0 rows; no row is between --from and --to"


SSCOM = (
    "[14:03:22.123]发→◇AA 01 01 03 E8 00 00 00 00 EE □\r\n"
    "[14:03:22.133]收←◆55 01 01 03 E8 00 00 00 0F EE \r\n"
)


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "utf-16-le", "gbk"])
def test_a_log_of_a_serial_assistant(run, tmp_path: Path, encoding: str) -> None:
    content = SSCOM.encode(encoding, "replace")
    (tmp_path / "log.txt").write_bytes(content)
    dated = ("--date", "2026-01-31", "--zone", "+08:00", "--format", "jsonl")
    # Standard input does not wait for the rows that decide facts.
    dated += ("--columns", "time,port,offset,direction,raw")
    done = run("decode", "log.txt", *dated)
    assert (done.returncode, done.stderr.count("\n")) == (0, 1)
    rows = jsonl(done.stdout)
    # A frame began 868 microseconds before its read, which is less than the stamps resolve.
    assert [row["time"] for row in rows] == [
        "2026-01-31T06:03:22.123000000Z",
        "2026-01-31T06:03:22.133000000Z",
    ]
    assert [row["direction"] for row in rows] == ["control", "feedback"]
    assert [row["port"] for row in rows] == ["log.txt:tx", "log.txt:rx"]
    assert jsonl(run("decode", "-", *dated, stdin=content).stdout) == [
        row | {"port": f"stdin:{way}"} for row, way in zip(rows, ("tx", "rx"), strict=True)
    ]
    undated = run("decode", "log.txt", "--format", "jsonl")
    today = datetime.fromtimestamp((tmp_path / "log.txt").stat().st_mtime, UTC).date()
    assert [row["time"][:21] for row in jsonl(undated.stdout)] == [
        f"{today}T14:03:22.1",
        f"{today}T14:03:22.1",
    ]
    assert "log.txt: its times have no date: the date" in undated.stderr
    assert "by the file's modification time; --date 2026-01-31 sets another" in undated.stderr


def test_a_log_with_times_becomes_a_recording(run, tmp_path: Path) -> None:
    (tmp_path / "log.txt").write_text(SSCOM)
    made = run("decode", "log.txt", "--date", "2026-01-31", "--zone", "UTC", "-o", "x.mcap")
    assert made.returncode == 0, made.stderr
    assert "2 rows, nothing malformed, 0.010 s" in run("decode", "x.mcap").stderr
    since = ("--date", "2026-01-31", "--from", "2026-01-31T14:03:22.13Z", "--format", "jsonl")
    assert len(jsonl(run("decode", "log.txt", *since).stdout)) == 1
    none = run("decode", "log.txt", "--date", "2026-01-31", "--from", "2027-01-01").stderr
    assert "log.txt: none of its 2 rows is between --from and --to; they go from" in none


@pytest.mark.parametrize("suffix", ["raw", "hex"])
def test_bytes_without_times_get_a_clock_at_the_baud(run, tmp_path: Path, suffix: str) -> None:
    frame = bytes.fromhex("AA010103E800000000EE")
    data = frame * 3 if suffix == "raw" else f"{frame.hex(' ')}\n".encode() * 3
    (tmp_path / f"x.{suffix}").write_bytes(data)
    clock = ("--start", "2026-01-31T12:00:00Z", "--baud", "9600")
    made = run("decode", f"x.{suffix}", *clock, "-o", "x.mcap")
    assert made.returncode == 0, made.stderr
    times = [row["time"] for row in jsonl(run("decode", "x.mcap", "--format", "jsonl").stdout)]
    assert [time[17:26] for time in times] == ["00.000000", "00.010416", "00.020833"]
    piped = run("decode", "-", "--format", "jsonl", *clock, stdin=data)
    assert [row["time"] for row in jsonl(piped.stdout)] == times


@pytest.mark.parametrize(("option", "value"), [("--date", "today"), ("--zone", "Nowhere")])
def test_a_day_or_zone_that_is_none(run, samples: Path, option: str, value: str) -> None:
    done = run("decode", samples / "idle.hex", option, value)
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1)
    assert value in done.stderr


def test_zone_changes_the_times_of_text_only(run, samples: Path) -> None:
    def times(form: str, *zone: str) -> list[str]:
        done = run("decode", samples / "clean.mcap", "--format", form, *zone)
        assert done.returncode == 0, done.stderr
        return re.findall(r"2026-0\S+?(?:Z|[+-]\d\d:\d\d)", done.stdout + done.stderr)

    utc = times("csv")
    for form in ("csv", "table"):
        found = times(form, "--zone", "Asia/Shanghai")
        assert found[0] == "2026-01-31T20:00:00.000350850+08:00"
        # The summary has the first time too.
        moments = [datetime.fromisoformat(f"{time[:26]}{time[29:]}") for time in found]
        assert moments == [datetime.fromisoformat(f"{time[:26]}Z") for time in utc]
    assert times("jsonl", "--zone", "Asia/Shanghai")[:-1] == utc[:-1]


@pytest.mark.parametrize(
    ("command", "shown"),
    [
        (("decode", "--format", "csv"), "2026-01-31T21:00:00.029484529+09:00"),
        (("stats",), "first      2026-01-31T21:00:00.029484529+09:00"),
        (("stats",), "until 21:00:16.529;"),
        (("findings",), "1. unanswered, motor 3, 21:00:30 to 21:00:59"),
        (
            ("check", "--expect", "count(unanswered) == 0"),
            "first at 2026-01-31T21:00:30.089133026+09",
        ),
        (
            ("check", "--expect", "count(unanswered) == 0", "--format", "junit"),
            "first at 2026-01-31T21:00:30.089133026+09",
        ),
    ],
)
def test_commands_print_times_in_the_zone(
    run, samples: Path, command: tuple[str, ...], shown: str
) -> None:
    name, *options = command
    done = run(name, samples / "motor3.mcap", *options, "--zone", "Asia/Tokyo")
    assert shown in done.stdout


@pytest.mark.parametrize(
    ("condition", "in_utc"),
    [
        ("time >= '2026-01-31 20:00:05'", "time >= '2026-01-31 12:00:05'"),
        ("time BETWEEN '20:00:03' AND '20:00:04'", "time BETWEEN '12:00:03' AND '12:00:04'"),
        ('kind = "speed" AND time < "20:00:03"', "kind = 'speed' AND time < '12:00:03'"),
        ("time > '12:00:05Z' AND port != '20:00'", "time > '12:00:05'"),
    ],
)
def test_times_in_a_filter_are_in_the_zone(run, samples: Path, condition: str, in_utc: str) -> None:
    zone = ("--zone", "Asia/Shanghai")
    words = (samples / "clean.mcap", "--filter")
    rows = run("decode", *words, condition, *zone, "--format", "jsonl").stdout
    assert rows.count("\n") > 5
    assert rows == run("decode", *words, in_utc, "--format", "jsonl").stdout
    counted = run("stats", *words, condition, *zone, "--format", "json").stdout
    assert json.loads(counted)["rows"] == rows.count("\n")


def test_time_of_any_day_needs_its_offset_where_there_is_summer_time(run, samples: Path) -> None:
    words = ("decode", samples / "clean.mcap", "--zone", "Europe/Berlin", "--filter")
    done = run(*words, "time > '12:00'")
    assert (done.returncode, done.stdout) == (2, "")
    assert "the offset of '12:00' depends on the season" in done.stderr
    assert "write it, as in '12:00:05+01:00'" in done.stderr
    assert run(*words, "time > '12:00+01:00'").returncode == 0


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


@pytest.mark.parametrize(
    "text", ["previous(time) > 1", "previous(rpm + 1) > 1", "previous(offset) > 1"]
)
def test_previous_of_other_than_a_field_is_one_line(run, samples: Path, text: str) -> None:
    done = run("decode", samples / "clean.mcap", "--filter", text)
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1)
    assert 'at character 10 of "previous(-->' in done.stderr


def test_a_log_that_swaps_the_directions_is_reported(run) -> None:
    swapped = SSCOM.replace("发→◇", "x").replace("收←◆", "发→◇").replace("x", "收←◆")
    reported = run("decode", "-", stdin=swapped).stderr
    assert (
        "stdin: 2 of 2 frames go the other way than the log says (received, header AA" in reported
    )


EXPECTED = sorted((SAMPLES / "expected").iterdir())
FORMS = {".txt": "table", ".jsonl": "jsonl", ".csv": "csv"}


def test_every_sample_is_here_in_three_forms_with_its_text() -> None:
    names = {path.name.removesuffix(".txt") for path in EXPECTED if path.suffix == ".txt"}
    stories = ("clean", "damaged", "idle", "midstream")
    assert names == {f"{story}.{form}" for story in stories for form in ("mcap", "raw", "hex")}
    assert all((SAMPLES / name).is_file() for name in names)


@pytest.mark.parametrize("expected", EXPECTED, ids=lambda path: path.name)
def test_decode_prints_what_is_expected(
    expected: Path, program: Program, environment: dict[str, str]
) -> None:
    words = ["decode", f"samples/{expected.stem}", "--format", FORMS[expected.suffix]]
    done = program.run(words, b"", ROOT, environment)
    assert (done.code, done.output) == (0, expected.read_bytes())


@pytest.mark.parametrize("name", ["clean", "damaged", "idle", "midstream"])
def test_recordings_hold_every_byte_for_the_readers_of_other_tools(name: str) -> None:
    with (SAMPLES / f"{name}.mcap").open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        decoded = [
            message
            for _, channel, _, message in reader.iter_decoded_messages()
            if channel.topic != "/fte/port"
        ]
    assert b"".join(message.raw for message in decoded) == (SAMPLES / f"{name}.raw").read_bytes()


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
    events: Sequence[PortEvent] = (),
    baud: int = 115_200,
) -> Path:
    """A recording with a chunk for every twenty rows."""
    with RecordingWriter(path, [PortFacts("p", baud)], facts or {}) as writer:
        for at in range(0, len(rows), 20):
            writer.write(in_columns(rows[at : at + 20]))
            last_ns = rows[min(at + 20, len(rows)) - 1].t_ns or 0
            while events and events[0].t_ns < last_ns:
                writer.write(in_columns(events[0]))
                events = events[1:]
            writer.flush()
    return path


def triggered(path: Path) -> Path:
    """A recording of which a trigger kept the rows 0-99, 200-299 and 400-499 of 500."""
    recorder = Recorder(
        path,
        [PortFacts("p")],
        options=RecordingOptions(trigger_window=TriggerWindow(0, 0)),
        select=lambda given: given.field("rpm")[0] // 100 % 2 == 0,
    )
    recorder.write(in_columns(rows_of(0, 500)))
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
    """Neither by `stats`, nor on the screen, nor in a copy of what is left."""
    paths = GAPS[gap](tmp_path)
    assert run("decode", *paths, "-o", "copy.mcap").returncode == 0
    for some in (paths, [tmp_path / "copy.mcap"]):
        reported = stats(run, *some)
        (port,) = reported["ports"]
        assert port["rows"] == 40
        assert port["silences"]["count"] == 2 * 19
        assert port["streams"][0]["period"]["longest_s"] == STEP / 1e9
        assert (reported["motors"][0]["unanswered"], reported["motors"][0]["neither"]) == (None, 40)
        models = viewed(some)
        assert models.statistics.ports()[0].silences.count == 2 * 19


def viewed(paths: list[Path]) -> LiveModels:
    """The models of the screen, once it has seen these recordings."""
    store = RowStore()
    models = LiveModels(store, LineSetup())
    inputs = [RecordingInput(RecordingReader(path)) for path in paths]
    for read in InputReading(inputs):
        models.add(read.rows.events, shifted(read.changes, store.next))
        store.append(read.rows)
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


def test_the_screen_takes_the_baud_from_the_recording(tmp_path: Path) -> None:
    slow = recorded(tmp_path / "a.mcap", rows_of(0, 20), baud=9600)
    assert viewed([slow]).statistics.ports()[0].baud == 9600
    said = InputReading([RecordingInput(RecordingReader(slow))], baud=1200)
    assert not [one for read in said for one in read.changes if isinstance(one.what, BaudChange)]
    assert said.source.bauds == {"p": 1200}


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
    triggered(tmp_path / "a.mcap")
    done = run("decode", "a.mcap", "-o", "copy.mcap", *options)
    assert done.returncode == 0, done.stderr
    for one, (rows, first, last) in zip(
        RecordingReader(tmp_path / "copy.mcap").gaps(), expected, strict=True
    ):
        assert one.rows == rows
        assert one.reason == "they are outside the trigger window"
        assert abs((one.start_ns or 0) - (START + first * STEP)) <= STEP
        assert abs((one.end_ns or 0) - (START + last * STEP)) <= STEP


def test_a_selection_is_reported(run, tmp_path: Path) -> None:
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


def test_only_the_filters_of_the_recording_explain_that_it_is_empty(run, tmp_path: Path) -> None:
    recorded(tmp_path / "empty.mcap", [])
    summary = run("decode", "empty.mcap", "--filter", "rpm < 50", "-o", "none.mcap").stderr
    assert summary.startswith("0 rows; nothing came")
    summary = run("decode", "none.mcap", "--filter", "rpm > 10").stderr
    assert summary == "0 rows; nothing was selected when the recording was written: rpm < 50\n"


def test_a_gap_of_unknown_length_is_reported_as_such(run, tmp_path: Path) -> None:
    paths = GAPS["another capture"](tmp_path)
    assert run("decode", *paths, "-o", "copy.mcap").returncode == 0
    times = START + 19 * STEP + 1, START + 40 * STEP - 1
    between = Gap(GapKind.LEFT_OUT, None, *times, "another recording begins here")
    assert RecordingReader(tmp_path / "copy.mcap").gaps() == [between]
    words = "left out   an unknown number of rows in 1 place: another recording begins here\n"
    assert words in run("stats", "copy.mcap").stdout
    assert stats(run, "copy.mcap")["left_out"][0]["rows"] is None


def test_raw_bytes_are_appended_to_redirected_output(tmp_path, environment):
    with (tmp_path / "out").open("wb") as out:
        out.write(b"before")
    words = ("decode", str(SAMPLES / "clean.mcap"), "--format", "raw", "-o", "-")
    with (
        (tmp_path / "out").open("ab") as out,
        started(environment, tmp_path, *words, stdout=out.fileno()) as process,
    ):
        assert ended(process)[0] == 0
    expected = b"before" + (SAMPLES / "clean.raw").read_bytes()
    assert (tmp_path / "out").read_bytes() == expected


@pytest.mark.parametrize(
    ("name", "columns"),
    crossed(
        ["clean.mcap", "idle.raw"], [("time", "motor", "rpm"), ("raw",), ("unanswered", "port")]
    ),
)
def test_columns_are_chosen_and_ordered(
    run, samples: Path, name: str, columns: tuple[str, ...]
) -> None:
    chosen = "--columns", ",".join(columns)
    whole = jsonl(run("decode", samples / name, "--format", "jsonl").stdout)
    lines = jsonl(run("decode", samples / name, "--format", "jsonl", *chosen).stdout)
    assert [[*line.items()] for line in lines] == [
        [(column, row[column]) for column in columns] for row in whole
    ]
    table = run("decode", samples / name, "--format", "csv").stdout
    expected = [{c: row[c] for c in columns} for row in csv.DictReader(io.StringIO(table))]
    found = run("decode", samples / name, *chosen)  # CSV without a format
    assert [*csv.DictReader(io.StringIO(found.stdout))] == expected
    assert found.stdout.splitlines()[0] == ",".join(columns)


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("--columns", "time,xyz"), "unknown column 'xyz'; use time, port"),
        (("--columns", "time,speed"), "unknown column 'speed'; did you mean rpm?"),
        (("--columns", "time,motr"), "unknown column 'motr'; did you mean motor?"),
        (("--columns", ""), "unknown column ''; use time, port"),
        (("--columns", "rpm,rpm"), "--columns names rpm twice"),
        (("--columns", "rpm", "-o", "x.parquet"), "parquet has its own"),
        (("--columns", "rpm", "--format", "table"), "table has its own"),
    ],
)
def test_columns_that_cannot_be_written_are_refused(
    run, samples: Path, tmp_path: Path, words: tuple[str, ...], told: str
) -> None:
    done = run("decode", samples / "idle.raw", *words)
    assert (done.returncode, done.stdout) == (2, "")
    assert told in done.stderr
    assert done.stderr.count("\n") == 1
    assert list(tmp_path.iterdir()) == []
