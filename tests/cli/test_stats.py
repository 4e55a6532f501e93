"""`stats`: the numbers over files, against the rows of the same files reckoned by other means."""

from __future__ import annotations

import json
import re
import shutil
import signal
import subprocess
from datetime import datetime
from itertools import pairwise
from pathlib import Path

import polars as pl
import pytest
from rich.cells import cell_len

import fte_sniff
from fte_sniff.analysis.facts import DEADLINE_NS
from fte_sniff.protocol import KIND_BY_NAME, PortEvent, PortEventKind, byte_time_ns, encode
from fte_sniff.protocol.rows import Rows
from fte_sniff.recording.metadata import PortFacts
from fte_sniff.recording.recorder import Recorder
from fte_sniff.recording.retention import RecordingOptions, TriggerWindow
from tests.cli.conftest import ROOT
from tests.cli.processes import BOUND_S, started
from tests.cli.terminals import terminal
from tests.slow import crossed
from tests.support.columns import in_columns
from tests.support.recorded_rows import write_recording

SECOND = 10**9
NAMES = ["clean", "damaged", "idle", "midstream"]
BYTE_NS = byte_time_ns(115_200)


def numbers(run, *arguments: str | Path) -> dict:
    done = run("stats", *arguments, "--format", "json")
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def t_ns(text: str) -> int:
    whole, fraction = text.removesuffix("Z").split(".")
    assert len(fraction) == 9
    return int(datetime.fromisoformat(f"{whole}+00:00").timestamp()) * SECOND + int(fraction)


def read(path: Path) -> pl.DataFrame:
    return fte_sniff.read(path).with_columns(ns=pl.col("time").dt.epoch("ns"))


def assert_times(reported: dict, times: pl.Series) -> None:
    assert (t_ns(reported["first_time"]), t_ns(reported["last_time"])) == (times.min(), times.max())


@pytest.mark.parametrize(
    "command",
    [
        ("stats", "midstream.mcap"),
        ("decode", "damaged.mcap"),
        ("hex", "55 01 01 03 E8 00 00 00 1F EE"),
    ],
)
def test_a_pipe_has_no_width_and_no_line_is_wrapped_or_cut(
    run, environment, samples: Path, command: tuple[str, str]
) -> None:
    """Whoever reads the pipe gets all columns, however narrow the terminal behind it is."""
    name, asked = command
    asked = asked if name == "hex" else str(samples / asked)
    reported = []
    for columns in ("40", "300"):
        environment["COLUMNS"] = columns
        reported.append(run(name, asked).stdout)
    assert reported[0] == reported[1]
    assert max(map(len, reported[0].splitlines())) > 80


@pytest.mark.parametrize("name", NAMES)
def test_extents_status_and_faults(samples: Path, name: str) -> None:
    reported, rows = fte_sniff.stats(samples / f"{name}.mcap"), read(samples / f"{name}.mcap")
    (port,) = reported["ports"]
    for part in (reported, *reported["files"], port):
        assert (part["rows"], part["bytes"]) == (len(rows), rows["length"].sum())
        assert_times(part, rows["ns"])
    assert reported["duration_s"] == pytest.approx((rows["ns"].max() - rows["ns"].min()) / SECOND)
    assert port["rows_per_s"] == pytest.approx((len(rows) - 1) / reported["duration_s"])
    for direction, count in port["frames"].items():
        assert count == len(rows.filter(pl.col("direction") == direction))
    for status, count in reported["status"].items():
        own = rows.filter(pl.col("status") == status)
        assert count == {"rows": len(own), "bytes": own["length"].sum()}
    assert port["status"] == reported["status"]
    having = rows.explode("faults").drop_nulls("faults")
    assert {fault["fault"] for fault in port["faults"]} == set(having["faults"])
    for fault in port["faults"]:
        own = having.filter(pl.col("faults") == fault["fault"])
        assert (fault["rows"], fault["bytes"]) == (len(own), own["length"].sum())
        assert fault["rows_share"] == pytest.approx(len(own) / len(rows))
        assert fault["bytes_share"] == pytest.approx(own["length"].sum() / rows["length"].sum())
        assert_times(fault, own["ns"])


