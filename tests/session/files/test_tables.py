"""`fte_sniff.scan` and `fte_sniff.read`: recordings as tables, their promise and their bounds."""

import re
import shutil
import subprocess
import sys
import warnings
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from pathlib import Path

import polars as pl
import pytest
from hypothesis import given
from hypothesis import strategies as st
from polars.exceptions import ComputeError

import fte_sniff
from fte_sniff.analysis.dataframe import TABLE_SCHEMA
from fte_sniff.errors import FileError, RecordingWarning
from fte_sniff.protocol.columns import record
from fte_sniff.protocol.framer import Framer
from fte_sniff.protocol.items import Chunk
from fte_sniff.protocol.rows import Row, Rows
from fte_sniff.protocol.spec import Fault
from fte_sniff.recording.metadata import PortFacts
from fte_sniff.recording.reader import Recording
from fte_sniff.recording.writer import RecordingWriter
from fte_sniff.session.scan import read, scan
from tests.analysis.captures import segments
from tests.examples import examples
from tests.recording.conftest import some_rows
from tests.support.columns import entries, fed, read_rows, rows_from, without_facts
from tests.support.recorded_rows import write_recording
from tests.torture.damage import CHUNK, records
from tests.waiting import BOUND_S

SAMPLES = Path(__file__).parents[3] / "samples"
RECORDINGS = sorted(SAMPLES.glob("*.mcap"))
FRAME = bytes.fromhex("AA 01 01 03 E8 00 00 00 00 EE")
START = 1_770_000_000 * 10**9


def _records(frame: pl.DataFrame) -> list[dict[str, object]]:
    """The frame as the row contract's dicts, times in nanoseconds."""
    return frame.with_columns(pl.col("time").dt.epoch("ns")).to_dicts()


def _rows(path: Path) -> list[Row]:
    """The rows with their facts."""
    (table,) = segments([rows_from(read_rows(path))])
    return [*table.with_facts]


@pytest.mark.parametrize("path", RECORDINGS, ids=lambda path: path.name)
def test_a_table_has_the_values_of_the_rows(path: Path) -> None:
    frame = fte_sniff.read(path)
    assert frame.schema == TABLE_SCHEMA
    assert _records(frame) == [record(row) for row in _rows(path)]


def test_each_column_alone_is_that_of_the_whole() -> None:
    path = SAMPLES / "damaged.mcap"
    whole = fte_sniff.read(path)
    for name in TABLE_SCHEMA:
        assert fte_sniff.scan(path).select(name).collect().equals(whole.select(name)), name


@pytest.mark.parametrize(
    "wanted",
    [
        pl.col("motor") == 1,
        pl.col("rpm") > 500,
        pl.col("faults").list.len() > 0,
        pl.col("kind") == "speed_feedback",
        pl.col("length") > 10,
        pl.lit(True),
        pl.lit(False),
        pl.col("time") < pl.datetime(2026, 1, 31, 12, 0, 5, time_zone="UTC"),
    ],
    ids=str,
)
def test_a_filter_gives_the_same_before_and_after_reading(wanted: pl.Expr) -> None:
    path = SAMPLES / "damaged.mcap"
    asked = fte_sniff.scan(path).filter(wanted).select("offset", "raw")
    expected = fte_sniff.read(path).filter(wanted).select("offset", "raw")
    assert asked.collect().equals(expected)
    assert asked.collect(engine="streaming").sort("offset").equals(expected.sort("offset"))
    assert asked.head(7).collect().equals(expected.head(7))


_Frame = pl.LazyFrame | pl.DataFrame
_FILTERS = [
    pl.col("motor") == 3,
    pl.col("length") > 0,
    pl.col("offset") % 20 == 0,
    *(pl.col("time") >= datetime(2026, 1, 31, 12, 0, at, tzinfo=UTC) for at in (1, 10, 19)),
]


