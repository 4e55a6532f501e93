"""`hex` and `encode`: bytes to fields and back."""

from __future__ import annotations

import pytest

from fte_sniff.protocol.spec import KINDS, FrameKind, encode
from tests.cli.processes import started
from tests.cli.terminals import terminal
from tests.protocol.document import EXAMPLES, Example
from tests.waiting import BOUND_S

FRAME = "AA 02 02 03 E8 00 00 27 10 EE"


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


def test_a_paste_on_a_terminal(environment, tmp_path) -> None:
    with terminal(environment, tmp_path, "hex") as screen:
        screen.until("paste the bytes, then press Enter and Ctrl-D")
        screen.type(f"[14:03:22.123]发→◇{FRAME}\n\x04")
        screen.until("10000 pulses")
        assert screen.process.wait(BOUND_S) == 0


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.name)
def test_raw_bytes_go_to_a_port(environment, tmp_path, pty, kind: FrameKind) -> None:
    values = {field.name: field.high // 3 + 1 for field in kind.fields}
    options = [f"--{field.option}={values[field.name]}" for field in kind.fields]
    words = ("encode", kind.name, *options, "--raw")
    with started(environment, tmp_path, *words, stdout=pty.near) as sending:
        assert sending.wait(BOUND_S) == 0
    assert pty.arrived(BOUND_S) == encode(kind, values)
