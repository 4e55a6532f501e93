"""Real WebSocket clients of `--serve`: who may read, what they get, and what they cannot delay."""

from __future__ import annotations

import base64
import json
import re
import signal
import socket
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader

from fte_sniff.analysis.feed import FeedState, FeedUpdate
from fte_sniff.protocol.rows import Row, Rows
from fte_sniff.protocol.spec import Fault
from fte_sniff.recording.schema import EVENTS, TOPICS, message_class
from tests.beside import server_socket
from tests.cli.conftest import ROOT
from tests.cli.processes import ended, started, stderr_until, wait_until
from tests.support.columns import rows_from
from tests.waiting import BOUND_S, while_waiting

pytestmark = pytest.mark.program
foxglove = pytest.importorskip("fte_sniff.cli.foxglove_server")
sync_client = pytest.importorskip("websockets.sync.client")
refusals = pytest.importorskip("websockets.exceptions")

SIM = "sim://?seed=1&rate=400&drop=0.02&noise=0.02"
WORDS = ("live", SIM, "--headless", "-o", "x.mcap", "--serve", "127.0.0.1:0")
_MESSAGE = struct.Struct("<BIQ")


class Viewer:
    """A client that subscribes to all channels."""

    def __init__(self, connection: Any) -> None:
        assert connection.subprotocol in foxglove.SUBPROTOCOLS
        self._connection = connection
        assert json.loads(connection.recv(BOUND_S))["op"] == "serverInfo"
        advertised = json.loads(connection.recv(BOUND_S))["channels"]
        self.channels: dict[int, dict[str, Any]] = {one["id"]: one for one in advertised}
        wanted = [{"id": number, "channelId": number} for number in self.channels]
        connection.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))

    def message(self) -> tuple[str, int, Any]:
        """Topic, time and decoded message of the next row or event."""
        data = self._connection.recv(BOUND_S)
        assert isinstance(data, bytes)
        kind, number, t_ns = _MESSAGE.unpack_from(data)
        assert kind == 1
        channel = self.channels[number]
        assert (channel["encoding"], channel["schemaEncoding"]) == ("protobuf", "protobuf")
        made = message_class(channel["schemaName"], base64.b64decode(channel["schema"]))
        return channel["topic"], t_ns, made.FromString(data[_MESSAGE.size :])


@pytest.fixture
def server() -> Iterator[Any]:
    """A server of the port p; it is closed at the end."""
    found = foxglove.FoxgloveServer(("127.0.0.1", 0), ["p"])
    try:
        yield found
    finally:
        found.ended()


def viewer_at(address: str, **options: Any) -> Any:
    options |= {"open_timeout": BOUND_S, "close_timeout": 1}
    return sync_client.connect(address, subprotocols=foxglove.SUBPROTOCOLS[:1], **options)


def address_in(text: str) -> str:
    found = re.search(r"ws://127\.0\.0\.1:\d+", text)
    assert found
    return found[0]


def noise(count: int) -> Rows:
    rows = [
        Row("p", 10 * n, bytes(10), 1000 * n, (Fault.NOISE,), framed=False) for n in range(count)
    ]
    return rows_from(rows)


def recorded(path: Path) -> dict[tuple[str, int], Any]:
    """The messages of a recording by topic and time."""
    found = {}
    with path.open("rb") as file:
        for schema, channel, message in make_reader(file).iter_messages():
            assert schema is not None
            made = message_class(schema.name, schema.data).FromString(message.data)
            found[channel.topic, made.time_ns or message.log_time] = made
            made.ClearField("time_ns")
    return found


def test_viewer_gets_the_rows_that_are_recorded(environment, tmp_path: Path) -> None:
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
    times = [t_ns for topic, t_ns, _ in messages if topic != EVENTS.name]
    assert times == sorted(times)


