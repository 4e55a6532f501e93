"""Files and standard input, opened and read through a filter.

It must not know what a command does with the rows.

    opening     how files are named, and opened
    one_input   one of them, whatever it is
    framing     bytes of a log, framed in portions
    batches     rows on their way through a command, many at once; few of them as objects
    packed_batches   many of them, side by side
    log_batches      which of both the rows of a log come as
    holes       where rows are missing between those that come
    viewing     inputs on their way to a view
    reading     inputs through a filter, and what is known of them then
"""
