"""A recording of which no row can be read is an error; an empty capture is not."""

import json
import os
from collections.abc import Callable
from pathlib import Path
from subprocess import CompletedProcess

import pytest

from fte_sniff.recording.metadata import PortFacts
from fte_sniff.recording.writer import RecordingWriter
from tests.recording.conftest import some_rows
from tests.support.columns import entries
from tests.torture.damage import records

Run = Callable[..., CompletedProcess[str]]

CHUNK, DATA_END = 6, 15
PORT = PortFacts("/dev/ttyUSB0", 115_200)
COMMANDS = (
    ("decode", "x.mcap"),
    ("decode", "x.mcap", "--format", "jsonl", "-o", "x.jsonl"),
    ("decode", "x.mcap", "--from", "2020-01-01T00:00:00Z"),
    ("stats", "x.mcap"),
    ("check", "x.mcap", "--expect", "count(malformed) == 0"),
)


def _record(folder: Path, rows: int) -> bytes:
    with RecordingWriter(folder / "x.mcap", [PORT]) as writer:
        writer.write(*entries(some_rows(rows)))
    return (folder / "x.mcap").read_bytes()


def _without_any_chunk(content: bytes) -> bytes:
    """The file with a byte damaged in its only chunk, and without its end."""
    (start, end), *_ = ((start, end) for opcode, start, end in records(content) if opcode == CHUNK)
    damaged = bytearray(content[:end])
    damaged[(start + end) // 2] ^= 1
    return bytes(damaged)


@pytest.mark.parametrize("command", COMMANDS, ids=lambda command: " ".join(command))
def test_no_row_of_a_recording_with_data_is_a_file_error(
    run: Run, tmp_path: Path, command: tuple[str, ...]
) -> None:
    content = _record(tmp_path, 30)
    (tmp_path / "x.mcap").write_bytes(_without_any_chunk(content))
    done = run(*command)
    assert done.returncode == 4, done.stderr
    assert "x.mcap: no row in it could be read, although it has data: " in done.stderr
    assert "Traceback" not in done.stderr


def test_nothing_is_repaired_of_a_recording_without_a_readable_row(
    run: Run, tmp_path: Path
) -> None:
    content = _record(tmp_path, 30)
    (tmp_path / "x.mcap").write_bytes(_without_any_chunk(content))
    done = run("repair", "x.mcap")
    assert done.returncode == 4, done.stderr
    assert len(done.stderr.splitlines()) == 1
    assert not (tmp_path / "x-repaired.mcap").exists()


def test_the_other_files_are_read_too(run: Run, tmp_path: Path) -> None:
    content = _record(tmp_path, 30)
    (tmp_path / "y.mcap").write_bytes(content)
    (tmp_path / "x.mcap").write_bytes(_without_any_chunk(content))
    done = run("decode", "x.mcap", "y.mcap", "--format", "jsonl")
    assert done.returncode == 4, done.stderr
    assert len(done.stdout.splitlines()) == 30


def test_two_recordings_in_one_file_are_reported(run, samples: Path, tmp_path: Path) -> None:
    """The second one's channels replace those of the first, and so its port's name."""
    names, joined = ("clean.mcap", "motor3.mcap"), tmp_path / "joined.mcap"
    joined.write_bytes(b"".join((samples / name).read_bytes() for name in names))
    done = run("decode", joined, "--format", "csv")
    rows = sum(len(run("decode", samples / one, "--format", "csv").stdout.split()) for one in names)
    assert len(done.stdout.split()) == rows - 1
    assert "they are behind the end of the recording" in done.stderr


def test_port_events_are_no_rows(run: Run, samples: Path, tmp_path: Path) -> None:
    content = bytearray((samples / "midstream.mcap").read_bytes())
    content[3032] ^= 1  # in the chunk of all rows; that of the events is whole
    (tmp_path / "x.mcap").write_bytes(content)
    done = run("decode", "x.mcap")
    assert done.returncode == 4, done.stderr
    assert "x.mcap: no row in it could be read" in done.stderr


def test_name_that_is_not_utf_8_is_shown_escaped(run: Run, samples: Path, tmp_path: Path) -> None:
    name = tmp_path / os.fsdecode(b"m\xff.mcap")
    name.write_bytes((samples / "clean.mcap").read_bytes())
    done = run("stats", os.fspath(name), "--format", "json")
    assert done.returncode == 0, done.stderr
    (file,) = json.loads(done.stdout)["files"]
    assert file["name"] == f"{tmp_path}/m\\udcff.mcap"