@pytest.mark.parametrize("protocol", foxglove.SUBPROTOCOLS)
def test_viewer_gets_what_it_subscribed_to(server: Any, protocol: str) -> None:
    with sync_client.connect(
        server.url, subprotocols=[protocol], open_timeout=BOUND_S
    ) as connection:
        server.update(FeedUpdate(FeedState("p"), noise(5)))  # nobody subscribed to it
        viewer = Viewer(connection)
        wait_until(lambda: server.wanted)
        server.update(FeedUpdate(FeedState("p"), noise(5)))
        assert [viewer.message()[1] for _ in range(5)] == [1000 * n for n in range(5)]
        connection.send(json.dumps({"op": "unsubscribe", "subscriptionIds": [*viewer.channels]}))
        wait_until(lambda: not server.wanted)


@pytest.mark.parametrize(
    "message",
    [
        '{"op": "nonsense"}', "nonsense", "[]", "[" * 100_000, '{"op": "subscribe"}',
        '{"op": "subscribe", "subscriptions": [{"id": 1, "channelId": 99}]}',
        '{"op": "subscribe", "subscriptions": [{"id": -1, "channelId": 1}]}',
        '{"op": "subscribe", "subscriptions": [{"id": Infinity, "channelId": 1}]}',
        '{"op": "unsubscribe", "subscriptionIds": ["\\u001b[2J"]}', b"", b"\x09abc",
    ],
    ids=lambda one: repr(one[:40]),
)  # fmt: skip
def test_message_that_is_not_understood_is_skipped(server: Any, message: str | bytes) -> None:
    with viewer_at(server.url) as connection:
        connection.send(message)
        viewer = Viewer(connection)
        wait_until(lambda: server.wanted)
        server.update(FeedUpdate(FeedState("p"), noise(1)))
        assert viewer.message()[1] == 0


def frame(opcode: int, data: bytes) -> bytes:
    """A WebSocket frame of a client, with a mask of zeros."""
    length = bytes([0x80 | len(data)]) if len(data) < 126 else struct.pack(">BH", 0xFE, len(data))
    return bytes([0x80 | opcode]) + length + bytes(4) + data


@pytest.fixture
def deaf(server: Any) -> Iterator[socket.socket]:
    """A viewer that subscribes to all channels, and never reads again."""
    with socket.socket() as client:
        client.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        client.connect(("127.0.0.1", int(server.url.rpartition(":")[2])))
        client.sendall(
            b"GET / HTTP/1.1\r\nHost: localhost\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
            b"Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\nSec-WebSocket-Version: 13\r\n"
            b"Sec-WebSocket-Protocol: foxglove.sdk.v1\r\n\r\n"
        )
        client.recv(12)
        wanted = [{"id": number, "channelId": number} for number in range(1, len(TOPICS) + 1)]
        subscribe = json.dumps({"op": "subscribe", "subscriptions": wanted}).encode()
        client.sendall(frame(1, subscribe))
        wait_until(lambda: server.wanted)
        yield client


DROPPED = re.compile(r"the viewer 127\.0\.0\.1:\d+ did not read, and was disconnected\n")


def test_viewer_that_does_not_read_is_dropped(server: Any, deaf, capsys) -> None:
    rows, sent = noise(10_000), 0
    while server.wanted:
        server.update(FeedUpdate(FeedState("p"), rows))
        sent += 10 * len(rows)
        assert sent < 100 * foxglove.MOST_UNREAD
    assert DROPPED.fullmatch(capsys.readouterr().err)


def test_viewer_that_pings_and_does_not_read_is_dropped(
    server: Any, deaf: socket.socket, capsys
) -> None:
    pings = frame(9, bytes(125)) * 1000
    for _ in while_waiting(lambda: "the end of the connection"):
        try:
            deaf.sendall(pings)
            server.update(FeedUpdate(FeedState("p"), noise(0)))
        except OSError:
            break
    wait_until(lambda: not server.wanted)
    assert DROPPED.fullmatch(capsys.readouterr().err)


# Who may read


@pytest.mark.parametrize(
    "origin",
    [
        foxglove.FOXGLOVE_ORIGIN,
        "http://localhost:8080",
        "https://127.0.0.1",
        "http://[::1]:3000",
        "file://",
    ],
)
def test_page_of_foxglove_or_of_this_machine_may_read(server: Any, origin: str) -> None:
    with viewer_at(server.url, origin=origin) as connection:
        Viewer(connection)


