"""Other people's logs in, tables out.

Nothing here knows a port, a recording or a filter. Import the modules one by one, so that a command
loads only what it needs:

    kinds      which kind of input a file is, by its name or its first bytes
    raw        a file of raw bytes, to chunks
    hex_log    hex as people paste it and log it, to chunks with their times; it stands on pastes:
        text_lines   text of whatever encoding, to lines
        code         words of source code around the bytes
        line_head    a time and a direction in front of the bytes
        log_clock    which moment such a time is
        pasted_line  a line on its way to its bytes
        dumps        lines of a hex dump, each a dump_line
        line_numbers numbered lines
        fronts       what stands before the bytes and may be none
        decimals     hex or decimal?
        hex_text     the digits of one line
    writers    what all that follow have in common, and which one serves a format
    layout     a row as the cells of a line of text
    lines      rows to plain or coloured lines
    jsonl      rows to JSON lines
    csv        rows to comma-separated values
    parquet    rows as a Parquet file
    hex_lines  the bytes of rows, as lines of hex
    dissection a row taken apart byte by byte, to text
"""
