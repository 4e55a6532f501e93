"""Rows of a capture for other programs: the options of `--udp` and `--serve`, and the datagrams.

`--udp` sends JSON objects as datagrams, for example to PlotJuggler; `foxglove_server` has the
WebSockets of `--serve`.
"""

from __future__ import annotations

import socket
from dataclasses import asdict
from typing import TYPE_CHECKING, Any, Final

import click

from fte_sniff.cli.capture_loop import Observer, in_order
from fte_sniff.cli.options import all_of
from fte_sniff.cli.streams import print_err
from fte_sniff.errors import UsageError, printable
from fte_sniff.formats.writers import json_text
from fte_sniff.protocol.columns import iso_time, record
from fte_sniff.protocol.items import PortEvent
from fte_sniff.protocol.rows import Row

if TYPE_CHECKING:
    from fte_sniff.analysis.feed import FeedUpdate
    from fte_sniff.analysis.filter.row_filter import RowFilter
    from fte_sniff.session.live_session import LiveSession


DEFAULT_ADDRESS: Final = "127.0.0.1:8765"
"""Where viewers look if the user names no other."""


class _Address(click.ParamType[tuple[str, int]]):
    """`HOST:PORT` or `PORT`; without a host this machine, IPv6 in brackets."""

    name = "address"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[str, int]:
        """The IP address and the port; fails for other texts."""
        name, _, number = value.rpartition(":")
        if not (number.isdecimal() and number.isascii() and int(number) < 1 << 16):
            self.fail(f"{printable(value)} is not HOST:PORT or PORT", param, ctx)
        try:
            found = socket.getaddrinfo(name.strip("[]") or "127.0.0.1", int(number))
        except (OSError, UnicodeError):
            self.fail(f"{printable(value)}: the host is not known", param, ctx)
        return str(found[0][4][0]), int(number)


data_options = all_of(
    click.option(
        "--udp",
        type=_Address(),
        metavar="[HOST:]PORT",
        help="Send each row as a JSON object to this UDP port of this machine.",
    ),
    click.option(
        "--serve",
        is_flag=False,
        type=_Address(),
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


def local(option: str, address: tuple[str, int], is_network: bool) -> tuple[str, int]:
    """The address; raises UsageError if it is of another machine, unless those may read."""
    import ipaddress

    host = address[0].partition("%")[0]
    if not is_network and not ipaddress.ip_address(host).is_loopback:
        raise UsageError(
            f"{option} {host} is not this machine: anyone in that network could read; if they may,"
            " set network = true in [live] of the settings"
        )
    return address


def datagram(entry: Row | PortEvent) -> bytes:
    """A JSON object, nested by its topic, so that a plotter names it as a recording's.

    `timestamp` is in seconds since 1970; PlotJuggler takes it as the time. Values that a row does
    not have are left out.
    """
    from fte_sniff.recording.schema import topic_of

    values: dict[str, object]
    if isinstance(entry, PortEvent):
        values = asdict(entry)
        del values["t_ns"]
    else:
        values = {name: value for name, value in record(entry).items() if value is not None}
    whole: dict[str, object] = {}
    if entry.t_ns is not None:
        values["time"] = iso_time(entry.t_ns)
        whole["timestamp"] = entry.t_ns / 1e9
    nested: object = values
    for part in reversed(topic_of(entry).name.strip("/").split("/")):
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
