"""Rows for other programs: `--udp` as PlotJuggler reads it; real WebSocket clients of `--serve`."""

from __future__ import annotations

import json
import socket
from collections.abc import Iterator
from pathlib import Path

import pytest

from fte_sniff.protocol.columns import iso_time
from fte_sniff.recording.schema import topic_of
from tests.cli.conftest import decoded
from tests.support.columns import read_rows, without_facts
from tests.waiting import BOUND_S

pytestmark = pytest.mark.program

SIM = "sim://?seed=1&rate=400&drop=0.02&noise=0.02"


@pytest.fixture
def receiver() -> Iterator[socket.socket]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as found:
        found.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 22)
        found.bind(("127.0.0.1", 0))
        found.settimeout(BOUND_S)
        yield found


def address(receiver: socket.socket) -> str:
    return f"127.0.0.1:{receiver.getsockname()[1]}"


def test_json_lines_of_a_capture_are_those_of_its_recording(run) -> None:
    done = run("live", SIM, "--count", "100", "-o", "x.mcap", "--format", "jsonl")
    assert done.returncode == 0
    # A capture does not know yet what later rows decide.
    printed = without_facts(map(json.loads, done.stdout.splitlines()))
    assert printed == without_facts(decoded(run, "x.mcap"))
    assert len(printed) == 100


def test_every_row_is_a_datagram_with_the_names_of_the_topics(run, receiver, tmp_path) -> None:
    words = ("live", SIM, "--count", "200", "-o", "x.mcap", "--format", "csv")
    done = run(*words, "--udp", address(receiver))
    assert done.returncode == 0
    assert f"200 rows sent to UDP 127.0.0.1 port {receiver.getsockname()[1]}\n" in done.stderr
    rows = read_rows(tmp_path / "x.mcap")
    rows = [row for row in rows if hasattr(row, "raw")]
    opened = None
    for row in rows:
        found = json.loads(receiver.recv(1 << 16))
        if "port" in found["fte"]:
            opened = found
            found = json.loads(receiver.recv(1 << 16))
        assert found.pop("timestamp") == row.t_ns / 1e9
        for part in topic_of(row).name.strip("/").split("/"):
            (inner,) = found.values()
            assert [*found] == [part]
            found = inner
        assert found["raw"] == row.raw.hex().upper()
        assert found["time"] == iso_time(row.t_ns)
        assert None not in found.values()
    for event, kind in ((opened, "opened"), (json.loads(receiver.recv(1 << 16)), "closed")):
        assert event is not None
        inner = event["fte"]["port"]
        assert {*inner} == {"port", "kind", "detail", "count", "time"}
        assert (inner["port"], inner["kind"], inner["count"]) == (SIM, kind, 0)
        assert inner["time"][:19] == iso_time(round(event["timestamp"] * 1e9))[:19]


def test_filter_selects_the_datagrams(run, receiver) -> None:
    words = ("live", SIM, "--count", "100", "--no-record", "--filter", "motor = 2")
    done = run(*words, "--format", "jsonl", "--udp", address(receiver))
    for line in done.stdout.splitlines():
        while "/port" in (found := receiver.recv(1 << 16).decode()) or '"port":{' in found:
            pass
        assert json.loads(line)["raw"] in found


def test_port_that_nobody_reads_does_not_disturb_a_capture(run, receiver) -> None:
    where = address(receiver)
    receiver.close()
    done = run("live", SIM, "--count", "50", "-o", "x.mcap", "--udp", where)
    assert done.returncode == 0
    assert "50 rows sent to UDP" in done.stderr


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("98700", "is not HOST:PORT or PORT"),
        ("localhost", "is not HOST:PORT"),
        ("localhost:", "is not HOST:PORT"),
        ("localhost:port", "is not HOST:PORT"),
        ("localhost:65536", "is not HOST:PORT"),
        ("localhost:\N{SUPERSCRIPT TWO}", "is not HOST:PORT"),
        ("a..b:1", "the host is not known"),
        ("192.0.2.1:9870", "is not this machine: anyone in that network could read"),
        ("0.0.0.0:9870", "is not this machine"),
        ("[2001:db8::1]:9870", "is not this machine"),
        ("\x1b[1m:9870", "the host is not known"),
    ],
)
def test_addresses_that_are_wrong_or_not_here_are_refused(run, text: str, told: str) -> None:
    done = run("live", SIM, "--no-record", "--count", "1", "--udp", text)
    assert done.returncode == 2
    assert told in done.stderr
    assert done.stderr.strip().isprintable()


@pytest.mark.parametrize("text", ["127.0.0.1:9870", ":9870", "9870", "[::1]:9870"])
def test_addresses_of_this_machine_are_accepted(run, text: str) -> None:
    host = "::1" if "::" in text else "127.0.0.1"
    done = run("live", SIM, "--no-record", "--count", "1", "--udp", text)
    assert done.returncode == 0
    assert f"1 rows sent to UDP {host} port 9870" in done.stderr


def test_network_is_allowed_by_the_settings(run, environment, tmp_path: Path) -> None:
    settings = tmp_path / "settings.toml"
    settings.write_text("[live]\nnetwork = true\n")
    environment["FTE_SNIFF_CONFIG"] = str(settings)
    done = run("live", SIM, "--no-record", "--count", "1", "--udp", "192.0.2.1:9870")
    assert done.returncode == 0
