"""`check`: verdicts, exit codes and forms, and the rules of the documentation."""

from __future__ import annotations

import json
import os
import re
import shlex
from collections.abc import Callable
from pathlib import Path
from xml.etree import ElementTree

import pytest
from junitparser import JUnitXml
from rich.cells import cell_len

from fte_sniff.protocol import KIND_BY_NAME, Damage, Fault, Frame, Row, encode
from fte_sniff.protocol.rows import Rows
from fte_sniff.recording.metadata import PortFacts
from tests.beside import running
from tests.cli.conftest import ROOT
from tests.cli.terminals import terminal
from tests.slow import first
from tests.support.recorded_rows import write_recording

MS = 1_000_000
START_NS = 1_700_000_000 * 10**9
GOOD = "count(kind = 'reset') >= 0"
BAD = "count(malformed) == 0"
UNCOVERED = "max(rpm, kind IS NULL) < 9"


def write(path: Path, rows: list[Row]) -> Path:
    write_recording(path, [PortFacts("a", 115_200)], [Rows.from_rows(rows)], {})
    return path


@pytest.mark.parametrize(
    ("rules", "code"),
    [
        ([GOOD], 0),
        ([GOOD, BAD], 1),
        ([UNCOVERED, GOOD], 1),
        ([GOOD, "count(x) == 0"], 2),
    ],
)
def test_exit_codes(run, samples: Path, rules: list[str], code: int) -> None:
    options = [word for rule in rules for word in ("--expect", rule)]
    done = run("check", samples / "damaged.mcap", *options)
    assert done.returncode == code
    assert len(done.stderr.splitlines()) == (code == 2)


def test_the_table(run, samples: Path) -> None:
    done = run("check", samples / "damaged.mcap", "--expect", BAD, "--expect", UNCOVERED)
    head, bad, first, view, uncovered, needs = done.stdout.splitlines()
    assert head.split() == ["rule", "measured", "expected", "verdict"]
    assert re.fullmatch(rf"! {re.escape(BAD)} +66 rows +== 0 +fail", bad)
    assert first.startswith("    first at 2026-01-31T12:00:00.066938325Z, offset 20 of sim://")
    assert first.endswith(": 55 01 02 00 00 00 00 00")
    assert view.startswith("    fte-sniff view ")
    assert re.fullmatch(rf"! {re.escape(UNCOVERED)} +– +< 9 +not covered", uncovered)
    assert needs == "    needs a matching row with the field"


def test_a_rate_without_times_fails_and_names_its_need(run, samples: Path) -> None:
    arguments = ["check", samples / "clean.raw", "--expect", "rate(feedback) != 0", "--format"]
    text, reported, suites = (run(*arguments, form) for form in ("text", "json", "junit"))
    assert {text.returncode, reported.returncode, suites.returncode} == {1}
    _, failed, needs = text.stdout.splitlines()
    assert re.fullmatch(r"! rate\(feedback\) != 0 +no duration +!= 0 +fail", failed)
    assert needs == "    needs two different times; no row has a time, try --start"
    (rule,) = json.loads(reported.stdout)["rules"]
    assert (rule["verdict"], rule["measured"], rule["row"]) == ("fail", None, None)
    assert rule["needs"] == needs.removeprefix("    needs ")
    ((case,),) = JUnitXml.fromstring(suites.stdout.encode())
    assert case.result[0].type == "fail"
    assert case.result[0].message.endswith("fail, measured no duration; " + needs.strip())
    assert run(*arguments, "text", "--start", "2026-01-31T12:00:00Z").returncode == 0


def test_every_key_is_described(run, samples: Path) -> None:
    done = run("check", samples / "damaged.mcap", "--expect", BAD, "--format", "json")
    described = set(re.findall(r"`(\w+)(?:\[\])?`", (ROOT / "docs/check.md").read_text()))
    reported = json.loads(done.stdout)
    (rule,) = reported["rules"]
    assert set(reported) | set(rule) | set(rule["row"]) <= described


