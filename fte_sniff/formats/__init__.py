"""Text logs in; tables and exports out.

Modules:

    cell_text    Text fitted to terminal cells; times and numbers in few characters (rich).
    input_kind   The format of an input; chunks of raw bytes.
    logs         Logs of other tools, read as rows.
    parquet      Write Parquet files (polars).
    text_frame   Lines of a text table from a whole DataFrame (polars).
    text_layout  Cells of a text table: row texts, widths and order.
    text_table   Rows as lines of a table, and explained byte by byte.
    writers      Output formats, and the writers of CSV, JSONL and hex.
"""
