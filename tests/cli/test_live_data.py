"""Rows for other programs: `--udp` as PlotJuggler reads it; real WebSocket clients of `--serve`."""

from __future__ import annotations

import base64
import json
import re
import signal
import socket
import struct
from collections.abc import Iterator
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any

import foxglove
import pytest
from mcap.reader import make_reader
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import ClientConnection, connect

from fte_sniff.analysis.feed import FeedUpdate
from fte_sniff.cli.live_data import (
    ENDED,
    PAUSED,
    PLAYING,
    SUBPROTOCOLS,
    Datagrams,
    FoxgloveWebSocket,
    PlayState,
    ServedChannels,
    address_of,
    datagram,
)
from fte_sniff.errors import UsageError
from fte_sniff.protocol import Damage, Fault, Rows, iso_time
from fte_sniff.recording.messages import EVENTS, TOPICS, message_class, topic_of
from fte_sniff.recording.reader import RecordingReader
from tests.beside import server_socket
from tests.cli.conftest import ROOT, decoded
from tests.cli.processes import ended, rows_in, started, stderr_until, wait_until
from tests.cli.terminals import terminal
from tests.recording.conftest import some_rows
from tests.slow import first
from tests.support.columns import without_facts
from tests.waiting import BOUND_S

SIM = "sim://?seed=1&rate=400&drop=0.02&noise=0.02"
WORDS = ("live", SIM, "--headless", "-o", "x.mcap", "--serve", "127.0.0.1:0")
_MESSAGE = struct.Struct("<BIQ")


_STATE = struct.Struct("<BBQf?")
_REQUEST = struct.Struct("<B?f?QI")


class Viewer:
    """A client that subscribes to all channels."""

    def __init__(self, connection: ClientConnection) -> None:
        assert connection.subprotocol in SUBPROTOCOLS
        self._connection = connection
        self.channels: dict[int, dict[str, Any]] = {}
        self.info: dict[str, Any] = {}
        self.states: list[PlayState] = []
        self.statuses: list[dict[str, Any]] = []
        while not self.channels:
            received = connection.recv(BOUND_S)
            if isinstance(received, bytes):
                continue
            said = json.loads(received)
            if said["op"] == "serverInfo":
                self.info = said
            if said["op"] == "advertise":
                self.channels = {one["id"]: one for one in said["channels"]}
        wanted = [{"id": number, "channelId": number} for number in self.channels]
        connection.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))

    def message(self) -> tuple[str, int, Any]:
        """Topic, time and decoded message of the next row or event."""
        while (data := self._received())[0] != 1:
            pass
        _, number, t_ns = _MESSAGE.unpack_from(data)
        channel = self.channels[number]
        assert (channel["encoding"], channel["schemaEncoding"]) == ("protobuf", "protobuf")
        made = message_class(channel["schemaName"], base64.b64decode(channel["schema"]))
        return channel["topic"], t_ns, made.FromString(data[_MESSAGE.size :])

    def _received(self) -> bytes:
        """The next binary message; a state of playback is kept too."""
        while isinstance(data := self._connection.recv(BOUND_S), str):
            self.statuses.append(json.loads(data))
        if data[0] == 5:
            self.states.append(PlayState(*_STATE.unpack_from(data)[1:]))
        return data

    def ask(self, *, plays: bool, speed: float = 1.0, seek_ns: int | None = None) -> None:
        """Request to play or pause."""
        request = _REQUEST.pack(3, not plays, speed, seek_ns is not None, seek_ns or 0, 1) + b"x"
        self._connection.send(request)

    def state(self, status: int, speed: float | None = None) -> PlayState:
        """The next state of playback with this status, and perhaps speed."""
        while True:
            while self.states:
                found = self.states.pop(0)
                if found.status == status and speed in (None, found.speed):
                    return found
            self._received()


def address_in(text: str) -> str:
    found = re.search(r"ws://127\.0\.0\.1:\d+", text)
    assert found
    return found[0]


def viewer_at(address: str, **options: Any) -> ClientConnection:
    return connect(address, subprotocols=SUBPROTOCOLS[:1], open_timeout=BOUND_S, **options)


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
    # The view learns of a port event apart from the rows.
    times = [t_ns for topic, t_ns, _ in messages if topic != EVENTS.name]
    assert times == sorted(times)