MEASURED = (
    BAD,
    "share(noise OR truncated) == 0",
    "rate(malformed) < 1",
    "max(rpm) < 10",
    "min(rpm, motor = 2 OR motor = 3) > 10",
    "delay(p95) < 1",
    "unanswered() == 0",
    "unanswered(kind = 'speed') == 0",
    "max_gap(feedback) < 0.01",
    "online(1) > 0.999",
)


@pytest.mark.parametrize("name", ["damaged.mcap", "motor3.mcap", "damaged.raw"])
def test_view_command_shows_the_row(run, samples: Path, name: str) -> None:
    """Another program would run it in a terminal: `decode` has the same options."""
    expected = [word for rule in MEASURED for word in ("--expect", rule)]
    arguments = ["check", samples / name, *expected, "--format"]
    rules = json.loads(run(*arguments, "json").stdout)["rules"]
    (cases,) = JUnitXml.fromstring(run(*arguments, "junit").stdout.encode())
    text = run(*arguments, "text").stdout
    for rule, case in zip(rules, cases, strict=True):
        if (row := rule["row"]) is None:
            assert rule["verdict"] != "fail" or rule["measured"] is None
            continue
        program, command, *words = shlex.split(row["view"])
        assert (program, command) == ("fte-sniff", "view")
        done = run("decode", *words, "--format", "jsonl")
        assert done.returncode == 0, done.stderr
        rows = [json.loads(line) for line in done.stdout.splitlines()]
        shown = {key: row[key] for key in ("time", "port", "offset", "motor", "raw")}
        assert shown in [{key: one[key] for key in shown} for one in rows]
        assert case.result[0].text == row["view"]
        assert row["view"] in text


def test_view_command_reads_a_log_as_check_did(run, tmp_path: Path) -> None:
    (tmp_path / "log.txt").write_text("[12:00:00.000] TX: AA 01 01 03 E8 00 00 00 00 EE\n" * 2)
    given = ("--date", "2026-01-31", "--zone", "+08:00")
    done = run("check", "log.txt", *given, "--expect", "max(rpm) < 9", "--format", "json")
    words = shlex.split(json.loads(done.stdout)["rules"][0]["row"]["view"])
    assert words[2:7] == ["log.txt", *given]
    shown = run("decode", *words[2:])
    assert shown.returncode == 0, shown.stderr
    assert shown.stdout.count("AA 01 01") == 2
    piped = run(
        "check", "-", *given, "--expect", "max(rpm) < 9", stdin=(tmp_path / "log.txt").read_bytes()
    )
    assert "fte-sniff view" not in piped.stdout


def test_the_first_row_names_its_file(run, samples: Path, tmp_path: Path) -> None:
    folder = tmp_path / "logs"
    folder.mkdir()
    good, bad = (folder / f"{name}.mcap" for name in ("good", "bad"))
    good.write_bytes((samples / "clean.mcap").read_bytes())
    bad.write_bytes((samples / "damaged.mcap").read_bytes())
    for jobs in ("1", "2"):
        arguments = ["check", folder, "--expect", BAD, "--jobs", jobs, "--format"]
        text, reported, suites = (
            run(*arguments, form).stdout for form in ("text", "json", "junit")
        )
        first = f"first in {bad} at 2026-01-31T12:00:00.066938325Z, offset 20 of sim://"
        assert text.splitlines()[2].startswith(f"    {first}")
        assert json.loads(reported)["rules"][0]["row"]["file"] == str(bad)
        ((case,),) = JUnitXml.fromstring(suites.encode())
        assert first in case.result[0].message
    reported = run("check", bad, "--expect", BAD, "--format", "json").stdout
    assert json.loads(reported)["rules"][0]["row"]["file"] == str(bad)


