"""`hex` and `encode`: bytes to fields and back."""

from __future__ import annotations

import csv
import io
import json
import os
import subprocess
from decimal import Decimal
from pathlib import Path

import pytest
from click.testing import CliRunner
from hypothesis import given
from hypothesis import strategies as st

from fte_sniff.analysis.statistics import LineSetup
from fte_sniff.cli.encode import command as encode_command
from fte_sniff.protocol import KIND_BY_NAME, KINDS, FrameKind, encode, spaced_hex
from tests.cli.processes import started
from tests.cli.terminals import terminal
from tests.protocol.document import EXAMPLES, Example
from tests.waiting import BOUND_S

POSITION = KIND_BY_NAME["position"]
FRAME = "AA 02 02 03 E8 00 00 27 10 EE"


def test_every_byte_is_explained(run) -> None:
    done = run("hex", *FRAME.split())
    assert done.returncode == 0
    assert done.stderr == ""
    title, *parts = done.stdout.splitlines()
    assert title == "offset 0  position  motor=2 rpm=1000 pulses=10000  ok"
    explained = [line.split()[0] for line in parts]
    assert explained == ["0", "1", "2", "3-4", "5-8", "9"]
    for word in ("header", "cmd", "motor", "speed limit", "10000 pulses", "tail"):
        assert word in done.stdout


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda example: example.text)
def test_examples_of_the_document_are_printed(run, example: Example) -> None:
    fields = example.frame_kind.fields
    options = [f"--{field.option}={example.values[field.name]}" for field in fields]
    assert run("encode", example.kind, *options).stdout == f"{example.text}\n"
    done = run("hex", example.text)
    title, *parts = done.stdout.splitlines()
    assert (done.returncode, done.stderr) == (0, "")
    assert title.split() == ["offset", "0", example.kind, *example.shown.split(), "ok"]
    for field in fields:
        first, last = field.offsets[0], field.offsets[-1]
        offsets = f"{first}" if first == last else f"{first}-{last}"
        (part,) = [part for part in parts if part.split()[0] == offsets]
        assert f" {field.name} " in part
        assert f" {field.text(example.values[field.name])} {field.unit}".rstrip() in part


@pytest.mark.parametrize(("speed", "lines"), [("00 00", 0), ("00 0A", 1), ("FF F6", 1)])
def test_a_move_to_the_side_names_the_erratum(run, speed: str, lines: int) -> None:
    shown = run("hex", f"AA 03 00 00 14 {speed} 00 00 EE").stdout
    assert shown.count("its example calls +10 right (erratum 3)") == lines


def test_several_frames_and_junk_between_them(run) -> None:
    done = run("hex", f"{FRAME} 13 37 {FRAME}", "--format", "jsonl")
    rows = [json.loads(line) for line in done.stdout.splitlines()]
    assert [row["offset"] for row in rows] == [0, 10, 12]
    assert [row["faults"] for row in rows] == [[], ["noise"], []]
    assert "".join(row["raw"] for row in rows) == (FRAME + "1337" + FRAME).replace(" ", "")


def test_the_same_rows_as_csv(run) -> None:
    rows = list(csv.DictReader(io.StringIO(run("hex", FRAME, "--format", "csv").stdout)))
    assert [(row["kind"], row["motor"], row["pulses"]) for row in rows] == [
        ("position", "2", "10000")
    ]


def test_standard_input(run) -> None:
    assert run("hex", "-", stdin=FRAME).stdout == run("hex", FRAME).stdout
    assert run("hex", stdin=f"[10:00:01.123] RX {FRAME}\n").stdout == run("hex", FRAME).stdout


def test_no_hex_is_one_line_that_points_at_the_character(run) -> None:
    done = run("hex", "AA", "0G")
    assert (done.returncode, done.stdout) == (2, "")
    assert "'G'" in done.stderr
    assert "column 5" in done.stderr
    assert done.stderr.count("\n") == 1


def test_half_a_byte_at_the_end_is_a_mistake(run) -> None:
    done = run("hex", "AA 01 01 03 E8 00 00 00 00 E")
    assert (done.returncode, done.stdout) == (2, "")
    assert "not hex: 'E' in line 1, column 28" in done.stderr