@pytest.mark.parametrize("clients", first(1, [5, 50]))
def test_clients_that_never_read_cost_no_row(environment, tmp_path, clients: int) -> None:
    with started(environment, tmp_path, *WORDS) as capture, ExitStack() as open_ones:
        address = address_in(stderr_until(capture, "viewers can connect"))
        for _ in range(clients):
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


def test_viewer_that_reads_too_slowly_loses_messages_that_are_counted(capsys) -> None:
    channels = ServedChannels(("127.0.0.1", 0), ["p"])
    channels.advertise()
    damage = [Damage("p", 1000 * n, bytes(1000), n, (Fault.NOISE,)) for n in range(1, 501)]
    rows, sent = Rows.from_rows(damage), 0
    with socket.socket() as narrow:
        narrow.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        narrow.connect(("127.0.0.1", channels.server.port))
        name = "{}:{}".format(*narrow.getsockname())
        with viewer_at(address_in(channels.text), sock=narrow, max_queue=1) as slow:
            viewer = Viewer(slow)
            wait_until(lambda: channels.server.wanted)
            while not channels.server.losses:
                channels.send(rows, [])
                sent += len(damage)
            got = 0
            while got + channels.server.losses[name] < sent:  # more may be lost meanwhile
                last = viewer.message()
                got += 1
            assert last[1] == damage[-1].t_ns
            assert channels.server.losses == {name: (lost := sent - got)}
            channels.close()
            with suppress(ConnectionClosed):
                while True:
                    assert isinstance(slow.recv(BOUND_S), str)
    warning = "this viewer reads too slowly and loses messages"
    assert viewer.statuses == [{"op": "status", "level": 1, "message": warning}]
    assert capsys.readouterr().err == (
        f"1 viewer read too slowly and lost {lost:,} messages ({name})\n"
    )


def test_viewer_that_never_reads_delays_no_end_and_loses_what_waits(capsys) -> None:
    channels = ServedChannels(("127.0.0.1", 0), ["p"])
    channels.advertise()
    damage = [Damage("p", 1000 * n, bytes(10_000), n, (Fault.NOISE,)) for n in range(1, 501)]
    with socket.socket() as narrow:
        narrow.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        narrow.connect(("127.0.0.1", channels.server.port))
        with viewer_at(address_in(channels.text), sock=narrow, max_queue=1) as slow:
            Viewer(slow)
            wait_until(lambda: channels.server.wanted)
            channels.send(Rows.from_rows(damage), [])
            assert channels.server.losses == {}
            channels.close()
            got = 0
            with suppress(ConnectionClosed):
                while True:
                    got += isinstance(slow.recv(BOUND_S), bytes)
    said = re.fullmatch(
        r"1 viewer read too slowly and lost ([\d,]+) messages \(.*\)\n", capsys.readouterr().err
    )
    assert said
    assert got + int(said[1].replace(",", "")) <= len(damage)


@pytest.mark.parametrize("protocol", SUBPROTOCOLS)
def test_each_viewer_gets_what_it_subscribed_to(protocol: str) -> None:
    channels = ServedChannels(("127.0.0.1", 0), ["p"])
    channels.advertise()
    rows = Rows.from_rows([Damage("p", 1000 * n, b"x", n, (Fault.NOISE,)) for n in range(5)])
    with connect(
        address_in(channels.text), subprotocols=[protocol], open_timeout=BOUND_S
    ) as connection:
        channels.send(rows, [])  # nobody subscribed to it
        viewer = Viewer(connection)
        wait_until(lambda: channels.server.wanted)
        channels.send(rows, [])
        assert [viewer.message()[1] for _ in range(5)] == [*range(5)]
        connection.send(json.dumps({"op": "unsubscribe", "subscriptionIds": [*viewer.channels]}))
        wait_until(lambda: not channels.server.wanted)
        channels.send(rows, [])
        channels.close()
        with suppress(ConnectionClosed):
            while True:
                assert isinstance(connection.recv(BOUND_S), str)


