"""Text logs in; tables and exports out.

Modules:

    cell_text    Text fitted to terminal cells; times and numbers in few characters (rich).
    decoders     Decoders for sigrok, Wireshark and JSON tools, generated from the frame table.
    known_files  Files that hold no bytes of a wire, by how they begin.
    log          Log: the chunks of a text log of another program.
    log_text     The text of a log as blocks of lines, from UTF-8, UTF-16 or GBK.
    log_times    Times in the lines of a log.
    plain_hex    Hex without any other text.
    looks        How a status looks: signs and colours.
    parquet      Write Parquet files (polars).
    pcapng       Write pcapng files, for Wireshark.
    text_table   Rows as lines of a table, and explained byte by byte.
    writers      Output formats, and the writers of CSV and JSON lines.
"""
