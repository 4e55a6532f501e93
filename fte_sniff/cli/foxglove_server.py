"""A server of Foxglove's WebSocket protocol: `--serve`, with the messages of a recording.

    capture ──update──► FoxgloveServer │ its thread ──► viewer: channels that it subscribed to
                                       │            ──✗ viewer that does not read: dropped

The protocol is that of https://github.com/foxglove/ws-protocol, docs/spec.md; its present name and
the one before 2025 are equal in what is used here. A web page that the user visits can connect to
any port of this machine, also by a name that leads there: the library checks the Origin that a
browser sends, and `_refused` the Host.
"""

from __future__ import annotations

import asyncio
import json
import logging
import re
import socket
import struct
import sys
from base64 import b64encode
from collections.abc import Collection, Coroutine, Sequence
from contextlib import suppress
from http import HTTPStatus
from threading import Thread
from typing import TYPE_CHECKING, Any, Final, TypeVar

from fte_sniff.cli.capture_loop import Observer, in_order
from fte_sniff.cli.streams import print_err
from fte_sniff.errors import UsageError, reason_of
from fte_sniff.protocol.items import PortEvent

if TYPE_CHECKING:
    from websockets.asyncio.server import Server, ServerConnection
    from websockets.http11 import Request, Response

    from fte_sniff.analysis.feed import FeedUpdate
    from fte_sniff.protocol.rows import Rows
    from fte_sniff.session.live_session import LiveSession

Result = TypeVar("Result")

SUBPROTOCOLS: Final = ("foxglove.sdk.v1", "foxglove.websocket.v1")
FOXGLOVE_ORIGIN: Final = "https://app.foxglove.dev"
MOST_UNREAD: Final = 4 << 20
"""Bytes that a viewer may leave unread, beside what the system buffers; then it is dropped."""
_CLOSE_S: Final = 1.0
"""Time for viewers to read the last messages at the end."""
_MESSAGE: Final = struct.Struct("<BIQ")
"""1, subscription, time in nanoseconds; the message follows."""


_THIS_MACHINE: Final = re.compile(
    r"file://|https?://(localhost|127(\.[0-9]+){3}|\[::1\])(:[0-9]+)?"
)
"""Origins of files and of pages of this machine."""
_NUMERIC: Final = re.compile(r"localhost|[0-9.]+|\[[0-9a-f:.]+\]")


def allows_host(host: str, bound: str) -> bool:
    """Whether a request names this server: by an IP address, as localhost, or as it is bound.

    Another name is that of a web page whose server lets its name lead to this machine.
    """
    name = re.sub(r":[0-9]*$", "", host).lower()
    return name == bound.lower() or _NUMERIC.fullmatch(name) is not None


