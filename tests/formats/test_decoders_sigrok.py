"""sigrok-cli decodes captures of a logic analyser with the generated decoder, sample by sample."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from random import Random

import pytest

from fte_sniff.formats.decoders import SETTLING_BYTES, sigrok_decoder
from fte_sniff.protocol.columns import spaced_hex
from fte_sniff.protocol.rows import Row
from fte_sniff.protocol.spec import (
    DEFAULT_BAUD,
    FRAME_LENGTH,
    KINDS,
    Fault,
    Field,
    FrameKind,
    encode,
)
from tests.recording.conftest import some_rows
from tests.slow import first
from tests.support.tools import needs

pytestmark = needs("sigrok-cli")

SAMPLES_PER_BIT = 16
BYTE = 10 * SAMPLES_PER_BIT
RATE = SAMPLES_PER_BIT * DEFAULT_BAUD
WIRES = ("rx", "tx")

_LINE = re.compile(r'(\d+)-(\d+) fte-1: ([\w-]+): "([^"]*)".*')


@dataclass(frozen=True, slots=True)
class Shown:
    """An annotation of sigrok: first sample, sample after the last, text."""

    first: int
    end: int
    text: str


Placed = list[tuple[int, bytes]]
"""Bytes on a wire without a pause between them, and the sample at which the first begins."""


def levels(placed: Placed, samples: int, broken: Iterable[int] = ()) -> bytearray:
    """The wire's level at each sample; a byte that begins at a `broken` sample has no stop bit."""
    found = bytearray(b"\1") * samples
    for start, data in placed:
        for number, byte in enumerate(data):
            at = start + number * BYTE
            bits = [0, *(byte >> bit & 1 for bit in range(8)), int(at not in broken)]
            found[at : at + BYTE] = b"".join(bytes([bit]) * SAMPLES_PER_BIT for bit in bits)
    return found


def decoded(
    folder: Path, wires: Sequence[Placed], broken: Iterable[int] = (), silence: int = 3
) -> dict[str, list[Shown]]:
    """What sigrok-cli shows, by class of annotation; `silence` byte times follow the last byte."""
    module = folder / "decoders/fte"
    module.mkdir(parents=True, exist_ok=True)
    (module / "__init__.py").write_text(sigrok_decoder())
    end = max(start + len(data) * BYTE for placed in wires for start, data in placed)
    columns = [levels(placed, end + silence * BYTE, broken) for placed in wires]
    capture = folder / "capture.bin"
    wired = zip(*columns, strict=True)
    capture.write_bytes(bytes(sum(bit << n for n, bit in enumerate(at)) for at in wired))
    pins = ":".join(f"{wire}={n}" for n, wire in enumerate(WIRES[: len(wires)]))
    done = subprocess.run(
        [
            *("sigrok-cli", "-I", f"binary:numchannels={len(wires)}:samplerate={RATE}"),
            *("-i", capture, "-P", f"uart:{pins},fte", "-A", "fte"),
            *("--protocol-decoder-samplenum", "-l", "4"),  # that level shows the class
        ],
        env={**os.environ, "SIGROKDECODE_DIR": str(folder / "decoders")},
        capture_output=True,
        text=True,
        check=True,
    )
    assert "Error" not in done.stderr
    found: dict[str, list[Shown]] = defaultdict(list)
    for line in done.stdout.splitlines():
        one = _LINE.fullmatch(line)
        assert one, line
        found[one[3]].append(Shown(int(one[1]), int(one[2]), one[4]))
    return found


def frame_text(row: Row) -> str:
    assert row.framed
    kind = row.kind.name if row.kind else "unknown"
    fields = row.kind.fields if row.kind else ()
    values = [f"{field.name}={field.text(row.values[field.name])}" for field in fields]
    return " ".join([row.direction, kind, *values])


def as_shown(placed: Placed) -> list[Shown]:
    """The annotation of each placed frame."""
    return [
        Shown(start, start + FRAME_LENGTH * BYTE, frame_text(Row("", 0, data, None)))
        for start, data in placed
    ]


