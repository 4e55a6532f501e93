"""`--serve`: rows for viewers, of a capture or a played file."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from math import inf
from queue import Empty, SimpleQueue
from time import monotonic
from typing import TYPE_CHECKING, Any, Final

from fte_sniff.cli.capture_loop import Observer, in_order
from fte_sniff.cli.foxglove_websocket import (
    ENDED,
    PAUSED,
    PLAYING,
    FoxgloveWebSocket,
    PlayState,
)
from fte_sniff.cli.streams import print_err
from fte_sniff.protocol import PortEvent

if TYPE_CHECKING:
    from fte_sniff.analysis.feed import FeedUpdate
    from fte_sniff.protocol.rows import Rows
    from fte_sniff.recording.messages.schema import Topic
    from fte_sniff.session.capture_process import CapturePlan
    from fte_sniff.session.live_session import LiveSession
    from fte_sniff.session.replay import Playback, PlayRequest


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
        from fte_sniff.recording.messages.schema import TOPICS

        for port in self._ports:
            for topic in TOPICS:
                self._channel(port, topic)

    def send(self, rows: Rows, events: Sequence[PortEvent]) -> None:
        """Send the rows and port events that viewers subscribed to, in order of time."""
        from fte_sniff.recording.messages.encode import encode_event, encode_row, topic_of
        from fte_sniff.recording.messages.schema import EVENTS

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
            from fte_sniff.recording.messages.encode import encodable
            from fte_sniff.recording.messages.schema import schema_data, schema_name

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
