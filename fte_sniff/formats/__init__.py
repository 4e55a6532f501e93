"""Text logs in; tables and exports out.

Modules:

    cell_text    Text fitted to terminal cells; times and numbers in few characters (rich).
    decoders     Decoders for other tools, generated from the frame table.
    input_kind   The format of an input; chunks of raw bytes.
    log_form     What a log is read as: its kind, and the bytes of its streams.
    log_reader   LogReader: the bytes of a text, whose kind a sample of its lines decides.
    logs         Logs of other tools, in which frames show where the bytes are.
    parquet      Write Parquet files (polars).
    pcapng       Write pcapng files, for Wireshark.
    plain_log    Logs without other text: plain hex, and rows that this program wrote.
    text_blocks  Text of any encoding as lines of UTF-8 bytes; very long lines in segments.
    text_frame   Lines of a text table from a whole DataFrame (polars).
    text_layout  Cells of a text table: row texts, widths and order.
    text_table   Rows as lines of a table, and explained byte by byte.
    writers      Output formats, and the writers of CSV, JSONL and hex.
"""
