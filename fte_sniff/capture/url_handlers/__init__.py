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
    baudrate     Is set while the port is open by a bridge and `doctor`, which calls
                 `_reconfigure_port`; a ValueError refuses it.
    dtr, rts     Are set while the port is open by a bridge, which calls `_update_dtr_state` and
                 `_update_rts_state`; an OSError refuses them.

A class that inherits `read` or `write` of pyserial's ports of devices or sockets is read or written
through their descriptor, which is faster; its own `read` and `write` are always used.

`URL_SCHEMES` has what differs besides. `tests/capture/test_url_handlers.py` has a line of each
scheme for the tests of these rules.

Modules:

    protocol_rfc2217  A serial port over telnet; loses no bytes when the connection fails.
    protocol_sim      The simulated host and controller.
    protocol_socket   Bare bytes over TCP, from the first one.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final


@dataclass(frozen=True, slots=True)
class UrlScheme:
    """What differs between URL schemes; the defaults are those of every scheme without an entry."""

    names_address: bool = False
    """Whether the URL must name a host and a TCP port."""
    has_server: bool = False
    """Whether a server has to listen there, which an error asks."""
    comes_back: bool = False
    """Whether a lost port is opened again by its URL."""
    latency_ns: int = 0
    """How much later bytes arrive than at a port of this machine, at most, nanoseconds."""
    sets_lines: bool = False
    """Whether opening always sets DTR and RTS, so that they cannot be left as they are."""


_LOCAL_NETWORK: Final = UrlScheme(
    names_address=True, has_server=True, comes_back=True, latency_ns=20_000_000
)
URL_SCHEMES: Final[Mapping[str, UrlScheme]] = {
    "rfc2217": replace(_LOCAL_NETWORK, sets_lines=True),
    "socket": _LOCAL_NETWORK,
}


def scheme_of(name: str) -> str:
    """The URL scheme of a port's name in lower case; empty for a device."""
    scheme, mark, _ = name.partition("://")
    return scheme.lower() if mark else ""


def url_scheme(name: str) -> UrlScheme:
    """What differs for the port of this name, a URL or a device."""
    return URL_SCHEMES.get(scheme_of(name), UrlScheme())
