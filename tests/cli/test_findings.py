"""`fte-sniff findings`, and the findings in `check`, `stats` and `report`."""

from __future__ import annotations

import json
import shlex
from pathlib import Path

import pytest

KEYS = [
    *("cause", "port", "motor", "kind", "first", "last", "events", "rows"),
    *("usual", "text", "filter"),
]


def test_a_finding_names_cause_motor_span_and_the_command_that_shows_it(run, samples) -> None:
    path = samples / "motor3.mcap"
    done = run("findings", path)
    assert (done.returncode, done.stderr) == (0, "")
    head, text, command = done.stdout.splitlines()[:3]
    assert head == "1. unanswered, motor 3, 12:00:30 to 12:00:59"
    assert "motor 3 answered 109 of 187 commands; usually all" in text
    assert shlex.split(command)[:3] == ["fte-sniff", "view", str(path)]
    shown = run("decode", *shlex.split(command)[2:], "--format", "jsonl").stdout.splitlines()
    assert len(shown) == 187 - 109
    assert {json.loads(line)["motor"] for line in shown} == {3}


def test_the_object_has_the_findings_and_what_was_examined(run, samples) -> None:
    found = json.loads(run("findings", samples / "motor3.mcap", "--format", "json").stdout)
    assert found.keys() == {"findings", "examined"}
    assert [list(one) for one in found["findings"]] == [KEYS] * len(found["findings"])
    assert [(one["cause"], one["motor"]) for one in found["findings"]] == [
        ("unanswered", 3),
        ("late", 3),
    ]
    assert found["examined"]["rows"] == 3762
    assert found["examined"]["not_covered"] == []


def test_standard_input_has_findings_too(run, samples) -> None:
    content = (samples / "motor3.mcap").read_bytes()
    done = run("findings", "-", stdin=content)
    assert "1. unanswered, motor 3" in done.stdout
    assert "fte-sniff view" not in done.stdout


@pytest.mark.parametrize(
    ("name", "begins"),
    [
        (
            "idle.mcap",
            [
                "no findings in 12 rows; examined: port, ",
                "too few, or too even over time, for a finding: commands without an answer 1",
            ],
        ),
        ("clean.hex", ["nothing could be examined: no row has a time; try --start"]),
    ],
)
def test_no_findings_are_reported_with_what_was_examined(run, samples, name, begins) -> None:
    done = run("findings", samples / name)
    assert done.returncode == 0
    lines = done.stdout.splitlines()
    assert len(lines) == len(begins)
    assert all(map(str.startswith, lines, begins))


def test_a_filter_is_refused_because_it_hides_answers(run, samples) -> None:
    done = run("findings", samples / "clean.mcap", "--filter", "motor = 1")
    assert done.returncode == 2
    assert "leave --filter out" in done.stderr


@pytest.mark.parametrize(
    ("rule", "result"),
    [
        ("findings() == 2", "pass"),
        ("findings(unanswered) == 1", "pass"),
        ("findings(unanswered, 3) == 0", "fail"),
        ("findings(unanswered, 1) == 0", "pass"),
    ],
)
def test_a_rule_counts_findings_by_cause_and_motor(run, samples, rule, result) -> None:
    done = run("check", samples / "motor3.mcap", "--expect", rule, "--format", "json")
    assert [one["verdict"] for one in json.loads(done.stdout)["rules"]] == [result]


def test_a_rule_about_what_cannot_be_examined_is_not_covered(run, samples) -> None:
    done = run("check", samples / "clean.hex", "--expect", "findings(late) == 0")
    assert done.returncode == 1
    assert "not covered" in done.stdout


def test_an_unknown_cause_of_a_rule_is_named(run, samples) -> None:
    done = run("check", samples / "clean.mcap", "--expect", "findings(lat) == 0")
    assert done.returncode == 2
    assert "did you mean late?" in done.stderr


def test_stats_name_the_number_of_findings_and_the_command(run, samples) -> None:
    path = samples / "motor3.mcap"
    last = run("stats", path).stdout.splitlines()[-1]
    assert last == "findings   2; see: fte-sniff findings"
    assert "findings  " not in run("stats", path, "--filter", "motor = 1").stdout


def test_a_report_begins_with_the_findings(run, samples: Path, tmp_path: Path) -> None:
    pytest.importorskip("bokeh")
    out = tmp_path / "r.html"
    assert run("report", samples / "motor3.mcap", "-o", out).returncode == 0
    text = out.read_text()
    start = text.index("motor 3 answered 109 of 187 commands")
    assert start < text.index("What was captured")
    assert 'class="finding" data-start="1769860830' in text
    chinese = tmp_path / "zh.html"
    run("report", samples / "motor3.mcap", "-o", chinese, "--lang", "zh")
    assert "电机 3 应答了 187 条命令中的 109 条" in chinese.read_text()


def test_a_filter_of_motor_and_damage_mentions_the_probable_motor(run, samples) -> None:
    path = samples / "damaged.mcap"
    done = run("decode", path, "--filter", "motor = 3 AND malformed")
    assert "motor_hint is the motor that they probably belonged to" in done.stderr
    found = run("decode", path, "--filter", "motor_hint = 3 AND malformed")
    assert "motor_hint is" not in found.stderr
    assert len(found.stdout.splitlines()) > len(done.stdout.splitlines())


@pytest.mark.parametrize(
    ("command", "option", "meant"),
    [("findings", "--json", "--format json"), ("check", "--junit", "--format junit")],
)
def test_a_format_that_is_written_as_an_option_is_named(run, samples, command, option, meant):
    done = run(command, samples / "motor3.mcap", option)
    assert done.returncode == 2
    assert f"Did you mean '{meant}'?" in done.stderr


def test_a_failed_rule_about_findings_names_the_command_that_shows_the_best(run, samples) -> None:
    path = samples / "motor3.mcap"
    shown = run("findings", path).stdout.splitlines()[2].strip()
    rule = ("--expect", "findings(unanswered, 3) == 0")
    lines = run("check", path, *rule).stdout.splitlines()
    assert "motor 3 answered 109 of 187 commands" in lines[2]
    assert lines[3].strip() == shown
    (found,) = json.loads(run("check", path, *rule, "--format", "json").stdout)["rules"]
    assert (found["finding"]["cause"], found["finding"]["view"]) == ("unanswered", shown)
    assert shown.split(" --from ")[0] in run("check", path, *rule, "--format", "junit").stdout


def test_noise_without_times_names_the_missing_frames(run, tmp_path: Path) -> None:
    path = tmp_path / "noise.raw"
    path.write_bytes(bytes(range(0x80)) * 20)
    done = run("findings", path)
    assert "no row is a frame" in done.stdout
    assert "no row has a time" not in done.stdout


def test_a_flag_of_a_second_is_a_finding_with_the_frames_that_stats_count(run, samples) -> None:
    path = samples / "clean.mcap"
    assert "(taken as motor 4) was 0 in 23 frames, 12:00:24.066" in run("stats", path).stdout
    found = json.loads(run("findings", path, "--format", "json").stdout)["findings"][0]
    assert (found["cause"], found["motor"], found["events"]) == ("offline", 4, 23)
    assert (found["first"][11:23], found["last"][11:23]) == ("12:00:24.066", "12:00:25.266")
