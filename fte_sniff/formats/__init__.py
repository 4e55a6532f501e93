"""Text logs in; tables and exports out.

Modules:

    cell_text    Text fitted to terminal cells; times and numbers in few characters (rich).
    decoders     Decoders for sigrok, Wireshark and JSON tools, generated from the frame table.
    logs         Logs of any form: plain hex, own rows, and those of other tools.
    parquet      Write Parquet files (polars).
    pcapng       Write pcapng files, for Wireshark.
    text_frame   Lines of a text table from a whole DataFrame (polars).
    text_table   Rows as lines of a table, and explained byte by byte.
    writers      Output formats, and the writers of CSV, JSONL and hex.
"""
