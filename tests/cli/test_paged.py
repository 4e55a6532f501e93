"""`view` on a recording of which only a part lies in memory, in a terminal."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fte_sniff.protocol import KIND_BY_NAME, encode
from fte_sniff.recording.bulk_writer import write_recording
from fte_sniff.recording.metadata import PortFacts
from fte_sniff.row_batch import Codebook, RowBatch
from tests.cli.terminals import terminal

ROWS = 400_000
FIRST_NS = 1_769_860_800_000_000_000
RPMS = 1000


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Speed commands, a millisecond apart; the speed is that of the row's number."""
    codebook = Codebook()
    raws = b"".join(encode(KIND_BY_NAME["speed"], {"motor": 1, "rpm": rpm}) for rpm in range(RPMS))
    columns = RowBatch.allocate(codebook, ROWS)
    numbers = np.arange(ROWS)
    columns.t_ns[:] = FIRST_NS + numbers * 1_000_000
    columns.offset[:] = numbers * 10
    columns.port[:] = codebook.port_code("p")
    columns.raw[:] = np.frombuffer(raws, np.uint8).reshape(-1, 10)[numbers % RPMS]
    path = tmp_path_factory.mktemp("large") / "large.mcap"
    write_recording(path, [PortFacts("p")], [columns])
    return path


def test_every_row_is_reached_and_found(environment, tmp_path: Path, recording: Path) -> None:
    few = ("view", "--keep-rows", "70000", str(recording))
    with terminal(environment, tmp_path, *few, size=(120, 40)) as screen:
        screen.until("FILE")
        screen.type("G")
        screen.until("12:06:39.999")
        screen.type("g")
        screen.until("12:00:00.000")
        screen.type(":50%\r")
        screen.until("12:03:20.000")
        screen.type("frpm = 777\r")
        screen.until("400 of 400,000 rows")
        screen.type("G")
        screen.until("12:06:39.777")
        screen.type("q")
        assert screen.ended() == 0
    assert b"Traceback" not in screen.drawn


def test_a_recording_that_vanishes_ends_the_screen_with_one_line(
    environment, tmp_path: Path, recording: Path
) -> None:
    path = tmp_path / "gone.mcap"
    path.write_bytes(recording.read_bytes())
    # So often that not all of these places can be in memory, whatever was read last.
    several = [str(path)] * 5
    with terminal(environment, tmp_path, "view", "--keep-rows", "70000", *several) as screen:
        screen.until("FILE")
        path.unlink()
        assert screen.ended_by(":20%\r", ":40%\r", ":60%\r", ":80%\r") == 4
    assert b"gone.mcap: there is no such file" in screen.drawn
    assert b"Traceback" not in screen.drawn


@pytest.mark.parametrize("key", ["q", "\x03"])
def test_it_can_be_left_while_it_loads(
    environment, tmp_path: Path, recording: Path, key: str
) -> None:
    several = [str(recording)] * 20
    with terminal(environment, tmp_path, "view", *several) as screen:
        screen.until("LOADING")
        screen.type(key)
        assert screen.ended() == 0
    assert b" FILE " not in screen.drawn
