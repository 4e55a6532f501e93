"""Recordings: rows and port events out to MCAP files, and in again, exactly as they were.

This package must not know where rows come from, who looks at them, or any other file format. It
re-exports nothing, so that no light command pays for mcap and protobuf. From the bottom up; each
imports only from those above it:

    encoding/    rows and events to the bytes of messages, and back
    container/   the file that these lie in, whoever wrote it and whatever befell it
    writing/     one capture into one file, or as many as it takes     } these two do
    reading/     the rows and events of a file, one by one or at once  } not know each other
    mending/     a damaged file to a whole one

A recording on disk (https://mcap.dev/spec):

    magic  Header  Metadata "fte-sniff"  Schemas  Channels    an empty capture explains itself
    Chunk  MessageIndex...                                    once or more a second, zstd, CRC
    Chunk  MessageIndex...
    DataEnd  summary  Footer  magic                           written anew behind each new chunk

Schemas and channels stand a second time in the first chunk that uses them: there a checksum guards
them, and the reader believes that copy more than the one at the head.
"""