@pytest.mark.parametrize("name", NAMES)
def test_lines_and_silences(samples: Path, name: str) -> None:
    (port,) = fte_sniff.stats(samples / f"{name}.mcap")["ports"]
    rows = read(samples / f"{name}.mcap").with_columns(
        end=pl.col("ns") + pl.col("length").cast(pl.Int64) * BYTE_NS
    )
    taken = (rows["end"] - rows["ns"]).sum()
    assert port["baud"] == 115_200
    assert port["line_use"] == pytest.approx(taken / (rows["end"].max() - rows["ns"].min()))
    silent = rows.with_columns(silent=pl.col("ns") - pl.col("end").shift()).filter(
        pl.col("silent") > 0
    )
    reported = port["silences"]
    assert reported["count"] == len(silent)
    assert reported["longest_s"] == pytest.approx(silent["silent"].max() / SECOND)
    longest = silent.filter(pl.col("silent") == pl.col("silent").max())["ns"][0]
    assert t_ns(reported["longest_until"]) == longest
    for percent in (50, 95, 99):
        exact = silent["silent"].quantile(percent / 100, "higher") / SECOND
        lower = silent["silent"].quantile(percent / 100, "lower") / SECOND
        assert lower * 0.95 <= reported[f"p{percent}_s"] <= exact * 1.05


@pytest.mark.parametrize("name", NAMES)
def test_streams(samples: Path, name: str) -> None:
    (port,) = fte_sniff.stats(samples / f"{name}.mcap")["ports"]
    rows = read(samples / f"{name}.mcap").drop_nulls("kind")
    motor = pl.col("motor").is_in([1, 2, 3, 4])
    sound = rows.filter(motor | pl.col("kind").is_in(["reset", "mecanum"])).with_columns(
        motor=pl.when(motor).then("motor")
    )
    reported = {(one["kind"], one["motor"]): one for one in port["streams"]}
    groups = sound.partition_by("kind", "motor", as_dict=True)
    assert set(reported) == set(groups)
    for key, own in groups.items():
        one = reported[key]
        assert one["frames"] == len(own)
        values = {
            column: {"least": own[column].min(), "greatest": own[column].max()}
            for column in ("rpm", "pulses", "vx_cm_s", "vy_cm_s", "wz_mrad_s")
            if own[column].null_count() == 0
        }
        assert one["values"] == values
        if len(own) < 2:
            assert one["frames_per_s"] is None
            assert one["period"] == dict.fromkeys(one["period"])
            continue
        periods = own["ns"].diff().drop_nulls()
        assert one["frames_per_s"] == pytest.approx((len(own) - 1) * SECOND / periods.sum())
        assert one["period"]["longest_s"] == pytest.approx(periods.max() / SECOND)
        assert one["period"]["p50_s"] <= periods.quantile(0.5, "higher") / SECOND * 1.05
        assert one["period"]["p50_s"] >= periods.quantile(0.5, "lower") / SECOND * 0.95


@pytest.mark.parametrize("name", NAMES)
def test_motors(samples: Path, name: str) -> None:
    rows = read(samples / f"{name}.mcap").drop_nulls("kind").to_dicts()
    for reported in fte_sniff.stats(samples / f"{name}.mcap")["motors"]:
        number, asked, delays, unanswered = reported["motor"], None, [], 0
        commands = feedback = 0
        covered = False
        for row in rows:
            if asked is not None and row["ns"] - asked["ns"] > DEADLINE_NS:
                unanswered += asked["covered"]
                asked = None
            covered = covered or row["direction"] == "feedback"
            if row["direction"] == "control" and row["motor"] in (None, number):
                commands += 1
                unanswered += asked is not None and asked["covered"]
                asked = {**row, "covered": covered} if row["cmd"] else None
            elif row["direction"] == "feedback" and row["motor"] == number:
                feedback += 1
                if asked is not None and asked["cmd"] == row["cmd"]:
                    delays.append((row["ns"] - asked["ns"]) / SECOND)
                    asked = None
        assert (reported["commands"], reported["feedback"]) == (commands, feedback)
        assert (reported["answered"], reported["unanswered"] or 0) == (len(delays), unanswered)
        assert reported["delay"]["longest_s"] == (pytest.approx(max(delays)) if delays else None)
        own = [row for row in rows if row["direction"] == "feedback" and row["motor"] == number]
        for bit in range(8):
            having = [row["ns"] for row in own if row["error"] >> bit & 1]
            found = [one for one in reported["error_bits"] if one["bit"] == bit]
            assert [one["frames"] for one in found] == ([len(having)] if having else [])
            assert [t_ns(one["first_time"]) for one in found] == having[:1]
            assert [t_ns(one["last_time"]) for one in found] == having[-1:]
        every = [row for row in rows if row["direction"] == "feedback" and 1 <= row["motor"] <= 4]
        here = [row["online"] >> (number - 1) & 1 for row in every]
        assert reported["offline"]["frames"] == here.count(0)
        assert reported["offline"]["times_lost"] == sum(a > b for a, b in pairwise(here))


