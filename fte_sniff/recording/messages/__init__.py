"""Rows as protobuf messages and back.

Modules:

    decode       Decoder of message records into rows, many at once.
    definitions  The channels of a recording, also of one whose own definitions are damaged.
    encode       Encoder of rows and port events.
    schema       Topics and protobuf schemas.
    template     The layout of a fault-free frame's message, to read and to write.
"""
