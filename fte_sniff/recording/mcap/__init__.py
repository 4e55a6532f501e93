"""MCAP container I/O, including truncated and damaged files.

Modules:

    append_file  A file that is valid MCAP after every flush.
    reader       Walk records; read summary and indexes.
    records      MCAP records: parse, decompress, CRC, end of file.
    salvage      Find intact chunks in a damaged file.
    writer       Write chunks, indexes, summary.
"""