@pytest.mark.parametrize(
    "message",
    [
        '{"op": "nonsense"}', "nonsense", "[]", "[" * 100_000, '{"op": "subscribe"}',
        '{"op": "subscribe", "subscriptions": [{"id": 1, "channelId": 99}]}',
        '{"op": "subscribe", "subscriptions": [{"id": -1, "channelId": 1}]}',
        '{"op": "subscribe", "subscriptions": [{"id": Infinity, "channelId": 1}]}',
        '{"op": "unsubscribe", "subscriptionIds": ["\\u001b[2J"]}', '{"op": "getParameters"}',
        b"", b"\x09abc", b"\x03", _REQUEST.pack(3, 0, 1.0, 0, 0, 7),
    ],
    ids=lambda one: repr(one[:40]),
)  # fmt: skip
@pytest.mark.parametrize("plays", [False, True])
def test_what_a_viewer_cannot_ask_is_answered(message: str | bytes, plays: bool) -> None:
    options: dict[str, Any] = {"span_ns": (0, 1), "on_control": None} if plays else {}
    server = FoxgloveWebSocket(("127.0.0.1", 0), **options)
    with viewer_at(f"ws://127.0.0.1:{server.port}") as connection:
        asked = [json.loads(connection.recv(BOUND_S))["op"] for _ in range(2)]
        assert asked == ["serverInfo", "advertise"]
        connection.send(message)
        said = json.loads(connection.recv(BOUND_S))
        assert (said["op"], said["level"]) == ("status", 2)
        assert "\x1b" not in said["message"]
        assert server.close() == {}


def test_protocol_is_that_of_the_library_of_foxglove() -> None:
    """foxglove-sdk, which does not count what a viewer loses, sends the same."""
    span_ns, t_ns = (10**18 + 1, 2 * 10**18), 10**18 + 7
    own = FoxgloveWebSocket(("127.0.0.1", 0), span_ns=span_ns)
    number = own.add_channel("/a", "X", b"schema", {"port": "p"})
    context = foxglove.Context()
    other = foxglove.start_server(
        name="fte-sniff", port=0, context=context, playback_time_range=span_ns
    )
    schema = foxglove.Schema(name="X", encoding="protobuf", data=b"schema")
    channel = foxglove.Channel(
        "/a", schema=schema, message_encoding="protobuf", metadata={"port": "p"}, context=context
    )
    received = []
    for port, at in ((own.port, number), (other.port, channel.id())):
        with viewer_at(f"ws://127.0.0.1:{port}") as connection:
            texts = [json.loads(connection.recv(BOUND_S)) for _ in range(2)]
            for name in ("sessionId", "metadata"):  # the library names itself
                texts[0].pop(name, None)
            assert texts[1]["channels"][0].pop("id") == at
            wanted = [{"id": 5, "channelId": at}]
            connection.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))
            if port == own.port:
                wait_until(lambda: own.wanted)
                own.send([(at, t_ns, b"data")])
                own.report(PlayState(PAUSED, t_ns, 1.5, jumped=True))
            else:
                wait_until(channel.has_sinks)
                channel.log(b"data", log_time=t_ns)
                status = foxglove.websocket.PlaybackStatus.Paused
                state = foxglove.websocket.PlaybackState(status, t_ns, 1.5, True, None)
                other.broadcast_playback_state(state)
            received.append((texts, {connection.recv(BOUND_S) for _ in range(2)}))
    assert received[0] == received[1]
    own.close()
    other.stop()


def test_a_refused_client_writes_nothing_on_the_screen(environment, tmp_path: Path) -> None:
    with started(environment, tmp_path, *WORDS) as capture:
        address = address_in(stderr_until(capture, "viewers can connect"))
        for _ in range(3):
            with pytest.raises(InvalidStatus):
                connect(address, subprotocols=["another.v1"], open_timeout=BOUND_S)  # type: ignore[list-item]
        with viewer_at(address) as connection:
            viewer = Viewer(connection)
            wait_until(lambda: viewer.message()[0].startswith("/fte/feedback"))
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
    another = f"name another port, as in --serve {taken_port + 1}"
    assert done.stderr == f"fte-sniff: --serve {where}: Address already in use; {another}\n"
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("where", "told"),
    [("0.0.0.0:8765", "anyone in that network could read"), ("sim://", "or --serve alone")],
)
def test_address_that_is_not_of_this_machine_is_refused(run, where: str, told: str) -> None:
    done = run("live", SIM, "--count", "5", "--no-record", "--serve", where)
    assert done.returncode == 2
    assert told in done.stderr


