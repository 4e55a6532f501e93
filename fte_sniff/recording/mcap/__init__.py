"""MCAP container I/O, including truncated and damaged files.

Modules:

    reader  Records of a file, whole or damaged; its summary; the messages of a chunk.
    writer  A file that is valid after every flush: chunks, indexes, summary.
"""
