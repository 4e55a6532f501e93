"""MCAP container I/O, including truncated and damaged files.

Modules:

    append_file  A file that is valid MCAP after every flush.
    chunk_index  Where the messages of a chunk begin.
    reader       Reader of a file's records, whole or damaged, and of its summary.
    records      MCAP records: parse, decompress, CRC, end of file.
    writer       Writer of chunks, indexes, summary.
"""
