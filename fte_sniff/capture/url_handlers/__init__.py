"""Ports of pyserial by URL, found by their module names, `protocol_<scheme>`.

A module has a class `Serial` with pyserial's interface. Of this the program uses:

    open         May wait some seconds, in which a capture does not end; where a port comes later,
                 `read` waits for it. An OSError or a ValueError becomes one line; where its cause
                 is a PortError, that line.
    close        Also after a loss.
    in_waiting   The number of bytes to request from `read`; with 0, one is requested.
    read         Waits at most for `timeout`. Raises OSError when the port is lost, after all bytes
                 that came before.
    write        In a bridge: raises OSError when the port is lost.

A class that inherits `read` or `write` of pyserial's ports of devices or sockets is read or written
through their descriptor, which is faster; its own `read` and `write` are always used.

`tests/capture/test_url_handlers.py` has a line of each scheme for the tests of these rules.

Modules:

    protocol_rfc2217  A serial port over telnet; loses no bytes when the connection fails.
    protocol_sim      The simulated host and controller.
    protocol_socket   Bare bytes over TCP, from the first one.
"""

from __future__ import annotations

from typing import Final

SCHEMES: Final = ("alt", "cp2110", "hwgrep", "loop", "rfc2217", "sim", "socket", "spy")
"""Schemes that can be opened: pyserial's, and `sim`."""

NETWORK: Final = frozenset({"rfc2217", "socket"})
"""Schemes of servers: the URL names a host and a TCP port, and a lost one is connected again."""

NETWORK_LATENCY_NS: Final = 20_000_000
"""How much later than at a port of this machine bytes arrive, at most, in a local network."""


def scheme_of(name: str) -> str:
    """The URL scheme of a port's name in lower case; empty for a device."""
    scheme, mark, _ = name.partition("://")
    return scheme.lower() if mark else ""


def is_network(name: str) -> bool:
    """Whether the port of this name, a URL or a device, is at a server."""
    return scheme_of(name) in NETWORK
