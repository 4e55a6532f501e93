"""Rows of a capture, or of a file that is played, for other programs: `--udp` and `--serve`.

`--udp` sends JSON objects as datagrams, for example to PlotJuggler. `--serve` is a server of
Foxglove's WebSocket protocol, https://github.com/foxglove/ws-protocol, docs/spec.md, with the
playback control of foxglove-sdk. Each viewer has a queue, and its losses are counted. The
WebSockets are those of the package websockets.
"""

from __future__ import annotations

import asyncio
import json
import logging
import socket
import struct
from base64 import b64encode
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict
from functools import partial
from math import inf
from queue import Empty, SimpleQueue
from threading import Thread
from time import monotonic, time_ns
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import click

from fte_sniff.cli.capture_loop import Observer, in_order
from fte_sniff.cli.options import Decorator, install_command
from fte_sniff.cli.streams import print_err
from fte_sniff.errors import UsageError, printable, reason_of
from fte_sniff.formats.writers import json_text
from fte_sniff.protocol import PortEvent, Row, iso_time, record
from fte_sniff.session.replay import PlayRequest

if TYPE_CHECKING:
    from websockets.asyncio.server import ServerConnection

    from fte_sniff.analysis.feed import FeedUpdate
    from fte_sniff.analysis.filter.row_filter import RowFilter
    from fte_sniff.protocol.rows import Rows
    from fte_sniff.recording.messages import Topic
    from fte_sniff.session.capture_process import CapturePlan
    from fte_sniff.session.live_session import LiveSession
    from fte_sniff.session.replay import Playback, PlayRequest


DEFAULT_ADDRESS: Final = "127.0.0.1:8765"
"""Where viewers look if the user names no other."""


def _host_and_port(text: str, option: str) -> tuple[str, int]:
    """Host and port of `HOST:PORT` or `PORT`; raises UsageError for other texts."""
    name, colon, number = text.rpartition(":")
    is_number = number.isdecimal() and number.isascii() and int(number) < 1 << 16
    if is_number and (colon or number == text):
        return name, int(number)
    example = "--udp 127.0.0.1:9870"
    if option == "--serve":
        example = f"--serve {DEFAULT_ADDRESS}, or --serve alone at the end"
    raise UsageError(f"{option} {printable(text)} is not HOST:PORT or PORT; write {example}")


def _checked(context: click.Context, _option: click.Parameter, text: str | None) -> str | None:
    """Refuse a port or file behind `--serve`, which click takes as its value."""
    if text is not None and not context.resilient_parsing:
        _host_and_port(text, "--serve")
    return text


serve_option = click.option(
    "--serve",
    is_flag=False,
    callback=_checked,
    flag_value=DEFAULT_ADDRESS,
    metavar="[[HOST:]PORT]",
    help=f"Serve the rows to viewers over WebSocket, by default at {DEFAULT_ADDRESS}.",
)
"""The `--serve` option."""


def network_option(allowed: str) -> Decorator:
    """The `--network` option, which allows these options to use a network."""
    return click.option(
        "--network",
        is_flag=True,
        help=f"Allow {allowed} to use a network: anyone there can read.",
    )


def address_of(text: str, option: str, *, network: bool) -> tuple[str, int]:
    """The address of `HOST:PORT` or `PORT`; without a host this machine, IPv6 in brackets.

    Raises UsageError if it is not valid, or is another machine and `network` is false.
    """
    import ipaddress
    import socket

    name, number = _host_and_port(text, option)
    shown = f"{option} {printable(text)}"
    try:
        found = socket.getaddrinfo(name.strip("[]") or "127.0.0.1", number)
    except (OSError, UnicodeError) as error:
        reason = reason_of(error) if isinstance(error, OSError) else "it is not a name"
        raise UsageError(f"{shown}: the host is not known ({reason})") from None
    host = str(found[0][4][0])
    if not network and not ipaddress.ip_address(host.partition("%")[0]).is_loopback:
        raise UsageError(
            f"{shown} is not this machine: anyone in that network could read; add --network if they"
            " may"
        )
    return host, number