@pytest.mark.parametrize("words", [("live",), ("view",)])
def test_port_or_file_behind_serve_is_not_its_address(run, samples, words) -> None:
    file = str(samples / "clean.mcap")
    done = run(*words, "--serve", file)
    assert (done.returncode, done.stdout) == (2, "")
    assert f"--serve {file} is not HOST:PORT or PORT; write" in done.stderr
    assert done.stderr.count("\n") == 1


def test_missing_package_is_named_with_its_command(environment, tmp_path: Path) -> None:
    hidden = tmp_path / "hidden"
    hidden.mkdir()
    (hidden / "websockets.py").write_text("raise ImportError")
    environment["PYTHONPATH"] = f"{hidden}:{ROOT}"
    with started(environment, tmp_path, "live", SIM, "--headless", "--serve") as capture:
        code, _, errors = ended(capture)
    assert code == 2
    assert "--serve needs the package websockets: " in errors
    assert re.search(r"install .*websockets", errors)
    assert errors.count("\n") == 1


NOON_NS = 1_769_860_800_000_000_000
"""About the first time of the samples."""


def test_file_is_played_as_the_viewer_asks(environment, tmp_path: Path, samples: Path) -> None:
    file = str(samples / "motor3.mcap")
    with terminal(environment, tmp_path, "view", file, "--serve", "127.0.0.1:0") as screen:
        screen.until("Foxglove WebSocket")
        address = address_in(screen.drawn.decode(errors="replace"))
        with screen.drawing(), viewer_at(address) as connection:
            viewer = Viewer(connection)
            assert "playbackControl" in viewer.info["capabilities"]
            assert {one["topic"] for one in viewer.channels.values()} == {t.name for t in TOPICS}
            viewer.ask(plays=True, speed=100)
            assert viewer.state(PLAYING).speed == 100
            played = [viewer.message() for _ in range(200)]
            viewer.ask(plays=False, speed=100)
            paused = viewer.state(PAUSED)
            assert NOON_NS < paused.t_ns < NOON_NS + 81 * 10**9
            sought_ns = NOON_NS + 70 * 10**9
            viewer.ask(plays=True, speed=3, seek_ns=sought_ns)
            assert viewer.state(PLAYING, speed=3).t_ns == sought_ns
            wait_until(lambda: viewer.message()[1] >= sought_ns)
            found = viewer.message()
            assert sought_ns <= found[1] < sought_ns + 5 * 10**9
            viewer.ask(plays=True, speed=1000)  # the fastest is 100
            assert viewer.state(PLAYING, speed=100)
            end = viewer.state(ENDED)
            assert end.t_ns == max(time for _, time in recorded(Path(file)))
            assert not end.jumped  # it followed from the times before
            viewer.ask(plays=True, speed=1)  # from the start again
            while not (found_state := viewer.state(PLAYING, speed=1)).jumped:
                pass
            assert found_state.t_ns < NOON_NS + 10**9
        screen.type("Q")
        assert screen.ended() == 0
    known = recorded(Path(file))
    for topic, t_ns, message in played:
        assert str(message) == str(known[topic, t_ns])
    assert [t_ns for _, t_ns, _ in played] == sorted(t_ns for _, t_ns, _ in played)


def test_keys_of_the_screen_control_what_is_served(environment, tmp_path, samples: Path) -> None:
    file = str(samples / "motor3.mcap")
    options = ("--serve", "127.0.0.1:0", "--play", "5")
    with terminal(environment, tmp_path, "view", file, *options) as screen:
        screen.until("Foxglove WebSocket")
        address = address_in(screen.drawn.decode(errors="replace"))
        with screen.drawing(), viewer_at(address) as connection:
            viewer = Viewer(connection)
            assert viewer.state(PLAYING).speed == 5
            screen.type(">")
            assert viewer.state(PLAYING, speed=10)
            screen.type(" ")
            assert viewer.state(PAUSED, speed=10)
        screen.type("Q")
        assert screen.ended() == 0


