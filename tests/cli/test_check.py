"""`check`: verdicts, exit codes and forms, and the rules of the documentation."""

from __future__ import annotations

import json
import re
from pathlib import Path

from fte_sniff.protocol.rows import Row
from fte_sniff.protocol.spec import KIND_BY_NAME, encode
from fte_sniff.recording.metadata import PortFacts
from tests.cli.conftest import ROOT
from tests.support.columns import rows_from
from tests.support.recorded_rows import write_recording

MS = 1_000_000
START_NS = 1_700_000_000 * 10**9
BAD = "count(malformed) == 0"


def write(path: Path, rows: list[Row]) -> Path:
    write_recording(path, [PortFacts("a", 115_200)], [rows_from(rows)], {})
    return path


def test_every_key_is_described(run, samples: Path) -> None:
    done = run("check", samples / "damaged.mcap", "--expect", BAD, "--format", "json")
    described = set(re.findall(r"`(\w+)(?:\[\])?`", (ROOT / "docs/check.md").read_text()))
    reported = json.loads(done.stdout)
    (rule,) = reported["rules"]
    assert set(reported) | set(rule) | set(rule["row"]) <= described


def test_an_input_without_rows_covers_nothing(run, tmp_path: Path) -> None:
    done = run("check", write(tmp_path / "a.mcap", []), "--expect", "count(malformed) == 0")
    assert done.returncode == 1
    assert "not covered" in done.stdout


# The rules of the documentation


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


def test_the_documented_rules_pass_on_a_good_minute_only(
    run, samples: Path, tmp_path: Path
) -> None:
    (block,) = re.findall(r"```toml\n(.*?)```", (ROOT / "docs/check.md").read_text(), re.DOTALL)
    (tmp_path / "rules.toml").write_text(block)
    good = write(tmp_path / "good.mcap", a_good_minute())
    passed = []
    for path in (good, samples / "damaged.mcap"):
        done = run("check", path, "--rules", "rules.toml", "--format", "json")
        passed.append([one["verdict"] for one in json.loads(done.stdout)["rules"]].count("pass"))
    assert passed[0] == block.count("[[rule]]") == 10
    assert passed[1] < 6