def datagram(entry: Row | PortEvent) -> bytes:
    """A JSON object, nested by its topic, so that a plotter names it as a recording's.

    `timestamp` is in seconds since 1970; PlotJuggler takes it as the time. Values that a row does
    not have are left out.
    """
    from fte_sniff.recording.messages import EVENTS, topic_of

    values: dict[str, object]
    if isinstance(entry, PortEvent):
        topic, values = EVENTS, asdict(entry)
        del values["t_ns"]
    else:
        topic = topic_of(entry)
        values = {name: value for name, value in record(entry).items() if value is not None}
    whole: dict[str, object] = {}
    if entry.t_ns is not None:
        values["time"] = iso_time(entry.t_ns)
        whole["timestamp"] = entry.t_ns / 1e9
    nested: object = values
    for part in reversed(topic.name.strip("/").split("/")):
        nested = {part: nested}
    assert isinstance(nested, dict)
    return json_text(whole | nested).encode("utf-8", "backslashreplace")


class Datagrams(Observer):
    """Sends each row and port event as a datagram; what cannot be sent at once is counted."""

    def __init__(self, address: tuple[str, int], wanted: RowFilter | None) -> None:
        self._wanted = None if wanted is None else wanted.stream()
        self._address = address
        family = socket.AF_INET6 if ":" in address[0] else socket.AF_INET
        self._socket = socket.socket(family, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self._sent = self._lost = 0

    def update(self, update: FeedUpdate, session: LiveSession) -> None:
        """Send the rows that pass the filter, and the port events, in order of time."""
        rows = update.rows
        if self._wanted is not None:
            rows = self._wanted.select(rows, update.changes)
        for entry in in_order(rows, update.events):
            try:
                self._socket.sendto(datagram(entry), self._address)
            except OSError:  # full, too large, no network, or nobody listens
                self._lost += 1
            else:
                self._sent += not isinstance(entry, PortEvent)

    def ended(self, session: LiveSession) -> None:
        """Print how many rows were sent."""
        self._socket.close()
        host, port = self._address
        lost = f", {self._lost:,} could not be sent" if self._lost else ""
        print_err(f"{self._sent:,} rows sent to UDP {host} port {port}{lost}")


SUBPROTOCOLS: Final = ("foxglove.sdk.v1", "foxglove.websocket.v1")
"""Of Foxglove, and of programs before 2025, such as Lichtblick; they are equal in what is used."""
MOST_WAITING: Final = 4096
"""Messages that wait for a slow viewer; then it loses the oldest."""
_MOST_REPLIES: Final = 64
_MOST_VIEWERS: Final = 64
_HANG_UP_S: Final = 1.0
"""How long viewers may take to read the last messages at the end, seconds."""
_MOST_SHOWN: Final = 80

_WARNING, _ERROR = 1, 2
"""Levels of a status."""
_MESSAGE: Final = struct.Struct("<BIQ")
"""1, subscription, time in nanoseconds; the message follows."""
_REQUEST: Final = struct.Struct("<BBf?QI")
"""3, whether to pause, speed, whether to seek, to which time; the length of the request's id, which
follows."""
_STATE: Final = struct.Struct("<BBQf?I")
"""5, status, time, speed, whether the time jumped; the length of the request's id, as above."""
PLAYING, PAUSED, ENDED = 0, 1, 3
"""Statuses of a playback."""


class PlayState(NamedTuple):
    """What viewers learn about a playback."""

    status: int
    t_ns: int
    speed: float
    jumped: bool = False
    """Whether the time did not follow from the last one."""


class _Viewer:
    """A connected viewer: its subscriptions, and what waits for it."""

    def __init__(self, connection: ServerConnection) -> None:
        self.connection = connection
        self.address = "{}:{}".format(*connection.remote_address[:2])
        self.subscriptions: dict[int, int] = {}
        """Their numbers by channel."""
        self.replies = deque[str | bytes](maxlen=_MOST_REPLIES)
        self.waiting = deque[bytes]()
        self.lost = 0
        self.ends = False
        """Whether to hang up once nothing waits."""
        self.wakes = asyncio.Event()

    def put(self, message: bytes) -> None:
        """Let a message wait; the oldest one gives way."""
        if len(self.waiting) == MOST_WAITING:
            self.waiting.popleft()
            self.lost += 1
            if self.lost == 1:
                self.reply(_status(_WARNING, "this viewer reads too slowly and loses messages"))
        self.waiting.append(message)
        self.wakes.set()

    def reply(self, message: str | bytes) -> None:
        """Let a message wait that comes before all others."""
        self.replies.append(message)
        self.wakes.set()

    async def send_all(self) -> None:
        """Send what waits, until the end."""
        while not self.ends or self.replies or self.waiting:
            self.wakes.clear()
            while self.replies or self.waiting:
                await self.connection.send((self.replies or self.waiting).popleft())
            if not self.ends:
                await self.wakes.wait()
        await self.connection.close(1001)


def _status(level: int, message: str) -> str:
    return json.dumps({"op": "status", "level": level, "message": message})


class FoxgloveWebSocket:
    """Serves channels of messages; its methods are called from one other thread."""

    def __init__(
        self,
        address: tuple[str, int],
        *,
        span_ns: tuple[int, int] | None = None,
        on_control: Callable[[PlayRequest], PlayState] | None = None,
    ) -> None:
        """Listen at the address.

        Args:
            address: host and port; port 0 is any that is free.
            span_ns: the first and the last time of data that are played, if viewers may control it.
            on_control: is called with each request of a viewer, and returns the state.

        Raises UsageError if the package is not installed, or the address cannot be used.
        """
        try:
            from websockets.asyncio.server import serve
            from websockets.typing import Subprotocol
        except ImportError:
            raise UsageError(
                f"--serve needs the package websockets: {install_command('foxglove')}"
            ) from None
        host, port = address
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        try:
            listening = socket.create_server(address, family=family)
        except OSError as error:
            reason, _, _ = reason_of(error).partition(" (while")  # Python adds the address
            raise UsageError(
                f"--serve {host}:{port}: {reason}; name another port, as in"
                f" --serve {(port + 1) % (1 << 16)}"
            ) from None
        self.port = int(listening.getsockname()[1])
        self._channels: list[dict[str, Any]] = []
        self._viewers: set[_Viewer] = set()
        self._lost: dict[str, int] = {}
        """By the address of viewers that are gone."""
        self.wanted: frozenset[int] = frozenset()
        """The channels that viewers subscribed to."""
        self._on_control = on_control
        self._info: dict[str, Any] = {
            "op": "serverInfo",
            "name": "fte-sniff",
            "capabilities": ["playbackControl"] if span_ns else [],
            "sessionId": str(time_ns() // 10**6),
        }
        for name, t_ns in zip(("dataStartTime", "dataEndTime"), span_ns or (), strict=False):
            self._info[name] = dict(zip(("sec", "nsec"), divmod(t_ns, 10**9), strict=True))
        quiet = logging.getLogger(f"{__name__}.library")  # it would write on the screen
        quiet.propagate = False
        quiet.handlers = [logging.NullHandler()]
        self._loop = asyncio.new_event_loop()
        listen = partial(
            serve,
            self._serve,
            sock=listening,
            subprotocols=[*map(Subprotocol, SUBPROTOCOLS)],
            compression=None,
            ping_interval=None,  # a viewer that reads slowly also answers pings slowly
            logger=quiet,
        )
        self._server = asyncio.run_coroutine_threadsafe(self._listen(listen), self._loop)
        self._thread = Thread(target=self._loop.run_forever, name="serves viewers", daemon=True)
        self._thread.start()
        self._server.result()

    async def _listen(self, listen: Any) -> Any:
        return await listen()  # in the thread of the loop

    def add_channel(
        self, topic: str, schema_name: str, schema: bytes, metadata: Mapping[str, str]
    ) -> int:
        """Advertise a channel of protobuf messages; the schema is a FileDescriptorSet."""
        number = len(self._channels) + 1
        channel = {
            "id": number,
            "topic": topic,
            "encoding": "protobuf",
            "schemaName": schema_name,
            "schemaEncoding": "protobuf",
            "schema": b64encode(schema).decode(),
            "metadata": dict(metadata),
        }
        self._channels.append(channel)
        self._loop.call_soon_threadsafe(self._reply_to_all, _advertised([channel]))
        return number

    def send(self, messages: Iterable[tuple[int, int, bytes]]) -> None:
        """Send messages to the viewers of their channels: channel, time and message of each."""
        self._loop.call_soon_threadsafe(self._send, [*messages])

    def report(self, state: PlayState) -> None:
        """Report the state of the playback to all viewers."""
        self._loop.call_soon_threadsafe(self._reply_to_all, _packed(state))

    def close(self) -> dict[str, int]:
        """Hang up, and return the losses."""
        asyncio.run_coroutine_threadsafe(self._hang_up(), self._loop).result()
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
        self._loop.close()
        return self._lost

    @property
    def losses(self) -> dict[str, int]:
        """How many messages viewers lost because they read too slowly, by their address."""
        return self._lost | {one.address: one.lost for one in [*self._viewers] if one.lost}

    # What follows runs in the thread of the loop.

    def _send(self, messages: list[tuple[int, int, bytes]]) -> None:
        for viewer in self._viewers:
            subscriptions = viewer.subscriptions
            for channel, t_ns, message in messages:
                if (number := subscriptions.get(channel)) is not None:
                    viewer.put(_MESSAGE.pack(1, number, t_ns) + message)

    def _reply_to_all(self, message: str | bytes) -> None:
        for viewer in self._viewers:
            viewer.reply(message)

    async def _serve(self, connection: ServerConnection) -> None:
        """Serve one viewer."""
        from websockets.exceptions import ConnectionClosed

        if len(self._viewers) >= _MOST_VIEWERS:
            await connection.close(1013, f"{_MOST_VIEWERS} viewers are connected")
            return
        viewer = _Viewer(connection)
        viewer.reply(json.dumps(self._info))
        viewer.reply(_advertised(self._channels))
        self._viewers.add(viewer)
        sends = asyncio.ensure_future(viewer.send_all())
        try:
            with suppress(ConnectionClosed):
                async for message in connection:
                    if reply := self._reply_of(viewer, message):
                        viewer.reply(reply)
        finally:
            sends.cancel()
            with suppress(ConnectionClosed, asyncio.CancelledError):
                await sends
            self._forget(viewer)

    def _forget(self, viewer: _Viewer) -> None:
        if viewer not in self._viewers:
            return
        self._viewers.remove(viewer)
        self._find_wanted()
        if viewer.lost:
            self._lost[viewer.address] = self._lost.get(viewer.address, 0) + viewer.lost

    def _find_wanted(self) -> None:
        self.wanted = frozenset().union(*(one.subscriptions for one in self._viewers))

    def _reply_of(self, viewer: _Viewer, message: str | bytes) -> str | bytes | None:
        """Do what a viewer asks, and return the answer."""
        if isinstance(message, bytes):
            return self._control(message)
        try:
            asked = json.loads(message)
            operation = asked["op"]
            if operation == "subscribe":
                pairs = [(int(one["id"]), int(one["channelId"])) for one in asked["subscriptions"]]
                return self._subscribe(viewer, pairs)
            if operation == "unsubscribe":
                gone = {*map(int, asked["subscriptionIds"])}
                kept = ((at, own) for at, own in viewer.subscriptions.items() if own not in gone)
                viewer.subscriptions = dict(kept)
                self._find_wanted()
                return None
        except (ValueError, TypeError, KeyError, OverflowError, RecursionError):
            operation = message
        return _status(_ERROR, f"not supported: {str(operation)[:_MOST_SHOWN]}")

    def _subscribe(self, viewer: _Viewer, pairs: Iterable[tuple[int, int]]) -> str | None:
        for number, channel in pairs:
            if not 0 < channel <= len(self._channels):
                return _status(_ERROR, f"channel {channel} does not exist")
            if not 0 <= number < 1 << 32 or number in viewer.subscriptions.values():
                return _status(_ERROR, f"subscription {number} cannot be used")
            viewer.subscriptions.setdefault(channel, number)
        self._find_wanted()
        return None

    def _control(self, message: bytes) -> str | bytes:
        """The state of the playback after what a viewer asks."""
        if self._on_control is None or message[:1] != b"\x03" or len(message) < _REQUEST.size:
            return _status(_ERROR, f"not supported: {message[:_MOST_SHOWN].hex(' ')}")
        _, pauses, speed, seeks, t_ns, size = _REQUEST.unpack_from(message)
        identity = message[_REQUEST.size :]
        if len(identity) != size:
            return _status(_ERROR, "the request has another length than it says")
        asked = PlayRequest(not pauses, speed, t_ns if seeks else None)
        return _packed(self._on_control(asked), identity)

    async def _hang_up(self) -> None:
        server, left = self._server.result(), [*self._viewers]
        tasks = asyncio.all_tasks() - {asyncio.current_task()}
        server.close(close_connections=False)
        for viewer in left:
            viewer.ends = True
            viewer.wakes.set()
        ends = [asyncio.ensure_future(one.connection.wait_closed()) for one in left]
        if ends:
            await asyncio.wait(ends, timeout=_HANG_UP_S)
        for viewer in [*self._viewers]:
            viewer.lost += len(viewer.waiting)
            viewer.connection.transport.abort()
            self._forget(viewer)
        for task in tasks:  # those that still connect too
            task.cancel()
        await server.wait_closed()
        await asyncio.gather(*tasks, *ends, return_exceptions=True)


def _advertised(channels: list[dict[str, Any]]) -> str:
    return json.dumps({"op": "advertise", "channels": channels})


def _packed(state: PlayState, request: bytes = b"") -> bytes:
    """The state of a playback in bytes, with the id of the request that it answers."""
    status, t_ns, speed, jumped = state
    return _STATE.pack(5, status, t_ns, speed, jumped, len(request)) + request


_MOST_NAMED: Final = 3


class ServedChannels:
    """The channels of a recording for viewers: the same topics, schemas and messages."""

    def __init__(self, address: tuple[str, int], ports: Sequence[str], **playback: Any) -> None:
        """Listen at the address; `playback` is that of `FoxgloveWebSocket`.

        Raises UsageError as `FoxgloveWebSocket`.
        """
        self.server = FoxgloveWebSocket(address, **playback)
        self.text = (
            f"viewers can connect to ws://{address[0]}:{self.server.port} (Foxglove WebSocket)"
        )
        """The address, for the user."""
        self._channels: dict[tuple[str, str], int] = {}
        self._ports = ports

    def advertise(self) -> None:
        """Advertise every topic of every port."""
        from fte_sniff.recording.messages import TOPICS

        for port in self._ports:
            for topic in TOPICS:
                self._channel(port, topic)

    def send(self, rows: Rows, events: Sequence[PortEvent]) -> None:
        """Send the rows and port events that viewers subscribed to, in order of time."""
        from fte_sniff.recording.messages import EVENTS, encode_event, encode_row, topic_of

        messages = list[tuple[int, int, bytes]]()
        for entry in in_order(rows, events):
            topic = EVENTS if isinstance(entry, PortEvent) else topic_of(entry)
            channel, t_ns = self._channel(entry.port, topic), entry.t_ns or 0
            if channel not in self.server.wanted:
                continue
            if isinstance(entry, PortEvent):
                message = encode_event(entry, t_ns)
            else:
                message = encode_row(topic, entry, t_ns)
            messages.append((channel, t_ns, message))
        if messages:
            self.server.send(messages)

    def close(self) -> None:
        """Hang up, and report what viewers lost."""
        if losses := self.server.close():
            count, total = len(losses), sum(losses.values())
            names = ", ".join([*losses][:_MOST_NAMED]) + ", ..." * (count > _MOST_NAMED)
            print_err(
                f"{count:,} viewer{'s' * (count > 1)} read too slowly and lost"
                f" {total:,} message{'s' * (total > 1)} ({names})"
            )

    def _channel(self, port: str, topic: Topic) -> int:
        found = self._channels.get((port, topic.name))
        if found is None:
            from fte_sniff.recording.messages import encodable, schema_data, schema_name

            found = self._channels[port, topic.name] = self.server.add_channel(
                topic.name,
                schema_name(topic),
                schema_data(topic.schema),
                {"port": encodable(port)},
            )
        return found


class FoxgloveServer(Observer):
    """Serves the rows of a capture as they come."""

    def __init__(self, address: tuple[str, int], plan: CapturePlan) -> None:
        """Listen at the address; raises UsageError as `FoxgloveWebSocket`."""
        self._channels = ServedChannels(address, plan.wiring.names)

    def begun(self, session: LiveSession) -> None:
        """Advertise the channels, and print the address."""
        self._channels.advertise()
        print_err(self._channels.text)

    def update(self, update: FeedUpdate, session: LiveSession) -> None:
        """Send the rows and port events."""
        self._channels.send(update.rows, update.events)

    def ended(self, session: LiveSession) -> None:
        """Hang up."""
        self._channels.close()


STATE_INTERVAL_S: Final = 1.0
"""A viewer that connects later knows the state of playback after this time."""


class PlaybackServer:
    """Serves a file as it is played; viewers can play, pause, seek and set the speed."""

    def __init__(
        self, address: tuple[str, int], ports: Sequence[str], span_ns: tuple[int, int]
    ) -> None:
        """Listen at the address; `span_ns` are the first and the last time of the rows.

        Raises UsageError as `FoxgloveWebSocket`.
        """
        self._requests: SimpleQueue[PlayRequest] = SimpleQueue()
        self._span_ns, self._t_ns = span_ns, span_ns[0]
        self._channels = ServedChannels(address, ports, span_ns=span_ns, on_control=self._answer)
        self._channels.advertise()
        self._shown: tuple[object, ...] = ()
        self._due_s = -inf

    @property
    def text(self) -> str:
        """The address, for the user."""
        return self._channels.text

    def requests(self) -> Iterator[PlayRequest]:
        """The requests of viewers since the last call."""
        while True:
            try:
                yield self._requests.get_nowait()
            except Empty:
                return

    def send(self, rows: Rows, events: Sequence[PortEvent]) -> None:
        """Send what was played."""
        self._channels.send(rows, events)

    def report(self, play: Playback | None, *, jumped: bool) -> None:
        """Report the state of playback where it changed, and from time to time; None: at the end.

        `jumped` is whether the time did not follow from the last one.
        """
        status, speed, t_ns = ENDED, 1.0, self._span_ns[1]
        if play is not None:
            speed, t_ns = play.speed, min(play.t_ns, t_ns)
            status = PAUSED if play.paused else ENDED if play.is_over else PLAYING
        shown, now_s = (status, speed), monotonic()
        self._t_ns = max(t_ns, 0)
        if shown == self._shown and not jumped and now_s < self._due_s:
            return
        self._shown, self._due_s = shown, now_s + STATE_INTERVAL_S
        self._channels.server.report(PlayState(status, self._t_ns, speed, jumped))

    def _answer(self, asked: PlayRequest) -> PlayState:
        """Answer a viewer at once, as the protocol wants; what is played then is reported later."""
        self._requests.put(asked)
        jumped = asked.seek_ns is not None
        t_ns = self._t_ns if asked.seek_ns is None else asked.seek_ns
        return PlayState(PLAYING if asked.plays else PAUSED, t_ns, asked.shown_speed, jumped)

    def close(self) -> None:
        """Hang up."""
        self._channels.close()