def test_directions_of_a_paste_are_streams_of_their_own(run) -> None:
    host, answer = "AA 01 01 03 E8 00 00 00 00 EE", "55 01 01 03 E8 00 00 00 0F EE"
    for tx, rx in (("TX: ", "RX: "), ("发送：", "接收："), (">> ", "<< ")):
        text = f"{rx}{answer[:11]}\n{tx}{host}\n{rx}{answer[12:]}\n"
        done = run("hex", "--format", "jsonl", stdin=text)
        rows = [json.loads(line) for line in done.stdout.splitlines()]
        assert [(row["port"], row["raw"]) for row in rows] == [
            ("hex:rx", answer.replace(" ", "")),
            ("hex:tx", host.replace(" ", "")),
        ]
        assert done.stderr == ""


def test_no_bytes_at_all(run) -> None:
    done = run("hex", "-", stdin="# nothing")
    assert done.returncode == 2
    assert "no bytes on standard input" in done.stderr


def test_a_file_name_is_recognised(run, tmp_path) -> None:
    (tmp_path / "log.hex").write_text(FRAME)
    done = run("hex", "log.hex")
    assert done.returncode == 2
    assert "fte-sniff decode log.hex" in done.stderr


def test_ambiguity_and_damage_are_explained(run) -> None:
    done = run("hex", "55 01 01 03 E8 00 01 80 8F EE 99")
    assert "suspect (undefined_flags,reserved_nonzero)" in done.stdout
    assert "expected 00 00 as in the protocol, found 00 01" in done.stdout
    assert "malformed (noise)" in done.stdout
    assert done.returncode == 0


def test_readings_are_shown_with_their_probabilities(run) -> None:
    frames = "AA 01 01 03 E8 AA 02 01 03 E8 00 00 00 0F EE 55 01 01 03 E8 00 00 00 0F EE"
    lines = run("hex", frames).stdout.splitlines()
    assert [line.split(": ")[1] for line in lines if line.startswith("  probability ")] == [
        "truncated AA 01 01 03 E8",
        "truncated AA 01 01 03 E8 (AA)",
        "position AA 02 01 03 E8 00 00 00 0F EE",
        "truncated (AA 01 01 03 E8) AA + rest of a frame 02 01 03 E8 00 00 00 0F EE",
    ]
    assert "why" not in run("hex", frames, "--format", "jsonl").stdout


def test_a_long_paste_that_is_not_hex(run) -> None:
    for paste in ("A" * 1001, "Z" * 1001):
        done = run("hex", paste)
        assert done.returncode == 2
        assert done.stderr.count("\n") == 1


def test_dash_and_bytes_are_not_mixed(run) -> None:
    done = run("hex", "AA", "-", stdin="BB")
    assert done.returncode == 2
    assert "not both" in done.stderr


def test_standard_input_without_end_is_taken_apart_as_it_comes(environment, tmp_path) -> None:
    with started(environment, tmp_path, "hex", "-", stdin=subprocess.PIPE) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        process.stdin.write(f"{FRAME}\n".encode() * 200)
        process.stdin.flush()
        assert b"position" in os.read(process.stdout.fileno(), 1 << 16)
        process.kill()


def test_a_dump_is_read_and_its_doubts_are_reported(run) -> None:
    dump = f"00000000  {FRAME.lower()}  |......'.|\n"
    assert "may be" not in run("hex", dump).stderr
    bare = run("hex", f"0000: {FRAME}")
    assert bare.stdout == run("hex", FRAME).stdout
    assert bare.stderr == "fte-sniff: line 1 holds words that are not read as bytes: '0000'\n"
    way = run("hex", "-", stdin=f"RX: {FRAME}\n")
    assert way.stdout == bare.stdout
    # A tap receives both directions, so the label of one frame is not a reason to doubt it.
    assert way.stderr == ""


def test_a_paste_on_a_terminal(environment, tmp_path) -> None:
    with terminal(environment, tmp_path, "hex") as screen:
        screen.until("paste the bytes, then press Enter and Ctrl-D")
        screen.type(f"[14:03:22.123]发→◇{FRAME}\n\x04")
        screen.until("10000 pulses")
        assert screen.process.wait(BOUND_S) == 0


