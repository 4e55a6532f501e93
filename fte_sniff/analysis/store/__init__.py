"""The rows behind a screen: a bounded run of them, with a filter on top.

It must not know a screen, a clock or a file.

    feed            what a view asks of whatever brings it rows
    block           so many rows side by side, and which of them a filter wants
    paging          which blocks lie in memory, where their rows can be read again
    row_store       RowStore: the blocks as one run of rows
    search          a text or bytes, looked for in rows
    search_texts    what each row tells, as polars expressions
"""
