"""Rows as protobuf messages and back.

Modules:

    codec        One row to one message and back.
    columns      Messages to RowBatch.
    index        Message starts in an unpacked chunk.
    packer       RowBatch to messages.
    schema       Protobuf schemas, topics, channel metadata.
    wire_layout  Protobuf wire format offsets and varints.
"""
