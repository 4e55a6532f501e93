"""The program with another frame table: other names, headers, longer frames, and one kind more.

A copy of the program, whose `protocol/spec.py` has another table, runs from its sources. So a name,
an offset or a length that other code states itself is found here.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import pytest
from mcap.reader import make_reader

from tests.beside import Process
from tests.cli.conftest import ROOT
from tests.cli.program import plain_environment
from tests.needs import needs

CHANGES = {
    "FRAME_LENGTH = 10": "FRAME_LENGTH = 12",
    "TAIL = 0xEE": "TAIL = 0xED",
    "{Direction.CONTROL: 0xAA, Direction.FEEDBACK: 0x55}": (
        "{Direction.CONTROL: 0xA5, Direction.FEEDBACK: 0x5A}"
    ),
    "KIND_BY_NAME: Mapping": """
_NAMES = {
    Role.MOTOR: "axis", Role.SPEED: "spin", Role.POSITION: "ticks", Role.FORWARD: "ahead",
    Role.LEFT: "aside", Role.ROTATION: "around", Role.ERRORS: "alarm", Role.ONLINE: "alive",
}
_KIND_NAMES = dict(zip(
    [kind.name for kind in KINDS],
    ["halt", "turn", "move", "drive", "turn_feedback", "move_feedback"],
    strict=True,
))


def _other(kind: FrameKind) -> FrameKind:
    fields = tuple(
        replace(
            one,
            name=_NAMES[one.role],
            option=_NAMES[one.role],
            start=one.start + 2 * (one.legal_bits is not None),
        )
        for one in kind.fields
    )
    used = {at for one in fields for at in one.offsets}
    free = [at for at in range(NUM_OFFSET + 1, FRAME_LENGTH - 1) if at not in used]
    name, reserved = _KIND_NAMES[kind.name], range(free[0], free[-1] + 1)
    return replace(kind, name=name, fields=fields, reserved=reserved)


CHARGE = Field("charge", 3, 2, 0, 0xFFFF, "mV", "charge of the battery", "charge")
KINDS = (
    *map(_other, KINDS),
    FrameKind("charge_feedback", _FEEDBACK, (9,), (CHARGE,), range(5, 11), "the battery"),
)
KIND_BY_NAME: Mapping""",
}
"""What is changed in `spec.py`: each text, which is there once, and what replaces it."""

COUNT = 600


COMMANDS = """
import json, os, sys
from pathlib import Path
from tests.in_process import call

commands, ended = os.fdopen(os.dup(0)), os.fdopen(os.dup(1), "w")
for line in commands:
    code, output, errors = call(json.loads(line), b"", Path.cwd(), dict(os.environ))
    print(json.dumps([code, output.decode(), errors.decode()]), file=ended, flush=True)
