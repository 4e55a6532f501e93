"""Other people's logs in, tables out.

Nothing here knows a port, a recording or a filter. Import the modules one by one, so that a command
loads only what it needs:

    kinds      which kind of input a file is, by its name or its first bytes
    raw        a file of raw bytes, to chunks
    logs/      hex as people paste it and log it, to chunks with their times
    tables/    rows out: as lines of text, JSON, CSV, Parquet
"""
