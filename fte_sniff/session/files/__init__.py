"""Files that are read: as the feed of a view, and as tables.

It must not know what shows the rows or asks for them.

    replay     a file as a feed for a view
    packed     a recording's columns to the packed rows of a view
    pages      a recording's rows once more, by their number
    tables     recordings as polars tables
    earliest   where a filter lets such a table begin
"""
