"""URL handlers that pyserial finds by their module names, `protocol_<scheme>`.

It must not hold anything else: `serial.serial_for_url` searches this package by name, once
`fte_sniff.capture` has added it to `serial.protocol_handler_packages`.

    protocol_sim      the simulated host and controller
    protocol_socket   bare bytes over TCP, the first ones too
    protocol_rfc2217  a serial port over telnet, which keeps what came before the connection died
"""