def pieces(run, source: Path, folder: Path) -> list[Path]:
    """A recording cut into three, by time."""
    folder.mkdir()
    cuts = [(), ("--from", "+10s"), ("--from", "+30s")], [("--to", "+10s"), ("--to", "+30s"), ()]
    found = []
    # Names whose order is not that of their times.
    for name, since, until in zip("bca", *cuts, strict=True):
        found.append(folder / f"{name}.mcap")
        run("decode", source, *since, *until, "-o", found[-1])
    return found


def test_nothing_is_measured_between_files_that_do_not_go_on(
    run, samples: Path, tmp_path: Path
) -> None:
    early, late = tmp_path / "early.mcap", tmp_path / "late.mcap"
    run("decode", samples / "clean.mcap", "--to", "+10s", "-o", early)
    run("decode", samples / "clean.mcap", "--from", "+20s", "-o", late)
    (port,) = numbers(run, early, late)["ports"]
    assert port["silences"]["longest_s"] < 5


def test_files_together_are_the_file_that_they_were(run, samples: Path, tmp_path: Path) -> None:
    whole = fte_sniff.stats(samples / "clean.mcap")
    parts = pieces(run, samples / "clean.mcap", tmp_path / "parts")
    for named in ([tmp_path / "parts"], [tmp_path / "parts" / "*.mcap"], parts[::-1]):
        together = numbers(run, *named)
        assert [file["name"] for file in together["files"]] == list(map(str, parts))
        assert sum(file["rows"] for file in together["files"]) == whole["rows"]
        assert together | {"files": None} == whole | {"files": None}


def test_files_that_overlap_in_time_have_no_answers(run, samples: Path, tmp_path: Path) -> None:
    shutil.copy(samples / "clean.mcap", tmp_path / "copy.mcap")
    reported = numbers(run, samples / "clean.mcap", "copy.mcap")
    assert reported["rows"] == 2400
    assert {motor["answered"] for motor in reported["motors"]} == {None}
    assert {motor["delay"]["p50_s"] for motor in reported["motors"]} == {None}
    text = run("stats", samples / "clean.mcap", "copy.mcap").stdout
    assert text.count("overlap in time") == 1


@pytest.mark.parametrize(("ending", "name"), crossed(["raw", "hex"], NAMES))
def test_without_times_there_are_counts_alone(run, samples: Path, ending: str, name: str) -> None:
    file = samples / f"{name}.{ending}"
    reported = numbers(run, file)
    rows = [json.loads(row) for row in run("decode", file, "--format", "jsonl").stdout.splitlines()]
    (port,) = reported["ports"]
    assert (reported["rows"], port["rows"]) == (len(rows), len(rows))
    assert (
        reported["bytes"]
        == sum(row["length"] for row in rows)
        == len((samples / f"{name}.raw").read_bytes())
    )
    for status, count in reported["status"].items():
        assert count["rows"] == sum(row["status"] == status for row in rows)
    assert (reported["first_time"], reported["duration_s"], port["line_use"]) == (None, None, None)
    assert {one["frames_per_s"] for one in port["streams"]} == {None}
    text = run("stats", file).stdout
    assert text.count("no times") == 1
    assert "baud" not in text


@pytest.mark.parametrize("ending", ["mcap", "raw", "hex"])
def test_standard_input(run, samples: Path, ending: str) -> None:
    file = samples / f"clean.{ending}"
    done = run("stats", "-", "--format", "json", stdin=file.read_bytes())
    reported, expected = json.loads(done.stdout), numbers(run, file)
    assert reported["files"][0]["name"] == "stdin"
    for key in ("rows", "bytes", "first_time", "status", "motors"):
        assert reported[key] == expected[key]


