"""Ports of pyserial by URL, found by their module names, `protocol_<scheme>`.

Modules:

    protocol_rfc2217  A serial port over telnet; loses no bytes when the connection fails.
    protocol_sim      The simulated host and controller.
    protocol_socket   Bare bytes over TCP, from the first one.
"""
