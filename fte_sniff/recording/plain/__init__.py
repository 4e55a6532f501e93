"""Reading MCAP recordings: the chunks of a file, and the rows in them.

Modules:

    chunks     Where the chunks of a file are: by its summary, or by a search; also as it grows.
    skeletons  Messages of one chunk to rows: those that differ in numbers only are read at once.
    reader     Recording: ports, metadata and rows of a file, in batches; what could not be read.
"""