def test_filter_and_span(run, samples: Path) -> None:
    wanted = "motor = 1 AND kind = 'speed'"
    options = ["--from", "+10s", "--to", "+35s"]
    reported = numbers(run, samples / "clean.mcap", "--filter", wanted, *options)
    start = read(samples / "clean.mcap")["ns"].min()
    inside = read(samples / "clean.mcap").filter(
        pl.col("ns").is_between(start + 10 * SECOND, start + 35 * SECOND, closed="left")
    )
    own = inside.filter((pl.col("motor") == 1) & (pl.col("kind") == "speed"))
    assert (reported["filter"], reported["rows_read"], reported["rows"]) == (
        wanted,
        len(inside),
        len(own),
    )
    assert_times(reported, own["ns"])
    ((stream,),) = (port["streams"] for port in reported["ports"])
    assert (stream["kind"], stream["motor"]) == ("speed", 1)
    text = run("stats", samples / "clean.mcap", "--filter", wanted, *options).stdout
    assert f"holds for {len(own):,} of {len(inside):,} rows" in text
    nothing = run("stats", samples / "clean.mcap", "--filter", "motor = 1 AND motor = 2")
    assert nothing.returncode == 0
    assert "holds for 0 of 1,200 rows" in nothing.stdout


def recorded(path: Path, port: PortFacts, rows: list[fte_sniff.Row], events: list[PortEvent]):
    write_recording(path, [port], [Rows.from_rows(rows, events=events)], {})


def speed(port: str, at: int, t: int) -> fte_sniff.Frame:
    raw = encode(KIND_BY_NAME["speed"], {"motor": 1, "rpm": 5})
    return fte_sniff.Frame(port, 10 * at, raw, t, (), 0)


def test_the_baud_of_the_recording_or_of_the_user(run, tmp_path: Path) -> None:
    recorded(
        tmp_path / "a.mcap",
        PortFacts("p", 9600),
        [speed("p", at, 10**18 + at * SECOND) for at in range(11)],
        [],
    )
    for options, baud in [((), 9600), (("--baud", "1200"), 1200)]:
        (port,) = numbers(run, "a.mcap", *options)["ports"]
        taken = 110 * byte_time_ns(baud)
        share = taken / (10 * SECOND + 10 * byte_time_ns(baud))
        assert port["baud"] == baud
        assert port["line_use"] == pytest.approx(share)
    assert run("stats", "a.mcap", "--baud", "0").returncode == 2


def with_gaps(path: Path, rows: list[fte_sniff.Row]) -> None:
    """A recording of which a trigger kept the rows that bear an even hundred of rpm."""
    around = TriggerWindow(0, 0)
    recorder = Recorder(
        path,
        [PortFacts("p")],
        options=RecordingOptions(trigger_window=around),
        select=lambda given: given.field("rpm")[0] // 100 % 2 == 0,
    )
    recorder.write(in_columns(rows))
    recorder.close()


def test_nothing_is_measured_across_what_was_left_out(run, tmp_path: Path) -> None:
    start, step = 10**18, SECOND // 100
    raws = [encode(KIND_BY_NAME["speed"], {"motor": 1, "rpm": at}) for at in range(500)]
    rows = [
        fte_sniff.Frame("p", 10 * at, raw, start + at * step, (), 0) for at, raw in enumerate(raws)
    ]
    with_gaps(tmp_path / "a.mcap", rows)
    reported = numbers(run, "a.mcap")
    assert [
        (one["rows"], t_ns(one["first_time"]), t_ns(one["last_time"]))
        for one in reported["left_out"]
    ] == [(100, start + first * step, start + (first + 99) * step) for first in (100, 300)]
    (port,), taken = reported["ports"], 10 * BYTE_NS
    assert port["rows_per_s"] == pytest.approx(100)
    assert port["line_use"] == pytest.approx(100 * taken / (99 * step + taken))
    assert port["silences"]["count"] == 3 * 99
    assert port["silences"]["longest_s"] == pytest.approx((step - taken) / SECOND)
    (stream,) = port["streams"]
    assert stream["frames_per_s"] == pytest.approx(100)
    assert stream["period"]["longest_s"] == step / SECOND
    motor = reported["motors"][0]
    # The wire of the answers was not recorded.
    assert (motor["commands"], motor["unanswered"], motor["neither"]) == (300, None, 300)
    text = run("stats", "a.mcap").stdout
    assert "left out   200 rows in 2 places: they are outside the trigger window\n" in text
    assert "200 rows in 2 places left out when recorded" in run("decode", "a.mcap").stderr
    some = numbers(run, "a.mcap", "--from", "+2.5s", "--filter", "rpm > 250")
    assert [one["rows"] for one in some["left_out"]] == [100]


