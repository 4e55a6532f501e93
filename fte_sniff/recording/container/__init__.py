"""MCAP files as such: records, chunks, checksums and the summary at the end.

It must not know rows or topics.

    records      what records look like, and how large one may be to be believed
    unpacking    a chunk to its records, checked
    record_stream   the records of any MCAP file, cut, damaged or hostile as it may be
    checksum     CRC-32, at the speed of memory
    tail         data end, summary, footer, magic, wherever they are put
    growing      how bytes come to the disk, so that the file never ends wrong
    packed_chunk a chunk with its indexes, ready to be written anywhere
    mcap_file    an MCAP file that grows by whole chunks
    summary      what a file's summary tells before its rows are read
    salvage      what is whole in a damaged file
    cores        how many threads bulk work is worth
    memory       freed memory kept for the next chunk
"""
