"""Rows as protobuf messages and back.

Modules:

    codec        One row to one message by protobuf, and back.
    columns      Decoder of many messages at once.
    index        Message starts in an unpacked chunk.
    packer       Encoder of rows and port events.
    schema       Topics and protobuf schemas.
    wire_layout  Fixed layouts in the protobuf wire format.
"""
