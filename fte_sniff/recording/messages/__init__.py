"""Rows as protobuf messages and back.

Modules:

    codec        One row to one message by protobuf, and back; the channels' readers.
    columns      Decoder of chunks, many messages at once.
    definitions  The channels of a recording whose own definitions are damaged.
    packer       Encoder of rows and port events.
    schema       Topics and protobuf schemas.
    wire_layout  Fixed layouts in the protobuf wire format.
"""
