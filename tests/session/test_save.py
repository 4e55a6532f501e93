"""Saving rows in every format."""

from __future__ import annotations

import csv
import io
import json
import os
import resource
from pathlib import Path

import polars as pl
import pytest

from fte_sniff.analysis.dataframe import TABLE_SCHEMA, table_frame
from fte_sniff.errors import FileError, UsageError
from fte_sniff.formats.log import Log
from fte_sniff.formats.writers import FORMAT_BY_SUFFIX, OutputFormat
from fte_sniff.protocol.columns import COLUMN_BY_NAME, iso_time, spaced_hex
from fte_sniff.protocol.items import Gap, GapKind
from fte_sniff.protocol.rows import Row
from fte_sniff.protocol.spec import KIND_BY_NAME, Fault, encode
from fte_sniff.recording.metadata import Selection
from fte_sniff.recording.output_file import Existing
from fte_sniff.recording.reader import Recording
from fte_sniff.recording.writer import RecordingWriter
from fte_sniff.session.framing import raw_chunks
from fte_sniff.session.save import (
    ExportSource,
    exported,
    replace_text,
    typed_path,
)
from tests.recording.conftest import entries_in
from tests.support.columns import rows_from

NOON_NS = 1_769_860_800_000_000_000
PORTS = ("/dev/ttyUSB0", "b")
ORIGIN = ExportSource(PORTS)


def rows(count: int = 40) -> list[Row]:
    made: list[Row] = []
    for number in range(count):
        raw = encode(KIND_BY_NAME["speed"], {"motor": 1 + number % 4, "rpm": number})
        made.append(Row(PORTS[0], 10 * number, raw, NOON_NS + number))
    return [*made, Row("b", 0, b"\x01\x02\x03", NOON_NS + count, (Fault.NOISE,), framed=False)]


def saved(path: Path, taken: list[Row]) -> Path:
    with exported(path, FORMAT_BY_SUFFIX[path.suffix], ORIGIN) as write:
        for at in range(0, len(taken), 7):
            write(rows_from(taken[at : at + 7]))
    return path


@pytest.mark.parametrize("suffix", FORMAT_BY_SUFFIX)
def test_every_form_holds_the_rows_and_leaves_nothing_beside(tmp_path: Path, suffix: str) -> None:
    taken = rows()
    path = saved(tmp_path / f"rows{suffix}", taken)
    assert [one.name for one in tmp_path.iterdir()] == [path.name]
    whole = b"".join(row.raw for row in taken)
    match suffix:
        case ".csv":
            lines = list(csv.DictReader(io.StringIO(path.read_text("utf-8"))))
            assert list(lines[0]) == list(COLUMN_BY_NAME)
            assert [line["raw"] for line in lines] == [row.raw.hex().upper() for row in taken]
        case ".jsonl":
            found = [json.loads(line) for line in path.read_text("utf-8").splitlines()]
            assert [one["time"] for one in found] == [iso_time(row.t_ns or 0) for row in taken]
        case ".parquet":
            assert pl.read_parquet(path).equals(table_frame(rows_from(taken)))
            assert pl.read_parquet_schema(path) == TABLE_SCHEMA
        case ".mcap":
            assert entries_in(path) == taken
        case ".txt":
            text = path.read_text("utf-8")
            assert all(spaced_hex(row.raw) in text for row in taken)
            assert "port" in text
        case ".hex":
            assert b"".join(chunk.data for chunk in Log(str(path)).chunks()) == whole
        case ".pcapng":
            data = path.read_bytes()
            assert all(row.raw in data for row in taken)
        case _:
            assert b"".join(chunk.data for chunk in raw_chunks(path, "p")) == whole


@pytest.mark.parametrize("suffix", FORMAT_BY_SUFFIX)
def test_no_rows_make_a_file_too(tmp_path: Path, suffix: str) -> None:
    assert saved(tmp_path / f"none{suffix}", []).exists()


def test_an_existing_file_is_named_and_replaced_only_with_force(tmp_path: Path) -> None:
    path = tmp_path / "rows.csv"
    path.write_text("mine")
    with pytest.raises(FileError, match=r"rows.csv exists already; name another, or .* rows.csv!"):
        typed_path(str(path))
    found, existing = typed_path(f"{path}!")
    assert found == path
    with exported(path, FORMAT_BY_SUFFIX[".csv"], ORIGIN, existing):
        assert path.read_text() == "mine"
    assert path.read_text().startswith("time,port")


