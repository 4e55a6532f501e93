"""The samples: what `decode` prints of each is what stands beside it, byte for byte."""

import subprocess
import sys
from pathlib import Path

import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from tests.cli.conftest import ROOT, SAMPLES

EXPECTED = sorted((SAMPLES / "expected").iterdir())
FORMS = {".txt": "table", ".jsonl": "jsonl", ".csv": "csv"}


def test_every_sample_is_here_in_three_forms_with_its_text() -> None:
    names = {path.name.removesuffix(".txt") for path in EXPECTED if path.suffix == ".txt"}
    stories = ("clean", "damaged", "idle", "midstream")
    assert names == {f"{story}.{form}" for story in stories for form in ("mcap", "raw", "hex")}
    assert all((SAMPLES / name).is_file() for name in names)


@pytest.mark.parametrize("expected", EXPECTED, ids=lambda path: path.name)
def test_decode_prints_what_is_expected(expected: Path, environment: dict[str, str]) -> None:
    form = FORMS[expected.suffix]
    done = subprocess.run(
        [sys.executable, "-m", "fte_sniff", "decode", f"samples/{expected.stem}", "--format", form],
        cwd=ROOT,
        env=environment,
        capture_output=True,
        timeout=60,
        check=True,
    )
    assert done.stdout == expected.read_bytes()


@pytest.mark.parametrize("name", ["clean", "damaged", "idle", "midstream"])
def test_recordings_hold_every_byte_for_the_readers_of_other_tools(name: str) -> None:
    with (SAMPLES / f"{name}.mcap").open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        decoded = [
            message
            for _, channel, _, message in reader.iter_decoded_messages()
            if channel.topic != "/fte/port"
        ]
    assert b"".join(message.raw for message in decoded) == (SAMPLES / f"{name}.raw").read_bytes()
