"""The rows that went into a recording come out of every reader that people have, as they were."""

import subprocess
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from fte_sniff.analysis.feed import FeedState, FeedUpdate
from fte_sniff.cli.repair import repaired
from fte_sniff.protocol.items import PortEvent, PortEventKind
from fte_sniff.recording.metadata import PortFacts
from fte_sniff.recording.output_file import Existing
from fte_sniff.recording.reader import Recording
from fte_sniff.recording.recorder import Recorder, RecordingOptions
from fte_sniff.recording.schema import TOPICS
from fte_sniff.recording.writer import RecordingWriter
from tests.beside import running
from tests.conformance.conftest import Lines, Recorded
from tests.conformance.expected import digest, expected_lines
from tests.recording.conftest import START, some_rows
from tests.support.columns import entries, rows_from
from tests.support.recorded_rows import write_recording
from tests.waiting import BOUND_S, wait_until

pytestmark = pytest.mark.conformance
foxglove_server = pytest.importorskip("fte_sniff.cli.foxglove_server")


@pytest.mark.parametrize("reader", ["python", "typescript", "rust", "rerun"])
def test_every_reader_finds_the_rows_that_went_in(
    reader: str, recorded: Recorded, request: pytest.FixtureRequest
) -> None:
    path, rows, events = recorded
    read = request.getfixturevalue(reader)(path)
    wanted = expected_lines(rows, events)
    assert read[:5] == wanted[:5]
    assert digest(read) == digest(wanted)


def test_client_of_the_open_viewers_receives_the_rows_that_are_served(node_programs: Path) -> None:
    """`@foxglove/ws-protocol`, with which Lichtblick connects."""
    rows = some_rows(1_000)
    events = [PortEvent(START - 5, rows[0].port, PortEventKind.OPENED, "115200 8N1 串口")]
    server = foxglove_server.FoxgloveServer(("127.0.0.1", 0), [rows[0].port])
    watch = ("node", "watch.mjs", server.url)
    with running(watch, cwd=node_programs, stdout=subprocess.PIPE) as viewer:
        wait_until(lambda: len(server.wanted) == len(TOPICS) or viewer.poll() is not None)
        server.update(FeedUpdate(FeedState("p"), rows_from(rows), events))
        server.ended()
        read = viewer.communicate(timeout=BOUND_S)[0].decode().splitlines()
    assert read == expected_lines(rows, events)


def test_the_checker_has_nothing_to_report(recorded: Recorded, doctor: Lines) -> None:
    assert doctor(recorded[0]) == []


PORT = PortFacts("/dev/ttyUSB0", 115_200)


def _write_bulk(folder: Path) -> None:
    batches = (rows_from(some_rows(15_000, start=START + n * 10**12)) for n in range(3))
    write_recording(folder / "x.mcap", [PORT], batches)


def _write_empty_bulk(folder: Path) -> None:
    write_recording(folder / "x.mcap", [PORT], [])


def _write_rotated(folder: Path) -> None:
    recorder = Recorder(folder / "x.mcap", [PORT], options=RecordingOptions(rotate_bytes=30_000))
    for row in some_rows(3000):
        recorder.write(*entries([row]))
        if row.offset % 1000 == 0:
            recorder.flush()
    recorder.close()


def _write_new_port(folder: Path) -> None:
    with RecordingWriter(folder / "x.mcap", [PORT]) as writer:
        for number, row in enumerate(some_rows(300)):
            writer.write(*entries([replace(row, port=f"port {number // 100}")]))
            if number % 50 == 0:
                writer.flush()


def _repair(folder: Path, *, chunk: int) -> None:
    """A recording whose chunk of this number is damaged, and the repaired one."""
    damaged = folder / "damaged"
    with RecordingWriter(damaged, [PORT]) as writer:
        for number in range(4):
            writer.write(*entries(some_rows(50, start=START + number * 10**9)))
            writer.flush()
    content = bytearray(damaged.read_bytes())
    marks = [at for at in range(len(content)) if content.startswith(b"\x04\0\0\0zstd", at)]
    content[marks[chunk] + 100] ^= 1
    damaged.write_bytes(content)
    repair = repaired(Recording(damaged), folder / "repaired.mcap", Existing.REFUSE)
    assert repair is not None
    assert repair.tally.rows == 150


RECORDINGS = {
    "decoded": _write_bulk,
    "decoded without rows": _write_empty_bulk,
    "rotated": _write_rotated,
    "a new port": _write_new_port,
    "repaired without the first chunk": lambda folder: _repair(folder, chunk=0),
    "repaired without another chunk": lambda folder: _repair(folder, chunk=2),
}


@pytest.mark.parametrize("write", RECORDINGS.values(), ids=RECORDINGS)
def test_the_checker_has_nothing_to_report_on_any_way_to_write(
    write: Callable[[Path], None], tmp_path: Path, doctor: Lines, python: Lines
) -> None:
    write(tmp_path)
    files = sorted(tmp_path.glob("*.mcap"))
    assert files
    for path in files:
        assert doctor(path) == []
        python(path)


def test_the_checker_finds_faults(tmp_path: Path, doctor: Lines) -> None:
    path = tmp_path / "x.mcap"
    RecordingWriter(path, [PORT]).close()
    content = path.read_bytes()
    channel = content.index(b"/fte/")
    schema = content.index(b"\x03", content.index(b"port.1.baud"))
    length = 9 + int.from_bytes(content[schema + 1 : schema + 9], "little")
    last = content.rindex(b"/fte/")
    for altered, remark in (
        (content + b"x", "1 bytes follow the end"),
        (content[: schema + length] + content[schema:], "schema 1 exists twice"),
        (content[:last] + b"X" + content[last + 1 :], "CRC failed"),
        (content[:channel] + content[channel:].replace(b"USB0", b"USB1", 1), "channel 1 differs"),
    ):
        path.write_bytes(altered)
        assert remark in "\n".join(doctor(path)), remark