"""
"""One command after the other, without the start of a process for each."""


class Other(NamedTuple):
    """The other program, and its folder with a recording of its simulated line."""

    folder: Path
    process: Process


@pytest.fixture(scope="module")
@needs("program")
def other(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Other]:
    """The other program."""
    folder = tmp_path_factory.mktemp("other")
    ignored = shutil.ignore_patterns("*.so", "*.pyd")
    shutil.copytree(ROOT / "fte_sniff", folder / "fte_sniff", ignore=ignored)
    spec = folder / "fte_sniff/protocol/spec.py"
    source = spec.read_text()
    for old, new in CHANGES.items():
        assert source.count(old) == 1, f"spec.py has changed: {old}"
        source = source.replace(old, new)
    spec.write_text(source)
    port = "sim://?seed=1&rate=400&drop=0.02&flip=0.02&noise=0.02"
    command, pipe = [sys.executable, "-c", COMMANDS], subprocess.PIPE
    with subprocess.Popen(
        command, cwd=folder, env=environment(folder), stdin=pipe, stdout=pipe
    ) as process:
        other = Other(folder, process)
        run(other, "live", port, "--headless", "--count", str(COUNT), "-o", "line.mcap")
        yield other


def environment(folder: Path) -> dict[str, str]:
    paths = {"PYTHONPATH": f"{folder}{os.pathsep}{ROOT}", "XDG_STATE_HOME": str(folder / "state")}
    settings = {"FTE_SNIFF_CONFIG": str(folder / "config.toml")}
    return plain_environment() | paths | settings


def run(other: Other, *arguments: str) -> str:
    commands, ended = other.process.stdin, other.process.stdout
    assert commands is not None
    assert ended is not None
    commands.write(json.dumps(arguments).encode() + b"\n")
    commands.flush()
    code, output, errors = json.loads(ended.readline())
    assert code == 0, errors
    return str(output)


def test_a_frame_is_encoded_and_decoded(other: Other) -> None:
    frame = run(other, "encode", "move", "--axis", "2", "--spin", "300", "--ticks", "-5")
    assert frame == "A5 02 02 01 2C FF FF FF FB 00 00 ED\n"
    shown = run(other, "hex", frame.strip())
    for text in ("move", "axis", "300 RPM", "-5 pulses", "    11    ED"):
        assert text in shown


def test_decoding_gives_the_other_columns_in_every_format(other: Other) -> None:
    head, *lines = run(other, "decode", "line.mcap", "--format", "csv").splitlines()
    assert "axis,spin,ticks,ahead,aside,around,alarm,alive" in head
    assert len(lines) == COUNT
    rows = [
        json.loads(line)
        for line in run(other, "decode", "line.mcap", "--format", "jsonl").splitlines()
    ]
    assert {row["length"] for row in rows if row["kind"]} == {12}
    assert {row["kind"] for row in rows} >= {"halt", "drive", "turn_feedback", None}
    asked = run(other, "decode", "line.mcap", "--format", "jsonl", "--filter", "spin > 0")
    assert [json.loads(line) for line in asked.splitlines()] == [
        row for row in rows if (row["spin"] or 0) > 0
    ]
    for copy in ("copy.parquet", "copy.csv", "copy.mcap", "copy.bin"):
        run(other, "decode", "line.mcap", "-o", copy, "--force")
    again = run(other, "decode", "copy.mcap", "--format", "csv")
    assert again.splitlines() == [head, *lines]


def test_a_further_kind_is_one_entry_of_the_table(other: Other) -> None:
    frames = [run(other, "encode", "charge_feedback", "--charge", text) for text in ("7", "65535")]
    lines = (f"12:00:{at:02} {frames[at % 2]}" for at in range(20))
    (other.folder / "charge.log").write_text("".join(lines))
    run(other, "decode", "charge.log", "--date", "2026-01-31", "-o", "charge.mcap", "--force")
    for file in ("charge.log", "charge.mcap"):
        shown = run(other, "decode", file, "--format", "jsonl", "--filter", "charge > 7")
        found = [json.loads(line) for line in shown.splitlines()]
        assert {(row["kind"], row["charge"], row["axis"]) for row in found} == {
            ("charge_feedback", 65535, None)
        }
        assert len(found) == 10
    topics = {name for name in topics_in(other.folder / "charge.mcap") if "charge" in name}
    assert topics == {"/fte/feedback/charge_feedback"}
    assert "65535 mV" in run(other, "hex", frames[1].strip())
    assert "charge 7 .. 65535" in run(other, "stats", "charge.mcap")


def topics_in(path: Path) -> set[str]:
    """The topics of an MCAP file that have messages, as its own reader finds them."""
    with path.open("rb") as stream:
        return {channel.topic for _, channel, _ in make_reader(stream).iter_messages()}


def test_statistics_and_checks_follow_the_roles(other: Other) -> None:
    found = json.loads(run(other, "stats", "line.mcap", "--format", "json"))
    motors = found["motors"]
    assert all(motor["commands"] and motor["feedback"] and motor["answered"] for motor in motors)
    streams = found["ports"][0]["streams"]
    assert {name for one in streams for name in one["values"]} >= {"spin", "ahead"}
    rules = ["max(spin) < 5000", "online(1) >= 0.5", "unanswered() >= 0", "delay(p50) < 1000"]
    shown = run(other, "check", "line.mcap", *(word for one in rules for word in ("--expect", one)))
    assert shown.count("pass") == len(rules)


def test_facts_findings_and_decoders_follow_the_table(other: Other) -> None:
    shown = run(other, "decode", "line.mcap", "--format", "jsonl", "--filter", "answer_ms > 0")
    assert {json.loads(line)["kind"] for line in shown.splitlines()} <= {"turn", "move", "drive"}
    assert shown
    found = json.loads(run(other, "findings", "line.mcap", "--format", "json"))
    assert found["examined"]["rows"] == COUNT
    for one in found["findings"]:
        run(other, "decode", "line.mcap", "--filter", one["filter"], "--format", "csv")
    assert "axis" in run(other, "decoder", "wireshark")


def test_a_report_has_the_plots_of_the_motors(other: Other) -> None:
    pytest.importorskip("bokeh")
    run(other, "report", "line.mcap", "-o", "report.html", "--force")
    page = (other.folder / "report.html").read_text()
    assert "motor 1: spin [RPM]" in page
    assert "bad_tail" in page or "noise" in page
