"""Text logs in; tables and exports out.

Modules:

    input_kind   Which format a file has; raw bytes.
    logs         Logs of other tools, read as rows.
    parquet      Write Parquet (polars).
    text_frame   Text rows of a whole DataFrame (polars).
    text_layout  Column widths and order of a text table; needs no polars.
    text_table   Aligned text rows and dissection, plain and coloured.
    writers      Registry and CSV, JSONL, hex writers.
"""
