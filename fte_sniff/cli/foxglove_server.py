"""`--serve`: a capture's rows for viewers, over the Foxglove WebSocket protocol (foxglove-sdk)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from fte_sniff.cli.capture_loop import Observer
from fte_sniff.cli.extras import install_command
from fte_sniff.cli.streams import print_err
from fte_sniff.errors import UsageError, printable
from fte_sniff.protocol import PortEvent, Row

if TYPE_CHECKING:
    from fte_sniff.analysis.feed import FeedUpdate
    from fte_sniff.recording.messages.schema import Topic
    from fte_sniff.session.capture_state import CapturePlan
    from fte_sniff.session.live_session import LiveSession

DEFAULT_ADDRESS: Final = "127.0.0.1:8765"
"""Where viewers look if the user names no other."""

MOST_WAITING: Final = 4096
"""Messages that wait for a slow viewer; then it loses the oldest."""


class FoxgloveServer(Observer):
    """Serves the channels of a recording: the same topics, schemas and messages.

    The library has a queue for each viewer and never waits for one.
    """

    def __init__(self, address: tuple[str, int], plan: CapturePlan) -> None:
        """Listen at the address.

        Raises UsageError if foxglove-sdk is not installed, or the address cannot be used.
        """
        try:
            import foxglove
        except ImportError:
            raise UsageError(
                f"--serve needs the package foxglove-sdk: {install_command('foxglove')}"
            ) from None
        host, port = address
        foxglove.set_log_level("ERROR")
        self._sdk = foxglove
        self._context = foxglove.Context()
        try:
            self._server = foxglove.start_server(
                name="fte-sniff",
                host=host,
                port=port,
                context=self._context,
                message_backlog_size=MOST_WAITING,
            )
        except (OSError, RuntimeError, ValueError) as error:
            reason = printable(" ".join(str(error).split()))
            raise UsageError(
                f"--serve {host}:{port} cannot be used: {reason}; name another port"
            ) from error
        self._address = f"{host}:{self._server.port}"
        self._channels: dict[tuple[str, str], Any] = {}
        self._ports = plan.wiring.names

    def begun(self, session: LiveSession) -> None:
        """Advertise every topic of every port, and print the address."""
        from fte_sniff.recording.messages.schema import TOPICS

        for port in self._ports:
            for topic in TOPICS:
                self._channel(port, topic)
        print_err(f"viewers can connect to ws://{self._address} (Foxglove WebSocket)")

    def update(self, update: FeedUpdate, session: LiveSession) -> None:
        """Send the rows and port events, in order of time."""
        from fte_sniff.recording.messages.encode import encode_event, encode_row, topic_of
        from fte_sniff.recording.messages.schema import EVENTS

        entries: list[Row | PortEvent] = [*update.rows, *update.events]
        for entry in sorted(entries, key=lambda entry: entry.t_ns or 0):
            t_ns = entry.t_ns or 0
            if isinstance(entry, PortEvent):
                message = encode_event(entry, t_ns)
                self._channel(entry.port, EVENTS).log(message, log_time=t_ns)
            else:
                topic = topic_of(entry)
                message = encode_row(topic, entry, t_ns)
                self._channel(entry.port, topic).log(message, log_time=t_ns)

    def ended(self, session: LiveSession) -> None:
        """Hang up."""
        self._server.stop()

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