def placed_frames(seed: int, count: int, pause: float) -> Placed:
    """Frames of all kinds and values; a share of them comes after a pause."""
    random, placed, at = Random(seed), Placed(), BYTE * 2
    for number in range(count):
        kind = KINDS[number % len(KINDS)]
        raw = encode(kind, {field.name: _value(random, field) for field in kind.fields})
        placed.append((at, raw))
        at += FRAME_LENGTH * BYTE
        if random.random() < pause:
            at += random.randrange(1, 30 * BYTE)
    return placed


def _value(random: Random, field: Field) -> int:
    if field.legal_bits is not None:
        return random.randrange(256) & field.legal_bits
    return random.choice([field.low, field.high, random.randint(field.low, field.high)])


@pytest.mark.parametrize("pause", [0.0, 0.3, 1.0])
def test_every_frame_of_both_wires_is_found_sample_exact(tmp_path: Path, pause: float) -> None:
    rx, tx = placed_frames(1, 60, pause), placed_frames(2, 60, pause)
    found = decoded(tmp_path, [rx, tx])
    assert found["rx-frame"] == as_shown(rx)
    assert found["tx-frame"] == as_shown(tx)
    assert {name.partition("-")[2] for name in found} == {"frame", "field"}


def test_every_field_covers_its_bytes(tmp_path: Path) -> None:
    placed = placed_frames(3, 4 * len(KINDS), 0.5)
    expected = []
    for start, raw in placed:
        row = Row("", 0, raw, None)
        assert row.kind is not None
        for field in row.kind.fields:
            first = start + field.start * BYTE
            text = f"{field.name}: {field.text(row.values[field.name])} {field.unit}".rstrip()
            expected.append(Shown(first, first + field.size * BYTE, text))
    assert decoded(tmp_path, [placed])["rx-field"] == expected


@pytest.mark.parametrize("seed", first(2, range(5)))
def test_damage_costs_no_other_frame(tmp_path: Path, seed: int) -> None:
    """Bytes are lost, changed and added; between two damaged spans are sound frames."""
    random, placed = Random(seed), placed_frames(seed, 60, 0.5)
    whole, sound = Placed(), Placed()
    shift = 0
    for number, (start, raw) in enumerate(placed):
        if number % 6 != 5:
            sound.append((start + shift, raw))
            whole.append((start + shift, raw))
            continue
        damaged = _damaged(random, raw)
        whole.append((start + shift, damaged))
        shift += max(0, len(damaged) - len(raw)) * BYTE
    found = decoded(tmp_path, [whole])
    assert [one for one in as_shown(sound) if one not in found["rx-frame"]] == []
    assert len(found["rx-frame"]) <= len(placed)
    assert found["rx-damage"]


def _damaged(random: Random, raw: bytes) -> bytes:
    """The frame with its header or tail lost or wrong, or with noise that begins nothing."""
    match random.randrange(4):
        case 0:
            return raw[1:]
        case 1:
            return raw[:-1]
        case 2:
            return raw[:-1] + b"\x11"
        case _:
            return b"\x01\x02\x03" + raw[:4]


def test_faults_of_a_frame_are_named(tmp_path: Path) -> None:
    names = {one.name: one for one in KINDS}
    sound = encode(names["reset"], {})
    faulty = {
        Fault.UNKNOWN_CMD: _changed(names["speed"], 1, 0x77),
        Fault.BAD_MOTOR: _changed(names["speed"], 2, 9),
        Fault.UNDEFINED_FLAGS: _changed(names["position_feedback"], 8, 0xFF),
        Fault.RESERVED_NONZERO: _changed(names["speed_feedback"], 5, 1),
    }
    data = b"".join(sound + raw for raw in faulty.values())
    found = decoded(tmp_path, [[(2 * BYTE, data)]])
    step = 2 * FRAME_LENGTH * BYTE
    first = 2 * BYTE + FRAME_LENGTH * BYTE
    assert found["rx-fault"] == [
        Shown(first + n * step, first + n * step + FRAME_LENGTH * BYTE, str(fault))
        for n, fault in enumerate(faulty)
    ]