@pytest.mark.parametrize(
    "origin",
    [
        "https://evil.example", "null", "https://app.foxglove.dev.evil.example", "http://[::1",
        "https://localhost.evil.example", "http://127.0.0.1.evil.example", "data://localhost",
    ],
)  # fmt: skip
def test_other_page_is_refused(server: Any, origin: str) -> None:
    with pytest.raises(refusals.InvalidStatus) as refused:
        viewer_at(server.url, origin=origin)
    assert refused.value.response.status_code == 403


@pytest.mark.parametrize("name", ["https://plots.example.org", "plots.example.org/"])
def test_origin_is_allowed_by_an_option(environment, tmp_path: Path, name: str) -> None:
    origin = "https://plots.example.org"
    with started(environment, tmp_path, *WORDS, "--allow-origin", name) as capture:
        address = address_in(stderr_until(capture, "viewers can connect"))
        with viewer_at(address, origin=origin) as connection:
            assert Viewer(connection).message()
        with pytest.raises(refusals.InvalidStatus):
            viewer_at(address, origin="https://other.example.org")
        capture.send_signal(signal.SIGINT)
        assert ended(capture)[0] == 0


# What goes wrong


def test_refused_client_writes_nothing_on_the_screen(environment, tmp_path: Path) -> None:
    with started(environment, tmp_path, *WORDS) as capture:
        address = address_in(stderr_until(capture, "viewers can connect"))
        for _ in range(3):
            with pytest.raises(refusals.InvalidStatus):
                sync_client.connect(address, subprotocols=["another.v1"], open_timeout=BOUND_S)
        capture.send_signal(signal.SIGINT)
        code, _, errors = ended(capture)
    assert code == 0
    assert "ERROR" not in errors
    assert "handshake" not in errors


def test_port_that_is_in_use_is_one_line(run, tmp_path: Path) -> None:
    with server_socket() as taken:
        taken_port = taken.getsockname()[1]
        where = f"127.0.0.1:{taken_port}"
        done = run("live", SIM, "--count", "5", "--serve", where)
    assert (done.returncode, done.stdout) == (2, "")
    another = "name another port, as in --serve 8766"
    assert done.stderr == f"fte-sniff: --serve {where}: Address already in use; {another}\n"
    assert list(tmp_path.iterdir()) == []


def test_missing_package_is_named_with_its_command(environment, tmp_path: Path) -> None:
    hidden = tmp_path / "hidden"
    hidden.mkdir()
    (hidden / "websockets.py").write_text("raise ImportError")
    environment["PYTHONPATH"] = f"{hidden}:{ROOT}"
    with started(environment, tmp_path, "live", SIM, "--headless", "--serve") as capture:
        code, _, errors = ended(capture)
    assert code == 2
    assert re.search(r"--serve needs websockets: .*pip install 'fte-sniff\[foxglove\]'`", errors)
    assert errors.count("\n") == 1


@pytest.mark.parametrize("host", ["evil.example", "evil.example:8765", "localhost.evil.example"])
def test_name_that_leads_to_this_machine_is_refused(server: Any, host: str) -> None:
    with pytest.raises(refusals.InvalidStatus) as refused:
        viewer_at(server.url, additional_headers={"Host": host})
    assert refused.value.response.status_code == 403


@pytest.mark.parametrize(
    ("host", "bound", "allowed"),
    [
        ("localhost:1", "127.0.0.1", True),
        ("[::1]:1", "::1", True),
        ("192.168.1.4:8765", "0.0.0.0", True),
        ("Robot.Local:8765", "robot.local", True),
        ("robot.local", "127.0.0.1", False),
        ("[::1", "::1", False),
        ("", "127.0.0.1", False),
    ],
)
def test_host_is_an_address_or_the_bound_name(host: str, bound: str, allowed: bool) -> None:
    assert foxglove.allows_host(host, bound) == allowed