def test_raw_bytes_on_standard_input_are_decodes_business(run, samples: Path) -> None:
    done = run("hex", stdin=(samples / "clean.raw").read_bytes()[:300])
    assert done.returncode == 4
    assert done.stderr.splitlines() == [
        "fte-sniff: standard input: holds no text; if it holds raw bytes, try:"
        " fte-sniff decode - --input raw"
    ]


def test_words_between_frames_are_reported_on_standard_error(run) -> None:
    frames = ("AA 01 01 00 64 00 00 00 00 EE", "55 01 01 00 64 00 00 00 0F EE")
    done = run("hex", f"{frames[0]} 收到 {frames[1]}", "--format", "jsonl")
    assert done.returncode == 0
    raw = [json.loads(line)["raw"] for line in done.stdout.splitlines()]
    assert raw == [frame.replace(" ", "") for frame in frames]
    assert done.stderr == "fte-sniff: line 1 holds words that are not read as bytes: '收到'\n"


@pytest.mark.parametrize(
    ("arguments", "frame"),
    [
        ("reset", "AA 00 00 00 00 00 00 00 00 EE"),
        ("speed --motor 1 --rpm 1000", "AA 01 01 03 E8 00 00 00 00 EE"),
        ("position --motor 2 --rpm 1000 --pulses 10000", "AA 02 02 03 E8 00 00 27 10 EE"),
        (
            "position --motor 2 --rpm 1000 --turns 2.5 --resolution 4096 --gear-ratio 30",
            "AA 02 02 03 E8 00 04 B0 00 EE",
        ),
        (
            "position-feedback --motor 1 --turns -0.1 --resolution 500",
            "55 02 01 FF FF FF CE 00 0F EE",
        ),
        ("mecanum --vx 10 --vy 0 --wz 0", "AA 03 00 00 0A 00 00 00 00 EE"),
        ("mecanum --vx 20 --vy -10 --wz 0", "AA 03 00 00 14 FF F6 00 00 EE"),
        ("speed_feedback --motor 1 --rpm 1000", "55 01 01 03 E8 00 00 00 0F EE"),
        ("speed-feedback --motor 4 --rpm -1 --cmd 3", "55 03 04 FF FF 00 00 00 0F EE"),
        ("position_feedback --motor 1 --pulses 10000", "55 02 01 00 00 27 10 00 0F EE"),
        ("position-feedback --motor 1 --pulses 0 --error 0x03 --online 7", "55 02 01" + " 00" * 4),
    ],
)
def test_frames_on_the_command_line(run, arguments: str, frame: str) -> None:
    done = run("encode", *arguments.split())
    assert done.returncode == 0
    assert done.stdout.startswith(frame)
    assert done.stderr == ""