def test_damage_of_a_file_is_in_every_form(run, samples: Path, tmp_path: Path) -> None:
    cut = tmp_path / "cut.mcap"
    whole = (samples / "clean.mcap").read_bytes()
    cut.write_bytes(whole[: len(whole) // 2])
    arguments = ["check", cut, "--expect", "count(malformed) == 0", "--format"]
    reported, suites = (run(*arguments, form) for form in ("json", "junit"))
    assert (reported.returncode, suites.returncode) == (0, 0)
    (note,) = json.loads(reported.stdout)["notes"]
    assert reported.stderr == suites.stderr == f"fte-sniff: {note}\n"
    assert note.startswith(f"{cut}: it is cut off")
    (suite,) = ElementTree.fromstring(suites.stdout)
    assert suite.findtext("system-err") == note
    assert (suite.get("errors"), suite.get("failures")) == ("0", "0")
    stats = json.loads(run("stats", cut, "--format", "json").stdout)
    assert stats["notes"] == [note]


def test_rules_of_a_file_and_options_together(run, samples: Path, tmp_path: Path) -> None:
    rules = tmp_path / "rules.toml"
    rules.write_text(
        f'[[rule]]\nname = "good"\nexpect = "{GOOD}"\n'
        f'[[rule]]\nname = "perhaps"\nexpect = "{UNCOVERED}"\nmay_be_uncovered = true\n'
    )
    arguments = ["check", samples / "clean.mcap", "--rules", rules, "--format", "json"]
    reported = json.loads(run(*arguments, "--expect", BAD).stdout)
    assert [(one["name"], one["verdict"]) for one in reported["rules"]] == [
        ("good", "pass"),
        ("perhaps", "not covered"),
        (BAD, "pass"),
    ]
    assert reported["passed"] is True
    assert run(*arguments).returncode == 0


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('[[rule]]\nname = "x"\nexpct = "y"\n', "unknown key 'expct'; did you mean expect?"),
        ('[[rule]]\nname = "x"\nexpect = "min(kind) > 0"\n', "kind is a word, not a number"),
        ('[[rule]]\nname = "x"\nexpect = "duration() > nan"\n', "NaN is not a number"),
    ],
)
def test_an_invalid_rule_is_one_line_and_nothing_is_read(
    run, tmp_path: Path, text: str, message: str
) -> None:
    rules = tmp_path / "rules.toml"
    rules.write_text(text)
    done = run("check", tmp_path / "absent.mcap", "--rules", rules)
    assert (done.returncode, done.stdout) == (2, "")
    assert len(done.stderr.splitlines()) == 1
    assert f"{rules}: rule 1 'x': {message}" in done.stderr


@pytest.mark.parametrize("encoding", ["utf-8-sig", "gbk"])
def test_rules_are_utf_8_with_or_without_a_byte_order_mark(
    run, samples: Path, tmp_path: Path, encoding: str
) -> None:
    rules = tmp_path / "rules.toml"
    rules.write_text(f"[[rule]]\nname = '没有损坏'\nexpect = '{BAD}'\n", encoding)
    done = run("check", samples / "clean.mcap", "--rules", rules)
    if encoding == "gbk":
        assert (done.returncode, done.stdout) == (4, "")
        assert done.stderr == f"fte-sniff: {rules}:2 is not UTF-8; save the file as UTF-8\n"
    else:
        assert (done.returncode, done.stderr) == (0, "")
        assert "没有损坏" in done.stdout


def test_without_rules_and_with_unreadable_rules(run, samples: Path, tmp_path: Path) -> None:
    done = run("check", samples / "clean.mcap")
    assert done.returncode == 2
    assert "--expect" in done.stderr
    done = run("check", samples / "clean.mcap", "--rules", tmp_path / "absent.toml")
    assert done.returncode == 4
    assert "no such file" in done.stderr
    rule = '[[rule]]\nname = "a"\nexpect = "count(ok) > 0"\n'
    (tmp_path / "large.toml").write_text(rule + "# comment\n" * 100_000)
    done = run("check", samples / "clean.mcap", "--rules", tmp_path / "large.toml")
    assert (done.returncode, done.stdout) == (4, "")
    assert "large.toml is larger than 1 MB" in done.stderr


