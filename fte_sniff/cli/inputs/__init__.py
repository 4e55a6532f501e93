"""Files and standard input, opened and read through a filter.

It must not know what a command does with the rows.

    opening     how files are named, and opened
    one_input   one of them, whatever it is
    batches     rows on their way through a command, many at once
    reading     inputs through a filter, and what is known of them then
"""
