"""Rows and events into recordings: live, valid at every moment; or a whole one from columns.

It must not know how a recording is read.

    place         the file: made, locked, put in its place, missed when it is gone
    outlet        what cannot seek: standard output, pipes, devices
    writer        RecordingWriter: rows in log order, into a file
    keeping       what is to be kept: bounds, rotation, what surrounds an event
    trigger       which rows surround one that was asked for
    shelf         the files of one capture, and the room they may take
    gaps          what is missed while the disk fails, and when it is tried again
    recorder      Recorder: one capture into one file, or as many as it takes
    refusals      the lines that tell why a recording cannot begin, or came to stop
    bulk_packing  columns to the messages of a chunk
    ahead         chunks packed by threads while the next are made
    bulk_writer   columns to a whole recording
"""
