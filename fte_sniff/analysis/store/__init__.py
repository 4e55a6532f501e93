"""The rows behind a screen: a bounded run of them, with a filter on top.

It must not know a screen, a clock or a file.

    feed            what a view asks of whatever brings it rows
    seams           what stands between two rows: missing ones, another pace
    block           so many rows side by side, and which of them a filter wants
    paging          which blocks lie in memory, where their rows can be read again
    row_run         the blocks as one run of rows, of which the oldest leave
    shown           which of them a filter leaves
    row_store       RowStore: both together
    finding         looking through them, a block at a time
    hits            counting the rows that pass a test
    search          a text or bytes, looked for in rows
    search_texts    what each row tells, as polars expressions
"""
