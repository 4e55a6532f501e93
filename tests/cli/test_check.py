"""`check`: verdicts, exit codes and forms, and the rules of the documentation."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Callable
from pathlib import Path

import pytest

from fte_sniff.protocol import KIND_BY_NAME, Fault, Row, encode
from fte_sniff.protocol.rows import Rows
from fte_sniff.recording.metadata import PortFacts
from tests.beside import running
from tests.cli.conftest import ROOT
from tests.slow import first
from tests.support.recorded_rows import write_recording

MS = 1_000_000
START_NS = 1_700_000_000 * 10**9
BAD = "count(malformed) == 0"


def write(path: Path, rows: list[Row]) -> Path:
    write_recording(path, [PortFacts("a", 115_200)], [Rows.of(rows)], {})
    return path


def test_every_key_is_described(run, samples: Path) -> None:
    done = run("check", samples / "damaged.mcap", "--expect", BAD, "--format", "json")
    described = set(re.findall(r"`(\w+)(?:\[\])?`", (ROOT / "docs/check.md").read_text()))
    reported = json.loads(done.stdout)
    (rule,) = reported["rules"]
    assert set(reported) | set(rule) | set(rule["row"]) <= described


@pytest.mark.parametrize("name", ["clean.mcap", "clean.hex", "clean.raw"])
def test_a_named_pipe_is_read_once(run, samples: Path, tmp_path: Path, name: str) -> None:
    os.mkfifo(tmp_path / "pipe")
    with running(["cp", samples / name, tmp_path / "pipe"]):
        done = run("check", tmp_path / "pipe", "--expect", "count(ok) == 1200")
    assert (done.returncode, done.stderr) == (0, "")


def test_an_input_without_rows_covers_nothing(run, tmp_path: Path) -> None:
    done = run("check", write(tmp_path / "a.mcap", []), "--expect", "count(malformed) == 0")
    assert done.returncode == 1
    assert "not covered" in done.stdout


# The rules of the documentation

FAULTS = dict[str, Callable[[list[Row]], list[Row]]]


def feedback(t_ns: int, motor: int, **values: int) -> Row:
    known = {"motor": motor, "rpm": 100, "error": 0, "online": 15} | values
    return Row("a", 0, encode(KIND_BY_NAME["speed_feedback"], known), t_ns)


def a_good_minute() -> list[Row]:
    rows: list[Row] = []
    for at in range(2401):
        t_ns = START_NS + at * 25 * MS
        if at % 40 == 0:
            command = encode(KIND_BY_NAME["speed"], {"motor": 1, "rpm": 100})
            rows.append(Row("a", 0, command, t_ns))
        rows += [feedback(t_ns + motor * 2 * MS, motor) for motor in (1, 2, 3, 4)]
    return [_at(row, 10 * number) for number, row in enumerate(rows)]


def _at(row: Row, offset: int) -> Row:
    return type(row)(row.port, offset, row.raw, row.t_ns, row.faults)


def _is_feedback(row: Row, motor: int) -> bool:
    return row.framed and row.raw[0] == 0x55 and row.values["motor"] == motor


def _with(rows: list[Row], row: Row) -> list[Row]:
    """The rows with another one instead of one of motor 3's."""
    at = 1000 + next(n for n, one in enumerate(rows[1000:]) if _is_feedback(one, 3))
    found = type(row)(row.port, rows[at].offset, row.raw, rows[at].t_ns, row.faults, row.framed)
    return [*rows[:at], found, *rows[at + 1 :]]


def _late_answers(rows: list[Row]) -> list[Row]:
    late = [feedback((row.t_ns or 0) + 20 * MS, 1) if _is_feedback(row, 1) else row for row in rows]
    return sorted(late, key=lambda row: row.t_ns or 0)


def _without_answers(rows: list[Row]) -> list[Row]:
    second = next(n for n, row in enumerate(rows[10:], 10) if row.raw[0] == 0xAA)
    doubled = type(rows[0])("a", 0, rows[0].raw, (rows[second].t_ns or 0) + 1000)
    return [*rows[: second + 1], doubled, *rows[second + 1 :]]


BROKEN: FAULTS = {
    "no damage": lambda rows: _with(rows, Row("a", 0, bytes(10), 0, (Fault.NOISE,), framed=False)),
    "hardly anything undefined": lambda rows: [
        type(row)(row.port, row.offset, row.raw, row.t_ns, (Fault.RESERVED_NONZERO,))
        if number % 500 == 0 else row
        for number, row in enumerate(rows)
    ],
    "all four motors online": lambda rows: _with(rows, feedback(0, 3, online=11)),
    "feedback of motor 1": lambda rows: [
        row for number, row in enumerate(rows) if not _is_feedback(row, 1) or number % 3
    ],
    "answers in time": _late_answers,
    "every command answered": _without_answers,
    "no speed above 300 RPM": lambda rows: _with(rows, feedback(0, 3, rpm=-301)),
    "no silence of 0.5 s": lambda rows: [
        row for row in rows if not 10_000 <= ((row.t_ns or 0) - START_NS) // MS < 10_600
    ],
    "no ERROR flag": lambda rows: _with(rows, feedback(0, 3, error=1)),
    "at least a minute": lambda rows: rows[:-1200],
}  # fmt: skip


@pytest.fixture
def documented(tmp_path: Path) -> Path:
    page = (ROOT / "docs" / "check.md").read_text()
    (block,) = re.findall(r"```toml\n(.*?)```", page, re.DOTALL)
    path = tmp_path / "rules.toml"
    path.write_text(block)
    assert block.count("[[rule]]") == 10
    return path


def verdicts(run, path: Path, rules: Path) -> dict[str, str]:
    done = run("check", path, "--rules", rules, "--format", "json")
    return {one["name"]: one["verdict"] for one in json.loads(done.stdout)["rules"]}


def test_the_documented_rules_pass_on_a_good_minute(run, documented: Path, tmp_path: Path) -> None:
    found = verdicts(run, write(tmp_path / "good.mcap", a_good_minute()), documented)
    assert found == dict.fromkeys(BROKEN, "pass")


@pytest.mark.parametrize("name", first(10, sorted(BROKEN)))
def test_each_documented_rule_finds_its_fault(
    run, documented: Path, tmp_path: Path, name: str
) -> None:
    rows = BROKEN[name](a_good_minute())
    found = verdicts(run, write(tmp_path / "bad.mcap", rows), documented)
    assert found[name] == "fail"
