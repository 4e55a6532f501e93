"""`encode` and `hex` are each other's inverse, and what does not fit is named."""

import json

import pytest

from fte_sniff.protocol import KINDS, FrameKind, encode, spaced_hex


@pytest.mark.parametrize(
    ("arguments", "frame"),
    [
        ("reset", "AA 00 00 00 00 00 00 00 00 EE"),
        ("speed --motor 1 --rpm 1000", "AA 01 01 03 E8 00 00 00 00 EE"),
        ("position --motor 2 --rpm 1000 --pulses 10000", "AA 02 02 03 E8 00 00 27 10 EE"),
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
    ("arguments", "told"),
    [
        ("speed --motor 5 --rpm 0", ["motor 5", "1..4"]),
        ("speed --motor 1 --rpm 32768", ["rpm 32768", "-32768..32767 RPM"]),
        ("position --motor 1 --rpm 0 --pulses 2147483648", ["pulses", "2147483647 pulses"]),
        ("mecanum --vx 40000 --vy 0 --wz 0", ["vx_cm_s 40000", "cm/s"]),
        ("speed_feedback --motor 1 --rpm 0 --error 256", ["error 256", "0..255"]),
        ("speed_feedback --motor 1 --rpm 0 --cmd 2", ["cmd 2", "1 or 3"]),
        ("speed --motor 1", ["--rpm"]),
        ("speed --motor one --rpm 1", ["'one'", "no integer"]),
        ("sped --motor 1", ["No such command 'sped'"]),
    ],
)
def test_what_does_not_fit_is_one_line_that_names_it(run, arguments: str, told: list[str]) -> None:
    done = run("encode", *arguments.split())
    assert done.returncode == 2
    assert done.stdout == ""
    assert done.stderr.count("\n") == 1
    assert all(word in done.stderr for word in told), done.stderr
