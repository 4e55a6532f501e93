"""`--serve`: rows for viewers, of a capture or a played file (foxglove-sdk).

The protocol is that of Foxglove's WebSocket.
"""

from __future__ import annotations

import logging
import re
import socket
from collections.abc import Iterator, Sequence
from math import inf
from queue import Empty, SimpleQueue
from threading import Thread
from time import monotonic
from typing import TYPE_CHECKING, Any, Final

from fte_sniff.cli.capture_loop import Observer, in_order
from fte_sniff.cli.extras import install_command
from fte_sniff.cli.streams import print_err
from fte_sniff.errors import UsageError, printable, reason_of
from fte_sniff.platform import POSIX
from fte_sniff.protocol import PortEvent

if TYPE_CHECKING:
    from fte_sniff.analysis.feed import FeedUpdate
    from fte_sniff.protocol.rows import Rows
    from fte_sniff.recording.messages.schema import Topic
    from fte_sniff.session.capture_state import CapturePlan
    from fte_sniff.session.live_session import LiveSession
    from fte_sniff.session.replay import Playback, PlayRequest

MOST_WAITING: Final = 4096
"""Messages that wait for a slow viewer; then it loses the oldest."""


_MOST_NAMED: Final = 3

_HANG_UP_S: Final = 1.0
"""How long viewers may take to read the last messages at the end, seconds."""

_FULL: Final = re.compile(r"outbox for client (\S+) full")


class _Log(logging.Handler):
    """Receives the library's log, which then writes nothing on the screen.

    Only the log shows that a viewer loses messages; it has one line for many of them.
    """

    def __init__(self, library: Any) -> None:
        super().__init__()
        self.slow: dict[str, None] = {}
        """The addresses of viewers that lost messages."""
        logger = logging.getLogger(library.__name__)
        logger.propagate = False
        logger.setLevel(logging.INFO)
        logger.handlers = [self]
        library.set_log_level("INFO")

    def emit(self, record: logging.LogRecord) -> None:
        """Remember the viewer of a message that was dropped."""
        if found := _FULL.search(record.getMessage()):
            self.slow[found[1]] = None