def _changed(kind: FrameKind, at: int, byte: int) -> bytes:
    values = {f.name: 1 if f.default is None else f.default for f in kind.fields}
    raw = bytearray(encode(kind, values))
    raw[at] = byte
    return bytes(raw)


def test_framing_error_of_the_uart_is_a_fault_of_the_frame(tmp_path: Path) -> None:
    raw = encode(KINDS[1], {"motor": 1, "rpm": 255})
    start, flawed = 2 * BYTE, 6 * BYTE  # the byte FF; behind it the line is high for a while
    placed = [(start, raw[:5]), (flawed + 2 * BYTE, raw[5:]), (20 * BYTE, raw)]
    found = decoded(tmp_path, [placed], [flawed])
    assert [one.text for one in found["rx-frame"]] == [frame_text(Row("", 0, raw, None))] * 2
    assert [(one.first, one.text) for one in found["rx-fault"]] == [(start, str(Fault.LINE_ERROR))]


def test_capture_that_begins_within_a_frame_shows_its_rest_as_damage(tmp_path: Path) -> None:
    frames = [row.raw for row in some_rows(6) if row.framed]
    found = decoded(tmp_path, [[(1, b"".join(frames)[3:])]])
    assert [one.text for one in found["rx-damage"]] == [f"Damage: {spaced_hex(frames[0][3:])}"]
    shown = [frame_text(Row("", 0, raw, None)) for raw in frames[1:]]
    assert [one.text for one in found["rx-frame"]] == shown


def test_begin_of_a_frame_before_a_long_silence_is_truncated(tmp_path: Path) -> None:
    whole = encode(KINDS[1], {"motor": 1, "rpm": 255})
    long = (SETTLING_BYTES + 2) * BYTE
    cut_at, after = 20 * BYTE, 24 * BYTE + long
    paused = [(after + 12 * BYTE, whole[:4]), (after + 16 * BYTE + long // 2, whole[4:])]
    placed = [(2 * BYTE, whole), (cut_at, whole[:4]), (after, whole), *paused]
    last = after + 40 * BYTE + long // 2
    found = decoded(tmp_path, [[*placed, (last, whole[:6])]], silence=SETTLING_BYTES + 2)
    assert found["rx-damage"] == [
        Shown(cut_at, cut_at + 4 * BYTE, f"Truncated: {spaced_hex(whole[:4])}"),
        Shown(last, last + 6 * BYTE, f"Truncated: {spaced_hex(whole[:6])}"),
    ]
    assert len(found["rx-frame"]) == 3


STAND_IN = """
OUTPUT_ANN = 0
class Decoder:
    def register(self, output):
        return output
    def put(self, ss, es, output, data):
        print(ss, es, data[1][0], sep=",")
"""
"""sigrok's module, as far as the decoder uses it."""


def test_frame_that_is_cut_at_the_end_of_the_capture_is_truncated(tmp_path: Path) -> None:
    """Debian's libsigrokdecode 0.5 does not call `end`, so newer versions are imitated."""
    (tmp_path / "sigrokdecode.py").write_text(STAND_IN)
    (tmp_path / "fte.py").write_text(sigrok_decoder())
    whole = encode(KINDS[1], {"motor": 1, "rpm": 255})
    code = (
        "import fte; one = fte.Decoder(); one.start()\n"
        f"for at, byte in enumerate({[*whole, *whole[:3]]}):\n"
        "    one.decode(10 * at, 10 * at + 10, ['FRAME', 1, (byte, True)])\n"
        "one.end()"
    )
    shown = subprocess.check_output([sys.executable, "-c", code], text=True, cwd=tmp_path)
    assert shown.splitlines()[-1] == f"100,130,Truncated: {spaced_hex(whole[:3])}"
    assert f"0,100,{frame_text(Row('', 0, whole, None))}" in shown.splitlines()