@st.composite
def _steps(draw: st.DrawFn) -> Callable[[_Frame], _Frame]:
    rows = draw(st.integers(0, 1300))
    columns = ["time", "motor", "offset", "length"]
    return draw(
        st.sampled_from(
            [
                lambda table: table.head(rows),
                lambda table: table.tail(rows),
                lambda table: table.slice(rows // 2, rows),
                lambda table: table.slice(-rows, rows // 3),
                lambda table: table.select(columns),
                *(lambda table, by=by: table.filter(by) for by in _FILTERS),
            ]
        )
    )


@pytest.fixture(scope="module")
def two_files(tmp_path_factory: pytest.TempPathFactory) -> tuple[pl.LazyFrame, pl.DataFrame]:
    """Two recordings, each of several chunks, some of which end before a filter's time."""
    rows = _rows(SAMPLES / "clean.mcap")
    folders = [tmp_path_factory.mktemp(name) for name in ("first", "second")]
    parts = (rows[:500], rows[500:])
    paths = [_recording_by_chunks(*given) for given in zip(folders, parts, strict=True)]
    return fte_sniff.scan(paths), fte_sniff.read(paths)


@examples(40)
@given(steps=st.lists(_steps(), min_size=1, max_size=5))
def test_a_query_gives_what_the_same_steps_give_of_the_whole(
    two_files: tuple[pl.LazyFrame, pl.DataFrame], steps: list[Callable[[_Frame], _Frame]]
) -> None:
    """The first rows of a filter's are not the filter's of the first rows."""
    lazy, whole = two_files
    for step in steps:
        lazy, whole = step(lazy), step(whole)
    assert lazy.collect().equals(whole)


def test_a_folder_and_a_pattern_come_in_order_of_time(tmp_path: Path) -> None:
    late, early = tmp_path / "a.mcap", tmp_path / "b.mcap"
    rows = _rows(SAMPLES / "clean.mcap")
    for path, part in ((late, rows[600:]), (early, rows[:600])):
        with RecordingWriter(path, [PortFacts("p")]) as writer:
            writer.write(*entries(part))
    offsets = [row.offset for row in rows]
    for paths in (tmp_path, tmp_path / "*.mcap", f"{tmp_path}/[ab].mcap", [late, early]):
        assert fte_sniff.read(paths)["offset"].to_list() == offsets
    assert fte_sniff.scan(tmp_path).head(3).collect()["offset"].to_list() == offsets[:3]


@pytest.mark.parametrize(
    ("name", "reported"),
    [
        ("absent.mcap", "no such file"),
        ("", "no file matches *.mcap"),
        ("*.mcap", "no file matches"),
        ("text.mcap", "is not an MCAP recording"),
    ],
)
def test_an_unreadable_file_is_reported_at_once(tmp_path: Path, name: str, reported: str) -> None:
    if name == "text.mcap":
        (tmp_path / name).write_text("AA 01 and so on")
    for use in (fte_sniff.scan, fte_sniff.read):
        with pytest.raises(FileError) as caught:
            use(tmp_path / name)
        assert reported in str(caught.value)


def test_a_recording_without_rows_is_an_empty_table(tmp_path: Path) -> None:
    path = tmp_path / "idle.mcap"
    RecordingWriter(path, [PortFacts("p")]).close()
    assert fte_sniff.read(path).schema == TABLE_SCHEMA
    assert fte_sniff.read(path).height == 0
    assert fte_sniff.scan(path).collect().height == 0


def test_a_damaged_recording_is_read_with_a_warning_that_names_the_loss(tmp_path: Path) -> None:
    whole = (SAMPLES / "clean.mcap").read_bytes()
    cut, flipped = tmp_path / "cut.mcap", tmp_path / "flipped.mcap"
    cut.write_bytes(whole[: len(whole) // 2])
    middle = len(whole) // 2
    flipped.write_bytes(whole[:middle] + bytes([whole[middle] ^ 1]) + whole[middle + 1 :])
    for path in (cut, flipped):
        reader = Recording(path)
        items = [item for item in reader.items() if isinstance(item, Rows)]
        rows = without_facts(record(row) for own in items for row in own)
        assert len(rows) < len(_rows(SAMPLES / "clean.mcap"))
        lost = reader.losses
        for use in (fte_sniff.read, lambda file: fte_sniff.scan(file).collect()):
            with pytest.warns(fte_sniff.RecordingWarning) as caught:
                assert without_facts(_records(use(path))) == rows
            (reported,) = (str(warning.message) for warning in caught)
            assert reported.startswith(f"{path}: ")
            assert len(reported.splitlines()) == 1
            assert all(loss in reported for loss in lost)
    with pytest.warns(fte_sniff.RecordingWarning) as caught:
        fte_sniff.read([cut, SAMPLES / "clean.mcap", flipped])
    assert [warning.filename for warning in caught] == [__file__, __file__]


def test_importing_the_package_loads_neither_numpy_nor_polars() -> None:
    program = (
        "import sys, fte_sniff; assert 'scan' in fte_sniff.__all__; "
        "print([name for name in ('numpy', 'polars', 'mcap') if name in sys.modules])"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True, timeout=BOUND_S
    )
    assert done.stdout.strip() == "[]"


def test_the_example_runs(tmp_path: Path) -> None:
    for path in (SAMPLES / "tables.py", SAMPLES / "damaged.mcap"):
        shutil.copy(path, tmp_path)
    done = subprocess.run(
        [sys.executable, "tables.py"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=True,
        timeout=BOUND_S,
    )
    assert "motor" in done.stdout
    assert done.stdout.endswith("rows in damaged.parquet\n")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["damaged.mcap", "tables.py"]


def test_the_first_example_of_the_documentation_shows_no_motor_that_does_not_exist(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    sound, flipped = (f"55 01 {motor} 03 E8 00 00 00 0F EE" for motor in ("01", "41"))
    raw = bytes.fromhex(f"{sound} {flipped} {sound}")
    framer = Framer("p")
    rows = fed(framer, Chunk("p", 10**18, raw)) + list(framer.finish())
    assert [row.faults for row in rows] == [(), (Fault.BAD_MOTOR,), ()]
    (tmp_path / "logs").mkdir()
    batch = rows_from(rows)
    write_recording(tmp_path / "logs/x.mcap", [PortFacts("p")], [batch])
    (tmp_path / "capture.mcap").write_bytes((tmp_path / "logs/x.mcap").read_bytes())
    page = (SAMPLES.parent / "docs/python.md").read_text("utf-8")
    monkeypatch.chdir(tmp_path)
    exec(page.partition("```python\n")[2].partition("```")[0], {})
    printed = capsys.readouterr().out
    assert re.findall(r"(\d+)\s+┆ 1000", printed) == ["1"]


def test_chunks_before_the_earliest_time_are_passed_over(tmp_path: Path) -> None:
    """The first chunk is damaged, and a query for what comes after it neither sees nor says it."""
    rows = _rows(SAMPLES / "clean.mcap")
    path = _recording_by_chunks(tmp_path, rows)
    start = datetime.fromtimestamp(rows[500].t_ns // 1000 / 1e6, UTC)
    content = bytearray(path.read_bytes())
    content[content.index(b"zstd") + 40] ^= 0xFF
    path.write_bytes(content)
    found = fte_sniff.scan(path, start=start).collect()
    assert without_facts(_records(found)) == without_facts(map(record, rows[500:]))
    with pytest.warns(fte_sniff.RecordingWarning):
        fte_sniff.scan(path, end=start).collect()


def _recording_by_chunks(folder: Path, rows: list[Row]) -> Path:
    from fte_sniff.recording.metadata import PortFacts
    from fte_sniff.recording.writer import RecordingWriter

    path = folder / "chunks.mcap"
    with RecordingWriter(path, [PortFacts("p")]) as writer:
        for start in range(0, len(rows), 100):
            writer.write(*entries(rows[start : start + 100]))
            writer.flush()
    return path


def _robots(folder: Path) -> list[Path]:
    """Recordings of two robots, an hour apart, each with a port of its own."""
    paths = []
    for robot in (7, 8):
        paths.append(folder / f"robot={robot}" / "site=a%20b" / "a.mcap")
        paths[-1].parent.mkdir(parents=True)
        rows = [
            Row(f"p{robot}", 10 * at, FRAME, START + robot * 3600 * 10**9 + at * 10**6)
            for at in range(100)
        ]
        write_recording(paths[-1], [PortFacts(f"p{robot}")], [rows_from(rows)])
    return paths


def test_the_columns_are_those_of_the_contract_unless_more_are_asked_for(tmp_path: Path) -> None:
    paths = _robots(tmp_path)
    assert scan(paths).collect_schema().names() == list(TABLE_SCHEMA)
    table = scan(paths, file_column=True)
    assert table.collect_schema().names() == [*TABLE_SCHEMA, "file"]
    found = table.group_by("file").len().sort("file").collect()
    assert found.rows() == [(str(paths[0]), 100), (str(paths[1]), 100)]
    assert table.drop("file").collect().equals(read(paths))
    robot = pl.col("file").str.extract(r"robot=(\d+)")
    assert table.select(robot).collect()["file"].to_list() == ["7"] * 100 + ["8"] * 100
    assert table.filter(robot == "8").select("offset").head(3).collect().height == 3


_MICROSECONDS = st.none() | st.integers(-2, 12)


_ENTRIES = st.lists(st.tuples(st.sampled_from("ab"), st.integers(0, 10)), max_size=6)


@examples(20)
@given(
    files=st.lists(st.tuples(st.booleans(), _ENTRIES), min_size=1, max_size=3),
    first=_MICROSECONDS,
    end=_MICROSECONDS,
)
def test_a_span_has_the_rows_of_the_whole_between_its_times(
    tmp_path_factory: pytest.TempPathFactory,
    files: list[tuple[bool, list[tuple[str, int]]]],
    first: int | None,
    end: int | None,
) -> None:
    """Rows of one port may come before earlier ones of another, also by a long time."""
    folder = tmp_path_factory.mktemp("files")
    for number, (at_once, own) in enumerate(files):
        path = folder / f"{number}.mcap"
        rows = [Row(port, 10 * at, FRAME, START + 1000 * ns) for at, (port, ns) in enumerate(own)]
        if at_once:
            write_recording(path, [PortFacts("a")], [rows_from(rows)])
            continue
        with RecordingWriter(path, [PortFacts("a"), PortFacts("b")]) as writer:
            for row in rows:
                writer.write(*entries([row]))
                writer.flush()
    bounds = [
        None if at is None else datetime.fromtimestamp(START // 10**9, UTC) + timedelta(0, 0, at)
        for at in (first, end)
    ]
    wanted = pl.lit(True)
    if bounds[0] is not None:
        wanted &= pl.col("time") >= bounds[0]
    if bounds[1] is not None:
        wanted &= pl.col("time") < bounds[1]
    found = scan(folder, start=bounds[0], end=bounds[1])
    assert found.collect().equals(read(folder).filter(wanted))
    own = found.filter(pl.col("port") == "a").select("offset")
    assert own.collect().equals(read(folder).filter(wanted, port="a").select("offset"))


def test_chunks_after_the_end_of_a_span_are_not_read(tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    with RecordingWriter(path, [PortFacts("a")]) as writer:
        for number in range(10):
            writer.write(*entries(Row("a", 10 * number, FRAME, START + 1000 * number)))
            writer.flush()
    content = bytearray(path.read_bytes())
    last = [place for place in records(bytes(content)) if place[0] == CHUNK][-1]
    content[last[2] - 5 : last[2]] = bytes(5)
    path.write_bytes(content)
    at = datetime.fromtimestamp(START // 10**9, UTC) + timedelta(microseconds=5)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = scan(path, end=at).select("offset", "time").collect()
        assert found["offset"].to_list() == [0, 10, 20, 30, 40]
    with pytest.warns(RecordingWarning):
        assert len(scan(path, start=at).select("offset").collect()) == 4


@pytest.mark.parametrize("is_closed", [False, True], ids=["while it is written", "after its end"])
def test_a_query_reads_what_a_recording_has_when_it_runs(tmp_path: Path, is_closed: bool) -> None:
    path = tmp_path / "x.mcap"
    later, port = START + 10**12, "/dev/ttyUSB1"
    writer = RecordingWriter(path, [PortFacts("/dev/ttyUSB0")])
    writer.write(*entries(some_rows(60)))
    writer.flush()
    table = scan(path)
    after = table.filter(pl.col("time") >= datetime.fromtimestamp(later // 10**9, UTC))
    other = table.filter(pl.col("port") == port)
    assert len(after.collect()) == len(other.collect()) == 0
    writer.write(*entries(some_rows(202, port, later)))
    writer.flush()
    if is_closed:
        writer.close()
    assert len(after.collect()) == len(other.collect()) == 202
    writer.close()


def test_a_query_reads_the_file_that_has_the_name_when_it_runs(tmp_path: Path) -> None:
    path, other = tmp_path / "x.mcap", tmp_path / "other"
    for name, port in ((path, "a"), (other, "b")):
        with RecordingWriter(name, [PortFacts(port)]) as writer:
            writer.write(*entries(some_rows(60, port)))
    table = scan(path).filter(pl.col("port") == "b")
    assert len(table.collect()) == 0
    other.replace(path)
    assert len(table.collect()) == 60
    path.unlink()
    with pytest.raises((FileError, ComputeError), match="no such file"):
        table.collect()
