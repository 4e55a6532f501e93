"""MCAP recordings: write, read, repair, rotate.

Modules:

    file_identity  Deletion of a file only if it is still ours.
    file_lock      Locks of recordings that are being written.
    foreign_topic  Serial bytes in topics of other tools.
    mcap           MCAP container I/O, including truncated and damaged files.
    messages       Rows as protobuf messages and back.
    metadata       Port facts, recorded gaps and selection as MCAP metadata.
    output_file    Path choice, existing files, pipes, refusals.
    reader         RecordingReader: read one recording, also while it grows.
    reading_pass   ReadingPass: one pass over a recording, decoded by several threads.
    recorder       Recorder: rows in, files out, gaps on write errors, rotation.
    repair         Repair a damaged recording.
    retention      Rotation and size limits; which old files are deleted.
    trigger        Keep rows only around rows that match.
    writer         Writers of one recording: rows as they come, and batches.
"""
