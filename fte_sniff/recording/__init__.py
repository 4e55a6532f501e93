"""Recordings: rows and port events out to MCAP files, and in again, exactly as they were.

This package must not know where rows come from, who looks at them, or any other file format. It
re-exports nothing, so that no light command pays for mcap and protobuf. To read it, in this order:

    facts      what a recording says about itself: ports, host, clocks
    topics     which row goes to which topic, derived from the frame table
    schema     the protobuf schema of each topic, derived from the frame table
    wire       how the fields of a message lie one behind the other
    messages   one row or event to the bytes of its message, and back
    plain_messages  the same for sound frames, quickly
    channels   the numbers of schemas and channels
    model      where values stand in the bytes of sound frames' messages
    batch      many rows and events to the messages of one chunk
    tail       data end, summary, footer, magic, wherever they are put
    growing    how bytes come to the disk, so that the file never ends wrong
    container  an MCAP file that grows by whole chunks
    place      the file: made, locked, put in its place, missed when it is gone
    outlet     what cannot seek: standard output, pipes, devices
    writer     RecordingWriter: rows in log order, into a container
    keeping    what is to be kept: bounds, rotation, what surrounds an event
    trigger    which rows surround one that was asked for
    shelf      the files of one capture, and the room they may take
    stretches  what a recording says of rows that are not in it
    gaps       what is missed while the disk fails, and when it is tried again
    recorder   Recorder: one capture into one file, or as many as it takes
    memory     freed memory kept for the next chunk
    checksum   CRC-32, at the speed of memory
    records    the records of any MCAP file, cut, damaged or hostile as it may be
    summary    what a file's summary tells before its rows are read
    reading    one pass over the records, one by one
    columns    rows side by side, in numpy arrays
    layout     where fields stand in messages that are equally long
    starts     where the messages of a chunk begin
    side       messages of one length side by side
    side_rows  those of one layout to columns at once
    usual      the messages of sound frames to columns at once
    gather     any messages to columns, as many at once as can be
    span       a part of time
    passage    some rows by where they stand in the file, to be read again
    bulk       one pass over the records by columns, on all cores
    reader     RecordingReader: the rows and events of a file, one by one or by columns
    row_times  when the first row was and when the last, for little reading
    files      which files a folder or a pattern means, and their order
    topic      the bytes that another program recorded on a topic of its own
    bulk_packing  columns to the messages of a chunk
    bulk_writer   columns to a whole recording
    salvage    what is whole in a damaged file
    believed   which of the definitions found in it are used
    unpacked   the messages of a chunk, whatever they say
    repair     a damaged file to a whole one
    refusals   the lines that tell why a recording cannot begin, or came to stop

A recording on disk (https://mcap.dev/spec):

    magic  Header  Metadata "fte-sniff"  Schemas  Channels    an empty capture explains itself
    Chunk  MessageIndex...                                    once or more a second, zstd, CRC
    Chunk  MessageIndex...
    DataEnd  summary  Footer  magic                           written anew behind each new chunk

Schemas and channels stand a second time in the first chunk that uses them: there a checksum guards
them, and the reader believes that copy more than the one at the head.
"""
