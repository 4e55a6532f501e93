"""Rows of a capture for other programs: the options of `--udp` and `--serve`, and the datagrams.

`--udp` sends JSON objects as datagrams, for example to PlotJuggler; `foxglove_server` has the
WebSockets of `--serve`.
"""

from __future__ import annotations

import socket
from dataclasses import asdict
from typing import TYPE_CHECKING, Final

import click

from fte_sniff.cli.capture_loop import Observer, in_order
from fte_sniff.cli.options import all_of
from fte_sniff.cli.streams import print_err
from fte_sniff.errors import UsageError, printable, reason_of
from fte_sniff.formats.writers import json_text
from fte_sniff.protocol import PortEvent, Row, iso_time, record

if TYPE_CHECKING:
    from fte_sniff.analysis.feed import FeedUpdate
    from fte_sniff.analysis.filter.row_filter import RowFilter
    from fte_sniff.session.live_session import LiveSession


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


data_options = all_of(
    click.option(
        "--udp",
        metavar="[HOST:]PORT",
        help="Send each row as a JSON object to this UDP port of this machine.",
    ),
    click.option(
        "--serve",
        is_flag=False,
        callback=_checked,
        flag_value=DEFAULT_ADDRESS,
        metavar="[[HOST:]PORT]",
        help=f"Serve the rows to viewers over WebSocket, by default at {DEFAULT_ADDRESS}.",
    ),
    click.option(
        "--allow-origin",
        "origins",
        multiple=True,
        metavar="ORIGIN",
        help="With --serve: let web pages from here read too, such as https://plots.example.org.",
    ),
)
"""The options of rows for other programs."""


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
            f"{shown} is not this machine: anyone in that network could read; if they may, set"
            " network = true in [live] of the settings"
        )
    return host, number


def datagram(entry: Row | PortEvent) -> bytes:
    """A JSON object, nested by its topic, so that a plotter names it as a recording's.

    `timestamp` is in seconds since 1970; PlotJuggler takes it as the time. Values that a row does
    not have are left out.
    """
    from fte_sniff.recording.schema import EVENTS, topic_of

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
