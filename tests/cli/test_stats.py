"""`stats`: the numbers over files, against the rows of the same files reckoned by other means."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

import fte_sniff
from fte_sniff.protocol.items import PortEvent, PortEventKind
from fte_sniff.protocol.spec import KIND_BY_NAME, encode
from fte_sniff.recording.metadata import PortFacts
from tests.cli.conftest import ROOT
from tests.cli.program import Program
from tests.cli.terminals import terminal
from tests.support.columns import rows_from
from tests.support.recorded_rows import write_recording

SECOND = 10**9
NAMES = ["clean", "damaged", "idle", "midstream"]


def numbers(run, *arguments: str | Path) -> dict:
    done = run("stats", *arguments, "--format", "json")
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


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


def recorded(path: Path, port: PortFacts, rows: list[fte_sniff.Row], events: list[PortEvent]):
    write_recording(path, [port], [rows_from(rows)], {}, events)


def speed(port: str, at: int, t: int) -> fte_sniff.Row:
    raw = encode(KIND_BY_NAME["speed"], {"motor": 1, "rpm": 5})
    return fte_sniff.Row(port, 10 * at, raw, t)


def test_of_one_row_there_is_no_rate_and_no_use_of_the_line(run, tmp_path: Path) -> None:
    recorded(tmp_path / "a.mcap", PortFacts("p"), [speed("p", 0, 10**18)], [])
    (port,) = numbers(run, "a.mcap")["ports"]
    assert (port["rows"], port["rows_per_s"], port["line_use"]) == (1, None, None)


def test_port_events(run, tmp_path: Path) -> None:
    happened = [(1, PortEventKind.LINE_ERROR, 3), (2, PortEventKind.LINE_ERROR, 4)]
    events = [PortEvent(10**18 + at * SECOND, "p", kind, "", n) for at, kind, n in happened]
    recorded(tmp_path / "a.mcap", PortFacts("p"), [speed("p", 0, 10**18)], events)
    (port,) = numbers(run, "a.mcap")["ports"]
    (event,) = port["events"]
    assert (event["event"], event["count"], event["total"]) == ("line_error", 2, 7)
    (line,) = [one for one in run("stats", "a.mcap").stdout.splitlines() if "line error" in one]
    assert line.split() == ["line", "error", "2", "7", "01:46:41.000", "01:46:42.000"]


def test_an_empty_recording_explains_itself(run, tmp_path: Path) -> None:
    recorded(tmp_path / "a.mcap", PortFacts("p", 9600), [], [])
    done = run("stats", "a.mcap")
    assert (done.returncode, "rows       0, 0 bytes" in done.stdout) == (0, True)
    assert done.stderr == "fte-sniff: nothing came: check the wire, the ground and the baud rate\n"
    between = run("stats", "a.mcap", "--from", "2026-01-01T00:00:00Z")
    assert "none of its rows is between" in between.stderr


def test_other_processes_read_logs_in_the_same_zone(run, variables, tmp_path: Path) -> None:
    for name in ("a.txt", "b.txt"):
        lines = [f"2026-01-31 12:00:0{at}.000 AA 01 01 03 E8 00 00 00 00 EE" for at in range(9)]
        (tmp_path / name).write_text("\n".join(lines))
    command = ("stats", "a.txt", "b.txt", "--format", "json", "--zone", "+08:00")
    options = ("--from", "2026-01-31T12:00:03")
    here = json.loads(run(*command, *options).stdout)
    others = Program().run([*command, *options, "--jobs", "2"], b"", tmp_path, variables)
    elsewhere = json.loads(others.output)
    assert here == elsewhere
    assert (here["rows"], here["first_time"]) == (12, "2026-01-31T04:00:03.000000000Z")


def test_terminal_has_the_lines_of_a_pipe_in_colours(
    environment, tmp_path: Path, samples: Path, run
) -> None:
    file = str(samples / "damaged.mcap")
    with terminal(environment, tmp_path, "stats", file, size=(40, 24)) as one:
        assert one.ended() == 0
        drawn = one.drawn.decode()
    assert "\x1b[" in drawn
    plain = re.sub(r"\x1b\[[0-9;]*m", "", drawn)
    assert plain.splitlines() == run("stats", file).stdout.splitlines()


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
