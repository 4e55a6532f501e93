"""Recordings that are written in sequence: pipes, standard output, devices."""

import os
import subprocess
import sys
import threading
from collections.abc import Callable
from io import BytesIO
from pathlib import Path

import pytest
from mcap.reader import make_reader

from fte_sniff.errors import FileError
from fte_sniff.protocol import Row
from fte_sniff.recording.metadata import PortFacts
from fte_sniff.recording.reader import RecordingReader
from fte_sniff.recording.writer import RecordingWriter

Rows = Callable[..., list[Row]]


def _record(path: Path, rows: list[Row]) -> None:
    with RecordingWriter(path, [PortFacts(rows[0].port)]) as writer:
        for start in range(0, len(rows), 20):
            writer.write(rows[start : start + 20])
            writer.flush()


def test_a_named_pipe_brings_a_whole_recording(tmp_path: Path, make_rows: Rows) -> None:
    rows = make_rows(60)
    pipe, copy = tmp_path / "pipe", tmp_path / "copy.mcap"
    os.mkfifo(pipe)
    writing = threading.Thread(target=_record, args=(pipe, rows))
    writing.start()
    content = pipe.read_bytes()
    writing.join()
    copy.write_bytes(content)
    reader = RecordingReader(copy)
    assert list(reader) == rows
    assert (reader.ending, reader.losses) == ("", ())
    package = make_reader(BytesIO(content), validate_crcs=True)
    summary = package.get_summary()
    assert summary is not None
    assert len(summary.chunk_indexes) == 3
    assert sum(1 for _ in package.iter_messages()) == 60


STANDARD = """
import sys
from pathlib import Path
from tests.recording.conftest import some_rows
from tests.recording.writing.test_outlet import _record
_record(Path(sys.argv[1]), some_rows(60))
"""


@pytest.mark.parametrize("name", ["-", "/dev/stdout"])
def test_standard_output_into_a_pipe(tmp_path: Path, make_rows: Rows, name: str) -> None:
    done = subprocess.run(
        [sys.executable, "-c", STANDARD, name], stdout=subprocess.PIPE, check=True, timeout=60
    )
    (tmp_path / "copy.mcap").write_bytes(done.stdout)
    assert list(RecordingReader(tmp_path / "copy.mcap")) == make_rows(60)


def test_a_pipe_whose_reader_goes_ends_in_one_line(tmp_path: Path, make_rows: Rows) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    reader = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    writer = RecordingWriter(pipe, [PortFacts("p")])
    os.close(reader)
    writer.write(make_rows(5))
    with pytest.raises(
        FileError, match=r"pipe: its reader is gone; .* ended after 0 rows"
    ) as caught:
        writer.flush()
    assert "\n" not in str(caught.value)
    writer.close()
    assert pipe.is_fifo()


def test_a_terminal_is_refused() -> None:
    far, near = os.openpty()
    try:
        with pytest.raises(FileError, match="is a terminal"):
            RecordingWriter(Path(os.ttyname(near)), [PortFacts("p")])
    finally:
        os.close(far)
        os.close(near)
