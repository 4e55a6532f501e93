"""MCAP recordings: write, read, repair, rotate.

Modules:

    foreign_topic  Serial bytes in topics of other tools.
    mcap           MCAP container I/O, including truncated and damaged files.
    messages       Rows as protobuf messages and back: schemas, channels, encoder, decoder.
    metadata       Port facts, recorded gaps and selection as MCAP metadata.
    output_file    The file of a recording: path, lock, identity, pipes, refusals.
    plain          The list of chunks, messages by skeleton, reader, writer and recorder of those.
    reader         RecordingReader: read one recording, in passes, also while it grows.
    recorder       Recorder: rows in, files out, gaps on write errors, rotation.
    repair         Repair a damaged recording.
    retention      What is kept: files within limits, rows around those that trigger.
    writer         Writers of one recording: rows as they come, and batches.
"""
