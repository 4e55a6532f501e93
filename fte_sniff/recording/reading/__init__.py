"""The rows and events of recordings, in their order, one by one or side by side.

It must not know what rows are used for, nor how a recording is written.

    one_by_one   one pass over the records, one by one
    starts       where the messages of a chunk begin
    side         messages of one length side by side
    side_rows    those of one layout to columns at once
    usual        the messages of sound frames to columns at once
    gather       any messages to columns, as many at once as can be
    span         a part of time
    route        the way through a file, and behind a damage
    passage      some rows by where they stand in the file, to be read again
    bulk         one pass over the records by columns, on all cores
    reader       RecordingReader: the rows and events of a file
    row_times    when the first row was and when the last, for little reading
    files        which files a folder or a pattern means, and their order
    topic        the bytes that another program recorded on a topic of its own
"""
