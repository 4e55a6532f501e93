"""What is easily lost: events of a view that stood still, the last bytes, times, directions."""

from __future__ import annotations

import os
import signal
import struct
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest
from mcap.reader import make_reader

from tests.cli.conftest import decoded
from tests.cli.processes import FRAME, ended, first_output, started, stderr_until, wire
from tests.cli.test_live import SPEED, Adapter
from tests.waiting import wait_until, while_waiting

ENHANCED_PACKET = 6
FLAGS, INBOUND, OUTBOUND = 2, 1, 2


@pytest.fixture
def adapter(tmp_path: Path) -> Iterator[Adapter]:
    adapter = Adapter(tmp_path)
    yield adapter
    adapter.pull()


def test_events_that_came_while_the_view_stood_still_are_counted(
    run, environment, tmp_path: Path, adapter: Adapter
) -> None:
    adapter.plug()
    with started(environment, tmp_path, "live", adapter.name, "-o", "x.mcap") as process:
        first_output(process, adapter.far)
        process.send_signal(signal.SIGSTOP)
        for times in ("once", "2 times", "3 times"):
            adapter.pull()
            wait_until(lambda times=times: f"lost {times}" in run("decode", "x.mcap").stderr)
            before = len(decoded(run, "x.mcap"))
            adapter.plug()
            for _ in while_waiting(lambda: "rows after the port was found again"):
                os.write(adapter.far, FRAME)
                if len(decoded(run, "x.mcap")) > before:
                    break
        process.send_signal(signal.SIGCONT)
        process.send_signal(signal.SIGINT)
        code, _, errors = ended(process)
    assert code == 0, errors
    assert "port events: lost 3, found_again 3" in errors


def test_bytes_that_came_before_the_end_are_recorded(run, environment, tmp_path: Path) -> None:
    with (
        wire() as (far, name),
        started(environment, tmp_path, "live", name, "--headless", "-o", "x.mcap") as process,
    ):
        stderr_until(process, "capturing")
        os.write(far, SPEED * 100)
        process.send_signal(signal.SIGINT)
        code, _, errors = ended(process)
    assert code == 0, errors
    assert [row["raw"] for row in decoded(run, "x.mcap")] == [SPEED.hex().upper()] * 100


def test_summary_has_the_first_and_the_last_time(environment, tmp_path: Path) -> None:
    with (
        wire() as (far, name),
        started(environment, tmp_path, "live", name, "-o", "x.mcap") as process,
    ):
        first_output(process, far)
        for _ in range(3):
            before = (tmp_path / "x.mcap").stat().st_size
            os.write(far, SPEED)
            wait_until(lambda before=before: (tmp_path / "x.mcap").stat().st_size > before)
        os.write(far, SPEED)
        process.send_signal(signal.SIGINT)
        assert ended(process)[0] == 0
    with (tmp_path / "x.mcap").open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        times = [message.log_time for _, _, message in reader.iter_messages()]
        summary = reader.get_summary()
    assert summary is not None
    found = summary.statistics
    assert found is not None
    assert (found.message_start_time, found.message_end_time) == (min(times), max(times))
    assert found.message_count == len(times)
    ends = [max(index.message_end_time for index in summary.chunk_indexes)]
    assert ends == [max(times)]


def test_packets_have_the_direction_of_their_rows(run, samples: Path, tmp_path: Path) -> None:
    assert run("decode", samples / "damaged.mcap", "-o", "x.pcapng").returncode == 0
    rows = decoded(run, str(samples / "damaged.mcap"))
    directions = {"control": OUTBOUND, "feedback": INBOUND, None: 0}
    frames = [row for row in rows if row["status"] != "malformed"]
    expected = Counter((row["raw"], directions[row["direction"]]) for row in frames)
    found = packets((tmp_path / "x.pcapng").read_bytes())
    assert not expected - Counter((data[-10:].hex().upper(), way) for data, way in found)


def packets(data: bytes) -> Iterator[tuple[bytes, int]]:
    """Bytes and direction of the packets of a pcapng file."""
    at = 0
    while at < len(data):
        kind, length = struct.unpack_from("<II", data, at)
        if kind == ENHANCED_PACKET:
            size = struct.unpack_from("<I", data, at + 20)[0]
            start = at + 28
            options = data[start + (size + 3) // 4 * 4 : at + length - 4]
            yield data[start : start + size], direction_of(options)
        at += length


def direction_of(options: bytes) -> int:
    """The direction in the options of a packet."""
    at = 0
    while at < len(options):
        code, length = struct.unpack_from("<HH", options, at)
        if code == FLAGS:
            return int(struct.unpack_from("<I", options, at + 4)[0]) & 3
        at += 4 + (length + 3) // 4 * 4
    return 0
