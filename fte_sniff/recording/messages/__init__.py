"""Rows as protobuf messages and back.

Modules:

    decode  Definitions of channels; decoder of message records into rows, many at once.
    encode  Encoder of rows and port events; the channels of a file.
    schema  Topics and protobuf schemas; the layout of a fault-free frame's message.
"""
