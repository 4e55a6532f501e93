"""`--serve`: real WebSocket clients decode the rows by the advertised schema."""

from __future__ import annotations

import base64
import json
import re
import signal
import struct
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader
from websockets.sync.client import ClientConnection, connect

from fte_sniff.recording.messages.schema import TOPICS, message_class
from tests.beside import server_socket
from tests.cli.conftest import ROOT
from tests.cli.processes import ended, rows_in, started, stderr_until, wait_until
from tests.waiting import BOUND_S

pytest.importorskip("foxglove")

SIM = "sim://?seed=1&rate=400&drop=0.02&noise=0.02"
WORDS = ("live", SIM, "--headless", "-o", "x.mcap", "--serve", "127.0.0.1:0")
PROTOCOL = "foxglove.sdk.v1"
_MESSAGE = struct.Struct("<BIQ")


class Viewer:
    """A client that subscribes to all channels."""

    def __init__(self, connection: ClientConnection) -> None:
        assert connection.subprotocol == PROTOCOL
        self._connection = connection
        self.channels: dict[int, dict[str, Any]] = {}
        while not self.channels:
            said = json.loads(connection.recv(BOUND_S))
            if said["op"] == "advertise":
                self.channels = {one["id"]: one for one in said["channels"]}
        wanted = [{"id": number, "channelId": number} for number in self.channels]
        connection.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))

    def message(self) -> tuple[str, int, Any]:
        """Topic, time and decoded message of the next row or event."""
        while isinstance(data := self._connection.recv(BOUND_S), str):
            pass
        code, number, t_ns = _MESSAGE.unpack_from(data)
        assert code == 1
        channel = self.channels[number]
        assert (channel["encoding"], channel["schemaEncoding"]) == ("protobuf", "protobuf")
        made = message_class(channel["schemaName"], base64.b64decode(channel["schema"]))
        return channel["topic"], t_ns, made.FromString(data[_MESSAGE.size :])


def address_in(text: str) -> str:
    found = re.search(r"ws://127\.0\.0\.1:\d+", text)
    assert found
    return found[0]


def viewer_at(address: str, **options: Any) -> ClientConnection:
    return connect(address, subprotocols=[PROTOCOL], open_timeout=BOUND_S, **options)  # type: ignore[list-item]


def recorded(path: Path) -> dict[tuple[str, int], Any]:
    """The messages of a recording by topic and time.

    A row that comes after its chunk has a later log time, and its own time in the message.
    """
    found = {}
    with path.open("rb") as file:
        for schema, channel, message in make_reader(file).iter_messages():
            assert schema is not None
            made = message_class(schema.name, schema.data).FromString(message.data)
            found[channel.topic, made.time_ns or message.log_time] = made
            made.ClearField("time_ns")
    return found


def test_client_gets_the_rows_that_are_recorded(environment, tmp_path: Path) -> None:
    with started(environment, tmp_path, *WORDS) as capture:
        address = address_in(stderr_until(capture, "viewers can connect"))
        with viewer_at(address) as connection:
            viewer = Viewer(connection)
            assert {one["topic"] for one in viewer.channels.values()} == {t.name for t in TOPICS}
            messages = [viewer.message() for _ in range(300)]
            capture.send_signal(signal.SIGINT)
            assert ended(capture)[0] == 0
    known = recorded(tmp_path / "x.mcap")
    for topic, t_ns, message in messages:
        # As text: NaN, a value that the row does not have, equals nothing.
        assert str(message) == str(known[topic, t_ns])
    assert len({topic for topic, _, _ in messages}) > 3
    times = [t_ns for _, t_ns, _ in messages]
    assert times == sorted(times)


def test_clients_that_never_read_and_fifty_clients_cost_no_row(environment, tmp_path) -> None:
    with started(environment, tmp_path, *WORDS) as capture, ExitStack() as open_ones:
        address = address_in(stderr_until(capture, "viewers can connect"))
        for _ in range(50):
            Viewer(open_ones.enter_context(viewer_at(address, max_queue=1)))
        file = tmp_path / "x.mcap"
        before = rows_in(file)
        with viewer_at(address) as connection:
            viewer = Viewer(connection)
            wait_until(lambda: viewer.message()[0].startswith("/fte/feedback"))
        wait_until(lambda: rows_in(file) > before + 1000)
        capture.send_signal(signal.SIGINT)
        code, _, errors = ended(capture)
    assert code == 0
    assert "too fast" not in errors
    assert "overrun" not in errors


def test_port_that_is_in_use_is_one_line(run, tmp_path: Path) -> None:
    with server_socket() as taken:
        where = f"127.0.0.1:{taken.getsockname()[1]}"
        done = run("live", SIM, "--count", "5", "--serve", where)
    assert (done.returncode, done.stdout) == (2, "")
    assert f"--serve {where} cannot be used" in done.stderr
    assert done.stderr.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("where", "told"),
    [("0.0.0.0:8765", "anyone in that network could read"), ("sim://", "is not HOST:PORT")],
)
def test_address_that_is_not_of_this_machine_is_refused(run, where: str, told: str) -> None:
    done = run("live", SIM, "--count", "5", "--no-record", "--serve", where)
    assert done.returncode == 2
    assert told in done.stderr


def test_missing_package_is_named_with_its_command(environment, tmp_path: Path) -> None:
    hidden = tmp_path / "hidden"
    hidden.mkdir()
    (hidden / "foxglove.py").write_text("raise ImportError")
    environment["PYTHONPATH"] = f"{hidden}:{ROOT}"
    with started(environment, tmp_path, "live", SIM, "--headless", "--serve") as capture:
        code, _, errors = ended(capture)
    assert code == 2
    assert "--serve needs the package foxglove-sdk: " in errors
    assert re.search(r"install .*foxglove-sdk", errors)
    assert errors.count("\n") == 1
