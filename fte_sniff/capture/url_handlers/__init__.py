"""Ports of pyserial by URL, found by their module names, `protocol_<scheme>`.

A module has a class `Serial` with pyserial's interface, of which a capture uses `open`, `close`,
`in_waiting` and `read`. `read` waits at most for the timeout that pyserial sets, and raises OSError
when the port is lost. An OSError or a ValueError of `open` becomes one line; where its cause is a
PortError, that line. The scheme of a port behind a server is also one of
`port_errors.NETWORK_SCHEMES`: its address is checked, and a lost one is opened again.

Modules:

    protocol_rfc2217  A serial port over telnet; loses no bytes when the connection fails.
    protocol_sim      The simulated host and controller.
    protocol_socket   Bare bytes over TCP, from the first one.
"""
