"""A server of Foxglove's WebSocket protocol: `--serve`, with the messages of a recording.

    capture ──update──► FoxgloveServer │ its thread ──► viewer: channels that it subscribed to
                                       │            ──✗ viewer that does not read: dropped

The protocol is that of https://github.com/foxglove/ws-protocol, docs/spec.md; its present name and
the one before 2025 are equal in what is used here. A web page that the user visits can connect to
any port of this machine, also by a name that leads there: the library checks the Origin that a
browser sends, and `_refused` the Host.

Importing this module raises ImportError if the package websockets is not installed.
"""

from __future__ import annotations

import asyncio
import json
import logging
import os
import re
import socket
import struct
from base64 import b64encode
from collections.abc import Collection, Sequence
from contextlib import suppress
from http import HTTPStatus
from threading import Thread
from typing import Any, Final

from websockets.asyncio.server import ServerConnection, broadcast, serve
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response
from websockets.typing import Origin, Subprotocol

from fte_sniff.analysis.feed import FeedUpdate
from fte_sniff.cli.capture_loop import Observer, in_order
from fte_sniff.cli.streams import print_err
from fte_sniff.errors import UsageError, encodable
from fte_sniff.protocol.items import PortEvent
from fte_sniff.protocol.rows import Rows
from fte_sniff.recording import schema
from fte_sniff.session.live_session import LiveSession

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


def _origin(name: str) -> Origin:
    """The origin that a user names; `plots.example.org` and a link to its top page are allowed."""
    return Origin((name if "://" in name else f"https://{name}").rstrip("/"))


class FoxgloveServer(Observer):
    """Serves the rows and port events of a capture as they come, in a thread of its own."""

    def __init__(
        self, address: tuple[str, int], ports: Sequence[str], origins: Collection[str] = ()
    ) -> None:
        """Listen at the address: host and port, where port 0 is any that is free.

        `ports` are those of the rows, `origins` those of further web pages that may read. Raises
        UsageError if the address cannot be used.
        """
        self._origins, self._name = origins, address[0]
        keys = ((port, topic) for port in ports for topic in schema.TOPICS)
        self._channels = {key: number for number, key in enumerate(keys, 1)}
        self._viewers: dict[ServerConnection, dict[int, int]] = {}
        """Of each viewer, its subscriptions by channel."""
        self._runner, self._is_ending = asyncio.Runner(), asyncio.Event()
        try:
            family = socket.AF_INET6 if ":" in address[0] else socket.AF_INET
            listening = socket.create_server(address, family=family)
        except OSError as error:
            why = os.strerror(error.errno or 0)
            raise UsageError(
                f"--serve {address[0]}:{address[1]}: {why}; name another port, as in --serve 8766"
            ) from None
        self.url = f"ws://{address[0]}:{listening.getsockname()[1]}"
        self._loop = self._runner.get_loop()
        arguments = (self._run(listening),)
        self._thread = Thread(target=self._runner.run, args=arguments, daemon=True)
        self._thread.start()

    @property
    def wanted(self) -> set[int]:
        """The channels that viewers subscribed to."""
        return set().union(*list(self._viewers.values()))

    def begun(self, session: LiveSession) -> None:
        """Print the address."""
        print_err(f"viewers can connect to {self.url} (Foxglove WebSocket)")

    def update(self, update: FeedUpdate, session: LiveSession | None = None) -> None:
        """Send the rows and port events that viewers subscribed to, in order of time."""
        sending = self._send(update.rows, update.events)
        asyncio.run_coroutine_threadsafe(sending, self._loop).result()

    def ended(self, session: LiveSession | None = None) -> None:
        """Hang up; viewers that do not read the last messages at once lose them."""
        self._loop.call_soon_threadsafe(self._is_ending.set)
        self._thread.join()
        self._runner.close()

    # What follows runs in the thread of the loop.

    async def _run(self, listening: socket.socket) -> None:
        """Serve until the end."""
        logging.disable()  # the libraries would write on the screen
        server = await serve(
            self._serve,
            sock=listening,
            process_request=self._refused,
            origins=[None, *map(_origin, (FOXGLOVE_ORIGIN, *self._origins)), _THIS_MACHINE],
            subprotocols=[*map(Subprotocol, SUBPROTOCOLS)],
            compression=None,
            ping_interval=None,
            close_timeout=_CLOSE_S,
        )
        await self._is_ending.wait()
        server.close()
        with suppress(TimeoutError):
            await asyncio.wait_for(server.wait_closed(), 2 * _CLOSE_S)
        for viewer in self._viewers:
            viewer.transport.abort()

    def _refused(self, connection: ServerConnection, request: Request) -> Response | None:
        """The answer to a request for another host; None for others."""
        hosts = request.headers.get_all("Host")
        if all(allows_host(host, self._name) for host in hosts):
            return None
        return connection.respond(HTTPStatus.FORBIDDEN, f"this is not {', '.join(hosts)}\n")

    async def _serve(self, connection: ServerConnection) -> None:
        """Serve one viewer until it leaves; a message that is not understood is skipped."""
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
        channels = [
            {
                "id": number,
                "topic": topic.name,
                "encoding": "protobuf",
                "schemaName": schema.schema_name(topic),
                "schemaEncoding": "protobuf",
                "schema": b64encode(schema.schema_data(topic.schema)).decode(),
                "metadata": {"port": encodable(port)},
            }
            for (port, topic), number in self._channels.items()
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
        for viewer in self._viewers:
            transport = viewer.transport
            if not transport.is_closing() and transport.get_write_buffer_size() > MOST_UNREAD:
                transport.abort()
                name = "{}:{}".format(*viewer.remote_address[:2])
                print_err(f"the viewer {name} did not read, and was disconnected")
        for entry in in_order(rows, events) if self.wanted else ():
            t_ns = entry.t_ns or 0
            message = schema.encode(entry, t_ns)
            channel = self._channels[entry.port, schema.topic_of(entry)]
            for viewer, subscriptions in self._viewers.items():
                if channel in subscriptions:
                    broadcast([viewer], _MESSAGE.pack(1, subscriptions[channel], t_ns) + message)
