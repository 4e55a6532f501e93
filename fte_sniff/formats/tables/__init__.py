"""Rows out, as text or in a file.

It must not know where rows come from, nor which of them are wanted.

    writers    what all that follow have in common, and which one serves a format
    layout     a row as the cells of a line of text
    lines      rows to plain or coloured lines
    frame_lines  many rows to plain lines at once
    jsonl      rows to JSON lines
    csv        rows to comma-separated values
    parquet    rows as a Parquet file
    times      how polars is told to write a time
    hex_lines  the bytes of rows, as lines of hex
    dissection a row taken apart byte by byte, to text
"""
