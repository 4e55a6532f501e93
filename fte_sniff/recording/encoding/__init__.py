"""Rows and port events as the bytes of MCAP messages, and back.

It must not know files. What the bytes are is derived from the frame table:

    facts           what a recording says about itself: ports, host, clocks
    stretches       what a recording says of rows that are not in it
    selection       what a copy says of the filter that chose its rows
    topics          which row goes to which topic
    schema          the protobuf schema of each topic
    wire            how the fields of a message lie one behind the other
    messages        one row or event to the bytes of its message
    plain_messages  the same for sound frames, quickly
    message_reader  the bytes of one message back to its row or event
    channels        the numbers of schemas and channels
    model           where values stand in the bytes of sound frames' messages
    batch           many rows and events to the messages of one chunk
    layout          where fields stand in messages that are equally long
    columns         rows side by side, as a recording is read and written at once
"""