def test_kinds_have_a_hyphen_in_help_and_may_be_written_with_an_underscore(run) -> None:
    listed = run("encode", "--help").stdout
    for kind in KINDS:
        assert f"  {kind.name.replace('_', '-')} " in listed
    values = ("--motor", "1", "--pulses", "5")
    printed = run("encode", "position-feedback", *values).stdout
    assert printed
    assert printed == run("encode", "position_feedback", *values).stdout


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.name)
def test_raw_bytes_go_to_a_port(environment, tmp_path, pty, kind: FrameKind) -> None:
    values = {field.name: field.high // 3 + 1 for field in kind.fields}
    options = [f"--{field.option}={values[field.name]}" for field in kind.fields]
    words = ("encode", kind.name, *options, "--raw")
    with started(environment, tmp_path, *words, stdout=pty.near) as sending:
        assert sending.wait(BOUND_S) == 0
    assert pty.arrived(BOUND_S) == encode(kind, values)


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.name)
def test_hex_takes_back_what_encode_prints(run, kind: FrameKind) -> None:
    values = {field.name: field.high // 3 + 1 for field in kind.fields}
    options = [f"--{field.option}={values[field.name]}" for field in kind.fields]
    printed = run("encode", kind.name, *options).stdout
    assert printed == spaced_hex(encode(kind, values)) + "\n"
    row = json.loads(run("hex", printed, "--format", "jsonl").stdout)
    assert row["kind"] == kind.name
    assert {name: row[name] for name in values} == values


@pytest.mark.parametrize(
    ("arguments", "reported"),
    [
        ("speed --motor 5 --rpm 0", ["motor 5", "1..4"]),
        ("speed --motor 1 --rpm 32768", ["rpm 32768", "-32768..32767 RPM"]),
        ("position --motor 1 --rpm 0 --pulses 2147483648", ["pulses", "2147483647 pulses"]),
        ("position --motor 1 --rpm 0", ["--pulses", "--turns"]),
        ("position --motor 1 --rpm 0 --turns 1", ["--turns needs --resolution"]),
        ("position --motor 1 --rpm 0 --pulses 1 --turns 1 --resolution 1", ["not both"]),
        ("position --motor 1 --rpm 0 --pulses 1 --resolution 1", ["need --turns"]),
        ("position --motor 1 --rpm 0 --pulses 1 --gear-ratio 1", ["need --turns"]),
        ("position --motor 1 --rpm 0 --turns x --resolution 1", ["--turns", "'x'"]),
        ("position --motor 1 --rpm 0 --turns inf --resolution 1", ["--turns", "'inf'"]),
        ("position --motor 1 --rpm 0 --turns 1 --resolution 0", ["--resolution", "above 0"]),
        (
            "position --motor 1 --rpm 0 --turns 1e9 --resolution 5",
            ["5000000000 pulses", "range"],
        ),
        (
            "position --motor 1 --rpm 0 --turns 1e99999999 --resolution 1e999999999",
            ["1E+99999999 turns", "2147483647 pulses"],
        ),
        ("mecanum --vx 40000 --vy 0 --wz 0", ["vx_cm_s 40000", "cm/s"]),
        ("speed_feedback --motor 1 --rpm 0 --error 256", ["error 256", "0..255"]),
        ("speed_feedback --motor 1 --rpm 0 --cmd 2", ["cmd 2", "1 or 3"]),
        ("speed --motor 1", ["--rpm"]),
        ("speed --motor one --rpm 1", ["'one'", "not an integer"]),
        ("sped --motor 1", ["No such command 'sped'"]),
    ],
)
def test_what_does_not_fit_is_one_line_that_names_it(
    run, arguments: str, reported: list[str]
) -> None:
    done = run("encode", *arguments.split())
    assert done.returncode == 2
    assert done.stdout == ""
    assert done.stderr.count("\n") == 1
    assert all(word in done.stderr for word in reported), done.stderr


@given(
    st.integers(-(2**31), 2**31 - 1),
    st.decimals("0.01", "100000", places=2),
    st.decimals("0.01", "1000", places=2),
)
def test_turns_are_the_inverse_of_what_the_screen_shows(
    pulses: int, resolution: Decimal, gear_ratio: Decimal
) -> None:
    setup = LineSetup(resolution=float(resolution), gear_ratio=float(gear_ratio))
    options = {"resolution": resolution, "gear-ratio": gear_ratio, "turns": setup.turns(pulses)}
    arguments = ["position", "--motor=1", "--rpm=0"]
    arguments += [f"--{name}={value!s}" for name, value in options.items()]
    done = CliRunner().invoke(encode_command, arguments)
    frame = encode(POSITION, {"motor": 1, "rpm": 0, "pulses": pulses})
    assert done.stdout == f"{spaced_hex(frame)}\n"


def test_rounding_to_a_pulse_is_reported(run) -> None:
    turns = ("--turns", "0.333", "--resolution", "4096", "--gear-ratio", "30")
    done = run("encode", "position", "--motor", "2", "--rpm", "1000", *turns)
    assert (done.returncode, done.stdout) == (0, "AA 02 02 03 E8 00 00 9F D7 EE\n")
    assert done.stderr == "fte-sniff: 0.333 turns are 40919.04 pulses; rounded to 40919\n"


@pytest.mark.parametrize(
    ("flags", "bits"),
    [
        ("00 0F", []),
        ("04 0F", ["bit 2 is 1: meaning unknown"]),
        ("00 1B", ["bit 2 is 0: motor 3 not online", "bit 4 is 1: undefined"]),
    ],
)
def test_only_the_bits_that_are_not_as_usual_have_a_line(run, flags: str, bits: list[str]) -> None:
    lines = run("hex", f"55 01 01 03 E8 00 00 {flags} EE").stdout.splitlines()
    shown = [line.strip() for line in lines if line.strip().startswith("bit ")]
    assert len(shown) == len(bits)
    assert all(map(str.startswith, shown, bits))
