"""Rows of a view to a new file, in any of the forms.

It must not know which rows, or why.

    save            the rows, in order, and what becomes of the file if it goes wrong
    origin          what is known of the rows beside them
    sinks           what takes rows for such a file, by its form
    parquet_sink, recording_sink   those of them that need much to be loaded
"""