@pytest.mark.parametrize("name", ["a.mcap", "a.mcap!", "./a.mcap!", "link.mcap!", "hard.mcap !"])
def test_a_file_that_rows_come_from_is_never_replaced(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    monkeypatch.chdir(tmp_path)
    source = tmp_path / "a.mcap"
    source.write_text("mine")
    Path("link.mcap").symlink_to(source)
    Path("hard.mcap").hardlink_to(source)
    with pytest.raises(FileError, match=r"is the file shown here; name another$"):
        typed_path(name, ["gone.mcap", str(source)])
    typed_path("b.mcap", ["gone.mcap", str(source)])


def test_a_file_that_came_meanwhile_is_not_replaced(tmp_path: Path) -> None:
    path = tmp_path / "rows.csv"
    with (
        pytest.raises(FileError, match=r"rows.csv exists already; name another"),
        exported(path, FORMAT_BY_SUFFIX[".csv"], ORIGIN, Existing.REFUSE),
    ):
        path.write_text("mine")
    assert [one.name for one in tmp_path.iterdir()] == [path.name]
    assert path.read_text() == "mine"


@pytest.mark.parametrize(
    ("name", "error", "said"),
    [
        ("rows", UsageError, "the extension selects the format; use one of .csv .jsonl"),
        ("rows.pdf", UsageError, "the extension selects"),
        ("", UsageError, "the extension selects"),
        ("folder.csv", FileError, "exists already; name another"),
    ],
)
def test_an_unwritable_output_is_reported_before(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, error: type[Exception], said: str
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("folder.csv").mkdir()
    with pytest.raises(error, match=said):
        typed_path(name)


@pytest.mark.parametrize("suffix", FORMAT_BY_SUFFIX)
def test_an_export_replaces_no_pipe_and_no_link(tmp_path: Path, suffix: str) -> None:
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "target").write_text("precious")
    (tmp_path / "link").symlink_to("target")
    (tmp_path / "dangling").symlink_to("nothing")
    form = FORMAT_BY_SUFFIX[suffix]
    for name, said in (
        ("pipe", "pipe is not a regular file; name another"),
        ("link", "link is a link; name the file itself"),
        ("dangling", "dangling is a link; name the file itself"),
        ("nowhere/rows", "its folder does not exist"),
    ):
        with pytest.raises(FileError, match=said), exported(tmp_path / name, form, ORIGIN):
            pass
    assert (tmp_path / "target").read_text() == "precious"
    assert {path.name for path in tmp_path.iterdir()} == {"pipe", "link", "target", "dangling"}


def test_a_link_that_appears_meanwhile_is_not_followed(tmp_path: Path) -> None:
    (tmp_path / "target").write_text("precious")
    with (
        pytest.raises(FileError, match="new is a link"),
        exported(tmp_path / "new", FORMAT_BY_SUFFIX[".csv"], ORIGIN),
    ):
        (tmp_path / "new").symlink_to("target")
    assert (tmp_path / "target").read_text() == "precious"
    assert {path.name for path in tmp_path.iterdir()} == {"new", "target"}


def test_a_small_text_replaces_only_a_regular_file(tmp_path: Path) -> None:
    replace_text(tmp_path / "new folder" / "a.json", "1")
    replace_text(tmp_path / "new folder" / "a.json", "2")
    assert (tmp_path / "new folder" / "a.json").read_text() == "2"
    assert (tmp_path / "new folder" / "a.json").stat().st_mode & 0o777 == 0o600
    (tmp_path / "device").symlink_to("/dev/null")
    with pytest.raises(FileError, match="device is a link; name the file itself"):
        replace_text(tmp_path / "device", "1")
    assert (tmp_path / "device").is_symlink()


@pytest.mark.parametrize("suffix", FORMAT_BY_SUFFIX)
def test_what_is_abandoned_leaves_nothing(tmp_path: Path, suffix: str) -> None:
    unfinished = exported(tmp_path / f"rows{suffix}", FORMAT_BY_SUFFIX[suffix], ORIGIN)
    unfinished.__enter__()(rows_from(rows()))
    assert list(tmp_path.iterdir())
    error = KeyboardInterrupt()
    assert not unfinished.__exit__(KeyboardInterrupt, error, None)
    assert not list(tmp_path.iterdir())


def test_a_recording_takes_no_row_without_a_time(tmp_path: Path) -> None:
    with (
        pytest.raises(FileError, match=r"offset 0, has no time since 1970.*write another format"),
        exported(tmp_path / "rows.mcap", OutputFormat.MCAP, ORIGIN) as write,
    ):
        write(rows_from([Row("b", 0, b"\x01", None, (Fault.NOISE,), framed=False)]))
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("suffix", FORMAT_BY_SUFFIX)
def test_a_file_that_cannot_grow_is_one_line_and_leaves_nothing(
    tmp_path: Path, suffix: str
) -> None:
    taken = rows(20_000)
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (4096, hard))
    try:
        with pytest.raises(FileError, match=r"rows.*File too large"):
            saved(tmp_path / f"rows{suffix}", taken)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert not list(tmp_path.iterdir())


def test_a_recording_keeps_what_is_known_beside_its_rows(tmp_path: Path) -> None:
    gaps = [
        Gap(GapKind.LEFT_OUT, 7, NOON_NS + 1, NOON_NS + 2, "why"),
        Gap(GapKind.LEFT_OUT, None, NOON_NS, NOON_NS),
    ]
    origin = ExportSource(PORTS, {"b": 9600}, [Selection("motor = 1", 99)])
    with exported(tmp_path / "rows.mcap", OutputFormat.MCAP, origin) as write:
        for item in (rows_from(rows()), *gaps):
            write(item)
    reader = Recording(tmp_path / "rows.mcap")
    assert (reader.gaps(), reader.selections()) == (gaps, [Selection("motor = 1", 99)])
    assert {port.name: port.baud for port in reader.ports} == {PORTS[0]: None, "b": 9600}


def test_a_file_that_is_being_recorded_is_not_replaced(tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    writer: RecordingWriter | None = None
    for _ in range(2):
        with (
            pytest.raises(FileError, match="being recorded to by another program"),
            exported(path, OutputFormat.MCAP, ORIGIN),
        ):
            writer = writer or RecordingWriter(path, [])
    assert writer is not None
    writer.flush()
    assert not writer.is_gone
    writer.close()
    assert [one.name for one in tmp_path.iterdir()] == ["x.mcap"]