def test_playback_without_a_terminal_is_one_line(run, samples: Path) -> None:
    done = run("view", samples / "clean.mcap", "--serve")
    assert (done.returncode, done.stdout) == (2, "")
    assert "view needs a terminal; its keys play what --serve sends; run it in tmux" in done.stderr
    assert done.stderr.count("\n") == 1


@pytest.mark.parametrize(
    ("name", "options", "reason"),
    [
        ("clean.raw", (), "these have none; try --start"),
        ("clean.mcap", ("--follow",), "leave --follow out"),
        ("clean.mcap", ("--serve", "0.0.0.0:1"), "anyone in that network could read"),
    ],
)
def test_playback_that_cannot_be_served_is_one_line(
    environment, tmp_path: Path, samples: Path, name: str, options: tuple[str, ...], reason: str
) -> None:
    words = ("view", str(samples / name), "--serve", "127.0.0.1:0", *options)
    with terminal(environment, tmp_path, *words, size=(200, 24)) as screen:
        assert screen.ended() == 2
    assert reason in screen.drawn.decode()
    assert b"Traceback" not in screen.drawn


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


def test_csv_of_a_capture_has_a_header_also_without_rows(run) -> None:
    words = ("live", "sim://?host=off&wire=control", "--no-record", "--duration", "0.1")
    done = run(*words, "--format", "csv")
    assert done.returncode == 0
    assert done.stdout.startswith("time,port,offset")
    assert done.stdout.count("\n") == 1


def test_every_row_is_a_datagram_with_the_names_of_the_topics(run, receiver, tmp_path) -> None:
    words = ("live", SIM, "--count", "200", "-o", "x.mcap", "--format", "csv")
    done = run(*words, "--udp", address(receiver))
    assert done.returncode == 0
    assert f"200 rows sent to UDP 127.0.0.1 port {receiver.getsockname()[1]}\n" in done.stderr
    rows = list(RecordingReader(tmp_path / "x.mcap"))
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


def test_datagram_that_is_too_large_is_counted(receiver, capsys) -> None:
    rows = [*some_rows(3), Damage("p", 0, bytes(60_000), 1, (Fault.NOISE,)), *some_rows(2)]
    sender = Datagrams(receiver.getsockname(), None)
    update = FeedUpdate(None, Rows.from_rows(rows), [], [])  # type: ignore[arg-type]
    sender.update(update, None)  # type: ignore[arg-type]
    sender.ended(None)  # type: ignore[arg-type]
    said = capsys.readouterr().err
    assert re.fullmatch(r"5 rows sent to UDP 127.0.0.1 port \d+, 1 could not be sent\n", said)
    assert [receiver.recv(1 << 16) for _ in range(5)] == [
        *map(datagram, some_rows(3)),
        *map(datagram, some_rows(2)),
    ]


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("98700", "is not HOST:PORT or PORT; write --udp 127.0.0.1:9870"),
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
def test_addresses_that_are_wrong_or_not_here_are_refused(text: str, told: str) -> None:
    with pytest.raises(UsageError, match=told) as error:
        address_of(text, "--udp", network=False)
    assert str(error.value).isprintable()


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("127.0.0.1:1", ("127.0.0.1", 1)),
        (":9870", ("127.0.0.1", 9870)),
        ("9870", ("127.0.0.1", 9870)),
        ("[::1]:9870", ("::1", 9870)),
    ],
)
def test_addresses_of_this_machine_are_accepted(text: str, expected: tuple[str, int]) -> None:
    assert address_of(text, "--udp", network=False) == expected


def test_network_is_allowed_by_an_option() -> None:
    assert address_of("192.0.2.1:9870", "--udp", network=True) == ("192.0.2.1", 9870)


@pytest.mark.parametrize(
    "words",
    [
        ("--headless", "--format", "jsonl", "-o", "x.mcap"),
        ("-o", "-", "--format", "jsonl"),
        ("--udp", "8.8.8.8:1", "--no-record"),
        ("--format", "parquet"),
    ],
)
def test_options_that_contradict_each_other_are_refused(
    run, tmp_path: Path, words: tuple[str, ...]
) -> None:
    done = run("live", SIM, "--count", "5", *words)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.count("\n") == 1
    assert list(tmp_path.iterdir()) == []