@pytest.mark.parametrize("name", ["clean.mcap", "clean.hex", "clean.raw"])
def test_a_named_pipe_is_read_once(run, samples: Path, tmp_path: Path, name: str) -> None:
    os.mkfifo(tmp_path / "pipe")
    with running(["cp", samples / name, tmp_path / "pipe"]):
        done = run("check", tmp_path / "pipe", "--expect", "count(ok) == 1200")
    assert (done.returncode, done.stderr) == (0, "")


def test_an_empty_and_a_junk_recording_are_named_and_the_others_judged(
    run, samples: Path, tmp_path: Path
) -> None:
    folder = tmp_path / "logs"
    folder.mkdir()
    (folder / "a.mcap").write_bytes((samples / "clean.mcap").read_bytes())
    (folder / "b.mcap").touch()
    (folder / "c.mcap").write_bytes(b"junk" * 100)
    for rule, verdict in ((BAD, "pass"), (UNCOVERED, "not covered")):
        done = run("check", folder, "--expect", rule)
        assert done.returncode == 4
        assert done.stdout.splitlines()[1].split()[-2:][-1] == verdict.split()[-1]
        assert [line.split()[1].rstrip(":") for line in done.stderr.splitlines()] == [
            str(folder / "b.mcap"), str(folder / "c.mcap"),
        ]  # fmt: skip
    (suite,) = JUnitXml.fromstring(
        run("check", folder, "--expect", BAD, "--format", "junit").stdout.encode()
    )
    assert (suite.tests, suite.failures, suite.errors) == (3, 0, 2)


def test_an_input_without_rows_covers_nothing(run, tmp_path: Path) -> None:
    done = run("check", write(tmp_path / "a.mcap", []), "--expect", "count(malformed) == 0")
    assert done.returncode == 1
    assert "not covered" in done.stdout


def test_junit(run, samples: Path) -> None:
    name = "count(port != '<&\"') >= 0"
    rules = [word for rule in (name, BAD, UNCOVERED) for word in ("--expect", rule)]
    text = run("check", samples / "damaged.mcap", *rules, "--format", "junit").stdout
    (suite,) = JUnitXml.fromstring(text.encode())
    assert (suite.tests, suite.failures, suite.errors) == (3, 2, 0)
    good, bad, uncovered = suite
    assert (good.name, good.is_passed) == (name, True)
    (failure,) = bad.result
    assert "measured 66 rows; first at 2026-01-31T12:00:00.066938325Z" in failure.message
    (failure,) = uncovered.result
    assert failure.type == "not covered"


def test_names_from_files_cannot_control_the_terminal(run, samples: Path, tmp_path: Path) -> None:
    rules = tmp_path / "rules.toml"
    rules.write_text(f'[[rule]]\nname = "\\u001b[31mred\\u202e<b>\\uFFFF"\nexpect = "{BAD}"\n')
    for form in ("text", "json", "junit"):
        done = run("check", samples / "damaged.mcap", "--rules", rules, "--format", form)
        assert done.returncode == 1
        assert not {"\x1b", "\u202e", "\uffff"} & set(done.stdout)
    ((case,),) = JUnitXml.fromstring(done.stdout.encode())
    assert case.name == r"\x1b[31mred\u202e<b>\uffff"


# The rules of the documentation

FAULTS = dict[str, Callable[[list[Row]], list[Row]]]


def feedback(t_ns: int, motor: int, **values: int) -> Frame:
    known = {"motor": motor, "rpm": 100, "error": 0, "online": 15} | values
    return Frame("a", 0, encode(KIND_BY_NAME["speed_feedback"], known), t_ns)


def a_good_minute() -> list[Row]:
    rows: list[Row] = []
    for at in range(2401):
        t_ns = START_NS + at * 25 * MS
        if at % 40 == 0:
            command = encode(KIND_BY_NAME["speed"], {"motor": 1, "rpm": 100})
            rows.append(Frame("a", 0, command, t_ns))
        rows += [feedback(t_ns + motor * 2 * MS, motor) for motor in (1, 2, 3, 4)]
    return [_at(row, 10 * number) for number, row in enumerate(rows)]