def test_the_commands_of_a_motor_add_up(samples: Path) -> None:
    for name in NAMES:
        for motor in fte_sniff.stats(samples / f"{name}.mcap")["motors"]:
            parts = motor["answered"], motor["unanswered"] or 0, motor["neither"]
            assert sum(parts) == motor["commands"]


def test_of_one_row_there_is_no_rate_and_no_use_of_the_line(run, tmp_path: Path) -> None:
    recorded(tmp_path / "a.mcap", PortFacts("p"), [speed("p", 0, 10**18)], [])
    (port,) = numbers(run, "a.mcap")["ports"]
    assert (port["rows"], port["rows_per_s"], port["line_use"]) == (1, None, None)
    assert "baud" not in run("stats", "a.mcap").stdout


def test_port_events(run, tmp_path: Path) -> None:
    start = 10**18
    happened = [
        (0, PortEventKind.OPENED, 0),
        (1, PortEventKind.LINE_ERROR, 3),
        (2, PortEventKind.LINE_ERROR, 4),
        (3, PortEventKind.LOST, 0),
        (4, PortEventKind.FOUND_AGAIN, 0),
        (5, PortEventKind.OVERRUN, 100),
    ]
    events = [PortEvent(start + at, "p", kind, "", count) for at, kind, count in happened]
    recorded(tmp_path / "a.mcap", PortFacts("p"), [speed("p", 0, start + 9)], events)
    (port,) = numbers(run, "a.mcap")["ports"]
    assert [(one["event"], one["count"], one["total"]) for one in port["events"]] == [
        ("opened", 1, None),
        ("line_error", 2, 7),
        ("lost", 1, None),
        ("found_again", 1, None),
        ("overrun", 1, 100),
    ]
    assert [t_ns(one["last_time"]) - start for one in port["events"]] == [0, 2, 3, 4, 5]
    text = run("stats", "a.mcap").stdout
    assert "line error 2 (7 in all)" in text


def test_an_empty_recording_explains_itself(run, tmp_path: Path) -> None:
    recorded(tmp_path / "a.mcap", PortFacts("p", 9600), [], [])
    done = run("stats", "a.mcap")
    assert done.returncode == 0
    assert "rows       0, 0 bytes" in done.stdout
    assert done.stderr == "fte-sniff: nothing came: check the wire, the ground and the baud rate\n"
    reported = numbers(run, "a.mcap")
    assert (reported["rows"], reported["first_time"], reported["ports"][0]["rows_per_s"]) == (
        0,
        None,
        None,
    )
    between = run("stats", "a.mcap", "--from", "2026-01-01T00:00:00Z")
    assert "no row is between" in between.stderr


def test_a_cut_recording_is_reported_as_far_as_it_goes(run, samples: Path, tmp_path: Path) -> None:
    whole = (samples / "clean.mcap").read_bytes()
    (tmp_path / "cut.mcap").write_bytes(whole[: len(whole) * 3 // 4])
    done = run("stats", "cut.mcap", "--format", "json")
    assert done.returncode == 0
    with pytest.warns(fte_sniff.RecordingWarning):
        assert json.loads(done.stdout)["rows"] == read(tmp_path / "cut.mcap").height
    assert done.stderr.count("\n") == 1
    assert "cut.mcap" in done.stderr


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (["none.mcap"], 4, "none.mcap"),
        (["text.mcap"], 4, "text.mcap"),
        (["bad.hex"], 2, "not hex"),
        (["empty.raw"], 4, "empty"),
        (["nothing*.mcap"], 4, "no file matches"),
        (["-", "-"], 2, "name it once"),
        (["--filter", "moter = 1", "good.raw"], 2, "did you mean motor"),
        (["--from", "+1s", "good.raw"], 2, "no times"),
        (["--format", "xml", "good.raw"], 2, "xml"),
        ([], 2, "FILE"),
    ],
    ids=str,
)
def test_what_cannot_be_is_one_line(
    run, samples: Path, tmp_path: Path, arguments: list[str], code: int, words: str
) -> None:
    (tmp_path / "text.mcap").write_text("no recording")
    (tmp_path / "bad.hex").write_text("AA 01 0G\n")
    (tmp_path / "empty.raw").write_bytes(b"")
    shutil.copy(samples / "idle.raw", tmp_path / "good.raw")
    done = run("stats", *arguments)
    assert done.returncode == code
    assert done.stdout == ""
    assert done.stderr.count("\n") == 1
    assert words in done.stderr


