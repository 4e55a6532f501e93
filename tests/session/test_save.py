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
from fte_sniff.formats.writers import FORMAT_BY_SUFFIX
from fte_sniff.protocol.columns import COLUMN_BY_NAME, iso_time, spaced_hex
from fte_sniff.protocol.items import Gap, GapKind
from fte_sniff.protocol.rows import Row, Rows
from fte_sniff.protocol.spec import KIND_BY_NAME, Fault, encode
from fte_sniff.recording.metadata import Selection
from fte_sniff.recording.reader import Recording
from fte_sniff.recording.writer import RecordingWriter
from fte_sniff.session.framing import raw_chunks
from fte_sniff.session.save import (
    ExportSource,
    FileExport,
    SaveTarget,
    replace_text,
)
from tests.recording.conftest import entries_in

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
    saving = SaveTarget.parse(str(path)).open(ORIGIN)
    for at in range(0, len(taken), 7):
        saving.write(Rows.of(taken[at : at + 7]))
    saving.close()
    assert saving.rows == len(taken)
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
            assert pl.read_parquet(path).equals(table_frame(Rows.of(taken)))
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
        SaveTarget.parse(str(path))
    saving = SaveTarget.parse(f"{path}!").open(ORIGIN)
    assert path.read_text() == "mine"
    saving.close()
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
        SaveTarget.parse(name, ["gone.mcap", str(source)])
    SaveTarget.parse("b.mcap", ["gone.mcap", str(source)])


def test_a_file_that_came_meanwhile_is_not_replaced(tmp_path: Path) -> None:
    path = tmp_path / "rows.csv"
    saving = SaveTarget.parse(str(path)).open(ORIGIN)
    path.write_text("mine")
    with pytest.raises(FileError, match=r"rows.csv exists already; name another"):
        saving.close()
    assert [one.name for one in tmp_path.iterdir()] == [path.name]
    assert path.read_text() == "mine"


@pytest.mark.parametrize(
    ("name", "error", "said"),
    [
        ("rows", UsageError, "the extension selects the format; use one of .csv .jsonl"),
        ("rows.pdf", UsageError, "the extension selects"),
        ("", UsageError, "the extension selects"),
        ("nowhere/rows.csv", FileError, "does not exist; name a folder that does"),
        ("folder.csv", FileError, "exists already; name another"),
        ("~nobody-here/rows.csv", FileError, "does not exist"),
    ],
)
def test_an_unwritable_output_is_reported_before(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, error: type[Exception], said: str
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("folder.csv").mkdir()
    with pytest.raises(error, match=said):
        SaveTarget.parse(name)


@pytest.mark.parametrize("suffix", FORMAT_BY_SUFFIX)
def test_an_export_replaces_no_pipe_and_no_link(tmp_path: Path, suffix: str) -> None:
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "target").write_text("precious")
    (tmp_path / "link").symlink_to("target")
    (tmp_path / "dangling").symlink_to("nothing")
    form = FORMAT_BY_SUFFIX[suffix]
    with pytest.raises(FileError, match="pipe is not a regular file; name another"):
        FileExport(tmp_path / "pipe", form, ORIGIN)
    for name in ("link", "dangling"):
        with pytest.raises(FileError, match=f"{name} is a link; name the file itself"):
            FileExport(tmp_path / name, form, ORIGIN)
    assert (tmp_path / "target").read_text() == "precious"
    assert {path.name for path in tmp_path.iterdir()} == {"pipe", "link", "target", "dangling"}


def test_a_link_that_appears_meanwhile_is_not_followed(tmp_path: Path) -> None:
    (tmp_path / "target").write_text("precious")
    export = FileExport(tmp_path / "new", FORMAT_BY_SUFFIX[".csv"], ORIGIN)
    (tmp_path / "new").symlink_to("target")
    with pytest.raises(FileError, match="new is a link"):
        export.close()
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
    saving = SaveTarget.parse(str(tmp_path / f"rows{suffix}")).open(ORIGIN)
    saving.write(Rows.of(rows()))
    saving.abandon()
    assert not list(tmp_path.iterdir())


def test_a_recording_takes_no_row_without_a_time(tmp_path: Path) -> None:
    saving = SaveTarget.parse(str(tmp_path / "rows.mcap")).open(ORIGIN)
    with pytest.raises(FileError, match=r"offset 0, has no time since 1970.*write another format"):
        saving.write(Rows.of([Row("b", 0, b"\x01", None, (Fault.NOISE,), framed=False)]))
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("suffix", FORMAT_BY_SUFFIX)
def test_a_file_that_cannot_grow_is_one_line_and_leaves_nothing(
    tmp_path: Path, suffix: str
) -> None:
    saving = SaveTarget.parse(str(tmp_path / f"rows{suffix}")).open(ORIGIN)
    taken = rows(20_000)
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (4096, hard))
    try:
        with pytest.raises(FileError, match=r"rows.*File too large"):
            _write_all(saving, taken)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert not list(tmp_path.iterdir())


def _write_all(saving: FileExport, taken: list[Row]) -> None:
    saving.write(Rows.of(taken))
    saving.close()


def test_a_recording_keeps_what_is_known_beside_its_rows(tmp_path: Path) -> None:
    gaps = [
        Gap(GapKind.LEFT_OUT, 7, NOON_NS + 1, NOON_NS + 2, "why"),
        Gap(GapKind.LEFT_OUT, None, NOON_NS, NOON_NS),
    ]
    origin = ExportSource(PORTS, {"b": 9600}, gaps, [Selection("motor = 1", 99)])
    saving = SaveTarget.parse(str(tmp_path / "rows.mcap")).open(origin)
    saving.write(Rows.of(rows()))
    saving.close()
    reader = Recording(tmp_path / "rows.mcap")
    assert (reader.gaps(), reader.selections()) == (gaps, [Selection("motor = 1", 99)])
    assert {port.name: port.baud for port in reader.ports} == {PORTS[0]: None, "b": 9600}


def test_a_file_that_is_being_recorded_is_not_replaced(tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    target = SaveTarget.parse(f"{path}!")
    saving = target.open(ORIGIN)
    with RecordingWriter(path, []) as writer:
        with pytest.raises(FileError, match="being recorded to by another program"):
            saving.close()
        with pytest.raises(FileError, match="being recorded to by another program"):
            target.open(ORIGIN)
        writer.flush()
    assert not writer.is_gone
    assert [one.name for one in tmp_path.iterdir()] == ["x.mcap"]