def _at(row: Row, offset: int) -> Row:
    return type(row)(row.port, offset, row.raw, row.t_ns, row.faults)


def _is_feedback(row: Row, motor: int) -> bool:
    return isinstance(row, Frame) and row.raw[0] == 0x55 and row.values["motor"] == motor


def _with(rows: list[Row], row: Row) -> list[Row]:
    """The rows with another one instead of one of motor 3's."""
    at = 1000 + next(n for n, one in enumerate(rows[1000:]) if _is_feedback(one, 3))
    found = type(row)(row.port, rows[at].offset, row.raw, rows[at].t_ns, row.faults)
    return [*rows[:at], found, *rows[at + 1 :]]


def _late_answers(rows: list[Row]) -> list[Row]:
    late = [feedback((row.t_ns or 0) + 20 * MS, 1) if _is_feedback(row, 1) else row for row in rows]
    return sorted(late, key=lambda row: row.t_ns or 0)


def _without_answers(rows: list[Row]) -> list[Row]:
    second = next(n for n, row in enumerate(rows[10:], 10) if row.raw[0] == 0xAA)
    doubled = type(rows[0])("a", 0, rows[0].raw, (rows[second].t_ns or 0) + 1000)
    return [*rows[: second + 1], doubled, *rows[second + 1 :]]


BROKEN: FAULTS = {
    "no damage": lambda rows: _with(rows, Damage("a", 0, bytes(10), 0, (Fault.NOISE,))),
    "hardly anything undefined": lambda rows: [
        type(row)(row.port, row.offset, row.raw, row.t_ns, (Fault.RESERVED_NONZERO,))
        if number % 500 == 0 else row
        for number, row in enumerate(rows)
    ],
    "all four motors online": lambda rows: _with(rows, feedback(0, 3, online=11)),
    **{
        f"feedback of motor {motor}": lambda rows, motor=motor: [
            row for number, row in enumerate(rows) if not _is_feedback(row, motor) or number % 3
        ]
        for motor in (1, 2, 3, 4)
    },
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
    assert block.count("\n# ") + block.startswith("# ") == 10
    return path


def verdicts(run, path: Path, rules: Path) -> dict[str, str]:
    done = run("check", path, "--rules", rules, "--format", "json")
    return {one["name"]: one["verdict"] for one in json.loads(done.stdout)["rules"]}


def test_the_documented_rules_pass_on_a_good_minute(run, documented: Path, tmp_path: Path) -> None:
    found = verdicts(run, write(tmp_path / "good.mcap", a_good_minute()), documented)
    assert found == dict.fromkeys(BROKEN, "pass")


@pytest.mark.parametrize("name", first(10, sorted(BROKEN, key=lambda name: name[-1] in "234")))
def test_each_documented_rule_finds_its_fault(
    run, documented: Path, tmp_path: Path, name: str
) -> None:
    rows = BROKEN[name](a_good_minute())
    found = verdicts(run, write(tmp_path / "bad.mcap", rows), documented)
    assert found[name] == "fail"


@pytest.mark.parametrize("columns", [60, 80, 200])
def test_a_terminal_of_any_width_shows_every_verdict_on_one_line(
    samples: Path, environment: dict[str, str], tmp_path: Path, columns: int
) -> None:
    rules = [word for rule in (BAD, UNCOVERED) for word in ("--expect", rule)]
    file = str(samples / "damaged.mcap")
    with terminal(environment, tmp_path, "check", file, *rules, size=(columns, 24)) as one:
        assert one.ended() == 1
        lines = re.sub(r"\x1b\[[0-9;]*m", "", one.drawn.decode()).splitlines()
    assert len(lines) == 6
    # What names a row is never cut: a command can be copied whole.
    whole = [line for line in lines if not line.startswith("    f")]
    assert len(whole) == 4
    assert max(map(cell_len, whole)) <= columns
    assert lines[3].endswith("--filter malformed")
    assert "fail" in lines[1]
    assert "not covered" in lines[4]