def test_names_are_shown_and_not_obeyed(run, tmp_path: Path) -> None:
    port = "[bold]p\x1b[31m\x07\nq[/bold]"
    rows = [speed(port, at, 10**18 + at) for at in range(3)]
    recorded(tmp_path / "[red]a\x1b]0;x\x07.mcap", PortFacts(port), rows, [])
    for arguments in (["stats"], ["stats", "--format", "json"]):
        done = run(*arguments, "[[]red]*.mcap")
        assert done.returncode == 0, done.stderr
        assert not re.search(r"[\x00-\x09\x0b-\x1f\x7f]", done.stdout)
        assert "[bold]p\\" in done.stdout
        assert "[red]a\\" in done.stdout
    assert numbers(run, "[[]red]*.mcap")["ports"][0]["port"] == port


@pytest.mark.parametrize(("columns", "name"), crossed([40, 80, 200], ["damaged", "clean"]))
def test_on_a_terminal_it_keeps_to_the_width(
    environment, tmp_path: Path, samples: Path, columns: int, name: str
) -> None:
    file = str(samples / f"{name}.mcap")
    with terminal(environment, tmp_path, "stats", file, size=(columns, 24)) as one:
        assert one.ended() == 0
        drawn = one.drawn.decode()
    plain = re.sub(r"\x1b\[[0-9;]*m", "", drawn)
    assert max(map(cell_len, plain.splitlines())) <= columns
    assert "\x1b[" in drawn
    assert ("99 %" in plain.split("kind and motor")[1]) is (columns == 200)


def test_no_colour_where_none_is_wanted(environment, tmp_path: Path, samples: Path, run) -> None:
    wanted = environment | {"NO_COLOR": "1"}
    with terminal(wanted, tmp_path, "stats", str(samples / "damaged.mcap")) as one:
        assert one.ended() == 0
        assert not re.search(rb"\x1b\[[0-9;]*3[0-9]", one.drawn)
    plain = run("stats", samples / "damaged.mcap").stdout
    assert "\x1b" not in plain
    assert "! truncated" in plain
    assert "? reserved_nonzero" in plain


def test_ctrl_c_stops_at_once_and_reports_what_was_read(environment, tmp_path: Path) -> None:
    with started(environment, tmp_path, "stats", "-", stdin=subprocess.PIPE) as process:
        assert process.stdin is not None
        process.stdin.write(bytes(1 << 17))
        process.stdin.flush()
        process.send_signal(signal.SIGINT)
        assert process.wait(BOUND_S) in (130, -signal.SIGINT)
        assert process.stdout is not None
        assert process.stderr is not None
        reported, errors = process.stdout.read(), process.stderr.read()
        assert b"Traceback" not in errors
        if process.returncode == 130 and reported:  # it was reading
            assert reported.startswith(b"files      stdin\nrows       ")
            assert re.fullmatch(
                rb"fte-sniff: interrupted; 0 of 1 files and [\d,]+ rows were read\n", errors
            )


def keys_of(value: object) -> set[str]:
    if isinstance(value, dict):
        return set(value).union(*map(keys_of, value.values()))
    return set().union(*map(keys_of, value)) if isinstance(value, list) else set()


def test_every_key_is_described(samples: Path) -> None:
    described = set(re.findall(r"`(\w+)(?:\[\])?`", (ROOT / "docs/stats.md").read_text()))
    names = {f"{name}.mcap" for name in NAMES}
    reported = set().union(*(keys_of(fte_sniff.stats(samples / name)) for name in names))
    rows = {"rpm", "pulses", "vx_cm_s", "vy_cm_s", "wz_mrad_s"}
    assert reported - rows <= described
