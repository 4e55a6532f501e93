"""Decoders for other tools, generated from the frame table.

Modules:

    json_schema  The JSON Schema of the JSON lines.
    sigrok       A protocol decoder for PulseView and sigrok-cli, stacked on `uart`.
    tools        The tools, and the folder in which each finds a decoder of the user.
    wireshark    A dissector in Lua for Wireshark and tshark.

The code of a decoder that does not depend on the protocol is a template beside these modules.
"""