def _check_free(host: str, port: int) -> None:
    """Raise UsageError if the address cannot be used: the library's reasons are its internals."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        with socket.socket(family) as found:
            if POSIX:  # on Windows it would allow an address that is in use
                found.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            found.bind((host, port))
    except OSError as error:
        raise UsageError(
            f"--serve {host}:{port}: {reason_of(error)}; name another port, as in"
            f" --serve {(port + 1) % (1 << 16)}"
        ) from None


class ServedChannels:
    """The channels of a recording for viewers: the same topics, schemas and messages.

    The library has a queue for each viewer and never waits for one.
    """

    def __init__(self, address: tuple[str, int], ports: Sequence[str], **options: Any) -> None:
        """Listen at the address; the options are those of the library's server.

        Raises UsageError if foxglove-sdk is not installed, or the address cannot be used.
        """
        try:
            import foxglove
        except ImportError:
            raise UsageError(
                f"--serve needs the package foxglove-sdk: {install_command('foxglove')}"
            ) from None
        host, port = address
        _check_free(host, port)
        self._log = _Log(foxglove)
        self._sdk = foxglove
        self._context = foxglove.Context()
        try:
            self.server = foxglove.start_server(
                name="fte-sniff",
                host=host,
                port=port,
                context=self._context,
                message_backlog_size=MOST_WAITING,
                **options,
            )
        except (OSError, RuntimeError, ValueError) as error:
            reason = printable(" ".join(str(error).split()))
            raise UsageError(f"--serve {host}:{port}: {reason}; name another port") from error
        self.text = f"viewers can connect to ws://{host}:{self.server.port} (Foxglove WebSocket)"
        """The address, for the user."""
        self._channels: dict[tuple[str, str], Any] = {}
        self._ports = ports

    def advertise(self) -> None:
        """Advertise every topic of every port."""
        from fte_sniff.recording.messages.schema import TOPICS

        for port in self._ports:
            for topic in TOPICS:
                self._channel(port, topic)

    def send(self, rows: Rows, events: Sequence[PortEvent]) -> None:
        """Send the rows and port events, in order of time."""
        from fte_sniff.recording.messages.encode import encode_event, encode_row, topic_of
        from fte_sniff.recording.messages.schema import EVENTS

        for entry in in_order(rows, events):
            t_ns = entry.t_ns or 0
            if isinstance(entry, PortEvent):
                message = encode_event(entry, t_ns)
                self._channel(entry.port, EVENTS).log(message, log_time=t_ns)
            else:
                topic = topic_of(entry)
                message = encode_row(topic, entry, t_ns)
                self._channel(entry.port, topic).log(message, log_time=t_ns)

    @property
    def slow(self) -> list[str]:
        """The addresses of viewers that lost messages."""
        return list(self._log.slow)

    def close(self) -> None:
        """Hang up, and report the viewers that were too slow."""
        # The library waits for viewers to read what they have not read.
        stop = Thread(target=self.server.stop, name="hangs up", daemon=True)
        stop.start()
        stop.join(_HANG_UP_S)
        if slow := self.slow:
            names = ", ".join(slow[:_MOST_NAMED]) + (", ..." if len(slow) > _MOST_NAMED else "")
            print_err(
                f"{len(slow):,} viewer{'s' * (len(slow) > 1)} read too slowly and lost messages"
                f" ({names}); how many, the library does not count"
            )

    def _channel(self, port: str, topic: Topic) -> Any:
        found = self._channels.get((port, topic.name))
        if found is None:
            from fte_sniff.recording.messages.encode import encodable
            from fte_sniff.recording.messages.schema import schema_data, schema_name

            found = self._channels[port, topic.name] = self._sdk.Channel(
                topic.name,
                schema=self._sdk.Schema(
                    name=schema_name(topic), encoding="protobuf", data=schema_data(topic.schema)
                ),
                message_encoding="protobuf",
                metadata={"port": encodable(port)},
                context=self._context,
            )
        return found


class FoxgloveServer(Observer):
    """Serves the rows of a capture as they come."""

    def __init__(self, address: tuple[str, int], plan: CapturePlan) -> None:
        """Listen at the address; raises UsageError as `ServedChannels`."""
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

        Raises UsageError as `ServedChannels`.
        """
        self._requests: SimpleQueue[PlayRequest] = SimpleQueue()
        self._span_ns, self._t_ns = span_ns, [span_ns[0]]
        self._channels = ServedChannels(
            address,
            ports,
            playback_time_range=span_ns,
            server_listener=_listener(self._requests, self._t_ns),
        )
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
        from foxglove.websocket import PlaybackState, PlaybackStatus

        status, speed, t_ns = PlaybackStatus.Ended, 1.0, self._span_ns[1]
        if play is not None:
            speed, t_ns = play.speed, min(play.t_ns, t_ns)
            status = PlaybackStatus.Playing
            if play.paused:
                status = PlaybackStatus.Paused
            elif play.is_over:
                status = PlaybackStatus.Ended
        shown, now_s = (str(status), speed), monotonic()
        self._t_ns[0] = max(t_ns, 0)
        if shown == self._shown and not jumped and now_s < self._due_s:
            return
        self._shown, self._due_s = shown, now_s + STATE_INTERVAL_S
        state = PlaybackState(status, max(t_ns, 0), speed, jumped, None)
        self._channels.server.broadcast_playback_state(state)

    def close(self) -> None:
        """Hang up."""
        self._channels.close()


def _listener(requests: SimpleQueue[PlayRequest], shown: Sequence[int]) -> Any:
    """Queues the requests of viewers, which come in threads of the library.

    `shown` has one item: the time that is played.
    """
    from foxglove.websocket import (
        PlaybackCommand,
        PlaybackState,
        PlaybackStatus,
        ServerListener,
    )

    from fte_sniff.session.replay import PlayRequest

    class Listener(ServerListener):
        def on_playback_control_request(self, playback_control_request: Any) -> PlaybackState:
            """Answer at once, as the protocol wants; what is played then is reported later."""
            asked = playback_control_request
            plays = asked.playback_command == PlaybackCommand.Play
            found = PlayRequest(plays, asked.playback_speed, asked.seek_time)
            requests.put(found)
            status = PlaybackStatus.Playing if plays else PlaybackStatus.Paused
            t_ns = shown[0] if found.seek_ns is None else found.seek_ns
            jumped = found.seek_ns is not None
            return PlaybackState(status, t_ns, found.shown_speed, jumped, asked.request_id)

    return Listener()