class FoxgloveServer(Observer):
    """Serves the rows and port events of a capture as they come, in a thread of its own."""

    def __init__(
        self,
        address: tuple[str, int],
        ports: Sequence[str],
        origins: Collection[str] = (),
    ) -> None:
        """Listen at the address: host and port, where port 0 is any that is free.

        `ports` are those of the rows, `origins` those of further web pages that may read. Raises
        UsageError if the package is not installed, or the address cannot be used.
        """
        from fte_sniff.recording.schema import TOPICS

        try:
            import websockets.asyncio.server  # noqa: F401
        except ImportError:
            raise UsageError(
                f"--serve needs websockets: `{sys.executable} -m pip install websockets`"
            ) from None
        self._origins, self._name = origins, address[0]
        keys = ((port, topic.name) for port in ports for topic in TOPICS)
        self._channels = {key: number for number, key in enumerate(keys, 1)}
        self._viewers: dict[ServerConnection, dict[int, int]] = {}
        """Of each viewer, its subscriptions by channel."""
        listening = _listening(address)
        self.url = f"ws://{address[0]}:{listening.getsockname()[1]}"
        self._loop = asyncio.new_event_loop()
        self._thread = Thread(target=self._loop.run_forever, name="serves viewers", daemon=True)
        self._thread.start()
        self._server = self._run(self._listen(listening))

    @property
    def wanted(self) -> set[int]:
        """The channels that viewers subscribed to."""
        return set().union(*list(self._viewers.values()))

    def begun(self, session: LiveSession) -> None:
        """Print the address."""
        print_err(f"viewers can connect to {self.url} (Foxglove WebSocket)")

    def update(self, update: FeedUpdate, session: LiveSession) -> None:
        """Send the rows and port events that viewers subscribed to, in order of time."""
        self.send(update.rows, update.events)

    def ended(self, session: LiveSession) -> None:
        """Hang up."""
        self.close()

    def send(self, rows: Rows, events: Sequence[PortEvent]) -> None:
        """Send rows and port events to the viewers of their channels."""
        self._run(self._send(rows, events))

    def close(self) -> None:
        """Hang up; viewers that do not read the last messages at once lose them."""
        self._run(self._hang_up())
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
        self._loop.close()

    def _run(self, coroutine: Coroutine[Any, Any, Result]) -> Result:
        return asyncio.run_coroutine_threadsafe(coroutine, self._loop).result()

    # What follows runs in the thread of the loop.

    async def _listen(self, listening: socket.socket) -> Server:
        from websockets.asyncio.server import serve
        from websockets.typing import Origin, Subprotocol

        own = logging.getLogger(f"{__name__}.library")
        for quiet in (own, logging.getLogger("asyncio")):  # they would write on the screen
            quiet.propagate = False
            quiet.handlers = [logging.NullHandler()]
        return await serve(
            self._serve,
            sock=listening,
            process_request=self._refused,
            origins=[None, *map(Origin, (FOXGLOVE_ORIGIN, *self._origins)), _THIS_MACHINE],
            subprotocols=[*map(Subprotocol, SUBPROTOCOLS)],
            compression=None,
            ping_interval=None,
            close_timeout=_CLOSE_S,
            logger=own,
        )

    def _refused(self, connection: ServerConnection, request: Request) -> Response | None:
        """The answer to a request for another host; None for others."""
        hosts = request.headers.get_all("Host")
        if all(allows_host(host, self._name) for host in hosts):
            return None
        return connection.respond(HTTPStatus.FORBIDDEN, f"this is not {', '.join(hosts)}\n")

    async def _serve(self, connection: ServerConnection) -> None:
        """Serve one viewer until it leaves; a message that is not understood is skipped."""
        from websockets.exceptions import ConnectionClosed

        self._viewers[connection] = {}
        info = {"op": "serverInfo", "name": "fte-sniff", "capabilities": []}
        with suppress(ConnectionClosed):
            await connection.send(json.dumps(info))
            await connection.send(json.dumps(self._advertisement()))
            async for message in connection:
                with suppress(ValueError, TypeError, KeyError, OverflowError, RecursionError):
                    self._subscribe(connection, json.loads(message))
        del self._viewers[connection]

    def _advertisement(self) -> dict[str, Any]:
        from fte_sniff.recording.schema import TOPICS, encodable, schema_data, schema_name

        topics = {topic.name: topic for topic in TOPICS}
        channels = [
            {
                "id": number,
                "topic": name,
                "encoding": "protobuf",
                "schemaName": schema_name(topics[name]),
                "schemaEncoding": "protobuf",
                "schema": b64encode(schema_data(topics[name].schema)).decode(),
                "metadata": {"port": encodable(port)},
            }
            for (port, name), number in self._channels.items()
        ]
        return {"op": "advertise", "channels": channels}

    def _subscribe(self, viewer: ServerConnection, request: Any) -> None:
        found = self._viewers[viewer]
        if request["op"] == "subscribe":
            pairs = [(int(one["id"]), int(one["channelId"])) for one in request["subscriptions"]]
            known = {*self._channels.values()}
            found = found | {at: own for own, at in pairs if at in known and 0 <= own < 1 << 32}
        elif request["op"] == "unsubscribe":
            gone = {*map(int, request["subscriptionIds"])}
            found = {at: own for at, own in found.items() if own not in gone}
        self._viewers[viewer] = found

    async def _send(self, rows: Rows, events: Sequence[PortEvent]) -> None:
        """Send to the viewers that subscribed; those that do not read are disconnected."""
        from websockets.asyncio.server import broadcast

        from fte_sniff.recording.schema import EVENTS, encode_event, encode_row, topic_of

        for viewer in self._viewers:
            transport = viewer.transport
            if not transport.is_closing() and transport.get_write_buffer_size() > MOST_UNREAD:
                transport.abort()
                name = "{}:{}".format(*viewer.remote_address[:2])
                print_err(f"the viewer {name} did not read, and was disconnected")
        wanted = self.wanted
        for entry in in_order(rows, events) if wanted else ():
            t_ns = entry.t_ns or 0
            if isinstance(entry, PortEvent):
                topic, encoded = EVENTS, encode_event(entry, t_ns)
            else:
                topic = topic_of(entry)
                encoded = encode_row(topic, entry, t_ns)
            channel = self._channels[entry.port, topic.name]
            for viewer, subscriptions in self._viewers.items():
                if channel in subscriptions and not viewer.transport.is_closing():
                    broadcast([viewer], _MESSAGE.pack(1, subscriptions[channel], t_ns) + encoded)

    async def _hang_up(self) -> None:
        self._server.close()
        viewers = [*self._viewers]
        with suppress(TimeoutError):
            await asyncio.wait_for(self._server.wait_closed(), 2 * _CLOSE_S)
        for viewer in viewers:
            viewer.transport.abort()
        for task in asyncio.all_tasks() - {asyncio.current_task()}:
            task.cancel()


def _listening(address: tuple[str, int]) -> socket.socket:
    host, port = address
    try:
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        return socket.create_server(address, family=family)
    except OSError as error:
        reason, _, _ = reason_of(error).partition(" (while")  # Python adds the address
        raise UsageError(
            f"--serve {host}:{port}: {reason}; name another port, as in --serve 8766"
        ) from None
