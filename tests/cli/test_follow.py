"""`decode --follow` and `view --follow`: recordings that other processes write."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from fte_sniff.protocol.columns import DERIVED
from fte_sniff.protocol.framer import Framer
from fte_sniff.protocol.items import Chunk
from fte_sniff.protocol.rows import Row
from tests.beside import running
from tests.cli.conftest import SAMPLES
from tests.cli.processes import (
    FRAME,
    Process,
    children_of,
    ended,
    first_output,
    rows_in,
    started,
    until,
    wait_until,
    wire,
)
from tests.cli.terminals import terminal
from tests.support.columns import fed

pytestmark = pytest.mark.program

WRITER = """
import sys
from pathlib import Path
from fte_sniff.recording.metadata import PortFacts
from fte_sniff.recording.writer import RecordingWriter
from tests.cli.test_follow import made_rows
from tests.support.columns import entries
rows = iter(made_rows())
with RecordingWriter(Path(sys.argv[1]), [PortFacts("p", 115200)]) as writer:
    print("open", flush=True)
    for line in sys.stdin:
        writer.write(*entries([next(rows) for _ in range(int(line))]))
        writer.flush()
        print("flushed", flush=True)
"""
"""Records and flushes as many rows as each line of its standard input names."""


def made_rows(count: int = 20) -> list[Row]:
    """Rows of one frame each, a second apart."""
    framer = Framer("p")
    chunks = [Chunk("p", (1 + number) * 10**9, FRAME) for number in range(count)]
    return [row for chunk in chunks for row in fed(framer, chunk)] + list(framer.finish())


@contextmanager
def writing(environment, folder: Path, name: str) -> Iterator[Process]:
    """A process that records to a file and holds its lock."""
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    words = [sys.executable, "-c", WRITER, name]
    with running(words, **pipes, env=dict(environment), cwd=folder) as process:
        until(process, b"open\n")
        yield process


def partial(folder: Path) -> Path | None:
    """The temporary file of an output that is being written; None before it is there."""
    return next(folder.glob(".fte-sniff-*.part"), None)


def flush(writer: Process, frames: int = 1) -> None:
    """Let the writer flush some frames."""
    assert writer.stdin is not None
    writer.stdin.write(b"%d\n" % frames)
    writer.stdin.flush()
    until(writer, b"flushed\n")


def test_each_flush_is_printed_while_the_writer_goes_on(environment, tmp_path: Path) -> None:
    follow = ("decode", "--follow", "x.mcap", "--format", "csv", "--filter", "offset >= 0")
    with (
        writing(environment, tmp_path, "x.mcap") as writer,
        started(environment, tmp_path, *follow) as reader,
    ):
        for number in range(4):
            flush(writer)
            until(reader, b",%d,10," % (10 * number))
        assert writer.stdin is not None
        writer.stdin.close()
        code, _, errors = ended(reader)
    assert code == 0
    assert "x.mcap: the program that recorded it has ended" in errors
    assert "4 rows, nothing malformed" in errors


def test_the_rows_before_a_kill_of_the_writer_are_kept(run, environment, tmp_path: Path) -> None:
    follow = ("decode", "--follow", "x.mcap", "-o", "rows.csv")
    with (
        writing(environment, tmp_path, "x.mcap") as writer,
        started(environment, tmp_path, *follow) as reader,
    ):
        flush(writer, 3)
        wait_until(lambda: partial(tmp_path))
        flush(writer, 2)
        writer.kill()
        code, _, errors = ended(reader)
    assert code == 0
    assert "the program that recorded it has ended" in errors
    assert (tmp_path / "rows.csv").read_text() == run("decode", "x.mcap", "--format", "csv").stdout
    assert len((tmp_path / "rows.csv").read_text().splitlines()) == 6


@pytest.mark.parametrize(
    ("end", "words"),
    [
        (signal.SIGKILL, "nothing records to it any more, but its ports were not closed"),
        (signal.SIGTERM, "the program that recorded it has ended\n"),
    ],
)
def test_a_capture_that_was_killed_is_not_taken_for_one_that_ended(
    environment, tmp_path: Path, end: signal.Signals, words: str
) -> None:
    live = ("live", "sim://?rate=200", "--headless", "-o", "x.mcap")
    with started(environment, tmp_path, *live) as writer:
        wait_until((tmp_path / "x.mcap").exists)
        follow = ("decode", "--follow", "x.mcap", "--format", "csv")
        with started(environment, tmp_path, *follow) as reader:
            until(reader, b",feedback,")
            (capture,) = children_of(writer.pid)
            os.kill(capture, end)
            code, _, errors = ended(reader)
    assert code == 0
    assert f"x.mcap: {words}" in errors


def test_ctrl_c_ends_it_as_a_capture_and_keeps_the_rows(environment, tmp_path: Path) -> None:
    follow = ("decode", "--follow", "x.mcap", "-o", "rows.csv")
    with (
        writing(environment, tmp_path, "x.mcap") as writer,
        started(environment, tmp_path, *follow) as reader,
    ):
        flush(writer, 3)
        wait_until(lambda: (part := partial(tmp_path)) and part.stat().st_size > 300)
        reader.send_signal(signal.SIGINT)
        code, _, errors = ended(reader)
    assert code == 0
    assert errors.endswith("Z\n")
    assert (tmp_path / "rows.csv").read_text().count("\n") == 4


def test_all_files_of_a_capture_that_rotates_are_read(run, environment, tmp_path: Path) -> None:
    live = ("live", "sim://?rate=200", "--headless", "--rotate", "1s", "-o", "c.mcap")
    with started(environment, tmp_path, *live) as writer:
        wait_until((tmp_path / "c_00001.mcap").exists)
        follow = ("decode", "--follow", "c_00001.mcap", "-o", "rows.csv")
        with started(environment, tmp_path, *follow) as reader:
            wait_until((tmp_path / "c_00004.mcap").exists)
            before = sum(map(rows_in, tmp_path.glob("c_0000[123].mcap")))
            wait_until(
                lambda: (part := partial(tmp_path)) and part.read_bytes().count(b"\n") > before + 1
            )
            writer.send_signal(signal.SIGINT)
            assert ended(writer)[0] == 0
            code, _, errors = ended(reader)
    assert code == 0
    files = sorted(tmp_path.glob("c_*.mcap"))
    assert len(files) > 2
    assert f"{files[-1].name}: the program that recorded it has ended" in errors
    found = (tmp_path / "rows.csv").read_text()
    # Rows that are followed do not wait for the facts that depend on later rows.
    whole = run("decode", tmp_path, "--format", "csv").stdout
    assert without_facts(found) == without_facts(whole)
    assert found.count("\n") == 1 + sum(map(rows_in, files))


def without_facts(text: str) -> list[str]:
    """The lines of CSV without the last columns."""
    return [line.rsplit(",", len(DERIVED))[0] for line in text.splitlines()]


def test_a_limit_and_the_end_of_a_range_end_it(run) -> None:
    file = SAMPLES / "clean.mcap"
    for option in (["--limit", "3"], ["--to", "+1s"]):
        done = run("decode", "--follow", file, *option, "--format", "csv")
        assert done.returncode == 0
        whole = run("decode", file, *option, "--format", "csv").stdout
        assert without_facts(done.stdout) == without_facts(whole)


def test_the_screen_follows_a_capture(environment, tmp_path: Path) -> None:
    with wire() as (far, device):
        live = ("live", device, "--plain", "-o", "x.mcap")
        with started(environment, tmp_path, *live) as writer:
            first_output(writer, far)
            follow = ("view", "--follow", "x.mcap")
            with terminal(environment, tmp_path, *follow, size=(120, 30)) as screen:
                screen.until("FOLLOWING")
                os.write(far, 3 * bytes.fromhex("55010306930000000FEE"))
                screen.until("1683")
                writer.send_signal(signal.SIGINT)
                screen.until("ENDED")
                screen.type("Q")
                assert screen.ended() == 0
